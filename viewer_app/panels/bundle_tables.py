"""What the Bundle tab says of its result: in a line, warnings, variance components, images, points, suspects, interiors; HTML."""

from __future__ import annotations

import numpy as np

from solvers.cameras import PARAMETERS

from .. import theme
from ..bridge import Wire
from ..bundle_actions import NOTHING
from ..bundle_rows import last_misfit, misfit, point_rms
from ..bundle_scene import MOST, ellipsoid_factor, judged, left_out, scale_end
from ..bundle_state import COLOURED, Bundle, Held
from ..bundle_values import Judged, Layout
from ..kept import by_identity
from ..matching_scene import RAYS, SCALE
from ..state import State
from .widgets import MUTED, css, decimals, esc, swatch, table

ROWS = 60
"""Rows of a table at most; the worst come first."""
GROUPS = {"tie image": "image, tie points", "control image": "image, control", "control": "control coordinates",
          "GPS": "GPS positions", "IMU": "IMU angles", "level": "assumed to look down",
          "GPS/IMU": "GPS and IMU together"}
UNITS = {"c": "mm", "xp": "mm", "yp": "mm", "k1": "mm⁻²", "k2": "mm⁻⁴", "k3": "mm⁻⁶", "p1": "mm⁻¹", "p2": "mm⁻¹"}


def summary(state: State) -> str:
    """How it goes or how it ended, and everything a person should know of it."""
    room = state.room(Bundle)
    lines = [f'<div role="status" aria-label="Bundle">{_headline(state, room)}</div>']
    if room.error:
        lines.append(f'<div role="alert" style="color:{css(theme.RESIDUAL)}">{esc(_here(state, room.error))}</div>')
    if room.rows and room.block is not state.block:
        lines.append(f"<div {MUTED}>Measurements or points have changed since; run the bundle again.</div>")
    elif room.rows and room.asked[:-1] != room.options:
        lines.append(f"<div {MUTED}>The choices above are not those of this bundle; run it again.</div>")
    if room.run:
        lines.append(f"<div {MUTED}>Kept in {esc(room.run)}</div>")
    if room.result is not None:
        lines += [f"<div>⚠ {esc(_sentence(w))}</div>" for w in room.result.warnings]
        if state.row < room.steps:
            lines.append(f"<div {MUTED}>Row {state.row} is shown; standard errors hold for row {room.steps} alone.</div>")
    return "".join(lines)


def _here(state: State, why: str) -> str:
    """Why there is no bundle: this project's, in the words of this tab, where options are no dashed words."""
    return _sentence(why.removeprefix(f"{state.block.name}: ").replace("--", ""))


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:] + ("" if text.endswith((".", "!", "?")) else ".")


def _headline(state: State, room: Bundle) -> str:
    if room.result is None:
        if room.progress:
            return esc(room.progress)
        if room.rows or room.error:
            return ""
        todo = "Adjust all images together: choose, then Run bundle." if len(state.block.observations) else NOTHING
        return f"<span {MUTED}>{todo}</span>"
    r, layout = room.result, room.layout
    sigma0 = "undetermined" if r.sigma0 is None else f"{r.sigma0:.3f}"
    end = "" if r.converged else " <b>not converged</b>"
    return (f"<b>σ0 {sigma0}</b>, rms {r.rms_px:.3g} px, {len(r.values)} images, {len(layout.points) if layout else 0} points, "
            f"redundancy {r.dof}, {room.steps} iterations{end}")


def components(result: Judged) -> str:
    """σ0 and redundancy of every kind of observation, and how control and check points fit."""
    rows = [("", (esc(GROUPS.get(k, k)), "–" if s is None else f"{s:.3f}", f"{r:.1f}")) for k, (s, r) in result.groups.items()]
    found = table(("observations", "σ0", "redundancy"), rows, "Variance components")
    for words, rms in (("control points, rms", result.control_rms), ("check points, rms", result.check_rms)):
        if rms is not None:
            found += f"<div>{words} <b>{' '.join(_metres(v) for v in rms)}</b> m in X, Y, Z</div>"
    return found


def two_runs(state: State) -> str:
    """The bundle set aside and the present one beside each other: what was asked, how they fit, what differs."""
    room, held = state.room(Bundle), state.room(Bundle).held
    if held is None:
        return ""
    now = Held(room.asked, room.layout, room.rows[-1], room.result, room.steps) if room.layout and room.result else None
    both = (held, now)
    rows = [("", (label, *("" if h is None else _asked(h.asked[k]) for h in both))) for k, label in enumerate(ASKED)]
    rows += [("", (label, *("" if h is None else value(h) for h in both))) for label, value in WORTH]
    kinds = dict.fromkeys(k for h in both if h is not None for k in h.result.groups)
    for kind in kinds:
        found = [None if h is None else h.result.groups.get(kind) for h in both]
        cells = ("" if g is None or g[0] is None else f"{g[0]:.3f}" for g in found)
        rows.append(("", (f"σ0 {esc(GROUPS.get(kind, kind))}", *cells)))
    body = table(("", "set aside", "now"), rows, "Two bundles")
    return f"<div><b>Two bundles</b></div>{body}" + ("" if now is None else _moved(held, now))


