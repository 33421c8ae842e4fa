"""Array types for annotations."""

from __future__ import annotations

from jaxtyping import Array, Bool, Float, Int

Value = Float[Array, ""]  # a scalar
Values = Float[Array, "..."]  # a scalar, or an array, for example with an element for each mode or story
Vector = tuple[Values, ...]  # (rotation,), or (rotation, displacements of the modes)
Flag = Bool[Array, ""]  # a boolean
Flags = Bool[Array, "..."]  # booleans
Index = Int[Array, ""]  # an integer
Number = Float[Array, "*batch"]  # a parameter: a scalar, or an array in a batch
