"""`rockjax risk`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rockjax._problem import models

from ._options import Output, options_of
from ._outputs import parse_outputs
from ._request import Request
from ._run import Report, command


@command(options_of(models.Risk))
def risk(request: Request, report: Report, output: Output = "rockjax-risk") -> None:
    """Compute the mean annual frequency of overturning: a fragility curve over the hazard of a site.

    Prints frequency, return period, probability in a given time, and sensitivities of the frequency if the
    fragility has them. Writes OUTPUT.nc (hazard, fragility and the contribution of each intensity) and
    OUTPUT-risk.png.

    \b
    Examples:
      rockjax risk --fragility rockjax-fragility.nc --hazard site.csv
      rockjax risk --median 3.5 --dispersion 0.4 \\
        --hazard hazard_curve-mean.csv --site 0
      rockjax risk --example risk --years 100
    """
    files = parse_outputs(output, "rockjax-risk").check(("risk",))
    settings = request.settings
    import rockjax as rj
    from rockjax._risk.annual import MIN_EXTRAPOLATED

    if settings.hazard is None:
        raise ValueError("--hazard: is missing; give the file with the hazard curve of the site")
    hazard = rj.Hazard.from_file(_path(request, settings.hazard), site=settings.site)
    fragility = _fragility(request, settings)
    found = rj.annual_frequency(fragility, hazard)
    contributions = rj.disaggregation(fragility, hazard)
    report.say(repr(hazard))
    median, dispersion = contributions.attrs["median"], contributions.attrs["dispersion"]
    report.say(f"fragility: median {median:.4g} {hazard.units}, dispersion {dispersion:.3g}")
    frequency = float(found.frequency)
    report.say(
        f"mean annual frequency of overturning: "
        f"{frequency:.4g}, once in {float(found.return_period):.4g} years"
    )
    within = float(found.probability(settings.years))
    report.say(f"probability in {settings.years:g} years: {within:.4g}")
    slopes = {name: float(y) for name, y in found.sensitivities.items()}
    for name, value in slopes.items():
        report.say(f"d ln λ_f/d{'β' if name == 'dispersion' else f' ln {name}'}: {value:.4g}")
    share = float(found.extrapolated)
    if share > MIN_EXTRAPOLATED:
        report.say(f"{share:.0%} of the frequency comes from beyond the given points of the hazard curve")
    report.facts |= {"frequency_per_year": frequency, "return_period_years": float(found.return_period)}
    report.facts |= {
        "years": settings.years,
        "probability": within,
        "extrapolated": share,
        "sensitivities": slopes,
    }
    report.write(files.data(), contributions)
    report.draw(files.picture("risk"), "risk", contributions)


def _path(request: Request, name: str) -> Path:
    """Return the path of a file: as given, or else beside the problem file."""
    return Path(name) if request.path is None or Path(name).exists() else request.path.parent / name


def _fragility(request: Request, curve: models.Risk) -> Any:
    import jax.numpy as jnp

    import rockjax as rj

    by_numbers = [value for value in (curve.median, curve.dispersion) if value is not None]
    if curve.fragility is None:
        if len(by_numbers) != 2:
            raise ValueError("needs a fragility curve: --fragility FILE, or --median and --dispersion")
        return rj.Lognormal(jnp.asarray(by_numbers[0]), jnp.asarray(by_numbers[1]))
    if by_numbers:
        raise ValueError("--fragility: give a file, or --median and --dispersion, not both")
    path = _path(request, curve.fragility)
    if path.suffix.lower() == ".xml":
        return _of_model(path, rj.read_fragility_model(path), curve.structure)
    from rockjax.plots._from_file import load

    data = load(path)
    if data.attrs["kind"] != "fragility":
        raise ValueError(
            f"{path}: holds a {data.attrs['kind']}, not a fragility; `rockjax fragility` makes one"
        )
    return data


def _of_model(path: Path, model: dict[str, Any], structure: str | None) -> Any:
    if structure is None and len(model) > 1:
        raise ValueError(f"{path}: holds {', '.join(model)}; choose one with --structure")
    name = next(iter(model)) if structure is None else structure
    if name not in model:
        raise ValueError(f"{path}: has no structure {name!r}; it has {', '.join(model)}")
    return model[name]
