"""Draw pictures for `pictures.md`, the README, `sensitivities.md` and `risk.md`: `python docs/pictures.py`.

They are pictures of one scene, sensitivity spectra and a design point.
"""

from __future__ import annotations

import math
from pathlib import Path

import matplotlib
import numpy as np
import xarray

matplotlib.use("Agg")

import rockjax as rj
from rockjax import plots
from rockjax._files import write_figure

IMAGES = Path(__file__).parent / "images"


def main() -> None:
    podium = rj.Podium.from_dimensions(
        width=0.45, height=3.0, column_mass=1.5e3, beam_mass=30e3, top_mass=300e3, period=0.5, damping=0.05
    )
    data = rj.simulate(podium, rj.Ricker(a_p=3.7, T_p=1.0), t_end=8.0).dataset()
    write_figure(IMAGES / "response.png", plots.response(data))
    for name, draw in (
        ("phase-portrait", plots.phase_portrait),
        ("moment-rotation", plots.moment_rotation),
        ("energy", plots.energy_balance),
    ):
        ax = draw(data)
        ax.figure.set_size_inches(6.4, 4.4)
        write_figure(IMAGES / f"{name}.png", ax.figure)
    tower = podium.replace(elevation=rj.Elevation([-3.0, 3.0], beam_depth=0.6, top_height=17.6))
    joints = rj.Options(outputs=("peak_rotation", "axial_force", "peak_friction", "impact_friction"))
    forces = rj.simulate(tower, rj.Ricker(a_p=3.7, T_p=1.0), t_end=8.0, options=joints)
    for name, ax in (
        ("joint-forces", plots.joint_forces(forces)),
        ("friction-demand", plots.friction_demand(forces, friction=0.4)),
    ):
        ax.figure.set_size_inches(6.4, 4.4)
        write_figure(IMAGES / f"{name}.png", ax.figure)
    plots.save_animation(IMAGES / "rocking.gif", data, start=-0.8, end=6.0, fps=20, dpi=80, exaggerate=2.0)
    write_figure(IMAGES / "sensitivity-spectra.png", plots.sensitivity_spectra(sensitivities()))
    block = rj.Podium(alpha=0.2, R=1.0)
    nearest = rj.design_points(block, rj.GaussianMotion(n=101, dt=0.05, S_0=0.01), starts=4)[0]
    write_figure(IMAGES / "design-point.png", plots.design_point(nearest, block))


def sensitivities() -> xarray.Dataset:
    """Draw sensitivity spectra of two podiums of the paper's Fig. 6, rigid and with T_s = 0.5 s."""
    frame = rj.Podium(alpha=math.atan(0.15), R=1.5, gamma=10.0)
    podiums = {
        0.0: frame.replace(superstructure=rj.Rigid(50.0)),
        0.5: frame.replace(superstructure=rj.Elastic(50.0, 0.5, 0.05)),
    }
    axes = np.linspace(1.0, 8.0, 120), np.linspace(1.0, 12.0, 120)
    how = rj.Options(outputs=("peak_rotation",))
    spectra = rj.rocking_spectra(
        list(podiums.values()), rj.Ricker, *axes, options=how, sensitivities=["alpha", "R"]
    )
    each = [data.assign_coords(T_s=T_s) for data, T_s in zip(spectra, podiums, strict=True)]
    panels = xarray.concat(each, "T_s", combine_attrs="drop_conflicts")
    return panels.expand_dims({"eta_over_gamma": [5.0]})


if __name__ == "__main__":
    main()
