"""`rockjax response`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from rockjax._problem import models

from ._context import MASSES
from ._joints import joint_warnings, request_joints
from ._options import PULSE_DEFAULTS, SINGLE_DEFAULTS, Output, accuracy_options, options_of, structure_options
from ._outputs import SINGLE_PICTURE, parse_outputs
from ._request import Request
from ._run import Console, command

if TYPE_CHECKING:
    import rockjax as rj


def residual_share(podium: rj.Podium) -> float:
    """Return the share of the mass of the superstructure that belongs to no mode and moves with the beam [–].
    It is 0 without a superstructure, and for `Rigid`, which is not described by modes."""
    superstructure = podium.superstructure
    if superstructure is None or not superstructure.rows:
        return 0.0
    carried = superstructure.carried if superstructure.elastic else superstructure.mass_ratio
    return 0.0 if carried is None else float(carried) / float(superstructure.mass_ratio)


@command(
    structure_options(**SINGLE_DEFAULTS),
    options_of(models.Pulses, **PULSE_DEFAULTS),
    options_of(models.Record),
    options_of(models.Response),
    accuracy_options(rtol=1e-8, method="dopri8"),
)
def response(request: Request, console: Console, output: Output = "rockjax-response") -> None:
    """Compute one time history: rotation, deformation, ground acceleration, and the peaks.

    Writes OUTPUT.nc and OUTPUT.png. If the structure has an elevation (positions of columns, heights of
    masses), both files include forces and friction in the joints. If the problem file has contents (blocks)
    or oscillators on floors, both files include their responses. `rockjax plot OUTPUT.nc --kind …` draws
    phase portraits, energies and an animation.

    \b
    Examples:
      rockjax response --acceleration-ratio 2.5 --T-p 1.0 --T-s 0.5
      rockjax response --width 0.45 --height 3 --column-mass 1500 \\
        --beam-mass 30e3 --a-p 3.7
      rockjax response --positions 0,4,8 --beam-depth 0.6 --top-height 8.4 \\
        --friction 0.4
      rockjax response --record suite/RSN1.AT2 --scale 2 --eta 0
      rockjax response problem.toml --motion pulses --number 2
      rockjax response --example response -o response.pdf
    """
    import rockjax as rj

    files = parse_outputs(output, "rockjax-response").check(SINGLE_PICTURE)
    podium = request.podium()
    excitation, options = request.motion(podium), request_joints(podium, request.options())
    contents, oscillators = request.contents(), request.oscillators()
    on_floors, end = (*contents.values(), *oscillators.values()), request.settings.t_end
    history = rj.simulate(podium, excitation, t_end=end, options=options, on_floors=on_floors)
    data = history.dataset()
    labels_by_dim = {"contents": list(contents), "oscillator": list(oscillators)}
    data = data.assign_coords({dim: labels for dim, labels in labels_by_dim.items() if labels})
    console.say(repr(history))
    for line in _describe_inputs(data.attrs | MASSES.get({})):
        console.say(f"  {line}")
    console.say_warnings(joint_warnings(podium, history, request.settings.friction), indent="  ")
    if history.uplifted and not history.overturned:
        console.say(
            "  distance to overturning: not computed here; rockjax.overturning_scale, or a check of the kind "
            "overturning-scale in a report, gives the least factor on this motion that overturns the columns"
        )
    share = residual_share(podium)
    if share > 0:
        console.say(
            f"  {share:.0%} of the mass of the superstructure is in no mode; shear and floor accelerations "
            "do not include its impulses at impacts"
        )
    console.write(files.data(), data)
    console.draw(files.picture(), "response", data)
    from rockjax import _results as results
    from rockjax._responses.peak import all_variables

    code = int(results.code_of(history.result))
    peaks = {name: getattr(history, name) for name in all_variables() if name != "margin"}
    console.json_object |= {"result": results.NAMES[code], **peaks, "inputs": dict(data.attrs)}
    console.json_object |= {
        str(name): dict(zip(labels_by_dim[str(y.dims[-1])], y.values.tolist(), strict=True))
        for name, y in data.data_vars.items()
        if y.dims and y.dims[-1] in labels_by_dim
    }
    if results.did_not_finish(code):
        console.error(f"the scene did not finish. {results.explain(code)}")


def impact_law(attrs: Mapping[str, Any]) -> str:
    """Return a line with the law of impact and the restitution factor e, from the attributes of a dataset."""
    law = attrs["restitution"] if isinstance(attrs["restitution"], str) else "given"
    return f"{'impact law':<16} {law}, e = {attrs['restitution_factor']:.6g}"


def _describe_inputs(attrs: Mapping[str, Any]) -> Iterator[str]:
    """Yield lines about the inputs: records, impact law and uplift acceleration. For a structure by
    dimensions, a line with the masses follows."""
    g = attrs["g_m_s2"]
    for component in ("", "vertical_"):
        prefix = f"{component}record_"
        record = {name.removeprefix(prefix): y for name, y in attrs.items() if name.startswith(prefix)}
        if not record:
            continue
        parts = [str(record[name]) for name in ("name", "source") if name in record]
        parts += [f"dt = {record['dt_s']:g} s, PGA = {record['pga_m_s2'] / g:.4g} g"]
        parts += [f"{name} {record[name]:g}" for name in ("scale", "seed") if name in record]
        yield f"{'vertical' if component else 'record':<16} {', '.join(parts)}, SHA-256 {record['sha256']}"
    yield impact_law(attrs)
    uplift, demand = attrs["uplift_ground_acceleration_m_s2"] / g, attrs["uplift_demand_m_s2"] / g
    yield f"{'uplift at':<16} {uplift:.4g} g of slow ground motion (demand q of Eq. (9): {demand:.4g} g)"
    if "columns" in attrs:
        masses = [
            f"{name.removesuffix('_kg').replace('_', ' ')} {_format_masses(attrs[name])}"
            for name in ("column_mass_kg", "beam_mass_kg", "top_mass_kg", "story_masses_kg")
            if name in attrs
        ]
        yield f"{'masses':<16} N = {attrs['columns']} columns, {', '.join(masses)}"


def _format_masses(value: Any) -> str:
    values = value if isinstance(value, list | tuple) else [value]
    return " + ".join(f"{float(y):g}" for y in values) + " kg"
