"""Gradient-based design of rocking podiums: sizes for which targets hold and an objective is minimal.

A scene is one structure under one ground motion. The overturning margin M of a scene, defined in
docs/overturning.md, is positive if the columns survive and negative if they overturn. The faster the columns
overturn, the lower M is.
"""

import lazy_loader as _lazy_loader

from rockjax import __version__ as __version__

# __init__.pyi lists the public names and their modules; each is imported on first use.
__getattr__, __dir__, __all__ = _lazy_loader.attach_stub(__name__, __file__)
