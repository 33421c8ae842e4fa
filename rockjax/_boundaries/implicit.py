"""How a boundary moves with the numbers of podium and motion, by the implicit function theorem."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from rockjax._checks import array_module
from rockjax._engine.solve import solve
from rockjax._programs.program import KeptProgram
from rockjax._results import REST

from .verdict import boundary_residual, margin_options

PAST = 1e-10  # relative distance to the boundary at which the margin is differentiated


def implicit(leaves, moving, scale, structure, live: tuple[bool, ...], margin: bool):
    """How the boundary moves with the numbers that do, by the implicit function theorem; zero where there is
    none."""
    numpy = array_module(leaves, scale)
    found = numpy.isfinite(scale)
    places = [k for k, moves in enumerate(live) if moves]
    limit = jax.tree.unflatten(structure, leaves)[2]
    past = numpy.where(found, numpy.multiply(scale, 1 + PAST), limit)

    def residual(scale, *values):
        numbers = list(leaves)
        for k, value in zip(places, values, strict=True):
            numbers[k] = value
        podium, excitation, _, (options, _) = jax.tree.unflatten(structure, numbers)
        wanted = margin_options(options, margin)
        (floats, _), _ = solve(podium, excitation.scaled(scale), REST, None, wanted)
        return boundary_residual(floats, margin)

    point = tuple(leaves[k] for k in places)
    _, along = jax.linearize(residual, past, *point)
    slope = numpy.asarray(along(numpy.ones_like(past), *(numpy.zeros_like(y) for y in point)))
    change = along(numpy.zeros_like(past), *moving)
    usable = found & (slope != 0) & numpy.isfinite(slope)
    weight = numpy.where(usable, -1 / numpy.where(usable, slope, 1.0), 0.0)
    return weight * jnp.where(usable, change, 0.0)


@KeptProgram
def weights(arguments, scale, *, numbers: tuple[int, ...], margin: bool):
    """How the boundary moves with each of some numbers of podium and motion."""
    leaves, structure = jax.tree.flatten(arguments)
    live = tuple(k in numbers for k in range(len(leaves)))
    along_unit = lambda unit: implicit(leaves, list(unit), scale, structure, live, margin)
    return jax.vmap(along_unit)(jnp.eye(len(numbers), dtype=scale.dtype))


implicit_in_program = jax.jit(implicit, static_argnames=("structure", "live", "margin"))
