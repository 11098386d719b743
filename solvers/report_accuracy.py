"""Positional accuracy at check points, in the words of the ASPRS standard.

Reference: ASPRS Positional Accuracy Standards for Digital Geospatial Data, edition 1 (2014; PE&RS 81(3)) and edition 2 (2023,
version 2 of 2024).
Edition 1 states accuracy at the 95 % level (NSSDA: 1.7308 RMSEr, 1.9600 RMSEz) and asks for 20 check points; edition 2
states RMSE, adds the error of the check points' own survey, and asks for 30.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

EDITIONS = ("2014", "2023", "2024")
TITLES = {"2023": "Edition 2 (2023)", "2024": "Edition 2, Version 2 (2024)"}
LEAST = {"2014": 20, "2023": 30, "2024": 30}
"""Check points that an edition asks for at least."""
RADIAL, VERTICAL = 1.7308, 1.9600
"""Factors to the 95 % level of edition 1 (NSSDA), for RMSEx = RMSEy and normal errors."""


@dataclass(frozen=True)
class Accuracy:
    """Errors at n check points [m]. mean, rmse (3,): X, Y, Z of product minus survey; survey (3,): rms of the survey's own
    sigmas."""

    n: int
    mean: np.ndarray
    rmse: np.ndarray
    survey: np.ndarray

    @classmethod
    def of(cls, off: np.ndarray, sigma: np.ndarray) -> Accuracy:
        """From differences (n, 3) [m] and the survey's standard errors (n, 3) [m]; n of at least 1."""
        return cls(len(off), off.mean(axis=0), np.sqrt((off**2).mean(axis=0)), np.sqrt((sigma**2).mean(axis=0)))

    def horizontal(self, edition: str) -> float:
        """RMSE_r of edition 1; RMSE_H of edition 2, the survey's error included [m]."""
        fit = float(np.hypot(*self.rmse[:2]))
        return fit if edition == "2014" else math.hypot(fit, *self.survey[:2])

    def vertical(self, edition: str) -> float:
        """RMSE_z of edition 1; RMSE_V of edition 2, the survey's error included [m]."""
        return float(self.rmse[2]) if edition == "2014" else math.hypot(self.rmse[2], self.survey[2])


def statements(a: Accuracy, edition: str = "2024", class_h_cm: float | None = None,
               class_v_cm: float | None = None) -> list[str]:
    """The horizontal and the vertical statement. class_h_cm, class_v_cm: the accuracy class the data were made for; where it
    is not given the
    smallest whole centimetre that the test meets is named, and that it was chosen after the test is said."""
    h, v = a.horizontal(edition) * 100, a.vertical(edition) * 100
    out = [_statement(a, edition, "horizontal", h, class_h_cm), _statement(a, edition, "vertical", v, class_v_cm)]
    if class_h_cm is None or class_v_cm is None:
        out.append("No accuracy class was given for the data: the classes named are the smallest whole centimetres that the "
                   "test meets, "
                   "chosen after it. Give the class that was agreed with --class-h-cm and --class-v-cm.")
    return out


def remarks(a: Accuracy, edition: str, class_h_cm: float | None = None, class_v_cm: float | None = None) -> list[str]:
    """What the standard wants said: too few check points, a mean error that is not small, a survey that is not good enough."""
    out = []
    if a.n < LEAST[edition]:
        out.append(f"Only {a.n} check points: the standard asks for at least {LEAST[edition]}. The RMSE of {a.n} points is "
                   f"itself uncertain "
                   f"by about {100 / math.sqrt(2 * a.n):.0f} % in each coordinate.")
    for k, name in enumerate("XYZ"):
        if abs(a.mean[k]) > 0.25 * a.rmse[k] and abs(a.mean[k]) > 2 * a.rmse[k] / math.sqrt(a.n):
            out.append(f"The mean error in {name} is {100 * a.mean[k]:.1f} cm, {100 * abs(a.mean[k]) / a.rmse[k]:.0f} % of "
                       f"its RMSE: a "
                       "systematic error (datum, heights, lever arm) is likely and should be found, not averaged.")
    need = 3 if edition == "2014" else 2
    known = float(np.hypot(*a.survey[:2])), float(a.survey[2])
    for what, survey, error in zip(("horizontally", "vertically"), known, (class_h_cm, class_v_cm), strict=True):
        if error is not None and survey * 100 * need > error:
            out.append(f"The check points are known to {100 * survey:.1f} cm {what}: for a class of {error:g} cm the "
                       f"standard wants them "
                       f"{need} times better than the class.")
    return out


def _statement(a: Accuracy, edition: str, which: str, rmse: float, chosen: float | None) -> str:
    tested = 100 * float(max(a.rmse[:2])) if (edition, which) == ("2014", "horizontal") else rmse
    level = chosen if chosen is not None else float(max(1, math.ceil(tested - 1e-9)))
    if edition == "2014":
        return _first_edition(a, which, rmse, level)
    title = f"ASPRS Positional Accuracy Standards for Digital Geospatial Data, {TITLES[edition]}"
    sub, name, found = _SECOND[which]
    found = "NVA accuracy" if (edition, which) == ("2023", "vertical") else f"The {found}"
    value, met = f"RMSE{sub} = {rmse:.1f} (cm)", rmse <= level + 1e-9
    if a.n < LEAST[edition]:
        return (f"This data set was tested as required by {title}. Although the Standards call for a minimum of thirty (30) "
                f"checkpoints, this test was performed using ONLY {a.n} checkpoints. This data set was produced to meet a "
                f"{level:g} (cm) RMSE{sub} {name}. {found} was found to be {value} using the reduced number of checkpoints."
                + _missed(met))
    return (f"This data set was tested to meet {title} for a {level:g} (cm) RMSE{sub} {name}. {found} was found to be "
            f"{value}." + _missed(met))


_SECOND = {"horizontal": ("H", "Horizontal Positional Accuracy Class", "tested horizontal positional accuracy"),
           "vertical": ("V", "Vertical Accuracy Class", "Non-Vegetated Vertical Accuracy (NVA)")}
"""Subscript, class and what was found, in the words of edition 2."""


def _first_edition(a: Accuracy, which: str, rmse: float, level: float) -> str:
    title = "ASPRS Positional Accuracy Standards for Digital Geospatial Data (2014)"
    few = f" Only {a.n} check points were used." if a.n < LEAST["2014"] else ""
    if which == "horizontal":
        x, y = a.rmse[:2] * 100
        return (f"This data set was tested to meet {title} for a {level:g} (cm) RMSEx / RMSEy Horizontal Accuracy Class. "
                f"Actual positional "
                f"accuracy was found to be RMSEx = {x:.1f} (cm) and RMSEy = {y:.1f} (cm) which equates to Positional "
                f"Horizontal "
                f"Accuracy = +/- {RADIAL * rmse:.1f} (cm) at 95% confidence level." + few + _missed(max(x, y) <= level + 1e-9))
    return (f"This data set was tested to meet {title} for a {level:g} (cm) RMSEz Vertical Accuracy Class. Actual NVA "
            f"accuracy was found to "
            f"be RMSEz = {rmse:.1f} (cm), equating to +/- {VERTICAL * rmse:.1f} (cm) at 95% confidence level." + few
            + _missed(rmse <= level + 1e-9))


def _missed(met: bool) -> str:
    return "" if met else " The test does NOT meet this class."


