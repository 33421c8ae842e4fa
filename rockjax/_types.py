"""The types of arrays that modules share: jaxtyping's, by what they hold."""

from __future__ import annotations

from jaxtyping import Array, Bool, Float, Int

Value = Float[Array, ""]  # one number
Values = Float[Array, "..."]  # one number, or a row of them: for each mode, each story
Vector = tuple[Values, ...]  # for each degree of freedom: the rotation, and the modes in one
Flag = Bool[Array, ""]
Flags = Bool[Array, "..."]
Index = Int[Array, ""]
Number = Float[Array, "*batch"]  # a parameter: one number, or an array of them
