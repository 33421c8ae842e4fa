"""Models of the tables of a problem file for the design report, and of random motions in checks of the
report."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from .fields import Keys, Points, Positive, Text, described_as, key


class EnvelopeKeys(Keys):
    """The envelope of a random motion."""

    t_1: Positive | None = key(None, "End of the rise [s].")
    t_2: Positive | None = key(None, "Start of the decay [s].")
    c: Positive | None = key(None, "Rate of the decay [1/s].")


class GaussianKeys(Keys):
    """A random motion. The keys are the parameters of `rockjax.GaussianMotion`."""

    n: Points = key(..., "Number of samples.")
    dt: Positive = key(..., "Sampling interval [s].")
    S_0: Positive = key(..., "Spectral density of the noise [m²/s³].")
    omega_g: Positive | None = key(None, "Frequency of the soil [rad/s].")
    zeta_g: Positive | None = key(None, "Damping ratio of the soil [–].")
    omega_f: Positive | None = key(None, "Frequency of the high-pass filter [rad/s].")
    zeta_f: Positive | None = key(None, "Damping ratio of the high-pass filter [–].")
    envelope: EnvelopeKeys | None = key(None, "Envelope of the motion.")


class Project(Keys):
    """Texts in the report of `rockjax report`. They do not influence any result."""

    title: Text | None = key(None, "Title of the report; by default the name of the file.")
    subject: Text | None = key(None, "Subject of the report.")
    number: Text | None = key(None, "Number of the project.")
    revision: Text | None = key(None, "Revision of the report.")
    author: Text | None = key(None, "Author of the report.")
    organisation: Text | None = key(None, "Organisation of the author.")
    date: Text | None = key(None, "Date of the report; by default SOURCE_DATE_EPOCH, else today.")


class JointKeys(Keys):
    """Properties of the joints that checks of `rockjax report` need."""

    friction: Positive | None = key(None, "Friction coefficient μ of the joints [–].")
    contact_width: Positive | None = key(None, "Width of the strip that bears at an edge, in the plane [m].")
    contact_depth: Positive | None = key(None, "Depth of a column across the plane [m].")


class ReportKeys(Keys):
    """Settings of `rockjax report`."""

    units: list[str] | None = key(None, "Units of the page, such as kN, m, deg, g, mm.")
    spread: Annotated[float, Field(gt=0, lt=1), described_as("a number in (0, 1)")] = key(
        0.05, "Relative change of each input, for the range of utilisations [–]."
    )
    laws: list[Literal["paper", "compatible"]] = key(
        ["paper", "compatible"], "Laws of impact that are compared with the law of the structure."
    )
    motions: dict[str, Text] = key({}, "Labels of the sets of motions, such as '475 years'.")
