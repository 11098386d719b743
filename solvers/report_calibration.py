"""A calibration as text: the parameters with their standard errors first, then what they do together."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .adjustment.reliability import correlation
from .cameras import PARAMETERS
from .report import _notes, _rendered
from .report_bundle import SAID, group_lines, headline, images_text, points_lines, significant
from .report_orientation import _run, _table

if TYPE_CHECKING:
    from .orientation import Adjusted
    from .workflows_calibration import CalibratedProject, Comparison

TOLD = 0.7
"""Correlation from which a pair of parameters is listed."""


def calibrated_text(done: CalibratedProject) -> str:
    """One report per camera, then the block it comes from."""
    from .workflows_calibration import facts

    result = done.adjusted.result
    parts = [headline(done.adjusted.block.name, result)]
    for camera, told in facts(result).items():
        parts += [parameter_table(result, camera), quality_line(told), *correlation_lines(result, camera), curve_table(told),
                  *conversion_lines(told["conversions"])]
    parts += [comparison_text(c) for c in done.comparisons]
    return "\n".join([*parts, images_text(result), *points_lines(result), *group_lines(result),
                      *_notes("warning", list(result.warnings)), *_run(done.adjusted.run)])


def parameter_table(result: Adjusted, camera: str) -> str:
    """Camera parameters and their standard deviations, as calibration reports print them."""
    interior, sigma = result.interiors[camera], result.interior_sigma[camera]
    scale = result.sigma0 if result.sigma0 is not None and result.sigma0 > 1 else 1.0
    table = _table(f"camera {camera}", "value", "standard deviation", "times sigma0", "value / deviation")
    for name in PARAMETERS:
        value = getattr(interior, name)
        if name in sigma:
            s = sigma[name]
            told = f"{value:.{significant(value, s)}g}"
            table.add_row(SAID[name], told, f"{s:.3e}", f"{scale * s:.3e}", f"{abs(value) / s:.1f}")
        else:
            table.add_row(SAID[name], f"{value:.7g}", "fixed", "", "")
    return _rendered(table)


def quality_line(told: dict[str, Any]) -> str:
    """sigma0 and rms in micrometres."""
    sigma0 = "undetermined" if told["sigma0_um"] is None else f"{told['sigma0_um']:.3f} um"
    return f"sigma0 {sigma0}, root mean square of the image coordinates {told['rms_um']:.3f} um"


def correlation_lines(result: Adjusted, camera: str) -> list[str]:
    """Pairs of parameters that the network does not keep well apart, the closest first."""
    rows = result.interior_rows(camera)
    if len(rows) < 2:
        return []
    r = correlation(result.interior_covariance[np.ix_(rows, rows)])
    names = [result.interior_names[k][1] for k in rows]
    pairs = sorted(((abs(r[i, j]), f"{names[j]} {names[i]} {r[i, j]:+.2f}") for i in range(len(rows)) for j in range(i)
                    if abs(r[i, j]) > TOLD), reverse=True)
    said = ", ".join(text for _, text in pairs) if pairs else f"none beyond {TOLD}"
    return _notes("correlations", [said])


def curve_table(told: dict[str, Any]) -> str:
    """The distortion curve, which is known better than its coefficients."""
    table = _table("radius [mm]", *(f"{row['r_mm']:.2f}" for row in told["curve"][1:]))
    for key, name in (("radial", "radial correction [um]"), ("decentring", "decentring [um]")):
        table.add_row(name, *(f"{row[f'{key}_um']:.2f}" for row in told["curve"][1:]))
        table.add_row("  its sigma [um]", *(f"{row[f'{key}_sigma_um']:.2f}" for row in told["curve"][1:]))
    return _rendered(table)


def conversion_lines(conversions: dict[str, Any]) -> list[str]:
    """How well other tools' models take the parameters; the values are in the JSON."""
    said = [f"{name} {'refused' if 'refused' in v else format(v['refit_max_px'], '.2g')}" for name, v in conversions.items()]
    return _notes("refitted for other tools, largest difference [px]", [", ".join(said)])


def comparison_text(c: Comparison) -> str:
    """Parameter differences against their sigma, the curves' difference, and what both say."""
    d = c.difference
    table = _table(f"camera {c.camera}: minus {c.other}", "difference", "sigma", "ratio")
    for name, v, s in zip(d.names, d.difference, d.sigma, strict=True):
        table.add_row(SAID[name], f"{v:.3g}", f"{s:.2g}", f"{v / s:.1f}")
    curves = _table("radius [mm]", *(f"{r:.2f}" for r in d.radius[1:]))
    curves.add_row("rays apart by [um]", *(f"{v:.2f}" for v in d.image_um[1:]))
    curves.add_row("  its sigma [um]", *(f"{v:.2f}" for v in d.image_sigma[1:]))
    verdict = "they differ by more than their standard errors explain" if d.changed else "their standard errors explain it"
    line = f"all parameters together: chi-square {d.chi_square:.1f} of {d.dof}, probability {d.probability:.2g}: {verdict}"
    return "\n".join([_rendered(table), _rendered(curves), line])
