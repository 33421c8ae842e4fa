"""Restrainers: devices that resist rocking, one module each. To add a device, write its module and add its
class to `KINDS`."""

from .base import AbstractRestrainer
from .damper import Damper
from .inerter import Inerter
from .tendon import Tendon

KINDS: dict[str, type[AbstractRestrainer]] = {cls.__name__: cls for cls in (Tendon, Damper, Inerter)}
