"""Rocking podium structures: simulation of uplift, rocking and impacts in JAX, with exact derivatives.

A scene is one structure under one ground motion. Docstrings cite equations by number, such as Eq. (9) or
(C10). Numbers without a letter are from the paper named in docs/model.md. docs/equations.md states which page
has the equations whose numbers begin with a letter.
"""

import os as _os
import sys as _sys
from importlib import import_module as _import_module
from typing import Any

import lazy_loader as _lazy_loader
from jaxlib import version as _jaxlib

from ._version import __version__ as __version__

# `__init__.pyi` lists the public names and the module of each. A module is imported when one of its names is
# first used.
_load_public_name, __dir__, __all__ = _lazy_loader.attach_stub(__name__, __file__)
_SUBPACKAGES = ("plots",)  # public subpackages


def __getattr__(name: str) -> Any:
    value = _import_module(f".{name}", __name__) if name in _SUBPACKAGES else _load_public_name(name)
    globals()[name] = value
    return value


def _is_command() -> bool:
    """Return whether this process runs the command `rockjax …` or `python -m rockjax …`. The command imports
    JAX only when it is needed, so that its help appears at once."""
    if _sys.argv[:1] == ["-m"]:
        return ("-m", "rockjax") in zip(_sys.orig_argv, _sys.orig_argv[1:], strict=False)
    return _os.path.basename(_sys.argv[0] if _sys.argv else "") in ("rockjax", "rockjax.exe")


if _jaxlib.__version__.startswith("0.10.") and "xla_disable_hlo_passes" not in _os.environ.get(
    "XLA_FLAGS", ""
):
    # This XLA pass removes the optimisation barriers between Runge–Kutta stages too early. The compiler would
    # then compute every stage many times.
    _flag = "--xla_disable_hlo_passes=cse_barrier_expander"
    _os.environ["XLA_FLAGS"] = f"{_os.environ.get('XLA_FLAGS', '')} {_flag}".strip()

# Rocking can be chaotic, so the rounding errors of float32 (1e-7) would change results. The default is
# therefore float64, unless the environment variable JAX_ENABLE_X64 is set.
if _is_command():
    # JAX reads this variable on import. The worker processes of a sweep inherit the variable.
    _os.environ.setdefault("JAX_ENABLE_X64", "1")
else:
    import jax as _jax

    if "JAX_ENABLE_X64" not in _os.environ:
        _jax.config.update("jax_enable_x64", True)
    for _module in ("_responses.simulate", "_batch.batch"):  # nearly every process uses these modules
        _import_module(f".{_module}", __name__)
