"""The pictures of a report. Functions that return a matplotlib Figure make a new one; `draw_...` draw into given axes.
No window is opened."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tautline.calibration.backlash import paper_knots
from tautline.errors import TautError
from tautline.folders import whole_file
from tautline.model import Model
from tautline.reports.evidence import STAGES, Evidence, Run

Array = np.ndarray
Onset = Mapping[str, Any]

INK, GREY, PALE = "#22303c", "#7b8794", "#e4e7eb"
UP, DOWN, MODEL, BAND = "#1f6fb2", "#d9772b", "#b3202c", "#f3c9cc"
STAGE_COLOURS = (INK, "#2f9e5b", "#d9a400")  # black, green, yellow: the paper's Figs. 10 and 11
SERIES = ("#1f6fb2", "#d9772b", "#2f9e5b", "#8e4ec6", "#b3202c", "#0f8b8d", "#7b8794")

_ENDINGS = (".png", ".svg", ".pdf")  # format: file endings of a picture
STYLE: Any = {  # matplotlib's own names
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.edgecolor": GREY,
    "axes.labelcolor": INK,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": PALE,
    "grid.linewidth": 0.7,
    "xtick.color": INK,
    "ytick.color": INK,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "svg.hashsalt": "tautline",
}
MANY = 3000  # format: samples from which a scatter is drawn as pixels inside the vector picture


def figure(width: float, height: float, rows: int = 1, columns: int = 1, **options: Any) -> tuple[Figure, Array]:
    """Makes a figure of width x height inches with rows x columns axes, in matplotlib's current style. Returns it and
    its axes, an array (rows, columns). options: further ones of matplotlib's `subplots`."""
    made = Figure(figsize=(width, height), layout="constrained")
    return made, made.subplots(rows, columns, squeeze=False, **options)


def data_uri(made: Figure) -> str:
    """The figure `made` as an SVG image in a data: URI, so that a page needs no other file."""
    out = io.BytesIO()
    with mpl.rc_context(STYLE):
        made.savefig(out, format="svg", dpi=120, metadata={"Date": None, "Creator": None})
    return "data:image/svg+xml;base64," + base64.b64encode(out.getvalue()).decode()


def check_ending(path: Path) -> None:
    """Raises a TautError where `save` cannot write a picture with the path's ending; to be called before the work for
    the picture is done."""
    if path.suffix.lower() not in _ENDINGS:
        raise TautError(f"{path}: a picture ends in {', '.join(_ENDINGS)}: name it so")


def save(made: Figure, path: Path) -> None:
    """Writes the figure `made` to `path`, whole or not at all, as PNG, SVG or PDF by the path's ending."""
    with mpl.rc_context(STYLE), whole_file(path) as file:
        made.savefig(file, dpi=120)


def onsets_of(model: Model) -> list[Onset]:
    """The onsets, one for each reversal, that a model was calibrated from (`onsets` in model.json), in the order of
    time. Each is a mapping of numbers, NaN where not measured: t_s; direction, 1 or -1; in the unit of q q1 and q2
    (motor at the turn and at the onset), width and its sigma; of texts: recording, reason, kind; and of `used`, whether
    B was fitted to it. TautError where they are damaged."""
    numbers = ("t_s", "direction", "q1", "q2", "width", "sigma")
    onsets: list[Onset] = []
    try:
        for given in model.extra.get("onsets", []):
            values = {name: np.nan if given.get(name) is None else float(given[name]) for name in numbers}
            texts = {name: str(given.get(name, "")) for name in ("recording", "reason", "kind")}
            onsets.append({**values, **texts, "used": bool(given["used"])})
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise TautError(f"the model's onsets are damaged ({error!r}): make it again with taut calibrate") from error
    return sorted(onsets, key=lambda onset: onset["t_s"])


def fine_unit(unit: str) -> tuple[str, float]:
    """The unit in which small changes of B are shown, and the factor from the unit of q to it: µm and 1000 for mm, else
    the unit itself and 1."""
    return ("µm", 1e3) if unit == "mm" else (unit, 1.0)


