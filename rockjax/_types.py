"""The types of arrays that modules share: jaxtyping's, by what they hold."""

from __future__ import annotations

from jaxtyping import Array, Bool, Float, Int

Value = Float[Array, ""]  # one number
Vector = tuple[Value, ...]  # one number for each degree of freedom
Flag = Bool[Array, ""]
Index = Int[Array, ""]
Number = Float[Array, "*batch"]  # a parameter: one number, or an array of them
