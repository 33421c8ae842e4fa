"""`rockjax spectrum`."""

from __future__ import annotations

from rockjax._problem import models

from ._options import PANEL_DEFAULTS, Output, Resume, accuracy_options, options_of, structure_options
from ._outputs import parse_outputs
from ._panels import combine_panels, make_pulse, report_minima
from ._request import Request
from ._run import Console, command, exit_after_saving


@command(
    structure_options(**PANEL_DEFAULTS),
    options_of(models.Spectrum),
    accuracy_options(rtol=1e-8, method="dopri8"),
)
def spectrum(
    request: Request, console: Console, output: Output = "rockjax-spectrum", resume: Resume = False
) -> None:
    """Compute rocking spectra: peak rotation and overturning against pulse frequency and acceleration.

    Without options, computes 12 spectra: Figs. 6 and 7 of the paper that defines the model (see
    docs/citing.md). Between neighbouring grid points with different outcomes, the overturning boundary is
    computed as a root. Boundaries between points with the same outcome are not found; `rockjax overturning`
    finds them. Writes OUTPUT.nc, OUTPUT-rotation.png, OUTPUT-overturning.png and, with sensitivities,
    OUTPUT-sensitivity.png. Ctrl-C saves the solved scenes (pairs of structure and motion) in
    OUTPUT.partial.nc; --resume solves the others.

    \b
    Examples:
      rockjax spectrum
      rockjax spectrum --points 40 --eta-over-gamma 5 --T-s 0,0.5 -o study
      rockjax spectrum --width 0.45 --height 3 --column-mass 1500 \\
        --beam-mass 30e3 --points 40
      rockjax spectrum --example spectrum --points 20
      rockjax spectrum --eta-over-gamma 5 --T-s 0,0.5 --sensitivities alpha,gamma
      rockjax spectrum problem.toml --points 200
    """
    import numpy as np

    import rockjax as rj
    from rockjax._cli import _checkpoint
    from rockjax._machine.memory import require_memory
    from rockjax._studies.grid_boundaries import with_boundaries

    podiums, ratios, periods, zeta = request.panels()
    settings = request.settings
    parameters = settings.sensitivities
    pictures = ("rotation", "overturning", *(("sensitivity",) if parameters else ()))
    files = parse_outputs(output, "rockjax-spectrum").check(pictures)
    pulse = make_pulse(settings.pulse, settings.vertical_ratio)
    options = request.options(outputs=("peak_rotation",))
    if "peak_rotation" not in options.outputs:
        options = options.replace(outputs=("peak_rotation", *options.outputs))
    ranges = settings.frequency_ratio, settings.acceleration_ratio
    x, y = (np.linspace(low, high, settings.points) for low, high in ranges)
    total = len(podiums) * settings.points**2
    require_memory("--points", total)
    console.note(
        f"podiums × frequencies × accelerations: {len(podiums)} × {settings.points} × {settings.points} = "
        f"{total} scenes"
    )
    checkpoint = _checkpoint.load(_checkpoint.path_of(files.prefix), len(podiums)) if resume else None
    spectra = []
    try:
        with console.progress(total, "scenes") as bar:
            arguments = {
                "options": options,
                "progress": bar,
                "resume": checkpoint,
                "sensitivities": parameters,
            }
            spectra = rj.rocking_spectra(podiums, pulse, x, y, **arguments)
        spectra = with_boundaries(spectra, podiums, pulse, options=options)
        panels = combine_panels(spectra, ratios, periods, zeta)
        console.write(files.data(), panels)
    except rj.Interrupted as stopped:
        raise exit_after_saving(files.prefix, stopped.partial, str(stopped)) from None
    except KeyboardInterrupt:
        raise exit_after_saving(files.prefix, spectra) from None
    console.draw(files.picture("rotation"), "spectra", panels)
    console.draw(files.picture("overturning"), "overturning_curves", panels)
    if parameters:
        console.draw(files.picture("sensitivity"), "sensitivity_spectra", panels)
    _checkpoint.path_of(files.prefix).unlink(missing_ok=True)
    counts = console.say_scenes(panels, total)
    report_minima(console, panels["minimum"].min("frequency_ratio"), ratios, periods)
    console.json_object |= counts
    if counts["without_answer"]:
        from rockjax._results import explain_failures

        console.error(explain_failures(panels["result"]))
