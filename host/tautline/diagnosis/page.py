"""The diagnosis as a page that reads in a minute: verdict, chain, residuals, candidates, what to do next."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tautline.diagnosis import narration, simulator_words, where
from tautline.diagnosis.diagnose import Diagnosis
from tautline.diagnosis.where import Condition
from tautline.effects import BY_ID, COLUMN, SIMULATOR, STAGES, Parameter, kind_of
from tautline.explain import of_effect
from tautline.model import Effect, Model
from tautline.reports import figures, pages

# format of all: numbers of a page's pictures and lists

FILE = "report.html"

_CANDIDATES = 5  # format: candidates that are listed
_GUESS = 0.2  # format: share of a gap that an effect must close for its stage to be marked as a guess
_PARAMETERS = 6  # format: parameters that are listed of an effect
_AXES = 2  # format: pictures of the conditions under which the gap is large
_MANY_POINTS = 2500  # format: points of a picture
_MARGIN = 1.08  # format: of an axis beyond what is drawn
_TITLES = {
    "q": "motor position",
    "direction": "direction of the motor",
    "speed": "motor speed",
    "phase": "time since the reversal",
    "time": "time in the session",
    "translation": "translation",
    "rotation": "rotation",
    "u": "image position, across",
    "v": "image position, down",
    "load": "load",
}


def write(diagnosis: Diagnosis, folder: Path, known_as: str = "") -> Path:
    """Writes the page FILE into `folder` and returns its path. known_as: the path of the folder that the page's
    commands show, by default `folder`; for a folder that is moved afterwards."""
    document = diagnosis.document
    unit = diagnosis.nominal.rig.actuator.unit
    named = document["verdict"] == "effect"
    page = {
        "title": "Where model and robot part",
        "source": _recordings_in_words(diagnosis),
        "sentence": narration.sentence(document),
        "document": document,
        "named": named,
        "digits": narration.digits,
        "percent": narration.percent,
        "steps": narration.steps(document, known_as or str(folder)),
        "flexible": narration.flexible(document),
        "chain": _chain(document),
        "residuals": pages.picture(
            residuals(diagnosis),
            "Residual before and after",
            "Distance between prediction and measurement over the session, on data that the fit did not see. "
            + ("Grey: the calibrated model. Red: with what was named." if named else "The calibrated model."),
        ),
        "candidates": [
            {
                "name": name,
                "says": simulator_words.says(document, name) if name in BY_ID else "",
                "percent": narration.percent(p),
                "width": f"{100 * p:.1f}",
                "closes": closes,
            }
            for name, p, closes in narration.rows(document, _CANDIDATES)
        ],
        "topics": [of_effect(effect["id"]) for effect in document["effects"]],
        "parameters": [
            row
            for effect in document["effects"]
            for row in _parameter_rows(document, effect, unit, width_now(diagnosis.nominal, diagnosis.corrected))
        ],
        "moved": narration.moved(document),
        "step": simulator_words.step(document),
        "tip": narration.tip(document),
        "tracker": narration.left_out_frames(document),
        "conditions": _conditions(diagnosis, unit),
        "colours": "Blue: mean residual across the image; orange: down."
        if document["unit"] == "px"
        else "Blue: mean residual.",
    }
    path = folder / FILE
    pages.write_page("diagnosis.html", page, path)
    return path


def _recordings_in_words(diagnosis: Diagnosis) -> str:
    """Names the recordings of the diagnosis and their total length, in words."""
    names = [segment.name for segment in diagnosis.segments]
    seconds = sum(float(np.ptp(segment.motor.t_s)) for segment in diagnosis.segments)
    return f"calibrated on {names[0]}, tested on {narration.listed(names[1:])}; {seconds:.0f} s in all"


def _chain(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The stages from motor to image in order, each with "name", "mark" ("named", "guess" or "") and "says", in words
    the share of the gap that its effects close or, if none is named, the most that one of them could close."""
    named = {effect["id"].split(".")[0] for effect in document["effects"]}
    marked = document["where"]["stage"]
    stages = []
    for stage in (*((SIMULATOR,) if "simulator" in document else ()), *STAGES):
        of_stage = [c for c in document["candidates"] if c["id"].startswith(stage + ".")]
        could_close = max((c["shrink"] for c in of_stage), default=0.0)
        share = sum(e["shrink"] for e in document["effects"] if e["id"].startswith(stage + "."))
        says = f"{narration.percent(share)} of the gap" if stage in named and share > narration.LEAST_TOLD else ""
        if not says and could_close > narration.least_told(document):
            says = f"could close {narration.percent(could_close)}"
        certain = document["verdict"] == "effect"
        mark = "named" if certain and (stage == marked or stage in named) else ""
        if not certain and stage == marked and could_close > _GUESS:
            mark = "guess"
        stages.append({"name": stage, "mark": mark, "says": says})
    return stages