def common_unit(models: Mapping[str, Model]) -> str:
    """The unit of q that the models to be compared share. TautError without models, or where their units differ."""
    units = {model.rig.actuator.unit for model in models.values()}
    if not units:
        raise TautError("no model to compare: name two or more")
    if len(units) > 1:
        raise TautError("the models' motors have different units, mm and deg: they are not of one instrument")
    return units.pop()


def split_onsets(onsets: Sequence[Onset]) -> tuple[list[Onset], list[Onset]]:
    """Two lists: the onsets that B(q) was fitted to, and those that were left out."""
    return [o for o in onsets if o["used"]], [o for o in onsets if not o["used"]]


def knots_of(model: Model) -> Array | None:
    """The knots (k,) of B's spline, unit of q, for a model that was calibrated with the paper's knots (--knots paper);
    None for other models."""
    if model.extra.get("options", {}).get("knots") != "paper":
        return None
    return paper_knots(float(model.q[0]), float(model.q[-1]))


def q_mean(onset: Onset) -> float:
    """The q at which an onset's width is drawn: midway between the motor's positions at the turn and at the onset."""
    return 0.5 * float(onset["q1"] + onset["q2"])


def draw_backlash(axes: Axes, model: Model, onsets: Sequence[Onset], knots: Array | None = None) -> None:
    """Draws B(q) with its band of 2 sigma and every measured width (the paper's Fig. 8). A width whose 2 sigma exceeds
    it is hollow and has no error bar. The range where B was not measured is grey. knots: unit of q, drawn as vertical
    lines."""
    unit, (low, high) = model.rig.actuator.unit, model.measured
    measured = model.is_measured
    used, _ = split_onsets(onsets)
    precise = [o for o in used if 2 * o["sigma"] <= o["width"]]  # a wider bar over the picture says nothing
    reaches = [o["width"] + 2 * o["sigma"] for o in precise]
    highest = max([o["width"] for o in used], default=0.0)
    level = max(highest, float(model.width[measured].max()) if measured.any() else 0.0, 1e-9)
    top = max(1.25 * level, min(1.05 * max(reaches, default=0.0), 3.0 * level))  # holds every bar, but for huge ones
    at = [q_mean(o) for o in used]
    ends = min([float(model.q[0]), *at]), max([float(model.q[-1]), *at])  # a motor may have gone beyond the range
    axes.fill_between(
        model.q[measured],
        np.maximum(model.width - 2 * model.width_sigma, 0)[measured],
        np.minimum(model.width + 2 * model.width_sigma, 2 * top)[measured],
        color=BAND,
        lw=0,
        label="± 2 sigma",
    )
    axes.plot(model.q, model.width, color=MODEL, lw=1.0, ls=":")
    axes.plot(model.q[measured], model.width[measured], color=MODEL, lw=1.8, label="B(q)")
    _draw_widths(axes, precise, [o for o in used if not 2 * o["sigma"] <= o["width"]])
    if knots is not None:
        for knot in np.unique(knots):
            axes.axvline(knot, color=UP, lw=0.7, alpha=0.5)
    for left, right in ((model.q[0], low), (high, model.q[-1])):
        if right > left:
            axes.axvspan(left, right, color=PALE, alpha=0.6, lw=0)
    axes.set(xlabel=f"q ({unit})", ylabel=f"backlash width ({unit})", xlim=ends, ylim=(0, top))
    axes.set_title("Backlash width B(q)")
    axes.legend(loc="best")


def _draw_widths(axes: Axes, precise: Sequence[Onset], vague: Sequence[Onset]) -> None:
    """Draws the widths that onsets measured over their q, with a marker and a colour for each direction: those of
    `precise` with an error bar of 2 sigma, those of `vague` hollow and without one."""
    for direction, colour, marker, name in ((1, UP, "^", "rising"), (-1, DOWN, "v", "falling")):
        if mine := [o for o in vague if np.sign(o["direction"]) == direction]:
            at, widths = [q_mean(o) for o in mine], [o["width"] for o in mine]
            axes.plot(at, widths, marker, ms=4, mfc="none", mec=colour, alpha=0.5, label=f"vague, {name}")
        if mine := [o for o in precise if np.sign(o["direction"]) == direction]:
            axes.errorbar(
                [q_mean(o) for o in mine],
                [o["width"] for o in mine],
                yerr=[2 * o["sigma"] for o in mine],
                fmt=marker,
                ms=4,
                color=colour,
                elinewidth=0.8,
                lw=0,
                label=f"onset, {name}",
            )


