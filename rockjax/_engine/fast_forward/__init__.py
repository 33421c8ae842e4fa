"""Fast-forwards: parts of a scene that are skipped without trial steps (steps that may be rejected).

A scene is one podium under one excitation. A rigid podium is a podium with a rigid superstructure or none.
Each module contains one fast-forward. A fast-forward calls one method of every requested output: `over_rest`
returns the accumulator (the value of the output up to the present time) after the skipped part; `over_sample`
and `over_bounces` return whether the accumulator stays the same. A fast-forward may be used only if every
requested output implements its method.

| name | module | skipped part |
|---|---|---|
| `rest` | `rest.py` | full contact of a rigid podium until its next uplift |
| `samples` | `samples.py` | sampling intervals of the ground motion in which a rigid podium rocks on |
| `bounces` | `bounces.py` | bounces of a rigid podium that end at rest |
"""

from __future__ import annotations

# Name of each fast-forward, and the method that outputs must implement for it.
FAST_FORWARDS = {"rest": "over_rest", "samples": "over_sample", "bounces": "over_bounces"}


def allowed(outputs, names) -> tuple[str, ...]:
    """Return the fast-forwards among `names` that all outputs allow."""
    return tuple(name for name in names if all(output.passes(FAST_FORWARDS[name]) for output in outputs))