def width_now(nominal: Model, corrected: Model) -> str:
    """The mean of B over the measured range, with the actuator's unit, after and before the correction, in words."""
    unit, inside = nominal.rig.actuator.unit, (nominal.q >= nominal.measured[0]) & (nominal.q <= nominal.measured[1])
    was = float(nominal.width[inside].mean())
    now = float(np.interp(nominal.q[inside], corrected.q, corrected.width).mean())
    return f"{narration.digits(now)} {unit} in the mean, it was {narration.digits(was)}"


def _parameter_rows(
    document: Mapping[str, Any], effect: Mapping[str, Any], unit: str, width: str
) -> list[dict[str, Any]]:
    """The rows of one named effect in the table of parameters: its values, at most _PARAMETERS, then the parts of the
    nominal model that it brings. A width has the text `width` (from `width_now`) in place of its values, a curve has
    none. unit: of q."""
    if of_simulator := simulator_words.values(document, effect["id"]):
        return [_table_row(document, effect, *of_simulator, True)]
    kind = kind_of(Effect(effect["id"], effect["parameters"]))
    known = {p.name: p for p in kind.parameters if p.name in effect["parameters"]}
    known = dict([item for item in known.items() if item[0] not in kind.curve][:_PARAMETERS])
    brought = [_table_row(document, effect, "brings", part["id"], False) for part in effect.get("brings", ())]
    if effect["id"] == "transmission.backlash":
        return [_table_row(document, effect, "B is now", width, True), *brought]
    if not known and COLUMN not in effect["parameters"]:
        return [_table_row(document, effect, "a curve", "", True)]
    shown = {name: value for name, value in effect["parameters"].items() if name in known or name == COLUMN}
    return [
        _table_row(
            document,
            effect,
            name.replace("_", " "),
            f"{narration.digits(value)} {_unit_in_words(known[name], unit)}".strip() if name in known else value,
            name == next(iter(shown)),
        )
        for name, value in shown.items()
    ] + brought


def _table_row(
    document: Mapping[str, Any], effect: Mapping[str, Any], name: str, value: str, first: bool
) -> dict[str, Any]:
    """One row of the table of parameters. first: whether it is the effect's first row, in which the page shows the
    effect too."""
    return {
        "effect": effect["id"],
        "name": name,
        "value": value,
        "since": narration.since(document, effect).strip(" ,"),
        "share": narration.percent(effect["shrink"]),
        "with": ", ".join(effect["ambiguous_with"]),
        "first": first,
    }


def _unit_in_words(parameter: Parameter, unit: str) -> str:
    """The parameter's unit, with the word "unit" replaced by the actuator's own `unit`."""
    return parameter.unit.replace("unit", unit)


def _conditions(diagnosis: Diagnosis, unit: str) -> list[dict[str, Any]]:
    """A title and a picture for each of the first _AXES conditions under which the gap is large; all have the same
    vertical range. unit: of q."""
    if diagnosis.document["verdict"] == "effect":
        after = {c.axis: c for c in where.conditions(diagnosis.segments[1:], diagnosis.after)}
    else:
        after = {}
    shown = diagnosis.conditions[:_AXES]
    drawn_too = [after[c.axis] for c in shown if c.axis in after]
    tops = [max(float(_rms(c).max()), float(c.mean.max())) for c in shown] + [float(_rms(c).max()) for c in drawn_too]
    top = max([*tops, diagnosis.document["noise_floor"]])
    pictures = []
    for condition in shown:
        title = _TITLES.get(condition.axis, condition.axis)
        drawn = _condition_figure(diagnosis, condition, after.get(condition.axis), unit, top)
        caption = f"{narration.percent(condition.share)} of the gap's power goes with it; largest {condition.says}."
        pictures.append({"title": title, "picture": pages.picture(drawn, title, caption)})
    return pictures


