"""Rocking podium structures: simulation of uplift, rocking and impacts in JAX, with exact derivatives.

A scene is one structure under one ground motion. Docstrings cite equations by number, such as Eq. (9) or
(C10). Numbers without a letter are those of the paper that docs/model.md names; docs/equations.md states
where the others are.
"""

import os as _os
import sys as _sys
from importlib import import_module as _import_module
from typing import Any

import lazy_loader as _lazy_loader
from jaxlib import version as _jaxlib

from ._version import __version__ as __version__

# __init__.pyi lists the public names and their modules, which are imported on first use.
_load_public_name, __dir__, __all__ = _lazy_loader.attach_stub(__name__, __file__)
_RENAMED = {"AbstractOutlook": "AbstractLookahead"}
_SUBPACKAGES = ("plots",)  # public subpackages


def __getattr__(name: str) -> Any:
    if name in _RENAMED:
        import warnings

        new = _RENAMED[name]
        warnings.warn(f"rockjax.{name} is called rockjax.{new} now", DeprecationWarning, stacklevel=2)
        return __getattr__(new)
    value = _import_module(f".{name}", __name__) if name in _SUBPACKAGES else _load_public_name(name)
    globals()[name] = value
    return value


def _is_command() -> bool:
    """Return whether this process is the command line (`rockjax …`, `python -m rockjax …`), whose help needs
    no JAX."""
    if _sys.argv[:1] == ["-m"]:
        return ("-m", "rockjax") in zip(_sys.orig_argv, _sys.orig_argv[1:], strict=False)
    return _os.path.basename(_sys.argv[0] if _sys.argv else "") in ("rockjax", "rockjax.exe")


if _jaxlib.__version__.startswith("0.10.") and "xla_disable_hlo_passes" not in _os.environ.get(
    "XLA_FLAGS", ""
):
    # This XLA pass expands the barriers between Runge–Kutta stages too early, so that every stage is computed
    # many times.
    _flag = "--xla_disable_hlo_passes=cse_barrier_expander"
    _os.environ["XLA_FLAGS"] = f"{_os.environ.get('XLA_FLAGS', '')} {_flag}".strip()

# Rocking is chaotic, and rounding errors of 1e-7 (float32) would change results. The default is therefore
# float64, unless the environment sets another precision.
if _is_command():
    # JAX reads this variable when it is imported, also in the worker processes of a sweep.
    _os.environ.setdefault("JAX_ENABLE_X64", "1")
else:
    import jax as _jax

    if "JAX_ENABLE_X64" not in _os.environ:
        _jax.config.update("jax_enable_x64", True)
    for _module in ("_responses.simulate", "_batch.batch"):  # modules that nearly every process uses
        _import_module(f".{_module}", __name__)
