"""Ensembles: scenes with random parameters and motions, and empirical distributions of their peaks.

A scene is one podium under one ground motion. The equations (E1) to (E3) are in docs/ensembles.md.
"""

from __future__ import annotations

import dataclasses
import difflib
import functools
from collections.abc import Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from rockjax import _results as results
from rockjax._batch.batch import peak_responses
from rockjax._checks import as_float, require, require_instance, require_number, require_whole
from rockjax._excitations.base import AbstractExcitation
from rockjax._machine.threads import TABLE_MODULES, import_in_background
from rockjax._motions.convert import AnyMotions
from rockjax._motions.provenance import describe_motions
from rockjax._options import Options
from rockjax._parameters.registry import INITIAL, motion_parameter
from rockjax._responses.arguments import check_single, check_types
from rockjax._responses.datasets import describe_excitation, describe_options, describe_podium
from rockjax._responses.peak import ALWAYS, Peak, data_variables
from rockjax._responses.variants import (
    check_names,
    labelled_motion,
    structure_parameters,
    variable_parameters,
)
from rockjax._results import REST, Interrupted, State
from rockjax._structures import Dimensions, Podium
from rockjax._text import tables
from rockjax._units import displayed

from . import empirical
from .distributions import draw, generator
from .empirical import Comparison, Sample
from .variants import Variants

if TYPE_CHECKING:
    import xarray

KIND = "ensemble"
CONFIDENCE = 0.95


def ensemble(
    podium: Podium | Dimensions,
    motions: AnyMotions,
    *,
    spread: Mapping[str, Any],
    n: int = 1000,
    seed: int = 0,
    initial: State = REST,
    t_end: float | None = None,
    options: Options = Options(),
    progress: Any = False,
) -> Ensemble:
    """Compute peak responses of random variants of a podium under random motions.

    All scenes form one batch. The confidence bounds of [`rockjax.Ensemble`][] hold for every n if the scenes
    are independent; arrays in `spread` must therefore contain independent draws. The bounds do not include
    the uncertainty from the choice of the motions.

    - `podium`: podium with scalar parameters, or an [`optimise.Dimensions`][]; the scenes are variants of it
    - `motions`: one motion, or several (`Motions`, `Records` or a list); each scene then draws one of them
      with equal probability
    - `spread`: dict with a frozen distribution of `scipy.stats`, a number, or an array of drawn values, shape
      (n,), for each parameter name. Valid names are those of [`rockjax.grid`][], and `initial.theta` [rad]
      and `initial.theta_dot` [rad/s] of the initial state; with an elastic superstructure also `initial.u_t`
      [m] and `initial.u_t_dot` [m/s], which are the same for all modes
    - `n`: number of scenes, ≥ 1
    - `seed`: seed of the random numbers, ≥ 0. The draws of a parameter depend only on its distribution and
      name, on `seed` and on `n`
    - `initial`: initial state; by default at rest
    - `t_end`: latest end of each scene [s]; by default as for [`rockjax.peak_responses`][]
    - `options`: options of the scenes; undecided scenes are found only with the output `"errors"`
    - `progress`: `True` for a progress bar, or any object with a method `update(number_of_scenes)`

    Returns a [`rockjax.Ensemble`][]. Ctrl-C raises [`rockjax.Interrupted`][]; its `partial` is an ensemble in
    which unsolved scenes count as not finished, or None if there are no answers yet. Before any scene is
    solved, `ValueError` is raised for invalid inputs, unknown names and draws out of range.
    """
    owner, structure = "ensemble", podium
    require_instance(
        owner, "podium", structure, Podium | Dimensions, "a rockjax.Podium or an optimise.Dimensions"
    )
    podium = structure.podium() if isinstance(structure, Dimensions) else structure
    check_types(owner, podium, options)
    check_single(owner, podium)
    require_instance(owner, "spread", spread, Mapping, "a dict of name → distribution")
    require_instance(owner, "initial", initial, State, "a rockjax.State")
    n, seed = require_whole(owner, "n", n, 1), require_whole(owner, "seed", seed, 0)
    end = None if t_end is None else require_number(owner, "t_end", t_end, np.isfinite, "finite")
    motion, labels = labelled_motion(owner, motions, "motions")
    if (labels is None or len(labels) == 1) and not spread:
        raise ValueError(f"{owner}: nothing is random; give a distribution in spread, or several motions")
    state_names = [
        name for name, y in INITIAL.items() if podium.vibrates or not y.attribute_path.startswith("u_t")
    ]
    valid = [*variable_parameters(structure, motion, labels is None), *state_names]
    check_names(owner, "names in spread", tuple(spread), valid)
    known = structure_parameters(structure) | INITIAL
    parameters = {name: known.get(name) or motion_parameter(name.rpartition(".")[2]) for name in spread}
    draws = {name: draw(owner, name, spread[name], n, seed, y.range) for name, y in parameters.items()}
    motion_index = None if labels is None else generator(seed, "motion").integers(len(labels), size=n)
    variants = Variants(structure, motion, initial, motion_index)
    podiums, excitations, start = variants.scenes(draws)
    import_in_background(*TABLE_MODULES)
    message = None
    try:
        peaks = peak_responses(
            podiums, excitations, initial=start, t_end=end, options=options, progress=progress
        )
    except Interrupted as interrupted:
        message, peaks = str(interrupted), interrupted.partial
        if peaks is None:
            raise
    import xarray

    columns = {name: ("scene", y, parameters[name].variable_attributes) for name, y in draws.items()}
    if labels is not None and motion_index is not None:
        columns["motion"] = "scene", labels[motion_index], {"units": "1", "long_name": "ground motion"}
    data = xarray.Dataset(
        data_variables(peaks, options.outputs, ("scene",)) | columns,
        attrs={
            "title": "Ensemble of random scenes",
            "kind": KIND,
            "parameters": " ".join(draws),
            "seed": seed,
            **(describe_excitation(motion) if labels is None else {}),
            **describe_motions(motions),
            **describe_podium(podium),
            **describe_options(options),
        },
    )
    result = Ensemble(data, peaks, variants)
    if message is not None:
        raise Interrupted(message, result) from None
    return result


