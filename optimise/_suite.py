"""Sets of ground motions (suites), and the responses of one podium to all motions of a suite."""

from __future__ import annotations

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

import rockjax as rj
from rockjax._checks import as_array
from rockjax._results import code_of, did_not_finish
from rockjax.internal import AnyMotions, Module, array_module, single_motions

from ._fresh import FreshSamples

Values = Float[Array, " k"]


class Suite(Module):
    """Ground motions of any types, in groups. One compiled loop simulates each group.

    - `groups`: groups of motions of the same type and shape. `Suite.of` puts records of any lengths into one
      group, a table of samples. `merged_with` does not merge such tables
    - `order`: for each motion, its index in the concatenated groups
    - `fresh_samples`: source of the motions if they are drawn anew in every step of a search for a design,
      otherwise None
    """

    groups: tuple[rj.AbstractExcitation, ...]
    order: tuple[int, ...] = eqx.field(static=True)
    fresh_samples: FreshSamples | None = eqx.field(static=True, default=None)

    @classmethod
    def of(
        cls, excitations: AnyMotions | FreshSamples, owner: str = "Suite", name: str = "excitations"
    ) -> Suite:
        """Return a suite of motions; for fresh samples, with the batch of step 0. Raises `ValueError` for an
        empty set and for members that are not ground motions."""
        if isinstance(excitations, FreshSamples):
            return cls((excitations.draw(0),), tuple(range(excitations.batch)), excitations)
        motions = single_motions(owner, excitations, name).members
        indices_by_type: dict[Any, list[int]] = {}
        for k, motion in enumerate(motions):
            if isinstance(motion, rj.Record):
                indices_by_type.setdefault(rj.Record, []).append(k)
                continue
            leaves, treedef = jax.tree.flatten(motion)
            type_and_shapes = treedef, tuple(jnp.shape(y) for y in leaves)
            indices_by_type.setdefault(type_and_shapes, []).append(k)
        indices = list(indices_by_type.values())
        groups = tuple(_stack_motions([motions[k] for k in group]) for group in indices)
        return cls(groups, _order(indices))

    def __len__(self) -> int:
        return len(self.order)

    def merged_with(self, other: Suite) -> Suite:
        """Return a suite that contains the motions of this suite, followed by those of `other`."""
        groups, indices = list(self.groups), [list(group) for group in self._indices()]
        for group, other_indices in zip(other.groups, other._indices(), strict=True):
            k = next((k for k, existing in enumerate(groups) if _can_merge(existing, group)), len(groups))
            if k < len(groups):
                groups[k] = jax.tree.map(
                    lambda *ys: as_array(array_module(ys).concatenate(ys)), groups[k], group
                )
            else:
                groups.append(group)
                indices.append([])
            indices[k] += [len(self) + index for index in other_indices]
        return Suite(tuple(groups), _order(indices))

    def _indices(self) -> list[list[int]]:
        """Return the indices of the motions in each group."""
        concatenated = sorted(range(len(self)), key=self.order.__getitem__)
        ends = np.cumsum([_size(group) for group in self.groups])
        return [concatenated[end - _size(group) : end] for group, end in zip(self.groups, ends, strict=True)]

    def map_motions(self, function) -> Any:
        """Return `function(motion)` of every motion, stacked in the order of the motions."""
        results = [jax.vmap(function, in_axes=(_vmap_axes(group),))(group) for group in self.groups]
        order = np.asarray(self.order)
        return jax.tree.map(lambda *ys: jnp.concatenate(ys)[order], *results)

    def motion(self, k: int) -> rj.AbstractExcitation:
        """Return the k-th motion."""
        indices = self._indices()
        group_index = next(j for j, group_indices in enumerate(indices) if k in group_indices)
        group, position = self.groups[group_index], indices[group_index].index(k)
        if isinstance(group, rj.Records):
            return group.pick_scaled(group.which[position], group.scale[position])
        return jax.tree.map(lambda y: y[position], group)

    def scaled(self, factor) -> Suite:
        """Return the suite with all motions multiplied by a factor."""
        return eqx.tree_at(
            lambda suite: suite.groups, self, tuple(group.scaled(factor) for group in self.groups)
        )

    def with_records(self, records: rj.Records) -> Suite:
        """Return a suite of fixed motions: `records`, a batch of the fresh samples of this suite."""
        return Suite((records,), self.order)

    def responses(self, podium: rj.Podium, options: rj.Options, outputs: tuple[Any, ...]) -> rj.Peak:
        """Return the peak responses to all motions (k,); NaN where a simulation did not finish. `outputs`
        replace those of `options`."""
        options = options.replace(outputs=outputs, throw=False)
        peaks = self.map_motions(lambda motion: rj.peak_response(podium, motion, options=options))
        is_answered = has_answer(peaks)

        def mask_unanswered(y):  # y may have a second axis, for modes, stories or floors
            return jnp.where(is_answered[:, None] if y.ndim == 2 else is_answered, y, jnp.nan)

        return dataclasses.replace(peaks, values=jax.tree.map(mask_unanswered, peaks.values))

    def peaks(
        self, podium: rj.Podium, options: rj.Options, outputs: tuple[Any, ...], names: tuple[str, ...]
    ) -> dict[str, np.ndarray]:
        """Simulate all motions on all cores; outside jit and grad. Return the attributes `names` of
        `rockjax.Peak`, name → values in the order of the motions; for `result`, its codes. `outputs` replace
        those of `options`."""
        options = options.replace(outputs=outputs, throw=False)
        peaks = [rj.peak_responses(podium, group, options=options) for group in self.groups]
        order = list(self.order)

        def values(peak: rj.Peak, name: str) -> np.ndarray:
            return np.asarray(code_of(peak.result) if name == "result" else getattr(peak, name))

        return {name: np.concatenate([values(y, name) for y in peaks])[order] for name in names}

    def overturning_margins(self, podium: rj.Podium, options: rj.Options) -> np.ndarray:
        """Return the overturning margins (k,) under all motions, on all cores; NaN where a simulation did not
        finish. Outside jit and grad."""
        peaks = self.peaks(podium, options, ("margin",), ("margin", "result"))
        return np.where(did_not_finish(peaks["result"]), np.nan, peaks["margin"])


