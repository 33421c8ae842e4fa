"""Structures: the column, the podium, what stands on it, and how it takes an impact."""

from .column import STANDARD_GRAVITY, column_of, g_tan_alpha
from .podium import Podium
from .restitution import GivenRestitution
from .superstructures import Elastic, Rigid

__all__ = ["STANDARD_GRAVITY", "Elastic", "GivenRestitution", "Podium", "Rigid", "column_of", "g_tan_alpha"]