@dataclasses.dataclass(frozen=True, repr=False, eq=False)
class Ensemble:
    """Answers (peaks and other results) of random scenes, and the empirical distributions of answers.

    - `data`: dataset with the dim `scene`. It contains the drawn parameters by name, the answers and, if
      there are several motions, the label `motion` of the drawn motion. `Ensemble(xarray.load_dataset(path))`
      restores an ensemble from a file
    - `peaks`: the answers as a [`rockjax.Peak`][] of shape (n,); None if restored from a file
    - `variants`: podium, motions and initial state, used by `scene`; None if restored from a file

    Distributions include every scene:

    - A scene that overturned has the worst possible value: +∞ for a peak, −∞ for a `least_…` answer. The
      margin and other answers that are also defined for overturned scenes keep the computed value
    - The value of a scene that did not finish (`unanswered`) or that is `undecided` counts as unknown, and so
      does NaN. Confidence bounds hold whatever the unknown values are. Estimates use the computed value of an
      `undecided` scene. In place of other unknown values they use +∞, or −∞ for the margin and for answers
      named `least_…` or `smallest_…`
    - If no uplift or no overturning occurs, its time is +∞

    Raises `ValueError` if `data` is not a dataset of [`rockjax.ensemble`][].
    """

    data: xarray.Dataset
    peaks: Peak | None = None
    variants: Variants | None = None

    def __post_init__(self) -> None:
        if getattr(self.data, "attrs", {}).get("kind") != KIND:
            raise ValueError(
                f"Ensemble: data must be a dataset of rockjax.ensemble, got a {type(self.data).__name__}"
            )

    @property
    def size(self) -> int:
        """Number of scenes n."""
        return self.data.sizes["scene"]

    @property
    def draws(self) -> dict[str, np.ndarray]:
        """Drawn values of each parameter, shape (n,)."""
        return {name: self.data[name].values for name in self.data.attrs["parameters"].split()}

    @property
    def answers(self) -> list[str]:
        """Names of the answers that have a distribution."""
        excluded = {*self.draws, "result", "steps", "peak_rotation_time"}
        return [
            str(name)
            for name, y in self.data.data_vars.items()
            if y.dtype.kind == "f" and name not in excluded and not str(name).endswith("_error")
        ]

    @functools.cached_property
    def overturned(self) -> np.ndarray:
        """True for scenes that overturned, shape (n,)."""
        return self.data["overturned"].values.astype(bool)

    @functools.cached_property
    def unanswered(self) -> np.ndarray:
        """True for scenes that did not finish, shape (n,); `data["result"]` names the causes."""
        return results.did_not_finish(self.data["result"].values)

    @functools.cached_property
    def undecided(self) -> np.ndarray:
        """True for scenes that finished, but whose outcome is open according to the error estimates, shape
        (n,); all False without the output `"errors"`."""
        flags = self.data["undecided"].values.astype(bool) if "undecided" in self.data else False
        return flags & ~self.unanswered

    def scene(self, k: int) -> tuple[Podium, AbstractExcitation, State]:
        """Return podium, motion and initial state of scene k, counted from 0, for [`rockjax.simulate`][].

        Raises `ValueError` if there is no scene k, and for an ensemble that was restored from a file.
        """
        if self.variants is None:
            raise ValueError(
                "Ensemble: an ensemble from a file has no structure and motions; run rockjax.ensemble again"
            )
        k = require_whole("Ensemble", "k", k, 0)
        require("Ensemble", "k", k, lambda y: y < self.size, f"less than {self.size}")
        return self.variants.scenes({name: values[k] for name, values in self.draws.items()}, k)

    def sample(self, output: str = "peak_rotation", component: int | None = None) -> Sample:
        """Return the values of an answer in all scenes, and flags for unknown values.

        - `output`: name of an answer: a scalar, such as `"peak_rotation"` or `"peak_shear"`, or an answer
          with an axis of modes, stories or joints
        - `component`: number of the mode, story or joint, from 1; by default the worst one of each scene

        Raises `ValueError` if the answer was not requested, or if there is no such component.
        """
        owner = "Ensemble"
        names = self.answers
        if output not in names:
            closest = difflib.get_close_matches(str(output), names, 1)
            hint = f"; did you mean {closest[0]!r}?" if closest else "; request others in Options(outputs=…)"
            raise ValueError(f"{owner}: output must be one of {', '.join(names)}, got {output!r}{hint}")
        answer, is_minimum = (
            self.data[output],
            output.startswith(("least_", "smallest_")) or output == "margin",
        )
        worst, values = -np.inf if is_minimum else np.inf, np.asarray(answer.values, float)
        if values.ndim > 1:
            count = values.shape[1]
            if component is None:
                values = values.min(axis=1) if is_minimum else values.max(axis=1)
            else:
                k = require_whole(owner, "component", component, 1)
                require(owner, "component", k, lambda y: y <= count, f"at most {count} for {output}")
                values = values[:, k - 1]
        elif component is not None:
            raise ValueError(f"{owner}: {output} has no components, got component = {component!r}")
        is_unknown = self.unanswered | self.undecided
        if output in ("overturn_time", "uplift_time"):  # NaN if it never happens
            values = np.where(np.isnan(values), np.inf, values)
        elif output == "peak_rotation" or answer.attrs.get("ancillary_variables") == "overturned":
            values = np.where(self.overturned, worst, values)
        is_unknown = is_unknown | np.isnan(values)
        return Sample(np.where(self.unanswered | np.isnan(values), worst, values), is_unknown)

    def cdf(
        self,
        output: str = "peak_rotation",
        *,
        component: int | None = None,
        at: Any = None,
        confidence: float = CONFIDENCE,
    ) -> xarray.Dataset:
        """Return the empirical distribution function of an answer, with a confidence band.

        The band of Dvoretzky, Kiefer, Wolfowitz and Massart holds at all values at once. Its half width is
        √(ln(2/a)/(2n)) with a = 1 − confidence, (E1), for example 0.0136 for n = 10⁴ and 95 %. Unknown values
        widen the band by the share of scenes that have them.

        - `output`, `component`: the answer, as for `sample`
        - `at`: values at which the function is evaluated, shape (x,); by default all finite values of the
          answer
        - `confidence`: confidence level of the band, in (0, 1)

        Returns a Dataset over `at` with `probability` and the ends `lower` and `upper` of the band. The
        `counts` of scenes are attributes. Raises `ValueError` for invalid inputs.
        """
        import xarray

        sample = self.sample(output, component)
        if at is None:
            at = np.unique(sample.values[np.isfinite(sample.values)])
        x = np.asarray(as_float(at, "Ensemble: at"))
        if x.ndim != 1:
            raise ValueError(f"Ensemble: at must be one-dimensional, got shape {x.shape}")
        if np.isnan(x).any():
            raise ValueError("Ensemble: at must not contain NaN")
        confidence = _checked_confidence(confidence)
        estimates = empirical.distribution(sample, x, confidence)
        return xarray.Dataset(
            _variables("at", ("probability", "lower", "upper"), estimates, {"units": "1"}),
            coords={"at": ("at", x, self._attributes(output))},
            attrs={
                "title": "Empirical distribution function",
                "output": output,
                "confidence": confidence,
                "half_width": empirical.band_half_width(self.size, confidence),
                **self.counts,
            },
        )

    def quantiles(
        self,
        output: str = "peak_rotation",
        probability: Any = (0.05, 0.16, 0.5, 0.84, 0.95),
        *,
        component: int | None = None,
        confidence: float = CONFIDENCE,
    ) -> xarray.Dataset:
        """Return quantiles of an answer and their confidence intervals, (E2). The ends of an interval are
        values of the sorted sample.

        - `output`, `component`: the answer, as for `sample`
        - `probability`: probabilities of not exceeding the quantiles, in (0, 1), shape (q,)
        - `confidence`: confidence level of each interval, in (0, 1)

        Returns a Dataset over `probability` with `quantile` and the ends `lower` and `upper` of its interval.
        A quantile of a peak is +∞ if its probability exceeds the share of scenes that finished without
        overturning. If n is too small, `lower` is −∞ or `upper` is +∞. Raises `ValueError` for invalid
        inputs.
        """
        import xarray

        sample = self.sample(output, component)
        q = np.atleast_1d(np.asarray(as_float(probability, "Ensemble: probability")))
        if q.ndim != 1:
            raise ValueError(f"Ensemble: probability must be one-dimensional, got shape {q.shape}")
        require("Ensemble", "probability", q, lambda y: (y > 0) & (y < 1), "in (0, 1)")
        confidence = _checked_confidence(confidence)
        estimates = empirical.quantiles(sample, q, confidence)
        return xarray.Dataset(
            _variables("probability", ("quantile", "lower", "upper"), estimates, self._attributes(output)),
            coords={"probability": ("probability", q, {"units": "1", "long_name": "probability"})},
            attrs={
                "title": "Empirical quantiles",
                "output": output,
                "confidence": confidence,
                **self.counts,
            },
        )

    def overturning_probability(self, confidence: float = CONFIDENCE) -> tuple[float, float, float]:
        """Return the share of scenes that overturned, and the lower and upper Clopper–Pearson bounds of the
        overturning probability [–]. Raises `ValueError` unless `confidence` is in (0, 1)."""
        is_unknown = self.unanswered | self.undecided
        least = int(np.sum(self.overturned & ~is_unknown))
        low, high = empirical.probability_interval(
            least, least + int(is_unknown.sum()), self.size, _checked_confidence(confidence)
        )
        return float(np.mean(self.overturned)), low, high

    def compare(
        self,
        other: Ensemble,
        output: str = "peak_rotation",
        *,
        component: int | None = None,
        confidence: float = CONFIDENCE,
    ) -> Comparison:
        """Compare an answer in two ensembles by the Kolmogorov–Smirnov test, (E3).

        - `other`: ensemble with another seed, because the samples must be independent
        - `output`, `component`: the answer, as for `sample`
        - `confidence`: confidence level of the bounds on the distance between the distributions, in (0, 1)

        Returns a [`rockjax.Comparison`][]. Raises `ValueError` if both ensembles have the same seed, and for
        other invalid inputs.
        """
        require_instance("Ensemble", "other", other, Ensemble, "a rockjax.Ensemble")
        if self.data.attrs["seed"] == other.data.attrs["seed"]:
            raise ValueError(
                f"Ensemble: both ensembles have the seed {self.data.attrs['seed']}, so they are not "
                "independent; draw one of them with another seed"
            )
        first, second = (y.sample(output, component) for y in (self, other))
        return empirical.compare(first, second, _checked_confidence(confidence))

    def dataset(self) -> xarray.Dataset:
        """Return a copy of `data`: draws and answers of all scenes, with units and parameters."""
        return self.data.copy()

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of scenes by name: `scenes` (all), `overturned`, `undecided`, and `unanswered` (scenes that
        did not finish)."""
        names = "overturned", "undecided", "unanswered"
        return {"scenes": self.size} | {name: int(np.sum(getattr(self, name))) for name in names}

    def _attributes(self, output: str) -> dict[str, str]:
        """Return the attributes `units` and `long_name` of an answer."""
        attrs = self.data[output].attrs
        return {name: attrs[name] for name in ("units", "long_name") if name in attrs}

    def __repr__(self) -> str:
        headline, *groups = self._tables()
        lines = [line for rows in groups for line in tables.align_rows(rows, numbers=True)]
        return "\n  ".join([headline, *lines])

    def _repr_html_(self) -> str:
        headline, *groups = self._tables()
        return f"<p>{escape(headline)}</p>" + "".join(tables.html(rows, headings="row") for rows in groups)

    def _tables(self) -> tuple[Any, ...]:
        """Return a headline, the table of draws and the table of quantiles, without empty tables."""
        share, low, high = self.overturning_probability()
        counts = self.counts
        is_checked = "undecided" in self.data
        undecided = f"{counts['undecided']} undecided" if is_checked else "undecided not checked ('errors')"
        headline = (
            f"Ensemble of {self.size} scenes: {share:.3g} overturned ({CONFIDENCE:.0%}: {low:.3g} to "
            f"{high:.3g}), {counts['unanswered']} did not finish, {undecided}"
        )
        draws = [
            (f"{name} [{displayed(self.data[name].attrs['units'])}]", *map(_format, _moments(y)))
            for name, y in self.draws.items()
        ]
        answers = []
        for name in (name for name in self.answers if name not in ALWAYS):
            values = self.quantiles(name, _PRINTED_PROBABILITIES)["quantile"].values
            unit = displayed(self.data[name].attrs["units"])
            answers.append((f"{name} [{unit}]", *map(_format, values)))
        quantile_names = [f"{q:.0%}" for q in _PRINTED_PROBABILITIES]
        headings = ("drawn", "mean", "std", "least", "largest"), ("answer", *quantile_names)
        parts = zip(headings, (draws, answers), strict=True)
        return headline, *([heading, *rows] for heading, rows in parts if rows)


_PRINTED_PROBABILITIES = (0.05, 0.5, 0.95)  # probabilities of the printed quantiles


def _moments(values: np.ndarray) -> tuple[float, ...]:
    """Return mean, standard deviation, least and largest value."""
    deviation = float(np.std(values - values[0]))  # exactly 0 for equal values
    return float(values.mean()), deviation, float(values.min()), float(values.max())


def _format(value: float) -> str:
    return f"{value:.4g}"


def _checked_confidence(value: float) -> float:
    return require_number("Ensemble", "confidence", value, lambda y: 0 < y < 1, "in (0, 1)")


def _variables(
    dim: str, names: Sequence[str], estimates: empirical.Estimates, attrs: Mapping[str, str]
) -> dict[str, Any]:
    """Return the dataset variables of estimates and their bounds.

    - `dim`: name of the axis; `names`: names of estimate, lower bound and upper bound
    - `estimates`: the estimates and their bounds
    - `attrs`: attribute `units` and optionally `long_name` of the estimated quantity
    """
    prefixes = "", "lower bound of the ", "upper bound of the "
    long_name = attrs.get("long_name") or names[0]
    return {
        name: (dim, values, {**attrs, "long_name": f"{prefix}{long_name}"})
        for name, values, prefix in zip(names, estimates, prefixes, strict=True)
    }