def draw_characteristic(axes: Axes, model: Model, evidence: Evidence | None) -> None:
    """Draws over the motor position the bending angle that was seen, in one colour while q rises and in another while
    it falls, and the curves f_coarse and f_remain (the paper's Fig. 9). evidence: None or without rows draws the curves
    alone."""
    unit = model.rig.actuator.unit
    if evidence is not None and len(evidence.q):
        rising = np.gradient(evidence.q) >= 0 if len(evidence.q) > 1 else np.ones(1, dtype=bool)
        for chosen, colour, name in ((rising, UP, "q rising"), (~rising, DOWN, "q falling")):
            axes.plot(
                evidence.q[chosen],
                evidence.c_deg[chosen],
                ".",
                ms=2,
                color=colour,
                alpha=0.5,
                label=name,
                rasterized=len(evidence.q) > MANY,
            )
    coarse = model.rig.coarse
    axes.plot(model.q, coarse.gain * model.q + coarse.offset, color=GREY, lw=1.0, ls="--", label="f_coarse")
    axes.plot(model.q, model.c_deg, color=MODEL, lw=1.8, label="f_remain")
    axes.set(xlabel=f"q ({unit})", ylabel="bending c (deg)", xlim=(model.q[0], model.q[-1]))
    axes.set_title("Characteristic")
    axes.legend(loc="best", markerscale=3)


@mpl.rc_context(STYLE)
def hero(model: Model, onsets: Sequence[Onset], evidence: Evidence | None, knots: Array | None = None) -> Figure:
    """The first picture of a report: B(q) on the left, the characteristic on the right. Arguments as in `draw_backlash`
    and `draw_characteristic`."""
    made, axes = figure(11, 3.9, 1, 2)
    draw_backlash(axes[0, 0], model, onsets, knots)
    draw_characteristic(axes[0, 1], model, evidence)
    return made


@mpl.rc_context(STYLE)
def stage_errors(evidence: Evidence) -> Figure:
    """A figure of the distance between prediction and observation for each of STAGES over time (the paper's Fig. 11),
    at the settled rows, on a logarithmic axis."""
    made, axes = figure(11, 3.0)
    ax = axes[0, 0]
    scored = evidence.settled
    for stage, colour, error in zip(STAGES, STAGE_COLOURS, evidence.error, strict=True):
        distance = np.linalg.norm(error[scored], axis=1)
        ax.semilogy(
            evidence.t_s[scored],
            np.maximum(distance, 1e-4),  # 0 has no logarithm
            ".",
            ms=2,
            color=colour,
            label=stage,
            rasterized=len(distance) > MANY,
        )
    ax.set(xlabel="time (s)", ylabel=f"distance ({evidence.unit})")
    ax.set_title("How far each model is from what was seen")
    _put_legend_above(ax, 3, markerscale=4)
    return made


def principal_coordinate(evidence: Evidence) -> tuple[Array, str]:
    """Reduces `seen` to one coordinate (n,): the angle, deg, or the marker's position along the principal direction of
    its path, px, from the mean position. Returns it and the label for its axis."""
    if evidence.seen.shape[1] == 1:
        return evidence.seen[:, 0], "c (deg)"
    centred = evidence.seen - evidence.seen.mean(axis=0)
    spread = np.cov(centred.T) if len(centred) > 1 else np.eye(2)
    along = np.linalg.svd(spread)[0][:, 0]
    along = along * np.sign(along[np.argmax(np.abs(along))])  # its larger part positive: the SVD leaves the sign open
    return centred @ along, "marker along its path (px)"