def has_answer(response: Any) -> Bool[Array | np.ndarray, "*batch"]:
    """Return whether each simulation finished: it settled, reached its end time or overturned. `response` is
    that of a podium or of a secondary system, with the attribute `result`."""
    return ~did_not_finish(code_of(response.result))


def _order(indices: list[list[int]]) -> tuple[int, ...]:
    """Return, for each motion, its index in the concatenated groups. `indices` holds the indices of the
    motions in each group."""
    concatenated = [k for group in indices for k in group]
    return tuple(concatenated.index(k) for k in range(len(concatenated)))


def _stack_motions(motions: list[Any]) -> rj.AbstractExcitation:
    """Stack the arrays of motions of one type along a new first axis; records become a `rockjax.Records`."""
    if isinstance(motions[0], rj.Record):
        # Every record gets its own factor, because `_vmap_axes` maps over `scale`.
        table = rj.Records.of(motions)
        return table.scaled(np.ones(len(table)))
    return jax.tree.map(lambda *ys: as_array(array_module(ys).stack(ys)), *motions)


def _vmap_axes(group: rj.AbstractExcitation) -> Any:
    """Return the argument `in_axes` of `jax.vmap` for a group. Records share one table of samples, so only
    the fields `which` and `scale` have an axis of motions."""
    if not isinstance(group, rj.Records):
        return 0
    unmapped = jax.tree.map(lambda _: None, group)
    return eqx.tree_at(lambda g: (g.which, g.scale), unmapped, (0, 0), is_leaf=lambda y: y is None)


def _size(group: rj.AbstractExcitation) -> int:
    """Return the number of motions in a group."""
    return jnp.size(group.which) if isinstance(group, rj.Records) else len(jax.tree.leaves(group)[0])


def _can_merge(a: rj.AbstractExcitation, b: rj.AbstractExcitation) -> bool:
    """Return whether two groups can be merged; groups of records cannot."""
    if isinstance(a, rj.Records) or jax.tree.structure(a) != jax.tree.structure(b):
        return False
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    return all(x.shape[1:] == y.shape[1:] for x, y in pairs)


def is_same_suite(a: Suite, b: Suite) -> bool:
    """Return whether two suites hold the same motions in the same order."""
    if a.order != b.order or jax.tree.structure(a) != jax.tree.structure(b):
        return False
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    return all(x is y or (x.shape == y.shape and bool(np.array_equal(x, y))) for x, y in pairs)
