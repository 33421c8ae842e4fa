"""`rockjax ensemble`."""

from __future__ import annotations

from rockjax._problem import models

from ._options import PULSE_DEFAULTS, SINGLE_DEFAULTS, Output, accuracy_options, options_of, structure_options
from ._outputs import parse_outputs
from ._request import Request
from ._run import Console, command


@command(
    structure_options(**SINGLE_DEFAULTS),
    options_of(models.Pulses, **PULSE_DEFAULTS),
    options_of(models.Record),
    options_of(models.Ensemble),
    accuracy_options(rtol=1e-8, overturn_ratio=1.0, method="dopri8"),
)
def ensemble(request: Request, console: Console, output: Output = "rockjax-ensemble") -> None:
    """Estimate distributions of the peaks of random structures under random motions, with confidence bounds.

    The table [ensemble.spread] of the problem file contains the distributions of parameters. A scene is one
    structure under one motion; each scene draws its motion from the set of motions. Prints quantiles. Writes
    OUTPUT.nc with all scenes, and a picture of the empirical distribution of each peak, such as
    OUTPUT-peak-rotation.png. Ctrl-C saves nothing.

    \b
    Examples:
      rockjax ensemble --example ensemble
      rockjax ensemble problem.toml --n 10000 --seed 1
      rockjax ensemble problem.toml --outputs peak_rotation,errors -o study
    """
    import rockjax as rj
    from rockjax._outputs.registry import variables_of
    from rockjax._results import explain_failures
    from rockjax._studies.distributions import distribution_of

    podium, settings = request.podium(), request.settings
    options = request.options(outputs=tuple(settings.outputs))
    pictures = {name: name.replace("_", "-") for name in variables_of(options.outputs)}
    files = parse_outputs(output, "rockjax-ensemble").check(pictures.values())
    spread = {name: distribution_of(entry) for name, entry in settings.spread.items()}
    with console.progress(settings.n, "scenes") as bar, request.reader.errors_at("ensemble"):
        result = rj.ensemble(
            podium,
            request.motion_or_set(podium),
            spread=spread,
            n=settings.n,
            seed=settings.seed,
            options=options,
            progress=bar,
        )
    console.write(files.data(), result.data)
    share, low, high = result.overturning_probability()
    console.json_object |= result.counts | {
        "overturning": share,
        "overturning_interval": [low, high],
        "quantiles": {},
    }
    for name in (name for name in pictures if name in result.answers):
        console.draw(files.picture(pictures[name]), "ensemble", result, output=name)
        quantiles = result.quantiles(name)
        console.json_object["quantiles"][name] = {
            f"{float(q):g}": [float(quantiles[y][k]) for y in ("quantile", "lower", "upper")]
            for k, q in enumerate(quantiles["probability"])
        }
    console.say(repr(result))
    if result.unanswered.any():
        console.error(explain_failures(result.data["result"]))