@mpl.rc_context(STYLE)
def recorded_motion(evidence: Evidence, onsets: Sequence[Onset], motor_unit: str) -> Figure:
    """A figure of the motor and of the marker (or angle) over time, with every onset as a dot, green where it was used,
    else red. motor_unit: of q."""
    made, axes = figure(11, 4.0, 2, 1, sharex=True)
    position, name = principal_coordinate(evidence)
    order = np.argsort(evidence.t_s, kind="stable")  # np.interp needs it; recordings may come in any order
    for ax, values, colour, label in (
        (axes[0, 0], evidence.q, UP, f"q ({motor_unit})"),
        (axes[1, 0], position, INK, name),
    ):
        for index in np.unique(evidence.recording):
            chosen = evidence.recording == index
            ax.plot(evidence.t_s[chosen], values[chosen], color=colour, lw=0.9, rasterized=len(values) > MANY)
        ax.set_ylabel(label)
    for used, colour in ((True, "#2f9e5b"), (False, MODEL)):
        chosen_onsets = [o for o in onsets if o["used"] == used]
        times = [o["t_s"] + _clock_offset(evidence, o) for o in chosen_onsets]
        for ax, values in ((axes[0, 0], evidence.q), (axes[1, 0], position)):
            ax.plot(
                times,
                np.interp(times, evidence.t_s[order], values[order]),
                "o",
                ms=3.5,
                color=colour,
                label=f"onset {'used' if used else 'not used'} ({len(times)})",
            )
    _put_legend_above(axes[0, 0], 2)
    axes[0, 0].set_title("What was recorded")
    axes[1, 0].set_xlabel("time (s)")
    return made


@mpl.rc_context(STYLE)
def onsets_closely(model: Model, evidence: Evidence, onsets: Sequence[Onset], count: int = 3) -> Figure | None:
    """A figure of up to `count` used onsets, evenly chosen from low to high q: how far the tip moved over the motor's
    way since it turned, with the fitted hinge (level, then a slope from the width on) and the width's 2 sigma. None
    where no used onset has enough frames."""
    used = sorted(split_onsets(onsets)[0], key=q_mean)
    views = [view for onset in used if (view := _frames_around(evidence, onset)) is not None]
    if not views:
        return None
    picked = [views[round(i)] for i in np.linspace(0, len(views) - 1, min(count, len(views)))]
    unit = model.rig.actuator.unit
    made, axes = figure(11, 2.9, 1, len(picked))
    for ax, view in zip(axes[0], picked, strict=True):
        onset, farthest = view.onset, view.way.max()
        width, sigma = onset["width"], onset["sigma"]
        ax.axvspan(0, width, color=PALE, alpha=0.7, lw=0)
        ax.plot(view.way, view.moved, ".", color=INK, ms=4)
        ax.plot([0, width, farthest], [0, 0, view.slope * (farthest - width)], color=MODEL, lw=1.4)
        ax.axvspan(width - 2 * sigma, width + 2 * sigma, color=MODEL, alpha=0.25, lw=0)
        ax.annotate(
            f"B = {width:.4g} ± {2 * sigma:.2g}",
            (0.5 * width, 0.98),
            xycoords=("data", "axes fraction"),
            ha="center",
            va="top",
            color=MODEL,
            fontsize=8,
        )
        ax.set_title(f"q = {q_mean(onset):.3g} {unit}, {'rising' if onset['direction'] > 0 else 'falling'}")
        ax.set_xlabel(f"motor's way since it turned ({unit})")
    axes[0, 0].set_ylabel("moved since (px)" if evidence.unit == "px" else "moved since (deg)")
    return made


class _FramesAround(NamedTuple):
    """The k frames around an onset, for its picture."""

    onset: Onset
    way: Array  # (k,) the motor's way since it turned, unit of q
    moved: Array  # (k,) how far the tip had moved by then in the direction of its motion, px or deg
    slope: float  # of `moved` over `way` after the onset, px or deg per unit of q


