"""Plots. Functions that take an `Axes` (or make one) return it, the others a `Figure`; nothing is shown or
saved here.

Figures made here have the style `STYLE`; settings and axes of the user are unchanged.
"""

import lazy_loader as _lazy_loader

# __init__.pyi is the single list of public names; they are imported on first access.
__getattr__, __dir__, __all__ = _lazy_loader.attach_stub(__name__, __file__)
