"""Targets on peaks of the rotation, the superstructure, the floors and the joints."""

from __future__ import annotations

from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

import rockjax as rj
from rockjax._outputs.axial_force import Unloading
from rockjax._outputs.base import AbstractOutput
from rockjax._outputs.registry import REGISTRY, name_if_registered
from rockjax._units import displayed_or_empty
from rockjax.internal import require_number

from ._suite import Suite, Values
from ._targets import AbstractResponses, AbstractResponseTarget, Name, require_limit, severity


class PeakRotation(AbstractResponseTarget):
    """The columns rotate by at most `limit`·α under every motion: max|θ|/α ≤ limit.

    - `limit`: 0 < limit < 1 [–]; `excitations`: a motion or a list of motions; `name`: name in reports, None
      for a description

    The margin for each motion is (limit − s)/limit with s = max|θ|/α. If the columns overturn, s is
    `Options.overturn_ratio` − M, where M < 0 is the overturning margin, and the margin is at most M. Raises
    `ValueError` for other limits; for a limit of 1 use [`optimise.NoOverturning`][].
    """

    limit: Any
    suite: Suite
    name: Name = eqx.field(static=True)
    outputs: ClassVar[tuple[str, ...]] = ("peak_rotation", "margin")

    def __init__(self, limit, excitations, name: Name = None):
        owner = type(self).__name__
        self.limit = require_limit(owner, "limit", limit, below=1)
        self.suite, self.name = Suite.of(excitations, owner), name

    def read(self, peaks: rj.Peak, options: rj.Options) -> Values:
        return limited_by_overturning((self.limit - severity(peaks, options)) / self.limit, peaks)

    def describe(self) -> str:
        return f"peak rotation ≤ {self.limit:g} α"


