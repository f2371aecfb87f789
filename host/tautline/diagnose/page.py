"""The diagnosis as a page that reads in a minute: verdict, chain, residuals, candidates, what to do next."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from tautline import figures, report
from tautline.diagnose.diagnosis import Diagnosis
from tautline.effects import BY_ID, STAGES

FILE = "report.html"


def sentence(document: Mapping[str, Any]) -> str:
    """Verdict, effect and shrinkage."""
    gap, unit = document["gap"], document["unit"]
    before = f"{gap['before']:.3g} {unit} rms"
    if document["verdict"] == "none":
        noise = f"{document['noise_floor']:.2g} {unit}"
        return f"No gap beyond noise: {before} on motions the calibration never saw, noise {noise}."
    if document["verdict"] == "unknown":
        return (
            f"A gap of {before} that no known effect explains; it is {document['signature'] or 'everywhere'}. "
            f"The leading guess is {document['candidates'][0]['id']}."
        )
    names = [effect["id"] for effect in document["effects"]]
    says = " and ".join(f"{name} ({BY_ID[name].says})" for name in names)
    first = document["effects"][0]
    text = (
        f"{says}: adding it shrinks the gap from {before} to {gap['after']:.3g} {unit} ({100 * gap['shrink']:.0f} %)."
    )
    if document["verdict"] == "effect" and first["id"] in ("transmission.stick_slip", "acquisition.jitter"):
        text = f"{says}: {before}. It has no reproducible path, so no model can predict it away."
    if first["ambiguous_with"]:
        text += f" These motions cannot tell it from {', '.join(first['ambiguous_with'])}."
    return text


def write(diagnosis: Diagnosis, folder: Path) -> Path:
    document = diagnosis.document
    following = document["next_motion"]
    page = {
        "title": "Where model and instrument part",
        "sentence": sentence(document),
        "document": document,
        "chain": report.picture(chain(document), "The chain", "The stage that the gap belongs to is marked."),
        "residuals": report.picture(
            residuals(diagnosis),
            "Residual before and after",
            "On data the fit did not see. Grey: the calibrated model. Red: with what was named.",
        ),
        "candidates": report.picture(candidates(document), "Candidates", "Probability to be the leading effect."),
        "conditions": report.picture(
            conditions(diagnosis),
            "Where it is",
            "Mean residual (lines) and its rms (area) over the axes that tell most.",
        )
        if diagnosis.conditions
        else None,
        "next": f"Run {following['file']} next: {following['why']}. It tells the leading candidates apart best."
        if following
        else "",
        "board": _board(document),
    }
    path = folder / FILE
    report.write_page("diagnosis.html", page, path)
    return path


def _board(document: Mapping[str, Any]) -> str:
    carried = [e["id"] for e in document["effects"] if e["loads_on_board"]]
    left = [e["id"] for e in document["effects"] if not e["loads_on_board"]]
    parts = []
    if carried:
        parts.append(f"The board's tables carry {', '.join(carried)}: load corrected/ with taut flash.")
    if left:
        parts.append(f"The board's tables cannot carry {', '.join(left)}.")
    return " ".join(parts)


@mpl.rc_context(figures.STYLE)
def chain(document: Mapping[str, Any]) -> Figure:
    """The stages as boxes, the one that the gap belongs to filled."""
    made, axes = figures.figure(10.5, 1.0)
    ax = axes[0, 0]
    ax.set_axis_off()
    ax.set_xlim(0, len(STAGES))
    ax.set_ylim(0, 1)
    marked = document["where"]["stage"]
    for i, stage in enumerate(STAGES):
        here = stage == marked
        ax.text(
            i + 0.5,
            0.5,
            stage,
            ha="center",
            va="center",
            fontsize=10,
            color="white" if here else figures.INK,
            fontweight="bold" if here else "normal",
            bbox={
                "boxstyle": "round,pad=0.6",
                "facecolor": figures.MODEL if here else "white",
                "edgecolor": figures.GREY,
            },
        )
        if i:
            ax.annotate("", (i + 0.10, 0.5), (i - 0.10, 0.5), arrowprops={"arrowstyle": "->", "color": figures.GREY})
    return made


@mpl.rc_context(figures.STYLE)
def residuals(diagnosis: Diagnosis) -> Figure:
    """Over the session's time, both models."""
    made, axes = figures.figure(10.5, 3.0)
    ax = axes[0, 0]
    for i, (segment, before, after) in enumerate(
        zip(diagnosis.segments[1:], diagnosis.before, diagnosis.after, strict=True)
    ):
        t = segment.arrival_s[segment.scored] + segment.offset_s
        for values, colour, label in ((before, figures.GREY, "calibrated model"), (after, figures.MODEL, "corrected")):
            size = np.sqrt(np.mean(values**2, axis=1))
            ax.plot(t, size, ".", markersize=1.5, color=colour, label=label if i == 0 else None, rasterized=True)
    ax.axhline(diagnosis.document["noise_floor"], color=figures.INK, linewidth=0.8, linestyle="--", label="noise")
    ax.set_xlabel("time in the session (s)")
    ax.set_ylabel(f"residual ({diagnosis.document['unit']})")
    ax.set_ylim(bottom=0)
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, markerscale=6)
    return made


@mpl.rc_context(figures.STYLE)
def candidates(document: Mapping[str, Any]) -> Figure:
    rows = [(c["id"], c["probability"]) for c in document["candidates"][:6]]
    rows += [("unknown", document["probability_unknown"]), ("no gap", document["probability_none"])]
    made, axes = figures.figure(10.5, 0.32 * len(rows) + 0.6)
    ax = axes[0, 0]
    ax.barh([name for name, _ in rows], [p for _, p in rows], color=figures.UP, height=0.6)
    for i, (_, p) in enumerate(rows):
        ax.text(p + 0.01, i, f"{100 * p:.0f} %", va="center", fontsize=8)
    ax.invert_yaxis()
    ax.set_xlim(0, 1.08)
    ax.set_xlabel("probability")
    return made


@mpl.rc_context(figures.STYLE)
def conditions(diagnosis: Diagnosis) -> Figure:
    shown = diagnosis.conditions[:4]
    made, axes = figures.figure(10.5, 2.4, 1, len(shown))
    for ax, condition in zip(axes[0], shown, strict=True):
        ax.fill_between(condition.centres, 0, np.sqrt(condition.power), color=figures.PALE)
        for values, colour in zip(condition.mean.T, (figures.UP, figures.DOWN), strict=False):
            ax.plot(condition.centres, values, color=colour)
        ax.set_title(f"{condition.axis}: {100 * condition.share:.0f} %")
        ax.set_xlabel(condition.says)
    axes[0, 0].set_ylabel(f"residual ({diagnosis.document['unit']})")
    return made
