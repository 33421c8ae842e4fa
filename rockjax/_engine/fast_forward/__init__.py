"""Fast-forwards: stretches of a scene that are passed over without trial steps.

Each module has one, and each asks the outputs of the plan: `over_rest`, `over_sample` and `over_bounces` of
an output return its record after the stretch, or whether the record stands. No fast-forward names an output.
One may be used only if every followed output has written its method.

| name | module | what is passed over |
|---|---|---|
| `rest` | `rest.py` | full contact of a rigid podium, until its next uplift |
| `samples` | `samples.py` | samples of a record over which rigid columns rock on |
| `bounces` | `bounces.py` | bounces of rigid columns that end at rest |
"""

from __future__ import annotations

# Name, and the method of an output that allows it.
FAST_FORWARDS = {"rest": "over_rest", "samples": "over_sample", "bounces": "over_bounces"}


def allowed(outputs, names) -> tuple[str, ...]:
    """Return those of some fast-forwards that all outputs allow."""
    return tuple(name for name in names if all(output.passes(FAST_FORWARDS[name]) for output in outputs))
