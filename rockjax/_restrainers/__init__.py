"""Restrainers: devices between the ground and the beam, one module each. A new device needs a module, and
its class in `KINDS`."""

from .base import AbstractRestrainer
from .damper import Damper
from .inerter import Inerter
from .tendon import Tendon

KINDS: dict[str, type[AbstractRestrainer]] = {cls.__name__: cls for cls in (Tendon, Damper, Inerter)}