ASKED = ("projection", "parallel rays", "datum", "free", "robust loss", "start", "of every image", "images", "rolling shutter")


def _asked(value: object) -> str:
    return esc(", ".join(value) if isinstance(value, tuple) else value or "all") or "none"


WORTH = (
    ("iterations", lambda h: str(h.steps)),
    ("images", lambda h: str(len(h.result.values))),
    ("redundancy", lambda h: str(h.result.dof)),
    ("σ0", lambda h: "–" if h.result.sigma0 is None else f"{h.result.sigma0:.3f}"),
    ("rms [px]", lambda h: f"{h.result.rms_px:.3f}"),
    ("control rms [m]", lambda h: "–" if h.result.control_rms is None else " ".join(f"{v:.3f}" for v in h.result.control_rms)),
    ("check rms [m]", lambda h: "–" if h.result.check_rms is None else " ".join(f"{v:.3f}" for v in h.result.check_rms)),
    ("σ of centres [m]", lambda h: _metres(float(np.median(np.sqrt(np.einsum("nii->n", h.result.image_covariance)))))),
    ("σ of points [m]", lambda h: _metres(float(np.median(np.sqrt(np.einsum("nii->n", h.result.covariance)))))),
)


def _moved(held: Held, now: Held) -> str:
    """How far images, points and cameras of one bundle lie from those of the other."""
    words = []
    for what, names, at in (("centres", lambda h: h.layout.images, lambda h: h.layout.poses(h.row.x)[0]),
                            ("points", lambda h: h.layout.points, lambda h: h.layout.places(h.row.x))):
        index = {n: k for k, n in enumerate(names(held))}
        pairs = np.array([(index[n], k) for k, n in enumerate(names(now)) if n in index], int).reshape(-1, 2)
        if len(pairs):
            off = np.linalg.norm(at(now)[pairs[:, 1]] - at(held)[pairs[:, 0]], axis=1)
            far = names(now)[int(pairs[np.argmax(off), 1])]
            words.append(f"{what} moved by {_metres(float(np.median(off)))} m in the middle, at most "
                         f"{_metres(float(off.max()))} m ({esc(far)})")
    for name, b in zip(now.layout.cameras, now.result.interiors, strict=True):
        if name in held.layout.cameras:
            a = held.result.interiors[held.layout.cameras.index(name)]
            if a.c != b.c:
                words.append(f"c of {esc(name)}: {b.c - a.c:+.4f} mm")
    return f"<div {MUTED}>Now minus set aside: {'; '.join(words)}.</div>" if words else ""


def _metres(value: float) -> str:
    return "–" if not np.isfinite(value) else f"{value:.4f}" if abs(value) < 1 else f"{value:.3f}"


def legend(state: State) -> str:
    """What the colours of the points mean."""
    room = state.room(Bundle)
    if not room.rows or not room.draw_points:
        return ""
    if room.colour == COLOURED[1]:
        parts = " &nbsp;".join(f"{swatch(c)}{n}{'+' if n == max(RAYS) else ''}" for n, c in RAYS.items())
        return f"<div>seen in {parts} images</div>"
    if room.colour == COLOURED[0]:
        of = misfit(state)
        if of is None:
            return f"<div {MUTED}>Residuals come with the last row.</div>"
        bar = ",".join(css((int(r), int(g), int(b))) for r, g, b in SCALE)
        when = "" if of.live else f" <span {MUTED}>(of the last row)</span>"
        style = f"display:inline-block;width:120px;height:.8em;background:linear-gradient(90deg,{bar})"
        return (f'<div>residual 0 <span style="{style}"></span> {scale_end(state):.2f} px and more{when}</div>')
    return ""


def marks(state: State) -> str:
    """What vectors and ellipsoids mean."""
    room = state.room(Bundle)
    words = []
    if room.draw_vectors and room.rows:
        words.append(f"{swatch(theme.CONTROL)}correction of control {swatch(theme.RESIDUAL)}error of check points")
    result = judged(state)
    if room.draw_ellipsoids and result is not None:
        words.append(f"ellipsoids: 95 % (factor 2.796, χ² with 3 degrees of freedom), a priori from the given standard errors; "
                     f"redundancy of the adjustment {result.dof}; drawn × {ellipsoid_factor(state):g}")
        words += [f"of {n} {kind} points only the {MOST} largest ellipsoids are drawn" for kind, n in left_out(result).items()]
    return "".join(f"<div {MUTED}>{w}</div>" for w in words)