def _frames_around(evidence: Evidence, onset: Onset) -> _FramesAround | None:
    """The frames from shortly before the turn to well after the onset; None where fewer than 2 frames are surely before
    the onset or fewer than 3 surely after it."""
    width = max(onset["width"], 1e-9)
    t2 = onset["t_s"] + _clock_offset(evidence, onset)
    same = evidence.recording == evidence.index(onset["recording"])
    way = evidence.path[same] - np.interp(t2, evidence.t_s[same], evidence.path[same]) + width
    # `way` is 0 at the turn and `width` at the onset t2. In shares of the width: what is shown; surely before or after.
    near = (way > -0.8 * width) & (way < 1.8 * width)
    way, seen = way[near], evidence.seen[same][near]
    still = (way > 0.1 * width) & (way < 0.95 * width)
    moving = way > 1.05 * width
    if still.sum() < 2 or moving.sum() < 3:
        return None
    level = seen[still].mean(axis=0)
    towards = seen[moving].mean(axis=0) - level
    towards = towards / max(float(np.linalg.norm(towards)), 1e-12)
    moved = (seen - level) @ towards
    reach = way[moving] - width  # the slope is a least-squares line through the hinge, `moved` = 0 at `width`
    return _FramesAround(onset, way, moved, slope=float(reach @ moved[moving] / (reach @ reach)))


@mpl.rc_context(STYLE)
def residuals(evidence: Evidence, motor_unit: str) -> Figure:
    """A figure of the residuals at the settled rows, seen minus predicted by the whole model (the last of STAGES), over
    time and over q. motor_unit: of q."""
    made, axes = figure(11, 2.9, 1, 2, sharey=True, width_ratios=[2, 1])
    names = ("u", "v") if evidence.unit == "px" else ("c",)
    for i, (name, colour) in enumerate(zip(names, (UP, DOWN), strict=False)):
        values = evidence.error[2][evidence.settled, i]
        for ax, x in ((axes[0, 0], evidence.t_s), (axes[0, 1], evidence.q)):
            ax.plot(x[evidence.settled], values, ".", ms=1.6, color=colour, label=name, rasterized=len(values) > MANY)
    axes[0, 0].set(xlabel="time (s)", ylabel=f"seen - predicted ({evidence.unit})")
    axes[0, 0].set_title("Residuals of f_remain + B")
    axes[0, 1].set_xlabel(f"q ({motor_unit})")
    if len(names) > 1:
        _put_legend_above(axes[0, 0], 2, markerscale=5)
    return made


@mpl.rc_context(STYLE)
def cross_check(model: Model, pass_width: Array) -> Figure:
    """A figure of B measured twice, by the model and by the distance of the passes up and down, and of the difference.
    pass_width: (n,) the latter on model.q, unit of q, NaN where it is not known."""
    unit = model.rig.actuator.unit
    made, axes = figure(11, 2.9, 1, 2, width_ratios=[3, 2])
    left, right = axes[0]
    left.plot(model.q, model.width, color=MODEL, lw=1.8, label="the model's B")
    left.plot(model.q, pass_width, color=UP, lw=1.4, ls="--", label="from the two passes alone")
    widths = np.concatenate([model.width, pass_width[np.isfinite(pass_width)]])
    left.set(xlabel=f"q ({unit})", ylabel=f"width ({unit})", ylim=(0, 1.3 * float(widths.max()) + 1e-9))
    left.set_title("B measured twice")
    left.legend(loc="upper right")
    right.fill_between(model.q, -2 * model.width_sigma, 2 * model.width_sigma, color=BAND, lw=0, label="± 2 sigma")
    difference = pass_width - model.width
    right.plot(model.q, difference, color=UP, lw=1.2)
    # The axis holds the largest difference, and 3 of the typical sigmas.
    worst = np.nanmax(np.abs(difference)) if np.isfinite(difference).any() else 1.0
    measured = model.is_measured
    band = 3 * float(np.median(model.width_sigma[measured])) if measured.any() else 0.0
    right.set(xlabel=f"q ({unit})", ylabel=f"difference ({unit})", ylim=np.array([-1.2, 1.2]) * max(worst, band, 1e-9))
    right.set_title("Passes minus model")
    right.legend(loc="upper right")
    return made


