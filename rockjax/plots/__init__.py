"""Plots. Functions with an argument `ax` return an `Axes`, and most other functions return a `Figure`.

New figures have the style `STYLE`; the user's settings and the style of the user's axes are unchanged. Only
`save_animation` writes a file. Symbols such as α, η/γ, T_s and ω_p/p are those of docs/model.md.
"""

import lazy_loader as _lazy_loader

# `__init__.pyi` lists the public names and the module of each. A module is imported when one of its names is
# first used.
__getattr__, __dir__, __all__ = _lazy_loader.attach_stub(__name__, __file__)
