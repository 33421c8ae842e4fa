"""Targets on peaks of the response: rotation, superstructure, floors and joints."""

from __future__ import annotations

from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import rockjax as rj
from rockjax._outputs.axial_force import Unloading
from rockjax._outputs.base import AbstractOutput
from rockjax._outputs.registry import REGISTRY, name_if_registered
from rockjax._units import displayed_or_empty
from rockjax.internal import concrete

from ._suite import Margins, Suite
from ._targets import AbstractResponses, AbstractResponseTarget, Name, check_limit, severity


class PeakRotation(AbstractResponseTarget):
    """The columns rotate by at most `limit`·α under every motion: max|θ|/α ≤ limit.

    - `limit`: 0 < limit < 1 [–]; `excitations`: a motion or a list of them; `name`: in reports

    The margin is (limit − s)/limit. s is max|θ|/α; where the columns overturn it increases beyond 1 with the
    negative overturning margin. Raises `ValueError` for other limits; for overturning use
    [`optimise.NoOverturning`][].
    """

    limit: Any
    suite: Suite
    name: Name = eqx.field(static=True)
    outputs: ClassVar[tuple[str, ...]] = ("peak_rotation", "margin")

    def __init__(self, limit, excitations, name: Name = None):
        check_limit("PeakRotation", "limit", limit, below=1)
        self.limit, self.suite, self.name = float(limit), Suite.of(excitations, type(self).__name__), name

    def read(self, peaks: rj.Peak, options: rj.Options) -> Margins:
        return (self.limit - severity(peaks, options)) / self.limit

    def describe(self) -> str:
        return f"peak rotation ≤ {self.limit:g} α"


