"""Plot of one response over time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from rockjax._responses.response import Response

from ._histories import as_history, deformation_history, ground_motion, rotation_history, vibrates
from ._joints import friction_demand, joint_forces
from ._style import styled

if TYPE_CHECKING:
    import xarray


@styled
def response(response: Response | xarray.Dataset, figure: Figure | None = None, points: int = 4000) -> Figure:
    """Plot a history, a panel each for the rotation, the deformation of an elastic superstructure, the axial
    forces and the friction demand of the joints (if outputs of the joints were requested), and the ground
    acceleration.

    - `response`: a [`rockjax.Response`][] or its dataset
    - `figure`: figure to draw into, by default a new one
    - `points`: number of times at which a `Response` is evaluated; ignored for a dataset
    """
    if isinstance(response, Response):
        response = response.dataset(np.linspace(*response.span, points))
    data = as_history(response)
    plot_functions = [rotation_history]
    if vibrates(data.attrs):
        plot_functions.append(deformation_history)
    if "joint_axial_force" in data:
        plot_functions += [joint_forces, friction_demand]
    plot_functions.append(ground_motion)
    figure = figure or plt.figure(figsize=(8, max(6.5, 2.2 * len(plot_functions))), layout="constrained")
    axes = figure.subplots(len(plot_functions), 1, sharex=True, squeeze=False)[:, 0]
    for ax, draw in zip(axes, plot_functions, strict=True):
        draw(data, ax)
        if ax is not axes[-1]:
            ax.set_xlabel("")
    figure.align_ylabels(axes)
    return figure
