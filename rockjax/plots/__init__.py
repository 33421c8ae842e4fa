"""Pictures. Functions that take an `Axes` (or make one) return it, the others a `Figure`; nothing is shown or
saved here.

Figures made here have the style `STYLE`; settings and axes of the user stay as they are.
"""

import lazy_loader as _lazy_loader

# What is public, and where it is, is said once, in __init__.pyi: imported when it is first asked for.
__getattr__, __dir__, __all__ = _lazy_loader.attach_stub(__name__, __file__)
