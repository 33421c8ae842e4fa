"""Ground motions that are drawn anew in every step of a search."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Self

import jax.numpy as jnp
import numpy as np

import rockjax as rj
from rockjax._risk.structure import records_from_samples
from rockjax.internal import AnyMotions, format_value, require_whole, single_motions

STEP, SAMPLE = 1, 2  # streams of random numbers: batches of a search, and independent samples


class FreshSamples:
    """Ground motions drawn anew in every step of a search by a gradient transformation.

    They replace a suite. They are drawn from a random motion, or from more records than fit into one batch.

    - `motions`: a [`rockjax.GaussianMotion`][], or two records or more, drawn with replacement
    - `batch`: number of motions of a step, ≥ 2
    - `verify`: number of motions of the independent sample that verifies a design, a multiple of `batch`
    - `seed`: of the random numbers, ≥ 0

    For targets on a distribution of capacities: `optimise.AnnualFrequency` (records) and
    `optimise.MedianCapacity`. Raises `ValueError` for invalid motions or numbers.
    """

    def __init__(
        self, motions: rj.GaussianMotion | AnyMotions, batch: int = 16, *, verify: int = 256, seed: int = 0
    ):
        owner = type(self).__name__
        require_whole(owner, "batch", batch, 2)
        require_whole(owner, "verify", verify, batch)
        require_whole(owner, "seed", seed, 0)
        if verify % batch:
            raise ValueError(f"{owner}: verify must be a multiple of batch = {batch}, got verify = {verify}")
        self.batch, self.verify, self.seed = batch, verify, seed
        self.motions: rj.GaussianMotion | rj.Records
        if isinstance(motions, rj.GaussianMotion):
            self.motions, self.members = motions, ()
            return
        members = single_motions(owner, motions, "motions").members
        self.members = tuple(motion for motion in members if isinstance(motion, rj.Record))
        for k, motion in enumerate(members):
            if not isinstance(motion, rj.Record):
                raise ValueError(
                    f"{owner}: motions must be a rockjax.GaussianMotion or records, but entry {k} is "
                    f"{format_value(motion)}"
                )
        if len(self.members) < 2:
            raise ValueError(f"{owner}: motions must hold two records or more, got one")
        self.motions = rj.Records.of(self.members)

    def records(self, owner: str) -> tuple[Any, ...]:
        """Return the records that are drawn from. Raises `ValueError` for a random motion."""
        if not self.members:
            raise ValueError(f"{owner}: suite must be FreshSamples of records, got {self!r}")
        return self.members

    def of_records(self, members: Sequence[Any]) -> Self:
        """Return fresh samples with the same draws from other records."""
        return type(self)(list(members), self.batch, verify=self.verify, seed=self.seed)

    def draw(self, k: int) -> rj.Records:
        """Return the batch of step k."""
        return self._draw(STEP, k)

    def sample(self, k: int) -> list[rj.Records]:
        """Return the k-th independent sample, in batches."""
        return [self._draw(SAMPLE, k, part) for part in range(self.verify // self.batch)]

    def _draw(self, *purpose: int) -> rj.Records:
        rng = np.random.default_rng([self.seed, *purpose])
        if isinstance(self.motions, rj.GaussianMotion):
            u = rng.standard_normal((self.batch, self.motions.dimension))
            records, which = records_from_samples(self.motions, jnp.asarray(u)), np.arange(self.batch)
        else:
            records, which = self.motions, rng.integers(len(self.motions), size=self.batch)
        return dataclasses.replace(records, which=which.astype(np.int32), scale=jnp.ones(self.batch))

    def __repr__(self):
        kind = f"{len(self.members)} records" if self.members else "Gaussian motions"
        return f"FreshSamples: {self.batch} of {kind} a step, {self.verify} to verify"
