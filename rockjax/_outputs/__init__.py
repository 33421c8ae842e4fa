"""Outputs of a scene (one podium under one excitation), such as its peak rotation.

`base` has the base classes of outputs, `views` the data that outputs read while a scene is solved, and
`registry` the outputs by name.
"""