@mpl.rc_context(STYLE)
def followed_runs(runs: Mapping[str, Run]) -> Figure:
    """A figure over time of the runs of `taut follow`, by compensation: above the tip's angle beside the angle asked
    for (the first run's), below the tracking error where it counts. runs: at least one."""
    made, axes = figure(11, 4.6, 2, 1, sharex=True)
    top, bottom = axes[:, 0]
    names = {"off": "without compensation", "backlash": "with f_coarse and B", "full": "with f_remain and B"}
    for (compensation, run), colour in zip(runs.items(), _colours(len(runs)), strict=True):
        t = run.t_s - run.t_s[0]
        if run is next(iter(runs.values())):
            top.plot(t, run.goal_deg, color=INK, lw=2.4, alpha=0.35, label="asked for")
        top.plot(t, run.tip_deg, color=colour, lw=1.1, label=names[compensation])
        error = np.where(run.counted, run.tip_deg - run.goal_deg, np.nan)
        bottom.plot(t, error, color=colour, lw=1.1, label=f"{names[compensation]}: rms {run.rms_deg:.2g} deg")
    top.set(ylabel="tip c (deg)")
    top.set_title("The tip")
    bottom.set(xlabel="time (s)", ylabel="off by (deg)")
    bottom.set_title("Tracking error")
    for ax in (top, bottom):
        _put_legend_above(ax, 4)
    return made


@mpl.rc_context(STYLE)
def compared(models: Mapping[str, Model]) -> Figure:
    """A figure of several models, by name: above B and f_remain of each (the paper's Fig. 2), below the differences of
    each from the first model, as equal curves would hide each other. TautError where their units differ."""
    unit = common_unit(models)
    first = next(iter(models.values()))
    made, axes = figure(11, 7.4, 2, 2, sharex="col")
    for k, ((name, model), colour) in enumerate(zip(models.items(), _colours(len(models)), strict=True)):
        line: Any = {
            "color": colour,
            "lw": max(3.2 - 0.9 * k, 1.2),
            "ls": "-" if k == 0 else (0, (5, 1 + k)),
            "label": name,
        }
        measured = model.is_measured
        low, high = np.maximum(model.width - 2 * model.width_sigma, 0), model.width + 2 * model.width_sigma
        axes[0, 0].fill_between(model.q[measured], low[measured], high[measured], color=colour, alpha=0.15, lw=0)
        axes[0, 0].plot(model.q[measured], model.width[measured], **line)
        for side in (-0.5, 0.5):
            axes[0, 1].plot(model.q + side * model.width, model.c_deg, color=colour, lw=0.8, alpha=0.7)
        axes[0, 1].plot(model.q, model.c_deg, **line)
        if k:
            _draw_change(axes[1, 0], axes[1, 1], first, model, line)
    axes[0, 0].set(ylabel=f"backlash width ({unit})", ylim=(0, None))
    axes[0, 0].set_title("Backlash width B(q), ± 2 sigma")
    axes[0, 1].set(ylabel="bending c (deg)")
    axes[0, 1].set_title("f_remain (thick) and the envelopes that B makes of it")
    axes[0, 0].legend(loc="best")
    first_name = next(iter(models))
    axes[1, 0].set(xlabel=f"q ({unit})", ylabel=f"change of B ({fine_unit(unit)[0]})")
    axes[1, 0].set_title(f"B less that of {first_name}, ± 2 sigma of the difference")
    axes[1, 1].set(xlabel=f"q ({unit})", ylabel="rest of f_remain's change (deg)")
    axes[1, 1].set_title(f"f_remain less that of {first_name}, its mean taken off")
    for ax in axes[1]:
        ax.axhline(0.0, color=GREY, lw=0.8)
        if ax.get_legend_handles_labels()[0]:  # none where no two have measured the same q
            ax.legend(loc="best")
    return made


