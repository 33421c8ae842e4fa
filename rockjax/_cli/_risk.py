"""`rockjax risk`."""

from __future__ import annotations

from pathlib import Path

from rockjax._problem import models

from ._options import Output, options_of
from ._outputs import parse_outputs
from ._request import Request
from ._run import Console, command


@command(options_of(models.Risk))
def risk(request: Request, console: Console, output: Output = "rockjax-risk") -> None:
    """Compute the mean annual frequency of overturning from a fragility curve and the hazard of a site.

    Prints frequency, return period, probability in a given time, and sensitivities of the frequency to median
    and dispersion. If the file of the fragility curve has sensitivities of the median to parameters of the
    structure, also prints the sensitivities of the frequency to these parameters. Writes OUTPUT.nc (hazard,
    fragility and the contribution of each intensity) and OUTPUT-risk.png.

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
    from rockjax._problem.risk import fragility_of
    from rockjax._risk.annual import MIN_EXTRAPOLATED

    if settings.hazard is None:
        raise ValueError("rockjax risk needs a hazard curve; give its file by --hazard")
    hazard = rj.Hazard.from_file(_path(request, settings.hazard), site=settings.site)
    fragility = fragility_of(settings, lambda name: _path(request, name))
    if fragility is None:
        raise ValueError(
            "rockjax risk needs a fragility curve; give --fragility FILE, or --median and --dispersion"
        )
    annual = rj.annual_frequency(fragility, hazard)
    contributions = rj.disaggregation(fragility, hazard)
    console.say(repr(hazard))
    median, dispersion = contributions.attrs["median"], contributions.attrs["dispersion"]
    console.say(f"fragility: median {median:.4g} {hazard.units}, dispersion {dispersion:.3g}")
    frequency, return_period = float(annual.frequency), float(annual.return_period)
    console.say(f"mean annual frequency of overturning: {frequency:.4g}, once in {return_period:.4g} years")
    probability = float(annual.probability(settings.years))
    console.say(f"probability in {settings.years:g} years: {probability:.4g}")
    slopes = {name: float(y) for name, y in annual.sensitivities.items()}
    for name, value in slopes.items():
        console.say(f"d ln λ_f/d{'β' if name == 'dispersion' else f' ln {name}'}: {value:.4g}")
    share = float(annual.extrapolated)
    if share > MIN_EXTRAPOLATED:
        console.say(
            f"{share:.0%} of the frequency comes from intensities beyond the points of the hazard curve"
        )
    console.json_object |= {"frequency_per_year": frequency, "return_period_years": return_period}
    console.json_object |= {
        "years": settings.years,
        "probability": probability,
        "extrapolated": share,
        "sensitivities": slopes,
    }
    console.write(files.data(), contributions)
    console.draw(files.picture("risk"), "risk", contributions)


def _path(request: Request, name: str) -> Path:
    """Return the path of a file. If it is not in the working directory, it must be in the folder of the
    problem file."""
    return Path(name) if request.path is None or Path(name).exists() else request.path.parent / name
