"""`rockjax ensemble`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rockjax._problem import models

from ._options import PULSE_DEFAULTS, SINGLE_DEFAULTS, Output, accuracy_options, options_of, structure_options
from ._outputs import parse_outputs, require_writable
from ._request import Request
from ._run import Console, command

if TYPE_CHECKING:
    import rockjax as rj


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
    OUTPUT-peak-rotation.png. Ctrl-C writes OUTPUT.nc with the scenes solved so far.

    With --against, each peak is compared with that of a second ensemble by the test of Kolmogorov and
    Smirnov. A picture such as OUTPUT-peak-rotation-quantiles.png plots the quantiles against each other. For
    a law of impact, the second ensemble has the same spread except for `restitution`, and the next seed; it
    is written to OUTPUT-against.nc. To compare two structures, run the command for each of them with its own
    --seed, and give the file of the first to the second.

    \b
    Examples:
      rockjax ensemble --example ensemble
      rockjax ensemble problem.toml --n 10000 --seed 1
      rockjax ensemble problem.toml --outputs peak_rotation,errors -o study
      rockjax ensemble problem.toml --against compatible
      rockjax ensemble other.toml --seed 2 --against rockjax-ensemble.nc -o other
    """
    import rockjax as rj
    from rockjax._outputs.registry import variables_of
    from rockjax._results import explain_failures
    from rockjax._studies.distributions import distribution_of

    podium, settings = request.podium(), request.settings
    options = request.options(outputs=tuple(settings.outputs))
    names = list(variables_of(options.outputs))
    is_law = settings.against is not None and not settings.against.endswith(".nc")
    second = None if settings.against is None or is_law else _read(settings.against, request)
    pictures = [name.replace("_", "-") for name in names]
    pictures += [] if settings.against is None else [f"{name}-quantiles" for name in pictures]
    files = parse_outputs(output, "rockjax-ensemble").check(pictures)
    second_path = Path(f"{files.prefix}-against.nc")
    if is_law:
        require_writable(second_path)

    def solve(structure: Any, spread: Mapping[str, Any], seed: int, path: Path) -> rj.Ensemble:
        """Return an ensemble, and write its scenes, also those of an interrupted ensemble."""
        try:
            with console.progress(settings.n, "scenes") as bar, request.reader.errors_at("ensemble"):
                result = rj.ensemble(
                    structure,
                    request.motion_or_set(podium),
                    spread=spread,
                    n=settings.n,
                    seed=seed,
                    t_end=settings.t_end,
                    options=options,
                    progress=bar,
                )
        except rj.Interrupted as interrupt:
            if interrupt.partial is not None:
                console.write(path, interrupt.partial.data)
            raise
        console.write(path, result.data)
        return result

    structure, other = request.structure(), None
    if is_law:
        with request.reader.errors_at("ensemble.against"):
            other = structure.replace(restitution=_law(settings.against))
    spread = {name: distribution_of(entry) for name, entry in settings.spread.items()}
    result = solve(structure, spread, settings.seed, files.data())
    if is_law:
        others = {name: y for name, y in spread.items() if name != "restitution"}
        second = solve(other, others, settings.seed + 1, second_path)
    share, low, high = result.overturning_probability()
    console.json_object |= result.counts | {
        "overturning": share,
        "overturning_interval": [low, high],
        "quantiles": {},
    }
    console.say(repr(result))
    label = Path(str(settings.against)).name
    for name in (name for name in names if name in result.answers):
        picture = name.replace("_", "-")
        quantiles = result.quantiles(name)
        console.json_object["quantiles"][name] = {
            f"{float(q):g}": [float(quantiles[y][k]) for y in ("quantile", "lower", "upper")]
            for k, q in enumerate(quantiles["probability"])
        }
        if second is None or name not in second.answers:
            console.draw(files.picture(picture), "ensemble", result, output=name)
            continue
        with request.reader.errors_at("ensemble.against"):
            comparison = result.compare(second, name)
        both = {"this ensemble": result, label: second}
        console.draw(files.picture(picture), "ensemble", both, output=name)
        console.draw(files.picture(f"{picture}-quantiles"), "quantile_quantile", both, output=name)
        console.json_object.setdefault("comparisons", {})[name] = comparison._asdict()
        console.say(
            f"  {name} against {label}: largest distance of the distributions {comparison.statistic:.4g} "
            f"({comparison.confidence:.0%}: {comparison.lower:.4g} to {comparison.upper:.4g}), "
            f"p = {comparison.p_value:.3g}"
        )
    for each in (result, second if is_law else None):
        if each is not None and each.unanswered.any():
            console.error(explain_failures(each.data["result"]))


def _law(text: Any) -> Any:
    """Return a law of impact or a factor. Other texts are returned unchanged; the structure refuses them."""
    try:
        return float(text)
    except ValueError:
        return text


def _read(text: str, request: Request) -> rj.Ensemble:
    """Return the ensemble in a file. In a problem file, the path is relative to the folder of the file."""
    import xarray

    import rockjax as rj

    path = Path(text) if "against" in request.flags else request.reader.folder / text
    with request.reader.errors_at("ensemble.against"):
        try:
            data = xarray.load_dataset(path)
        except FileNotFoundError:
            raise ValueError(f"must be a file of `rockjax ensemble` or a law, got {text!r}") from None
        result = rj.Ensemble(data)
        if result.data.attrs["seed"] == request.settings.seed:
            raise ValueError(
                f"the file has the seed {request.settings.seed}, like this ensemble, so they are not "
                "independent; give another --seed"
            )
        return result