def _rms(condition: Condition) -> where.Array:
    """(bins,) Rms of the residuals per coordinate in each bin of a condition, px or deg."""
    return np.asarray(np.sqrt(condition.power / condition.mean.shape[1]))


@mpl.rc_context(figures.STYLE)
def _condition_figure(
    diagnosis: Diagnosis, condition: Condition, after: Condition | None, unit: str, top: float
) -> Figure:
    """Draws the residual over one axis: rms (area), mean of each coordinate (lines), and rms after the correction (red)
    if `after`, the same condition then, is given. unit: of q; top: upper end of the vertical axis, px or deg."""
    figure, axes = figures.figure(3.5, 2.2)
    ax: Axes = axes[0, 0]
    floor = diagnosis.document["noise_floor"]
    x, rms = condition.centres, _rms(condition)
    colours = (figures.UP, figures.DOWN)
    if condition.axis == "direction":
        shown = {-1: "falls", 0: "rests", 1: "rises"}
        direction = np.sign(np.round(x)).astype(int)
        ax.bar(direction, rms, width=0.6, color=figures.PALE)
        for values, colour in zip(condition.mean.T, colours, strict=False):
            ax.plot(direction, values, "o", color=colour, markersize=4)
        if after is not None:
            ax.plot(np.sign(np.round(after.centres)), _rms(after), "_", color=figures.MODEL, markersize=22)
        ax.set_xticks(list(shown), list(shown.values()))
        ax.set_xlim(-1.5, 1.5)
    else:
        ax.fill_between(x, 0, rms, color=figures.PALE)
        for values, colour in zip(condition.mean.T, colours, strict=False):
            ax.plot(x, values, color=colour, linewidth=1.2)
        if after is not None:
            ax.plot(after.centres, _rms(after), color=figures.MODEL, linewidth=1.8)
        ax.margins(x=0)
        unit_of_axis = where.AXES[condition.axis][2].replace("unit", unit)
        ax.set_xlabel(f"{_TITLES.get(condition.axis, condition.axis)} ({unit_of_axis})")
    ax.axhline(floor, color=figures.INK, linewidth=0.8, linestyle="--")
    low = min(0.0, float(condition.mean.min()))
    ax.set_ylim(_MARGIN * low, _MARGIN * top)
    ax.set_ylabel(f"residual ({diagnosis.document['unit']})")
    return figure


@mpl.rc_context(figures.STYLE)
def residuals(diagnosis: Diagnosis) -> Figure:
    """Draws the rms residual of each scored observation, px or deg, over the session's time, s, by the calibrated model
    and, if effects are named, by the corrected one."""
    figure, axes = figures.figure(10.5, 2.8)
    ax = axes[0, 0]
    named = diagnosis.document["verdict"] == "effect"
    series = [(diagnosis.before, figures.GREY, "calibrated model")]
    if named:
        series.append((diagnosis.after, figures.MODEL, "corrected"))
    tests = diagnosis.segments[1:]
    stride = max(1, sum(int(segment.scored.sum()) for segment in tests) // _MANY_POINTS)
    for values, colour, label in series:
        for i, (segment, residual) in enumerate(zip(tests, values, strict=True)):
            t = segment.session_s[segment.scored]
            size = np.sqrt(np.mean(residual**2, axis=1))
            ax.plot(
                t[::stride],
                size[::stride],
                ".",
                markersize=2.5,
                color=colour,
                label=label if i == 0 else None,
                rasterized=True,
            )
    ax.axhline(diagnosis.document["noise_floor"], color=figures.INK, linewidth=0.8, linestyle="--", label="noise")
    for segment in tests:
        start = float(segment.motor.t_s[0]) + segment.offset_s
        ax.axvline(start, color=figures.GREY, linewidth=0.6)
        ax.annotate(
            segment.name,
            (start, 1.0),
            (3, -3),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            va="top",
            fontsize=8,
            color=figures.INK,
        )
    ax.margins(x=0.01)
    ax.set_xlabel("time in the session (s)")
    ax.set_ylabel(f"residual ({diagnosis.document['unit']})")
    ax.set_ylim(bottom=0)
    ends = [segment.motor.t_s[[0, -1]] + segment.offset_s for segment in tests]
    ax.set_xlim(float(np.min(ends)), float(np.max(ends)))
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, markerscale=4)
    return figure
