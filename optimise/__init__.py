"""Gradient-based design of rocking podiums: size the columns so that targets hold and an objective is
least."""

import lazy_loader as _lazy_loader

from rockjax import __version__ as __version__

# What is public, and where it is, is said once, in __init__.pyi: imported when it is first asked for.
__getattr__, __dir__, __all__ = _lazy_loader.attach_stub(__name__, __file__)
