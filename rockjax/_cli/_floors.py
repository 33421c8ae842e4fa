"""`rockjax floors`."""

from __future__ import annotations

from typing import Any

from rockjax._problem import models

from ._options import PULSE_DEFAULTS, SINGLE_DEFAULTS, Output, accuracy_options, options_of, structure_options
from ._outputs import SINGLE_PICTURE, parse_outputs
from ._request import Request
from ._run import Console, command


@command(
    structure_options(**SINGLE_DEFAULTS),
    options_of(models.Pulses, **PULSE_DEFAULTS),
    options_of(models.Record),
    options_of(models.Floors),
    accuracy_options(rtol=1e-8, method="dopri8"),
)
def floors(request: Request, console: Console, output: Output = "rockjax-floors") -> None:
    """Compute floor response spectra of deck and stories, of the ground, and of the building on a fixed base.

    The deck is the beam on the columns. Writes OUTPUT.nc and OUTPUT.png. If the set has several motions, the
    picture shows medians.

    \b
    Examples:
      rockjax floors --acceleration-ratio 2.5 --T-p 1.0 --T-s 0.5
      rockjax floors --record suite/RSN1.AT2 --levels deck --direction vertical
      rockjax floors --example floors -o floors.pdf
      rockjax floors problem.toml --motion records --sensitivities alpha
    """
    import numpy as np

    import rockjax as rj
    from rockjax._results import did_not_finish, explain_failures

    files = parse_outputs(output, "rockjax-floors").check(SINGLE_PICTURE)
    podium, settings = request.podium(), request.settings
    motion = request.motion_or_set(podium)
    superstructure = podium.superstructure
    story_weights = None if superstructure is None else superstructure.story_weights
    stories = 0 if story_weights is None else story_weights.shape[-2]
    levels: Any = settings.levels or ["deck", *range(1, stories + 1)]
    levels = [int(y) if str(y).isdigit() else y for y in levels]
    periods = np.geomspace(settings.periods[0], settings.periods[1], settings.points)
    with console.progress(len(motion) if isinstance(motion, list | rj.Motions) else 1, "motions") as bar:
        data = rj.floor_spectrum(
            podium,
            motion,
            periods,
            damping=settings.oscillator_damping,
            level=levels,
            direction=settings.direction,
            t_end=settings.t_end,
            fixed_base=True,
            sensitivities=settings.sensitivities,
            options=request.options(),
            progress=bar,
        )
    console.write(files.data(), data)
    console.draw(files.picture(), "floor_spectrum", data)
    g, overturned = float(podium.g), np.atleast_1d(data["overturned"].values)
    counts = {
        "overturned": overturned,
        "did not finish": np.atleast_1d(did_not_finish(data["result"].values)),
    }
    parts = [f"{int(y.sum())} {name}" for name, y in counts.items() if y.any()]
    note = (
        f"; {', '.join(parts)}, and the values of these scenes cover only the time until then"
        if parts
        else ""
    )
    console.say(f"{overturned.size} scenes{note}; largest values:")
    largest_values = {}
    for level in data["level"].values.tolist():
        at_level = data.sel(level=level)
        spectrum = at_level["pseudo_acceleration"]
        spectrum = spectrum.max([dim for dim in spectrum.dims if dim != "period"])
        k = int(spectrum.argmax("period"))
        peak, jump = (float(at_level[name].max()) for name in ("peak_acceleration", "peak_velocity_jump"))
        console.say(
            f"  {level:<6} acceleration {peak / g:.4g} g, velocity jump {jump:.4g} m/s, spectrum "
            f"{float(spectrum[k]) / g:.4g} g at {periods[k]:.3g} s"
        )
        largest_values[level] = {
            "peak_acceleration": peak,
            "peak_velocity_jump": jump,
            "spectrum": float(spectrum[k]),
        }
    may_grow = ~(data["remaining_ratio"].values <= 1)
    if may_grow.any():
        console.say(f"  {may_grow.mean():.0%} of the values may still grow after the end of their scene")
    console.json_object |= {
        "scenes": overturned.size,
        "overturned": float(overturned.mean()),
        "without_answer": int(counts["did not finish"].sum()),
        "levels": largest_values,
    }
    if message := explain_failures(data["result"]):
        console.error(message)
