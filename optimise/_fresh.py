"""Fresh samples: ground motions that are drawn anew in every step of a search."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Self

import jax.numpy as jnp
import numpy as np

import rockjax as rj
from rockjax._risk.structure import records_from_samples
from rockjax.internal import AnyMotions, format_value, require_whole, single_motions

# The seed of a batch is [seed, stream, …]. The entry `stream` differs between the steps of a search, the
# independent samples and the bootstrap, so that all of them use different random numbers.
STEP_STREAM, SAMPLE_STREAM, BOOTSTRAP_STREAM = 1, 2, 3


class FreshSamples:
    """Ground motions that are drawn anew in every step of a search with an Optax gradient transformation.

    `optimise.MedianCapacity` accepts an instance as its argument `suite`. `optimise.AnnualFrequency` accepts
    an instance that draws from records.

    - `motions`: a [`rockjax.GaussianMotion`][], or two or more records, from which motions are drawn with
      replacement
    - `batch`: number of motions that are drawn in every step, ≥ 2
    - `verify`: number of motions of the independent sample that verifies a design, a multiple of `batch`
    - `seed`: seed of the random numbers, ≥ 0

    Raises `ValueError` for invalid arguments.
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
                    f"{owner}: motions must be a rockjax.GaussianMotion or records, but motions[{k}] is "
                    f"{format_value(motion)}"
                )
        if len(self.members) < 2:
            raise ValueError(f"{owner}: motions must hold at least two records, got one")
        self.motions = rj.Records.of(self.members)

    def records(self, owner: str) -> tuple[Any, ...]:
        """Return the records from which samples are drawn.

        Raises `ValueError` if samples are drawn from a Gaussian motion; its message begins with `owner`.
        """
        if not self.members:
            raise ValueError(f"{owner}: FreshSamples must be drawn from records, got {self!r}")
        return self.members

    def of_records(self, members: Sequence[Any]) -> Self:
        """Return fresh samples of the records `members`, with the same `batch`, `verify` and `seed`."""
        return type(self)(list(members), self.batch, verify=self.verify, seed=self.seed)

    def draw(self, k: int) -> rj.Records:
        """Return the batch of step k."""
        return self._draw(STEP_STREAM, k)

    def sample(self, k: int) -> list[rj.Records]:
        """Return the k-th independent sample of `verify` motions, as a list of batches."""
        return [self._draw(SAMPLE_STREAM, k, index) for index in range(self.verify // self.batch)]

    def _draw(self, *stream: int) -> rj.Records:
        """Return the batch that is drawn with the random seed [`self.seed`, *`stream`]."""
        rng = np.random.default_rng([self.seed, *stream])
        if isinstance(self.motions, rj.GaussianMotion):
            u = rng.standard_normal((self.batch, self.motions.dimension))
            records, rows = records_from_samples(self.motions, jnp.asarray(u)), np.arange(self.batch)
        else:
            records, rows = self.motions, rng.integers(len(self.motions), size=self.batch)
        return dataclasses.replace(records, which=rows.astype(np.int32), scale=jnp.ones(self.batch))

    def __repr__(self):
        source = f"of {len(self.members)} records" if self.members else "Gaussian motions"
        return f"FreshSamples: {self.batch} {source} per step, {self.verify} for verification"