def _draw_change(of_width: Axes, of_angle: Axes, first: Model, model: Model, line: Mapping[str, Any]) -> None:
    """Draws how a model differs from the model `first`, with 2 sigma, over the q that both have measured; nothing where
    there is no such q. Into the axes `of_width` goes the difference of B, in `fine_unit`; into `of_angle` that of
    f_remain, deg, without its mean, which is told in the legend. line: matplotlib's style of the curves, with the
    model's name as label."""
    low, high = max(first.measured[0], model.measured[0]), min(first.measured[1], model.measured[1])
    if not high > low:
        return
    q = np.linspace(low, high, 401)
    change = np.interp(q, model.q, model.width) - np.interp(q, first.q, first.width)
    sigma = np.hypot(np.interp(q, model.q, model.width_sigma), np.interp(q, first.q, first.width_sigma))
    per_unit = fine_unit(first.rig.actuator.unit)[1]
    low_side, high_side = per_unit * (change - 2 * sigma), per_unit * (change + 2 * sigma)
    of_width.fill_between(q, low_side, high_side, color=line["color"], alpha=0.15, lw=0)
    of_width.plot(q, per_unit * change, **line)
    moved_deg = model.remaining(q) - first.remaining(q)
    offset_deg = float(moved_deg.mean())
    rest_deg = moved_deg - offset_deg
    of_angle.plot(q, rest_deg, **{**line, "label": f"{line['label']}, beside {offset_deg:+.2g} deg"})
    if model.c_sigma is not None and first.c_sigma is not None:
        sigma_deg = np.hypot(np.interp(q, model.q, model.c_sigma), np.interp(q, first.q, first.c_sigma))
        low_side, high_side = rest_deg - 2 * sigma_deg, rest_deg + 2 * sigma_deg
        of_angle.fill_between(q, low_side, high_side, color=line["color"], alpha=0.15, lw=0)


@mpl.rc_context(STYLE)
def servo_steps(steps: Mapping[float, Any], chosen: float) -> Figure:
    """A figure of the servo's step responses (live.commission.StepResponse), by the factor on its gains: position
    above, following error below, in encoder counts. The response with the `chosen` factor is thick."""
    made, axes = figure(11, 5.0, 2, 1, sharex=True)
    top, bottom = axes[:, 0]
    for (factor, step), colour in zip(steps.items(), _colours(len(steps)), strict=True):
        width = 2.0 if factor == chosen else 0.9
        if factor == chosen:
            top.plot(1e3 * step.t_s, step.q_ref, color=INK, lw=2.4, alpha=0.35, label="reference")
        top.plot(1e3 * step.t_s, step.q, color=colour, lw=width, label=f"gains x {factor:.3g}")
        name = f"x {factor:.3g}: rms {step.rms:.2f}"
        bottom.plot(1e3 * step.t_s, step.q - step.q_ref, color=colour, lw=width, label=name)
    top.set(ylabel="motor (counts)")
    top.set_title("Step response of the servo")
    bottom.set(xlabel="time (ms)", ylabel="off by (counts)")
    bottom.set_title("Following error")
    for ax in (top, bottom):
        _put_legend_above(ax, 5)
    return made


def _put_legend_above(ax: Axes, columns: int, markerscale: float | None = None) -> None:
    """Puts the legend, in this many columns, above the axes' upper right corner, where it hides nothing. markerscale:
    size of its markers relative to those in the picture; None: matplotlib's default."""
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=columns, markerscale=markerscale, borderaxespad=0.1)


def _colours(count: int) -> list[Any]:
    """`count` different colours for lines: the first of SERIES, or colours of a colour map where SERIES has fewer."""
    if count <= len(SERIES):
        return list(SERIES[:count])
    return list(mpl.colormaps["viridis"](np.linspace(0, 0.9, count)))


def _clock_offset(evidence: Evidence, onset: Onset) -> float:
    """The offset, s, that turns an onset's time on its recording's clock into the recordings' common clock."""
    return float(evidence.offset_s[evidence.index(onset["recording"])])