class PeakLimit(AbstractResponseTarget):
    """An output of a scene stays at most `limit` under every motion.

    - `output`: name of one of `rockjax.Options.outputs` with a single answer, such as `"peak_shear"`, or an
      output of your own
    - `limit`: > 0, in the unit of the output; `excitations`: a motion or a list of them; `name`: in reports

    Every mode, story, floor or joint has its own margin, (limit − peak)/limit. Where the columns overturn,
    the peak until then is no measure: the margin is then at most the overturning margin, which is negative.
    Raises `ValueError` for other limits and outputs; and, when evaluated, for a podium without the output.
    """

    output: AbstractOutput = eqx.field(static=True)
    limit: Any
    suite: Suite
    name: Name = eqx.field(static=True)
    until_overturning: ClassVar[bool] = True

    def __init__(self, output: str | AbstractOutput, limit, excitations, name: Name = None):
        owner = type(self).__name__
        check_limit(owner, "limit", limit)
        self.output, self.limit = limited_output(owner, output).for_limit(float(limit))
        self.name = name
        self.suite = Suite.of(excitations, owner)

    @property
    def outputs(self) -> tuple[str | AbstractOutput, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return requested(self.output)

    def read(self, peaks: rj.Peak, options: rj.Options) -> Margins:
        margins = (self.limit - of_output(self, self.output, peaks)) / self.limit
        return limited_by_overturning(margins, peaks)

    def describe(self) -> str:
        return f"{words_of(self.output)} ≤ {self.limit:g} {displayed_or_empty(self.output.unit)}".rstrip()


def limited_output(owner: str, output: str | AbstractOutput) -> AbstractOutput:
    """Return an output by its name. Raises `ValueError` for one that is no peak."""
    found = output if isinstance(output, AbstractOutput) else REGISTRY.get(output)
    if found is None or not any(y.name == found.name and y.until_overturning for y in found.variables):
        peaks = [name for name, y in REGISTRY.items() if any(z.until_overturning for z in y.variables)]
        raise ValueError(f"{owner}: output must be one of {peaks}, or an output of your own; got {output!r}")
    return found


def requested(output: AbstractOutput) -> tuple[str | AbstractOutput, ...]:
    """Return the requested outputs with the overturning margin, as in `rockjax.Options`."""
    return name_if_registered(output), "margin"


def words_of(output: AbstractOutput) -> str:
    """Return an output in words, for reports."""
    return output.name.replace("_", " ")


def of_output(wanted: AbstractResponses, output: AbstractOutput, peaks: rj.Peak) -> Float[Array, " k"]:
    """Return an output of all motions and all modes, stories or floors, (k,)."""
    values = getattr(peaks, output.name)
    if values is None:
        raise ValueError(
            f"{type(wanted).__name__}: this podium has no {output.name}; a rockjax.ShearBuilding as its "
            "superstructure has those of stories and floors"
        )
    return values.ravel()


def limited_by_overturning(margins: Margins, peaks: rj.Peak) -> Margins:
    """Return margins (k,) of peaks, at most the overturning margin where the columns overturn."""
    overturned, depth = overturning_depths(peaks, len(margins))
    return jnp.where(overturned, jnp.minimum(margins, -depth), margins)


def overturning_depths(peaks: rj.Peak, count: int) -> tuple[Array, Float[Array, " k"]]:
    """Return whether the scene of each of `count` values overturned, and its −margin [–]."""
    depth = jnp.where(peaks.margin < 0, -peaks.margin, 1.0)
    each = lambda y: jnp.repeat(jnp.ravel(y), count // jnp.size(y))
    return each(peaks.overturned), each(depth)


class PeakShear(PeakLimit):
    """The shear of the superstructure over its weight stays at most `limit`: max|V_s|/(m_t g) ≤ limit.

    - `limit`: > 0 [–]; `excitations`: a motion or a list of them; `name`: in reports
    """

    def __init__(self, limit, excitations, name: Name = None):
        super().__init__("peak_shear", limit, excitations, name)

    def describe(self) -> str:
        return f"peak shear ≤ {self.limit:g} m_t g"


class PeakDeformation(PeakLimit):
    """The deformation of the superstructure, of all its modes, stays at most `limit`: max|u_t − u_b| ≤ limit.

    - `limit`: > 0 [m]; `excitations`: a motion or a list of them; `name`: in reports
    """

    def __init__(self, limit, excitations, name: Name = None):
        super().__init__("peak_deformation", limit, excitations, name)


class PeakDrift(PeakLimit):
    """The drifts of all stories of a building stay at most `limit`.

    - `limit`: > 0 [m]; `excitations`: a motion or a list of them; `name`: in reports

    Raises `ValueError` for a podium without stories, when evaluated.
    """

    def __init__(self, limit, excitations, name: Name = None):
        super().__init__("peak_drift", limit, excitations, name)


class PeakFloorAcceleration(PeakLimit):
    """The absolute horizontal accelerations of all floors of a building stay at most `limit`.

    - `limit`: > 0 [m/s²]; `excitations`: a motion or a list of them; `name`: in reports

    Raises `ValueError` for a podium without stories, when evaluated.
    """

    def __init__(self, limit, excitations, name: Name = None):
        super().__init__("peak_floor_acceleration", limit, excitations, name)


class PeakFriction(PeakLimit):
    """The joints of all columns need at most the friction coefficient `limit`: max|T|/N ≤ limit, (F9).

    - `limit`: > 0 [–], such as μ over a safety factor; `excitations`: a motion or a list of them; `name`: in
      reports

    The margins of the bottom and the top joint are the least (limit·N − |T|)/(limit·N_0) with the dead load
    N_0 of the mean column. They are smooth where a joint pulls, so that a design finds its way back from
    there. Columns stand as the elevation of the podium says; without one the mean column counts.
    """

    friction: float = eqx.field(static=True)

    def __init__(self, limit, excitations, name: Name = None):
        super().__init__("peak_friction", limit, excitations, name)
        self.friction = float(limit)

    def describe(self) -> str:
        return f"friction demand ≤ {self.friction:g}"


class PeakFoundationShear(PeakLimit):
    """The shear on the foundation over the total weight stays at most `limit`: max|V|/W_0 ≤ limit, (F5).

    - `limit`: > 0 [–]; `excitations`: a motion or a list of them; `name`: in reports
    """

    def __init__(self, limit, excitations, name: Name = None):
        super().__init__("peak_foundation_shear", limit, excitations, name)

    def describe(self) -> str:
        return f"foundation shear ≤ {self.limit:g} W_0"


class LeastAxialForce(AbstractResponseTarget):
    """Every joint of every column keeps the share `at_least` of its dead load: N ≥ at_least·N_0, (F8).

    - `at_least`: 0 ≤ at_least < 1 [–]; 0 keeps the joints closed
    - `excitations`: a motion or a list of them; `name`: in reports

    The margins of the bottom and the top joint are min N/N_0 − at_least, with the dead load N_0 of the mean
    column. Where the columns overturn they are at most the overturning margin. Columns stand as the elevation
    of the podium says; without one the mean column counts. Raises `ValueError` for other shares.
    """

    at_least: Any
    suite: Suite
    name: Name = eqx.field(static=True)
    outputs: ClassVar[tuple[str | AbstractOutput, ...]] = (Unloading(), "margin")
    until_overturning: ClassVar[bool] = True

    def __init__(self, at_least, excitations, name: Name = None):
        share = concrete(at_least)
        if share is None or not np.all(np.isfinite(share) & (share >= 0) & (share < 1)):
            raise ValueError(f"LeastAxialForce: at_least must be in [0, 1), got at_least = {at_least!r}")
        self.at_least, self.name = float(at_least), name
        self.suite = Suite.of(excitations, "LeastAxialForce")

    def read(self, peaks: rj.Peak, options: rj.Options) -> Margins:
        lost = of_output(self, Unloading(), peaks)
        return limited_by_overturning(1 - self.at_least - lost, peaks)

    def describe(self) -> str:
        return f"axial force ≥ {self.at_least:g} of the dead load"
