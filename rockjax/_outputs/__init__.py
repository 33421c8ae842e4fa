"""Outputs of a scene, their base classes, the views of a scene that they use, and their registry."""