class PeakLimit(AbstractResponseTarget):
    """A peak is at most `limit` under every motion.

    - `output`: an output that is a peak: a name in `rockjax.Options.outputs`, such as `"peak_shear"`, or an
      instance of [`rockjax.AbstractOutput`][]
    - `limit`: > 0, in the unit of the output; `excitations`: a motion or a list of motions; `name`: name in
      reports, None for a description

    The margin is (limit − peak)/limit, except for `"peak_friction"`, which can be infinite;
    [`optimise.PeakFriction`][] defines its margin. Every mode, story, floor or joint has its own margin for
    each motion. If the columns overturn, the peak covers only the time until overturning, and the margin is
    at most the overturning margin, which is negative.

    Raises `ValueError` for other limits and outputs. The evaluation raises `ValueError` for a podium that
    does not have the output.
    """

    # An output that can be infinite is replaced by a smooth output, which has another limit. `output` and
    # `limit` are those of the evaluation; descriptions state the given ones.
    given_output: AbstractOutput = eqx.field(static=True)
    given_limit: Any
    output: AbstractOutput = eqx.field(static=True)
    limit: Any
    suite: Suite
    name: Name = eqx.field(static=True)
    until_overturning: ClassVar[bool] = True

    def __init__(self, output: str | AbstractOutput, limit, excitations, name: Name = None):
        owner = type(self).__name__
        self.given_limit = require_limit(owner, "limit", limit)
        self.given_output = limited_output(owner, output)
        self.output, self.limit = self.given_output.for_limit(self.given_limit)
        self.suite, self.name = Suite.of(excitations, owner), name

    @property
    def outputs(self) -> tuple[str | AbstractOutput, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return with_margin(self.output)

    def read(self, peaks: rj.Peak, options: rj.Options) -> Values:
        margins = (self.limit - output_values(self, self.output, peaks)) / self.limit
        return limited_by_overturning(margins, peaks)

    def describe(self) -> str:
        output = self.given_output
        return f"{output_title(output)} ≤ {self.given_limit:g} {displayed_or_empty(output.unit)}".rstrip()


def limited_output(owner: str, output: str | AbstractOutput) -> AbstractOutput:
    """Return the instance of an output that is given by name or as an instance. Raises `ValueError`, which
    names `owner`, if the output is not a peak."""
    instance = output if isinstance(output, AbstractOutput) else REGISTRY.get(str(output))
    if instance is None or not _is_peak(instance):
        peaks = [name for name, registered in REGISTRY.items() if _is_peak(registered)]
        raise ValueError(
            f"{owner}: output must be one of {peaks}, or a rockjax.AbstractOutput that is a peak "
            f"(until_overturning = True); got {output!r}"
        )
    return instance


def _is_peak(output: AbstractOutput) -> bool:
    """Return whether an output is a peak: it has a variable with the name of the output which, if the columns
    overturn, covers only the time until overturning."""
    return any(y.name == output.name and y.until_overturning for y in output.variables)


def with_margin(output: AbstractOutput) -> tuple[str | AbstractOutput, ...]:
    """Return an output and the overturning margin, as entries of `rockjax.Options.outputs`."""
    return name_if_registered(output), "margin"


def output_title(output: AbstractOutput) -> str:
    """Return the name of an output for reports."""
    return output.name.replace("_", " ")


def output_values(reader: AbstractResponses, output: AbstractOutput, peaks: rj.Peak) -> Float[Array, " k"]:
    """Return the values (k,) of an output for all motions and all modes, stories, floors or joints; values of
    the same motion are adjacent. Raises `ValueError`, which names the `reader` (target or objective), for a
    podium that does not have the output."""
    values = getattr(peaks, output.name)
    if values is None:
        raise ValueError(
            f"{type(reader).__name__}: this podium has no {output.name}; outputs of stories and floors "
            "need a rockjax.ShearBuilding as the superstructure"
        )
    return values.ravel()


def limited_by_overturning(margins: Values, peaks: rj.Peak) -> Values:
    """Return margins (k,); where the columns overturn, they are at most the overturning margin."""
    overturned, depth = overturning_depths(peaks, len(margins))
    return jnp.where(overturned, jnp.minimum(margins, -depth), margins)


def overturning_depths(peaks: rj.Peak, count: int) -> tuple[Array, Float[Array, " k"]]:
    """Return two vectors (count,): for each value, whether its scene overturned, and the depth −M [–], with
    the overturning margin M. In a scene that did not overturn, the depth is set to 1; callers ignore it. Each
    scene has the same number of values; the values are in the order of the scenes."""
    depth = jnp.where(peaks.margin < 0, -peaks.margin, 1.0)
    repeat = lambda y: jnp.repeat(jnp.ravel(y), count // jnp.size(y))
    return repeat(peaks.overturned), repeat(depth)


class PeakShear(PeakLimit):
    """The shear V_s of the superstructure is at most `limit` times its weight m_t g: max|V_s| ≤ limit·m_t g.

    - `limit`: > 0 [–]; `excitations`: a motion or a list of motions; `name`: name in reports, None for a
      description

    [`optimise.PeakLimit`][] defines the margin.
    """

    def __init__(self, limit, excitations, name: Name = None):
        super().__init__("peak_shear", limit, excitations, name)

    def describe(self) -> str:
        return f"peak shear ≤ {self.limit:g} m_t g"


class PeakDeformation(PeakLimit):
    """The deformation of the superstructure is at most `limit`: max|u_t − u_b| ≤ limit.

    u_t and u_b are the displacements of the superstructure and of the beam. With several modes, each modal
    deformation is limited.

    - `limit`: > 0 [m]; `excitations`: a motion or a list of motions; `name`: name in reports, None for a
      description

    [`optimise.PeakLimit`][] defines the margin.
    """

    def __init__(self, limit, excitations, name: Name = None):
        super().__init__("peak_deformation", limit, excitations, name)


class PeakDrift(PeakLimit):
    """The drifts of all stories of a building are at most `limit`.

    - `limit`: > 0 [m]; `excitations`: a motion or a list of motions; `name`: name in reports, None for a
      description

    [`optimise.PeakLimit`][] defines the margin. The evaluation raises `ValueError` for a podium without
    stories.
    """

    def __init__(self, limit, excitations, name: Name = None):
        super().__init__("peak_drift", limit, excitations, name)


class PeakFloorAcceleration(PeakLimit):
    """The absolute horizontal accelerations of all floors of a building are at most `limit`.

    - `limit`: > 0 [m/s²]; `excitations`: a motion or a list of motions; `name`: name in reports, None for a
      description

    [`optimise.PeakLimit`][] defines the margin. The evaluation raises `ValueError` for a podium without
    stories.
    """

    def __init__(self, limit, excitations, name: Name = None):
        super().__init__("peak_floor_acceleration", limit, excitations, name)


class PeakFriction(PeakLimit):
    """The joints of all columns need at most the friction coefficient `limit`: max(|T|/N) ≤ limit.

    - `limit`: > 0 [–], such as the friction coefficient of the joints divided by a safety factor
    - `excitations`: a motion or a list of motions; `name`: name in reports, None for a description

    T is the shear force and N the axial force in a joint; compression is positive. N_0 is the axial force
    under dead load, averaged over the columns. The bottom and the top joint have one margin each: the minimum
    of (limit·N − |T|)/(limit·N_0) over time and columns. The margin is also defined if N < 0, where the joint
    would open, so that a search can start from such a structure. If the columns overturn, margins are at most
    the overturning margin, which is negative. If the podium has no elevation (positions of columns and
    heights of masses), T and N are averaged over the columns. At a joint with N_0 = 0, m_c g replaces N_0 if
    the joint slides; otherwise the margin is 1.
    """

    def __init__(self, limit, excitations, name: Name = None):
        super().__init__("peak_friction", limit, excitations, name)

    def describe(self) -> str:
        return f"friction demand ≤ {self.given_limit:g}"


class PeakFoundationShear(PeakLimit):
    """The shear V on the foundation is at most `limit` times the total weight W_0: max|V|/W_0 ≤ limit.

    - `limit`: > 0 [–]; `excitations`: a motion or a list of motions; `name`: name in reports, None for a
      description

    [`optimise.PeakLimit`][] defines the margin.
    """

    def __init__(self, limit, excitations, name: Name = None):
        super().__init__("peak_foundation_shear", limit, excitations, name)

    def describe(self) -> str:
        return f"foundation shear ≤ {self.limit:g} W_0"


class LeastAxialForce(AbstractResponseTarget):
    """The axial force N in all joints is at least a fraction of the dead load N_0: N ≥ at_least·N_0.

    - `at_least`: the fraction, 0 ≤ at_least < 1 [–]; 0 keeps the joints closed between impacts
    - `excitations`: a motion or a list of motions; `name`: name in reports, None for a description

    Compression is positive. N_0 is averaged over the columns. The bottom and the top joint have one margin
    each, min(N)/N_0 − at_least, with the minimum over time and columns. If the columns overturn, margins are
    at most the overturning margin, which is negative. If the podium has no elevation (positions of columns
    and heights of masses), N is averaged over the columns. Impulses of impacts are not limited: the beam may
    lift off a column at an impact, as the output `"impact_friction"` shows. At a joint with N_0 = 0, m_c g
    replaces N_0 if N < 0; otherwise the margin is 1 − at_least. Raises `ValueError` for other fractions.
    """

    at_least: Any
    suite: Suite
    name: Name = eqx.field(static=True)
    outputs: ClassVar[tuple[str | AbstractOutput, ...]] = (Unloading(), "margin")
    until_overturning: ClassVar[bool] = True

    def __init__(self, at_least, excitations, name: Name = None):
        owner = type(self).__name__
        self.at_least = require_number(owner, "at_least", at_least, lambda v: 0 <= v < 1, "in [0, 1)")
        self.suite, self.name = Suite.of(excitations, owner), name

    def read(self, peaks: rj.Peak, options: rj.Options) -> Values:
        unloading = output_values(self, Unloading(), peaks)
        return limited_by_overturning(1 - self.at_least - unloading, peaks)

    def describe(self) -> str:
        return f"axial force ≥ {self.at_least:g} of the dead load"
