"""`rockjax overturning`."""

from __future__ import annotations

from rockjax._problem import models

from ._options import PANEL_DEFAULTS, Output, Resume, accuracy_options, options_of, structure_options
from ._outputs import parse_outputs
from ._panels import combine_panels, make_pulse, report_minima
from ._request import Request
from ._run import Console, command, exit_after_saving


@command(structure_options(**PANEL_DEFAULTS), options_of(models.Overturning), accuracy_options(rtol=1e-11))
def overturning(
    request: Request, console: Console, output: Output = "rockjax-overturning", resume: Resume = False
) -> None:
    """Compute overturning boundaries against pulse frequency, with survival windows above the first boundary.

    A boundary is an acceleration of the pulse at which the outcome changes. In a survival window, columns
    survive although smaller accelerations overturn them. Boundaries are roots of the overturning margin;
    their accuracy depends on the tolerance, not on a grid. Without options, computes Fig. 7 of the paper that
    defines the model (see docs/citing.md). Writes OUTPUT.nc, OUTPUT-boundaries.png and, with sensitivities,
    OUTPUT-sensitivity.png. Ctrl-C saves the finished podiums in OUTPUT.partial.nc; --resume continues with
    the others.

    \b
    Examples:
      rockjax overturning --T-s 0,0.5 --eta-over-gamma 5 --points 41
      rockjax overturning --gamma 0 --eta 0 --T-s 0 --pulse one-sine \\
        --sensitivities alpha,R -o block
      rockjax overturning --example spectrum --points 21
      rockjax overturning problem.toml --frequency 2 6
    """
    import numpy as np

    import rockjax as rj
    from rockjax._cli import _checkpoint
    from rockjax._studies.overturning_spectrum import check_overturning_resumes

    podiums, ratios, periods, zeta = request.panels()
    settings = request.settings
    parameters, max_ratio = settings.sensitivities, settings.max_acceleration_ratio
    pictures = ("boundaries", "sensitivity") if parameters else ("boundaries",)
    files = parse_outputs(output, "rockjax-overturning").check(pictures)
    low, high = settings.frequency_ratio
    x = np.linspace(low, high, settings.points)
    pulse, options = make_pulse(settings.pulse, settings.vertical_ratio), request.options()
    spectra: list = (
        _checkpoint.load(_checkpoint.path_of(files.prefix), len(podiums)) if resume else [None] * len(podiums)
    )
    console.note(f"podiums × frequencies: {len(podiums)} × {settings.points}")
    with console.progress(len(podiums), "podiums") as bar:
        for k, podium in enumerate(podiums):
            if spectra[k] is not None:
                check_overturning_resumes(spectra[k], podium, pulse, x, max_ratio, parameters, options)
            else:
                try:
                    spectra[k] = rj.overturning_spectrum(
                        podium,
                        pulse,
                        x,
                        max_acceleration_ratio=max_ratio,
                        sensitivities=parameters,
                        options=options,
                    )
                except KeyboardInterrupt:
                    raise exit_after_saving(
                        files.prefix, spectra, f"stopped with {k} of {len(podiums)} podiums solved"
                    ) from None
                console.note(f"podium {k + 1}: {spectra[k].attrs['scenes']} scenes")
            bar.update()
    try:
        panels = combine_panels(spectra, ratios, periods, zeta)
        console.write(files.data(), panels)
    except KeyboardInterrupt:
        raise exit_after_saving(files.prefix, spectra) from None
    for suffix, plot in zip(pictures, ("overturning_boundaries", "sensitivities"), strict=False):
        console.draw(files.picture(suffix), plot, panels)
    _checkpoint.path_of(files.prefix).unlink(missing_ok=True)
    report_minima(console, panels["minimum"].min("frequency_ratio"), ratios, periods)
    frequencies_with_windows = int((panels["boundaries"].count("boundary") > 1).sum())
    scenes = int(sum(data.attrs["scenes"] for data in spectra))
    console.say(f"{scenes} scenes; windows of survival at {frequencies_with_windows} frequencies")
    console.json_object |= {
        "scenes": scenes,
        "frequencies_with_windows_of_survival": frequencies_with_windows,
    }
