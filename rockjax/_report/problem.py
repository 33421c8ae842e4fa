"""Problem files of reports: the structure, named motions, checks, joints and sources of inputs."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rockjax._excitations.base import AbstractExcitation
from rockjax._motions.motion import Motion
from rockjax._motions.provenance import sha256
from rockjax._options import Options
from rockjax._problem import models
from rockjax._problem.reading import Reader, to_excitation
from rockjax._structures import GivenRestitution, Podium

from .entry import Entry

RESTITUTION = "e"  # name of the factor of restitution of a law of impact
# Inputs that are counts. They cannot be multiplied by a factor.
COUNTS = ("columns", "stories", "modes", "superstructure.stories", "superstructure.modes")


@dataclasses.dataclass(frozen=True)
class MotionSet:
    """A named set of motions.

    - `name`: key under `[motions]`; `label`: label from `motions` in the table `[report]`, by default the
      name
    - `members`: records (`Motion`) or pulses; `names`: a unique name for each
    """

    name: str
    label: str
    members: tuple[Motion | AbstractExcitation, ...]
    names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.members)

    @property
    def excitations(self) -> list[AbstractExcitation]:
        """The motions as excitations."""
        return [to_excitation(member) for member in self.members]

    def scaled(self, factor: float) -> list[AbstractExcitation]:
        """Return the motions as excitations, multiplied by a factor."""
        return self.excitations if factor == 1 else [y.scaled(factor) for y in self.excitations]

    @property
    def has_vertical(self) -> bool:
        """True if every motion has a vertical component."""
        return all(
            member.vertical is not None if isinstance(member, Motion) else hasattr(member, "vertical")
            for member in self.members
        )

    @functools.cached_property
    def hashes(self) -> tuple[str, ...]:
        """SHA-256 of the samples of each record, or of the class and the parameters of each pulse. A motion
        with a vertical component has two hashes, joined by "+"."""

        def hash_of(component: Any) -> str:
            if isinstance(component, Motion):
                return sha256(component.acceleration)
            leaves = [float(y) for y in jax.tree.leaves(component)]
            return hashlib.sha256(f"{type(component).__name__} {leaves}".encode()).hexdigest()

        def components(member: Any) -> list[Any]:
            horizontal = getattr(member, "horizontal", member)
            vertical = getattr(member, "vertical", None)
            return [horizontal] if vertical is None else [horizontal, vertical]

        return tuple("+".join(map(hash_of, components(member))) for member in self.members)

    @property
    def identities(self) -> tuple[str, ...]:
        """For each motion, a text with its hash and, for a record, the sampling interval of each component.
        Motions with equal texts cause equal responses."""

        def intervals(member: Any) -> list[float]:
            components = (member, member.vertical) if isinstance(member, Motion) else ()
            return [y.dt for y in components if y is not None]

        pairs = zip(self.hashes, self.members, strict=True)
        return tuple(f"{sha} {intervals(member)}" for sha, member in pairs)


@dataclasses.dataclass(frozen=True)
class Input:
    """An input of the structure.

    - `key`: key under `[structure]`, such as `width` or `superstructure.T_s`; `value`: value or list of
      values
    - `source`: source of the value in the table `[sources]`; None if there is none
    """

    key: str
    value: Any
    source: str | None

    @property
    def varies(self) -> bool:
        """True if the input is a number or a list of numbers, not all zero, and not a count."""
        values = np.ravel(self.value) if not isinstance(self.value, str) else np.zeros(0)
        return bool(values.size) and self.key not in COUNTS and bool(np.any(values != 0))


@dataclasses.dataclass(frozen=True)
class Problem:
    """The contents of a problem file as objects, from [`rockjax.read_problem`][].

    - `path`, `sha256`: the file and the hash of its bytes
    - `podium`: the structure; `inputs`: `key`, `value` and `source` of each key of `[structure]`
    - `motions`: name → set of motions, with `name`, `label`, `members` and `names`
    - `checks`: the entries of `[[checks]]` and `[[targets]]`
    - `options`: options of the solver
    - `sources`: key of the file, such as `structure.width` → text that states the source of its value. The
      source of a value that the command line replaces is "command line"
    - `project`, `joints`, `report`, `fragility`, `risk`, `structure`: the tables of the file with these names
    - `text`: the text of the file
    - `given`: names of the tables that the file has
    """

    path: Path
    text: str
    sha256: str
    podium: Podium
    inputs: tuple[Input, ...]
    motions: Mapping[str, MotionSet]
    checks: tuple[Entry, ...]
    options: Options
    sources: Mapping[str, str]
    project: models.Project
    joints: models.JointKeys
    report: models.ReportKeys
    fragility: models.Fragility
    risk: models.Risk
    structure: models.ByRatios | models.ByDimensions
    given: Collection[str] = ()

    def sources_of_inputs(self, used: Collection[str | None]) -> dict[str, str | None]:
        """Return each input → its source, or None if it has none.

        The inputs are keys of the file: those of the structure, those of `[joints]` that the file gives, the
        sets of motions, and the hazard curve if a check uses it. A set without a source of its own has the
        source of one of its keys.

        - `used`: names of the sets of motions that checks use; the other sets are left out
        """
        keys = [f"joints.{name}" for name in self.joints.as_arguments()]
        keys += [f"motions.{name}" for name in self.motions if name in used]
        keys += ["risk.hazard"] if any(entry.uses_hazard_of_file for entry in self.checks) else []
        sources = {f"structure.{entry.key}": entry.source for entry in self.inputs}
        for key in keys:
            inner = [text for name, text in self.sources.items() if name.startswith(f"{key}.")]
            sources[key] = self.sources.get(key) or next(iter(inner), None)
        return sources

    def varied(self, factors: Mapping[str, Any]) -> Podium:
        """Return the structure with inputs multiplied by factors.

        - `factors`: key of an input → factor on the number, or on all numbers of a list. "e" → factor on the
          factor of restitution of the law of impact. Factors may be JAX tracers
        """
        inputs = {name: y for name, y in factors.items() if name != RESTITUTION}
        podium = podium_with(self.structure, inputs) if inputs else self.podium
        if RESTITUTION not in factors:
            return podium
        return podium.replace(restitution=factors[RESTITUTION] * podium.restitution_factor)

    @functools.cached_property
    def variables(self) -> tuple[str, ...]:
        """Keys of the inputs that can be multiplied by a factor. If the factor of restitution e is positive
        and comes from a law of impact, "e" is the last one; other inputs also change e as the law states."""
        keys = tuple(entry.key for entry in self.inputs if entry.varies)
        has_law = not isinstance(self.podium.restitution, GivenRestitution)
        has_law &= float(self.podium.restitution_factor) > 0
        return (*keys, RESTITUTION) if has_law else keys

    @functools.cached_property
    def differentiable_podium(self) -> Podium:
        """The structure, whose factor of restitution is a number if "e" is among the `variables`."""
        return self.varied({RESTITUTION: 1.0}) if RESTITUTION in self.variables else self.podium

    @property
    def leaf_derivatives(self) -> list[Any]:
        """For each pytree leaf of `differentiable_podium`, its derivatives with respect to ln y for the
        inputs y in `variables`. The last axis runs over these inputs."""
        return self._derivatives[0]

    @property
    def split_derivatives(self) -> Podium:
        """`differentiable_podium.split_rows()` with derivatives in place of its leaves, in the form of
        `leaf_derivatives`.

        `split_rows` turns arrays over columns, modes or stories into tuples of numbers.
        """
        return self._derivatives[1]

    @functools.cached_property
    def _derivatives(self) -> tuple[list[Any], Podium]:
        """`leaf_derivatives` and `split_derivatives`."""

        def varied_leaves(logs: Any) -> tuple[list[Any], Podium]:
            podium = self.varied(dict(zip(self.variables, jnp.exp(logs), strict=True)))
            leaves, split = jax.tree.leaves(podium), podium.split_rows()
            return jax.tree.map(lambda y: jnp.asarray(y, float), (leaves, split))

        return jax.jit(jax.jacfwd(varied_leaves))(jnp.zeros(len(self.variables)))

    @property
    def story_heights(self) -> np.ndarray | None:
        """Heights of the stories [m], (stories,); None if the structure has none."""
        heights = getattr(self.structure, "story_heights", None)
        if heights is None:
            heights = getattr(self.podium.superstructure, "heights", None)
        return None if heights is None else np.asarray(heights, float)

    @property
    def column_size(self) -> tuple[float, float]:
        """Width 2B and height 2H of a real column [m]. If its ends are round, the columns of `podium` are
        larger."""
        given = (getattr(self.structure, name, None) for name in ("width", "height"))
        actual = (self.podium.width, self.podium.height)
        width, height = (float(z if y is None else y) for y, z in zip(given, actual, strict=True))
        return width, height

    @property
    def missing_positions(self) -> str:
        """Key of the positions of the columns, "structure.positions" or "structure.elevation", if the forces
        in the joints of each column are unknown without them. Otherwise "": the structure has positions or a
        single column, or its columns carry nothing, so that all columns have the same forces."""
        podium = self.podium
        is_loaded = float(podium.gamma) or float(podium.eta) or any(y.joints != 1 for y in podium.restrainers)
        if podium.elevation is not None or not is_loaded or getattr(self.structure, "columns", None) == 1:
            return ""
        return "structure.positions" if self.column_mass is not None else "structure.elevation"

    @property
    def column_enlargement(self) -> float:
        """H/(H − r_c), the size of the columns of `podium` divided by the size of columns with round ends,
        (R5); 1 for flat ends."""
        radius = float(getattr(self.structure, "end_radius", None) or 0.0)
        half_height = 0.5 * self.column_size[1]
        return half_height / (half_height - radius)

    @property
    def column_mass(self) -> float | None:
        """Mass of a column m_c [kg], or None for a structure by ratios."""
        mass = getattr(self.structure, "column_mass", None)
        return None if mass is None else float(mass)


def podium_with(structure: models.ByRatios | models.ByDimensions, factors: Mapping[str, Any]) -> Podium:
    """Return the podium of a table `[structure]` with inputs multiplied by factors.

    - `structure`: the table; `factors`: key of an input → factor, a number or a JAX tracer
    """
    changes: dict[str, Any] = {}
    nested: dict[str, dict[str, Any]] = {}

    def scaled(value: Any, factor: Any) -> Any:
        return jnp.asarray(value) * factor if isinstance(value, list | tuple) else value * factor

    for name, factor in factors.items():
        table, _, inner = name.rpartition(".")
        if table:
            owner = getattr(structure, table)
            nested.setdefault(table, {})[inner] = scaled(getattr(owner, inner), factor)
        elif name == "tan_alpha":  # `Reader.structure` cannot convert a traced tan α
            changes["alpha"] = jnp.arctan(scaled(getattr(structure, name), factor))
            changes["tan_alpha"] = None
        else:
            changes[name] = scaled(getattr(structure, name), factor)
    for table, values in nested.items():
        changes[table] = getattr(structure, table).model_copy(update=values)
    return Reader().structure(structure.model_copy(update=changes))
