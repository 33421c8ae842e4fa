"""Conversion of ground motions in any form to excitations.

An excitation is a ground motion that the engine can use, such as a pulse or a `Record`. The functions of this
module return excitations unchanged and convert other values:

- A `Motion`, which readers return, becomes a `Record`, or a `GroundMotion` if it has a vertical component.
- `Motions` and lists of motions become a table of records (`Records`). If all of them have vertical
  components, they become `RecordPairs`.
- A list of pulses of one class becomes a batch of pulses.

Other values raise a `ValueError`. For strings, paths, arrays, numbers and classes of pulses, the message also
names a call that makes a ground motion. In all functions, `owner` is the name of the function that the user
has called, and `name` is the name of its argument; messages contain both.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rockjax._checks import concrete, format_value, require_instance
from rockjax._excitations.base import AbstractExcitation
from rockjax._excitations.ground import PARTS, GroundMotion
from rockjax._excitations.pulses import AbstractPulse

from .motion import Motion, Motions
from .record import Record
from .records import RecordPairs, Records

# Types that functions accept for one motion (`AnyMotion`), and for one or several motions (`AnyMotions`).
AnyMotion = AbstractExcitation | Motion | Motions
AnyMotions = AnyMotion | Sequence[AbstractExcitation | Motion | Motions]


class SingleMotions(NamedTuple):
    """Single motions and their names; `names` is None if any of the motions has no name. Pulses are named by
    `pulse_name`; a `Record` has no name."""

    members: Sequence[AbstractExcitation]
    names: list[str] | None


def as_excitation(owner: str, value) -> AbstractExcitation:
    """Return an argument as an excitation. An excitation is returned unchanged, even if it is a batch. Any
    other value must contain exactly one motion, or `ValueError` is raised."""
    if isinstance(value, AbstractExcitation):
        return value
    members = single_motions(owner, value, "excitation").members
    if len(members) != 1:
        raise ValueError(
            f"{owner}: excitation must be one motion, got {len(members)}; pass one of them, or pass all to "
            "rockjax.peak_responses or rockjax.incremental_dynamic_analysis"
        )
    return members[0]


def as_batch(owner: str, value) -> AbstractExcitation:
    """Return one or several motions as one excitation: a `Motion` as a single excitation, a list or `Motions`
    as a batch, as described at `combine_motions`. An excitation is returned unchanged."""
    if isinstance(value, Motion):
        return value.record()
    if isinstance(value, AbstractExcitation):
        return value
    return combine_motions(owner, single_motions(owner, value, "excitations").members, "excitations")


def as_records(owner: str, value, name: str = "records") -> tuple[Records | RecordPairs, list[str] | None]:
    """Return records as one table, and the names of the records. Pairs of a horizontal and a vertical record
    become `RecordPairs`. The names are None if any record has no name; a table does not store names. Raises
    `ValueError` for motions that are not records."""
    if isinstance(value, RecordPairs):
        return RecordPairs(*(_complete_table(owner, getattr(value, part), name) for part in PARTS)), None
    if isinstance(value, Records):
        return _complete_table(owner, value, name), None
    members, names = single_motions(owner, value, name)
    pairs = [member for member in members if isinstance(member, GroundMotion)]
    components = [component for pair in pairs for component in (pair.horizontal, pair.vertical)]
    if pairs and len(pairs) == len(members) and all(isinstance(motion, Record) for motion in components):
        return RecordPairs.of(pairs), names
    for k, member in enumerate(members):
        if not isinstance(member, Record):
            raise ValueError(
                f"{owner}: {name} must be records, but entry {k} is {format_value(member)}; "
                "rockjax.Record(motion(t), dt) samples a motion at times t"
            )
    return Records.of([member for member in members if isinstance(member, Record)]), names


def _complete_table(owner: str, records: Records, name: str) -> Records:
    """Return a table whose rows are the members of a batch of records, with their factors. A table with
    traced values is returned unchanged, because its selected rows are unknown."""
    which, scale = concrete(records.which), concrete(records.scale)
    is_traced = which is None or scale is None
    if is_traced or (np.array_equal(which, np.arange(len(records))) and bool(np.all(scale == 1))):
        return records
    return Records.of(_records_of_table(owner, records, name))


def as_motions(owner: str, value, name: str = "motion") -> list[Motion]:
    """Return one or several motions as a list of `Motion`. A `Record` becomes a `Motion` with the name
    `record k`, where k is its position in the list, from 1. For a `GroundMotion`, the list contains only the
    horizontal component. Raises `ValueError` for motions without samples, and for traced samples."""
    motions = []
    for k, member in enumerate(flatten_motions(owner, value, name), start=1):
        if isinstance(member, Motion):
            motions.append(member)
            continue
        member = member.horizontal if isinstance(member, GroundMotion) else member
        samples = concrete(member.acceleration) if isinstance(member, Record) else None
        if samples is None or not isinstance(member, Record):
            raise ValueError(
                f"{owner}: {name} must be rockjax.Motion, Motions or records, got {format_value(member)}; "
                "rockjax.Motion(motion(t), dt) samples a motion at times t"
            )
        motions.append(Motion(float(member.scale) * samples, float(member.dt), f"record {k}"))
    return motions


def single_motions(owner: str, value, name: str) -> SingleMotions:
    """Return all single motions in an argument, which may be one motion, a table or `Motions`, or a nested
    list of these. Raises `ValueError` for a batch of another class, and if there is no motion."""
    members = flatten_motions(owner, value, name)
    labels = [y.name if isinstance(y, Motion) else pulse_name(y) for y in members]
    names = [label for label in labels if label is not None]
    return SingleMotions(
        [member.record() if isinstance(member, Motion) else member for member in members],
        make_unique(names) if len(names) == len(members) else None,
    )


def flatten_motions(owner: str, value, name: str) -> list[Motion | AbstractExcitation]:
    """Return the motions of `single_motions`, with every `Motion` as it is. Rows of tables become records."""
    if isinstance(value, Motion):
        return [value]
    if isinstance(value, Records):
        return [*_records_of_table(owner, value, name)]
    if isinstance(value, AbstractExcitation):
        return [require_single(owner, value, name)]
    if isinstance(value, Iterable) and not isinstance(value, _NO_MOTIONS):
        members = [y for k, entry in enumerate(value) for y in flatten_motions(owner, entry, f"{name}[{k}]")]
        if not members:
            raise ValueError(f"{owner}: {name} must hold at least one motion, got none")
        return members
    raise ValueError(f"{owner}: {name} must be {ACCEPTED_MOTIONS}, got {format_value(value)}{_advice(value)}")


def pulse_name(motion: AbstractExcitation) -> str | None:
    """Return the class and the parameters of a pulse as its name, such as "Ricker(3, 0.7)". Return None for
    motions with samples, and for traced parameters."""
    leaves = [concrete(y) for y in jax.tree.leaves(motion)]
    values = [y for y in leaves if y is not None and not y.ndim]
    if len(values) < len(leaves):
        return None
    return f"{type(motion).__name__}({', '.join(f'{float(y):.4g}' for y in values)})"


def group_by_kind(members: Sequence[AbstractExcitation]) -> dict[str, list[int]]:
    """Return the indices of motions by the name of their kind: their class, or the classes of both components
    of a `GroundMotion`. Motions of one kind can be combined as one batch."""
    groups: dict[str, list[int]] = {}
    for k, member in enumerate(members):
        parts = [getattr(member, part) for part in PARTS] if isinstance(member, GroundMotion) else [member]
        groups.setdefault(" with vertical ".join(type(part).__name__ for part in parts), []).append(k)
    return groups


_NO_MOTIONS = str | bytes | Path | np.ndarray | jax.Array | dict | type  # never motions, even if iterable
ACCEPTED_MOTIONS = "a rockjax motion (Record, Motion, a pulse …), Motions, Records or a list of them"


def _advice(value) -> str:
    """Return advice on how to convert a value to a motion; an empty string for types without advice."""
    if isinstance(value, type) and issubclass(value, AbstractPulse):
        return f"; pass an instance of the class: rockjax.{value.__name__}(a_p, T_p)"
    if isinstance(value, str | bytes | Path):
        return "; rockjax.read_motion(path) reads a file, rockjax.read_suite(path) a folder"
    if isinstance(value, np.ndarray | jax.Array | float | int):
        return "; rockjax.Record(acceleration, dt) makes a motion from samples"
    return ""


def require_single(owner: str, motion: AbstractExcitation, name: str) -> AbstractExcitation:
    """Return the motion unchanged. Raises `ValueError` if it is a batch."""
    if isinstance(motion, GroundMotion):
        for part in PARTS:
            require_single(owner, getattr(motion, part), f"{name}.{part}")
        return motion
    for field in dataclasses.fields(motion):
        value = getattr(motion, field.name)
        if isinstance(value, jax.Array | np.ndarray) and value.ndim > motion.own_dimensions.get(
            field.name, 0
        ):
            raise ValueError(
                f"{owner}: {name} must be a single motion, but its "
                f"{field.name} is an array, shape {value.shape}; "
                "pass a list of motions, or the array as an axis of rockjax.grid"
            )
    return motion


def _records_of_table(owner: str, records: Records, name: str) -> list[Record]:
    """Return the selected rows of a table as single records. Raises `ValueError` for traced tables."""
    which, counts, scale = map(concrete, (records.which, records.counts, records.scale))
    if which is None or counts is None:
        raise ValueError(f"{owner}: {name} must be concrete, but is traced; pass a list of records")
    if which.ndim > 1:
        raise ValueError(f"{owner}: {name} must be a table of shape (k,), got shape {which.shape}")
    if scale is None:
        raise ValueError(
            f"{owner}: the scale of {name} must be concrete, but is traced; pass a list of records"
        )
    scales = np.broadcast_to(scale, which.shape)
    rows = zip(np.atleast_1d(which).astype(int), np.atleast_1d(scales), strict=True)
    samples = [records.acceleration[j, : int(count)] for j, count in enumerate(counts)]
    return [Record(samples[j], records.intervals[j], scale, records.starts[j]) for j, scale in rows]


def combine_motions(owner: str, members: Sequence[Any], name: str) -> AbstractExcitation:
    """Return single motions as one batch.

    - Several `Record` become `Records`, a table.
    - Several `GroundMotion` become `RecordPairs` if all components are records, and otherwise one
      `GroundMotion`, whose two components are batches.
    - Motions of another class become one motion of this class, whose parameters are arrays.

    Raises `ValueError` for motions of different classes.
    """
    if all(isinstance(member, Record) for member in members):
        return Records.of(members)
    if all(isinstance(member, GroundMotion) for member in members):
        components = [
            combine_motions(owner, [getattr(member, part) for member in members], name) for part in PARTS
        ]
        are_records = all(isinstance(component, Records) for component in components)
        return RecordPairs(*components) if are_records else GroundMotion(*components)  # pyright: ignore[reportArgumentType]
    class_names = sorted({type(member).__name__ for member in members})
    if len({jax.tree.structure(member) for member in members}) > 1:
        raise ValueError(f"{owner}: {name} must be motions of one kind, got {', '.join(class_names)}")
    return jax.tree.map(lambda *values: jnp.stack(values), *members)


def as_pulse(owner: str, value) -> Callable[[Any, Any], AbstractExcitation]:
    """Check and return an argument that makes pulses from the amplitude a_p [m/s²] and the period T_p [s]. A
    class of pulses is returned unchanged. A function (a_p, T_p) ↦ excitation is wrapped, so that the type of
    its result is checked at every call."""
    if isinstance(value, type) and issubclass(value, AbstractPulse):
        return value
    if isinstance(value, AbstractPulse):
        raise ValueError(
            f"{owner}: pulse must be {ACCEPTED_PULSES}, got the instance {format_value(value)}; pass the "
            f"class rockjax.{type(value).__name__}"
        )
    if isinstance(value, AbstractExcitation | Motion | Motions | type) or not callable(value):
        raise ValueError(f"{owner}: pulse must be {ACCEPTED_PULSES}, got {format_value(value)}")
    return value if isinstance(value, _CheckedPulse) else _CheckedPulse(owner, value)


ACCEPTED_PULSES = "a class of pulses such as rockjax.Ricker, or a function (a_p, T_p) → excitation"


@dataclasses.dataclass(frozen=True)
class _CheckedPulse:
    """Wrapper that checks the results of a user-defined function of (a_p, T_p). Wrappers of the same function
    with the same `owner` are equal, so that repeated calls reuse compiled programs."""

    owner: str
    function: Callable[[Any, Any], Any]

    @property
    def __name__(self) -> str:
        return getattr(self.function, "__name__", repr(self.function))

    def __call__(self, a_p, T_p) -> AbstractExcitation:
        try:
            inspect.signature(self.function).bind(a_p, T_p)
        except TypeError as error:
            raise ValueError(
                f"{self.owner}: pulse must be {ACCEPTED_PULSES}; called with (a_p, T_p): {error}"
            ) from None
        except ValueError:  # a builtin without a signature
            pass
        motion = self.function(a_p, T_p)
        result = "the result of pulse(a_p, T_p)"
        require_instance(self.owner, result, motion, AbstractExcitation, "a rockjax motion")
        return motion


def make_unique(labels: Sequence[str]) -> list[str]:
    """Return the labels. Equal labels become different by a number in parentheses: a, b, a gives a (1), b,
    a (2). Numbers that would give a label in the list are left out."""
    total, used, unique = Counter(labels), Counter(), []
    for label in labels:
        name = label
        while total[label] > 1 and name in total:
            used[label] += 1
            name = f"{label} ({used[label]})"
        unique.append(name)
    return unique
