"""Sets of ground motions, and the responses of one podium to all of them."""

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
from rockjax._responses.peak import AbstractPeak
from rockjax.internal import AnyMotions, Module, array_module, single_motions

from ._fresh import FreshSamples

Margins = Float[Array, " k"]


class Suite(Module):
    """Ground motions of any kinds, in groups with one compiled loop each: records, or motions of one kind."""

    groups: tuple[rj.AbstractExcitation, ...]
    order: tuple[int, ...] = eqx.field(static=True)  # index of each motion among the stacked ones
    fresh_samples: FreshSamples | None = eqx.field(static=True, default=None)  # of motions drawn anew

    @classmethod
    def of(
        cls, excitations: AnyMotions | FreshSamples, owner: str = "Suite", name: str = "excitations"
    ) -> Suite:
        """Return a suite. Raises `ValueError` for an empty set and for members that are no ground motions."""
        if isinstance(excitations, FreshSamples):
            return cls((excitations.draw(0),), tuple(range(excitations.batch)), excitations)
        motions = single_motions(owner, excitations, name).members
        kinds: dict[Any, list[int]] = {}
        for k, motion in enumerate(motions):
            if isinstance(motion, rj.Record):
                kinds.setdefault(rj.Record, []).append(k)
                continue
            leaves, structure = jax.tree.flatten(motion)
            kinds.setdefault((structure, tuple(jnp.shape(y) for y in leaves)), []).append(k)
        members = list(kinds.values())
        return cls(tuple(_stack_motions([motions[k] for k in places]) for places in members), _order(members))

    def __len__(self) -> int:
        return len(self.order)

    def merged_with(self, other: Suite) -> Suite:
        """Return the motions of both suites, grouped by kind."""
        groups, members = list(self.groups), [list(part) for part in self._members()]
        for group, places in zip(other.groups, other._members(), strict=True):
            k = next((k for k, existing in enumerate(groups) if _can_merge(existing, group)), len(groups))
            if k < len(groups):
                groups[k] = jax.tree.map(
                    lambda *ys: as_array(array_module(ys).concatenate(ys)), groups[k], group
                )
            else:
                groups.append(group)
                members.append([])
            members[k] += [len(self) + place for place in places]
        return Suite(tuple(groups), _order(members))

    def _members(self) -> list[list[int]]:
        """Return the numbers of the motions in each group."""
        by_order = sorted(range(len(self)), key=self.order.__getitem__)
        ends = np.cumsum([_size(group) for group in self.groups])
        return [by_order[end - _size(group) : end] for group, end in zip(self.groups, ends, strict=True)]

    def map_motions(self, function) -> Any:
        """Return `function(motion)` of every motion, stacked in the order of the motions."""
        parts = [jax.vmap(function, in_axes=(_axes(group),))(group) for group in self.groups]
        order = np.asarray(self.order)
        return jax.tree.map(lambda *ys: jnp.concatenate(ys)[order], *parts)

    def motion(self, k: int) -> rj.AbstractExcitation:
        """Return the k-th motion."""
        number = next(j for j, members in enumerate(self._members()) if k in members)
        group, place = self.groups[number], self._members()[number].index(k)
        if isinstance(group, rj.Records):
            return group.chosen(group.which[place], group.scale[place])
        return jax.tree.map(lambda y: y[place], group)

    def scaled(self, factor) -> Suite:
        """Return all motions times a factor."""
        return eqx.tree_at(
            lambda suite: suite.groups, self, tuple(group.scaled(factor) for group in self.groups)
        )

    def with_records(self, records: rj.Records) -> Suite:
        """Return the suite with another batch of fresh samples."""
        return Suite((records,), self.order)

    def responses(self, podium: rj.Podium, options: rj.Options, outputs: tuple[Any, ...]) -> rj.Peak:
        """Return the peak responses to all motions; NaN where a scene did not finish.

        - `podium`: the structure; `options`: of the simulations
        - `outputs`: the requested outputs, as in `rockjax.Options`
        """
        options = options.replace(outputs=outputs, throw=False)
        peaks = self.map_motions(lambda motion: rj.peak_response(podium, motion, options=options))
        is_answered = has_answer(peaks)

        def mask_unanswered(y):  # of modes and stories along a last axis
            return jnp.where(is_answered[:, None] if y.ndim == 2 else is_answered, y, jnp.nan)

        return dataclasses.replace(peaks, values=jax.tree.map(mask_unanswered, peaks.values))

    def margins(self, podium: rj.Podium, options: rj.Options) -> np.ndarray:
        """Return the overturning margins of all motions, on all cores (host, without derivatives)."""
        options = options.replace(outputs=("margin",), throw=False)
        parts = [rj.peak_responses(podium, group, options=options).margin for group in self.groups]
        return np.concatenate([np.asarray(part) for part in parts])[list(self.order)]


def has_answer(peaks: AbstractPeak) -> Bool[Array, "*batch"]:
    """Return whether scenes settled, reached their end or overturned."""
    ends = (peaks.result == rj.RESULTS.settled) | (peaks.result == rj.RESULTS.end_of_time)
    return ends | peaks.overturned


def _order(members: list[list[int]]) -> tuple[int, ...]:
    """Return the index of each motion among the stacked ones, from the numbers in each group."""
    placed = [k for places in members for k in places]
    return tuple(placed.index(k) for k in range(len(placed)))


def _stack_motions(motions: list[Any]) -> rj.AbstractExcitation:
    if isinstance(motions[0], rj.Record):
        table = rj.Records.of(motions)
        return table.scaled(np.ones(len(table)))
    return jax.tree.map(lambda *ys: as_array(array_module(ys).stack(ys)), *motions)


def _axes(group: rj.AbstractExcitation) -> Any:
    """Return the vmap axes of a group; of records in a table only the row and its scale vary."""
    if not isinstance(group, rj.Records):
        return 0
    none = jax.tree.map(lambda _: None, group)
    return eqx.tree_at(lambda g: (g.which, g.scale), none, (0, 0), is_leaf=lambda y: y is None)


def _size(group: rj.AbstractExcitation) -> int:
    return jnp.size(group.which) if isinstance(group, rj.Records) else len(jax.tree.leaves(group)[0])


def _can_merge(a: rj.AbstractExcitation, b: rj.AbstractExcitation) -> bool:
    """Return whether two groups can be merged; tables of records cannot."""
    if isinstance(a, rj.Records) or jax.tree.structure(a) != jax.tree.structure(b):
        return False
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    return all(x.shape[1:] == y.shape[1:] for x, y in pairs)


def is_same_suite(a: Suite, b: Suite) -> bool:
    """Return whether two suites hold the same motions."""
    if a.order != b.order or jax.tree.structure(a) != jax.tree.structure(b):
        return False
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    return all(x is y or (x.shape == y.shape and bool(np.array_equal(x, y))) for x, y in pairs)