def images_table(state: State, result: Judged, layout: Layout, wire: Wire) -> str:
    """Every image: points, rms, σ0 and standard errors, the worst σ0 first; a click chooses it and flies there."""
    order = np.argsort(-np.nan_to_num(result.image_sigma0), kind="stable")[:ROWS]
    rows = []
    for k in order:
        name = layout.images[k]
        sigma = np.sqrt(np.diag(result.exterior[k]))
        bold = 'style="font-weight:600;cursor:pointer"' if name == state.image else ""
        attributes = wire.attributes("fly-image", name, f"fly to {name}")
        attributes = attributes.replace('style="cursor:pointer"', bold) if bold else attributes
        angle = np.degrees(sigma[3:])
        rows.append((attributes, (esc(name), str(int(result.seen[k])), f"{result.rms[k]:.2f}",
                                  "–" if not np.isfinite(result.image_sigma0[k]) else f"{result.image_sigma0[k]:.2f}",
                                  *(f"{s:.2g}" for s in sigma[:3]), *(f"{a:.2g}" for a in angle))))
    head = ("image", "pts", "rms px", "σ0", "sX m", "sY m", "sZ m", "sω °", "sφ °", "sκ °")
    return _titled(f"{len(layout.images)} images", len(order), len(layout.images),
                   table(head, rows, "Bundle images", 190, 10))


def points_table(state: State, result: Judged, layout: Layout, wire: Wire) -> str:
    """Control and check points by how far off, then tie points by residual, at the last row; a click flies there."""
    roles, off, rms = result.roles, result.off, point_rms(layout, last_misfit(result))
    order, given = _order(layout, result)
    rows = []
    for k in order:
        name = layout.points[k]
        d = off[k] if given[k] else np.full(3, np.nan)
        w = result.point_w[k]
        worst = float(np.abs(w[np.isfinite(w)]).max(initial=0.0))
        sigma = np.sqrt(np.diag(result.covariance[k]))
        mark = swatch({"control": theme.CONTROL, "check": theme.CHECK}.get(roles[k], theme.INITIAL))
        bold = ' style="font-weight:600;cursor:pointer"' if name == state.point else ""
        attributes = wire.attributes("fly-point", name, f"fly to {name}")
        attributes = attributes.replace('style="cursor:pointer"', bold) if bold else attributes
        rows.append((attributes, (f"{mark}{esc(name)}", str(int(result.rays[k])), f"{rms[k]:.2f}" if np.isfinite(rms[k]) else "–",
                                  *("" if not np.isfinite(v) else f"{1000 * v:+.1f}" for v in d), f"{worst:.1f}" if worst else "",
                                  *(f"{1000 * s:.1f}" for s in sigma))))
    head = ("point", "rays", "rms px", "dX mm", "dY", "dZ", "|w|", "sX mm", "sY", "sZ")
    return _titled("Points, adjusted − given", len(order), len(roles), table(head, rows, "Bundle points", 230, 10))


@by_identity(2)
def _order(layout: Layout, result: Judged) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the table of points, and which points (n,) were given."""
    rms = point_rms(layout, last_misfit(result))
    given = np.isin(np.array(result.roles), ("control", "check"))
    far = np.nan_to_num(np.linalg.norm(result.off, axis=1))
    return np.lexsort((-np.nan_to_num(rms), -far * given, ~given))[:ROWS], given


def suspects_table(result: Judged, wire: Wire) -> str:
    """Observations with |w| > 4, the worst first; a click flies to the point."""
    if not result.suspects:
        return f"<div {MUTED}>No suspect observation: every |w| is below 4.</div>"
    rows = []
    for s in result.suspects:
        where = s.get("image") or "coordinates"
        size = s.get("residual_px") or s.get("off_m")
        unit = "px" if "residual_px" in s else "m"
        rows.append((wire.attributes("fly-point", str(s.get("point", "")), f"fly to {s.get('point', '')}"),
                     (esc(s.get("point", "")), esc(where), f"{s['w']:.1f}",
                      "" if size is None else " ".join(f"{v:+.3g}" for v in size) + f" {unit}")))
    return "<div><b>Suspects</b></div>" + table(("point", "in", "|w|", "misfit"), rows, "Suspects", 160)


def interior_table(result: Judged, layout: Layout) -> str:
    """Interior orientations that were adjusted, with their standard errors."""
    sigma = dict(zip(result.freed, np.sqrt(np.diag(result.interior_covariance)), strict=True)) if result.freed else {}
    found = ""
    for name, interior in zip(layout.cameras, result.interiors, strict=True):
        mine = {p: v for (c, p), v in sigma.items() if name == c or name.startswith(f"{c}@")}
        free = [p for p in PARAMETERS if p in mine]
        rows = []
        for p in free[:10]:
            value, s = float(getattr(interior, p)), float(mine[p])
            text = f"{value:.{decimals(s)}f}" if p in ("c", "xp", "yp") else f"{value:.4e}"
            rows.append(("", (f"{p} <span {MUTED}>{UNITS.get(p, '')}</span>", text, f"{s:.2g}")))
        if rows:
            found += table((f"camera {esc(name)}", "value", "σ"), rows, f"Interior of {name}")
    return found


def _titled(title: str, shown: int, count: int, body: str) -> str:
    more = f" <span {MUTED}>· the worst {shown} of {count}</span>" if shown < count else ""
    return f"<div><b>{title}</b>{more}</div>{body}"
