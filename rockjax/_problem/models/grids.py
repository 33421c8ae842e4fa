"""Models of the tables of a problem file for `rockjax sweep` and `rockjax ensemble`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from .fields import (
    GRID,
    MACHINES,
    STATISTICS,
    Count,
    Index,
    Keys,
    Number,
    Numbers,
    Points,
    Positive,
    key,
    require_one,
)
from .studies import OneMotion


class Span(Keys):
    """Values of an axis, from one end to the other. Neighbouring values have equal distances or equal
    ratios."""

    low: Number = Field(alias="from", description="First value.")
    high: Number = Field(alias="to", description="Last value.")
    points: Points = key(..., "Number of values.")
    log: bool = key(False, "Whether neighbouring values have equal ratios instead of equal distances.")

    @model_validator(mode="after")
    def _check(self) -> Span:
        if self.log and not (self.low > 0 and self.high > 0):
            raise ValueError(f"equal ratios need from and to > 0, got {self.low:g} and {self.high:g}")
        return self


Axis = Annotated[
    Annotated[Numbers, Tag("list")] | Annotated[Span, Tag("span")],
    Discriminator(lambda given: "span" if isinstance(given, dict) else "list"),
]


class Sweep(OneMotion):
    """Table of `rockjax sweep`. The key `number` selects one motion of a set. Without it, the motions of the
    set form an axis of the grid."""

    outputs: list[str] = key(
        ["peak_rotation"], "Requested outputs: peak_rotation, peak_shear, margin …", GRID
    )
    chunk: Count | None = key(
        None, "Number of scenes computed at a time; by default as many as take some seconds.", MACHINES
    )
    axes: dict[str, Axis] = key({}, "Axes of the grid: name of a parameter → values, as in `rockjax.grid`.")


class Normal(Keys):
    """A normal distribution. If `low` or `high` is given, the distribution is truncated there."""

    kind: Literal["normal"] = key(..., "Kind of the distribution.")
    mean: Number = key(..., "Mean before truncation.")
    std: Positive | None = key(None, "Standard deviation before truncation.")
    cov: Positive | None = key(None, "Coefficient of variation, instead of the standard deviation [–].")
    low: Number | None = key(None, "Lower end.")
    high: Number | None = key(None, "Upper end.")

    @model_validator(mode="after")
    def _check(self) -> Normal:
        if require_one(self.as_arguments(), "std", "cov") == "cov" and self.mean == 0:
            raise ValueError("cov needs a mean other than 0; give std")
        if self.low is not None and self.high is not None and self.low >= self.high:
            raise ValueError(f"low must be less than high, got {self.low:g} and {self.high:g}")
        return self


class LognormalSpread(Keys):
    """A lognormal distribution."""

    kind: Literal["lognormal"] = key(..., "Kind of the distribution.")
    median: Positive = key(..., "Median.")
    dispersion: Positive | None = key(None, "Standard deviation of the logarithm [–].")
    cov: Positive | None = key(None, "Coefficient of variation, instead of the dispersion [–].")

    @model_validator(mode="after")
    def _check(self) -> LognormalSpread:
        require_one(self.as_arguments(), "dispersion", "cov")
        return self


class Uniform(Keys):
    """A uniform distribution."""

    kind: Literal["uniform"] = key(..., "Kind of the distribution.")
    low: Number = key(..., "Lower end.")
    high: Number = key(..., "Upper end.")

    @model_validator(mode="after")
    def _check(self) -> Uniform:
        if self.low >= self.high:
            raise ValueError(f"low must be less than high, got {self.low:g} and {self.high:g}")
        return self


Spread = Annotated[
    Annotated[Number, Tag("number")]
    | Annotated[
        Annotated[Normal, Tag("normal")]
        | Annotated[LognormalSpread, Tag("lognormal")]
        | Annotated[Uniform, Tag("uniform")],
        Field(discriminator="kind"),
        Tag("table"),
    ],
    Discriminator(lambda given: "table" if isinstance(given, dict | Keys) else "number"),
]


class Ensemble(OneMotion):
    """Table of `rockjax ensemble`. The key `number` selects one motion of a set. Without it, every scene
    (a random structure under one motion) draws one of the motions of the set."""

    n: Count = key(1000, "Number of scenes.", GRID)
    seed: Index = key(0, "Seed of the random numbers; equal seeds give equal draws.", GRID)
    outputs: list[str] = key(
        ["peak_rotation"], "Requested outputs: peak_rotation, peak_shear, errors …", GRID
    )
    t_end: Number | None = key(
        None, "End of the scenes [s]; by default max(30/p, 10 T_s) after the motion.", GRID
    )
    against: str | None = key(
        None,
        "Second ensemble, for a comparison: a file (.nc) of `rockjax ensemble` with another seed, or a law "
        "of impact: paper, compatible or a factor.",
        STATISTICS,
    )
    spread: dict[str, Spread] = key(
        {}, "Name of a parameter → number (a fixed value) or distribution, as in `rockjax.ensemble`."
    )
