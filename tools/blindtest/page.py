"""A campaign's result: one table of all methods, as text, result.json and report.html."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from tautline.effects import EVENTS
from tautline.folders import write_file
from tautline.plain import plain
from tautline.reports import figures, pages
from tools.blindtest import scores
from tools.blindtest.campaign import FORMAT
from tools.blindtest.cases import SCORED_FROM, SEVERAL, Label
from tools.blindtest.draws import UNKNOWN
from tools.blindtest.generators import SECOND
from tools.blindtest.scores import Answer, Bin, Share, answer_of

FILE, RESULT = "report.html", "result.json"
OURS = "tautline"
HERE = "tautline, there"  # on the cases that the baselines answered
_MOST_LINES = 60  # cases that are printed one by one

# What the table shows: Scores' field, what it means, the goal (None: none).
ROWS: Sequence[tuple[str, str, str | None]] = (
    ("top1", "single identifiable effect, right name leads", "90 %"),
    ("worst", "... worst effect", "75 %"),
    ("in_set", "... in the ambiguity set", "95 %"),
    ("set_size", "... mean size of the set", "1.6"),
    ("stage", "... right stage", "95 %"),
    ("unknown", "unknown effect called unknown", "90 %"),
    ("false_known", "... given a known name", None),
    ("none", "nothing wrong called none", "95 %"),
    ("false_alarm", "... called an effect", None),
    ("pairs", "pair, both named", "70 %"),
    ("pairs_covered", "... named, brought, or in a set of three at most that one of is there", "75 %"),
    ("pairs_one", "... one of them at least", None),
    ("triples", "triple, all named", None),
    ("triples_covered", "... named, brought, or in a set of three at most that one of is there", "50 %"),
    ("left_out", "effect taken out of the library, called unknown", None),
    ("stood_for", "... or a set of three at most that leaves 1.3 times the noise on an unseen motion", "85 %"),
    ("left_out_sure", "... named without that at 90 % or more", "4 %"),
    ("overall", "single, unknown and none, right verdict", None),
    ("probability", "mean probability on the truth", None),
    ("log_score", "mean log probability on the truth", None),
    ("calibration_error", "expected calibration error", None),
    ("further_error", "... of what is named beside the leading effect", "0.05"),
    ("claim", "claimed less realised shrinkage, mean (points)", "5"),
    ("claim_size", "... mean of its size (points)", None),
    ("covered", "... realised within the stated interval", "85 %"),
    ("claim_all", "... of all that was named: pairs, unknown, events", "4"),
    ("covered_all", "... realised within the stated interval", "85 %"),
    ("worse", "named, and worse on an unseen motion", "1 %"),
    ("several", "more than one effect named for one", "3 %"),
    ("closed", "closable gap closed on an unseen motion, mean", "90 %"),
    ("closed_90", "... at least 90 % of it", None),
    ("core_s", "core-seconds a case", "10"),
)
# ... and of each baseline on the cases that it answered.
PAIRED: Sequence[tuple[str, str]] = (
    ("verdicts", "only tautline right : only the baseline (exact p)"),
    ("closed", "tautline closes more : the baseline does (exact p)"),
)

Cases = Sequence[tuple[Label, Answer]]


def result(records: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """result.json: scores of every method, confusion, calibration curve, and every case in a line."""
    methods = methods_of(records)
    ours = methods[OURS]
    rows, columns, counts = scores.confusion(ours)
    labels = [label for label, _ in ours if label.kind not in ("none", "left out")]
    scored = {name: scores.score(cases) for name, cases in methods.items()}
    return {
        "format": FORMAT,
        "tuning": any(label.seed < SCORED_FROM for label, _ in ours),
        "cases": len([1 for label, _ in ours if label.kind != "left out"]),
        "identifiable": Share(sum(label.identifiable for label in labels), len(labels)).to_json(),
        "methods": {name: scores_of.to_json() for name, scores_of in scored.items()},
        "generators": {name: scores.score(cases).to_json() for name, cases in _generators(ours).items()},
        "compared": _compared(records, methods),
        "confusion": {"truth": rows, "said": columns, "counts": counts.tolist()},
        "reliability": [
            {"low": b.low, "high": b.high, "said": b.stated, "right": b.right.to_json()}
            for b in scores.reliability(ours)
        ],
        "each": [_line(record) for record in records],
    }


def methods_of(records: Sequence[Mapping[str, Any]]) -> dict[str, Cases]:
    """Every method's answers. Where there are baselines, HERE are our own on the cases that they answered."""
    labels = [Label.from_json(record["label"]) for record in records]
    methods: dict[str, Cases] = {
        OURS: [(label, answer_of(record)) for label, record in zip(labels, records, strict=True)]
    }
    answered = [bool(record.get("answers")) for record in records]
    if any(answered):
        methods[HERE] = [case for case, there in zip(methods[OURS], answered, strict=True) if there]
    for name in {name: None for record in records for name in record.get("answers", {})}:
        methods[name] = [
            (label, scores.from_json(record["answers"][name]))
            for label, record in zip(labels, records, strict=True)
            if name in record.get("answers", {})
        ]
    return methods


def _generators(cases: Cases) -> dict[str, Cases]:
    """The cases of each generator."""
    names = dict.fromkeys(label.generator for label, _ in cases)
    return {name: [case for case in cases if case[0].generator == name] for name in names}


def by_generator(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    """How often the right name leads, what is unknown is called so, and what is sound; empty where there is but one
    generator."""
    generators = document["generators"]
    rows = [
        {
            "what": name,
            "goal": "",
            "cells": [_cell(generators[name], what, OURS) for what in ("top1", "unknown", "none")],
        }
        for name in generators
    ]
    return rows if len(rows) > 1 else []


def _compared(records: Sequence[Mapping[str, Any]], methods: Mapping[str, Cases]) -> dict[str, Any] | None:
    """Which cases the baselines answered, and who has the better of how many."""
    if HERE not in methods:
        return None
    ours = methods[HERE]
    scored = [label for label, _ in methods[OURS] if label.kind != "left out" and scores.counts(label)]
    paired = {
        name: scores.paired([(label, own, other) for (label, own), (_, other) in zip(ours, cases, strict=True)])
        for name, cases in methods.items()
        if name not in (OURS, HERE)
    }
    return {
        "cases": [record["name"] for record in records if record.get("answers")],
        "of": len(scored),
        "failed": [
            {"case": record["name"], "method": method, "error": what}
            for record in records
            for method, what in record.get("failed", {}).items()
        ],
        "paired": {name: {what: share.to_json() for what, share in both.items()} for name, both in paired.items()},
    }


def write(records: Sequence[Mapping[str, Any]], folder: Path) -> dict[str, Any]:
    """result.json and report.html."""
    document: dict[str, Any] = plain(result(records))
    write_file(folder / RESULT, json.dumps(document, indent=1, allow_nan=False) + "\n")
    ours = methods_of(records)[OURS]
    page = {
        "title": "Diagnoses of instruments whose effect was withheld",
        "sentence": sentence(document),
        "note": "These seeds are for tuning: the figures say nothing about unseen cases." if document["tuning"] else "",
        "methods": list(document["methods"]),
        "compared": compared(document),
        "rows": table(document),
        "naming": naming(document),
        "strengths": strengths(document),
        "effects": effects(document),
        "generators": by_generator(document),
        "confusion": pages.picture(
            confusion(document["confusion"]),
            "Confusion",
            "Truth in rows, verdicts in columns, shares of a row. Below the line: effects outside the library.",
        ),
        "reliability": pages.picture(
            reliability(scores.reliability(ours)),
            "Calibration of the probabilities",
            "How often the leading answer is right over the probability it was given, with exact 95 % intervals.",
        ),
        "shrinkage": pages.picture(
            shrinkage(ours),
            "Claimed and realised shrinkage",
            "Realised: on a motion that the diagnosis never saw. Single identifiable effects that have a path.",
        ),
        "wrong": [line for line in document["each"] if line["right"] is False],
    }
    pages.write_page("blindtest.html", page, folder / FILE, Path(__file__).parent)
    return document


def sentence(document: Mapping[str, Any]) -> str:
    ours = document["methods"][OURS]
    values = {
        "top1": "single effects named rightly",
        "unknown": "effects outside the library called unknown",
        "none": "sound instruments called sound",
    }
    parts = [
        f"{ours[name]['hits']} of {ours[name]['of']} {what} ({100 * ours[name]['share']:.0f} %)"
        for name, what in values.items()
        if ours[name]["of"]
    ]
    return f"{document['cases']} cases: " + ", ".join(parts) + "."


def table(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    """ROWS, then PAIRED, with a cell for each method; rows that say nothing of any method are left out."""
    methods = document["methods"]
    rows = [
        {
            "what": what,
            "goal": goal or "",
            "cells": [_cell(method_scores, name, method) for method, method_scores in methods.items()],
        }
        for name, what, goal in ROWS
    ]
    paired = (document["compared"] or {"paired": {}})["paired"]
    for name, what in PAIRED:
        cells = [_pair(paired.get(method, {}).get(name)) for method in methods]
        rows.append({"what": what, "goal": "", "cells": cells})
    return [row for row in rows if any(row["cells"])]


def compared(document: Mapping[str, Any]) -> str:
    """Which cases the baselines answered; empty where there are none."""
    comparison = document["compared"]
    if comparison is None:
        return ""
    return (
        f"Baselines answered {len(comparison['cases'])} of the {comparison['of']} cases that are scored, as many of "
        f"each effect and kind; '{HERE}' is tautline on these."
    ) + "".join(f" {x['method']} failed on {x['case']}: {x['error']}." for x in comparison["failed"])


def effects(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    """How often each effect's name leads: a cell for each method that names effects."""
    methods = {name: document["methods"][name]["per_effect"] for name in naming(document)}
    return [
        {
            "what": effect,
            "goal": "75 %",
            "cells": [
                _share(per_effect[effect], method) if effect in per_effect else ""
                for method, per_effect in methods.items()
            ],
        }
        for effect in methods.get(OURS, {})
    ]


def strengths(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    """How often the right name leads by how much a recalibration leaves of the effect."""
    methods = {name: document["methods"][name]["by_strength"] for name in naming(document)}
    names = [scores.strength_name(*ends) for ends in scores.STRENGTHS]
    return [
        {
            "what": name,
            "goal": "",
            "cells": [_share(shares[name], method) if name in shares else "" for method, shares in methods.items()],
        }
        for name in names
        if name in methods.get(OURS, {})
    ]


def naming(document: Mapping[str, Any]) -> list[str]:
    """The methods that name effects."""
    return [name for name, method_scores in document["methods"].items() if method_scores["per_effect"]]


def text(document: Mapping[str, Any]) -> str:
    """The table for a terminal; before it the cases one by one if they are few, else those that came out wrong."""
    each = document["each"]
    shown = each if len(each) <= _MOST_LINES else [line for line in each if line["right"] is False][:_MOST_LINES]
    lines = [_sentence_of(line) for line in shown]
    lines += _aligned(["", "goal", *document["methods"]], table(document))
    if by_strength := strengths(document):
        lines += _aligned(["right name leads", "", *naming(document)], by_strength)
    if per_effect := effects(document):
        lines += _aligned(["right name leads", "goal", *naming(document)], per_effect)
    if generators := by_generator(document):
        lines += _aligned(["by generator", "", "right name leads", "unknown called so", "none called so"], generators)
    if comparison := compared(document):
        lines.append(comparison)
    identifiable = document["identifiable"]
    lines.append(
        f"{identifiable['hits']} of {identifiable['of']} cases with an effect are identifiable; only these are scored."
    )
    if document["tuning"]:
        lines.append("Seeds below 1000000 are for tuning: nothing here is a result.")
    return "\n".join(lines)


def _aligned(head: Sequence[str], body: Sequence[Mapping[str, Any]]) -> list[str]:
    rows = [list(head), *([row["what"], row["goal"], *row["cells"]] for row in body)]
    widths = [max(len(row[i]) for row in rows) for i in range(len(head))]
    lines = []
    for row in rows:
        cells = [cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)]
        lines.append("  ".join([row[0].ljust(widths[0]), *cells]).rstrip())
    return lines


def _line(record: Mapping[str, Any]) -> dict[str, Any]:
    label = Label.from_json(record["label"])
    answer = answer_of(record)
    gap = record["document"].get("gap")
    right = scores.all_named(label, answer) if label.kind in SEVERAL else answer.verdict == scores.truth(label)
    return {
        "name": record["name"],
        "seed": label.seed,
        "generator": label.generator,
        "kind": label.kind,
        "effects": list(label.effects),
        "throughout": label.throughout,
        "identifiable": label.identifiable,
        "left": [x / label.noise_px for x in label.left],  # times the noise
        "verdict": answer.verdict,
        "named": list(answer.named),
        "probability": (answer.probabilities or {}).get(answer.verdict),
        "right": right if scores.counts(label) else None,
        "gap": [gap["before"], gap["after"]] if gap else None,
        "floor": record["document"].get("noise_floor"),
        "realised": record["realised"],
        "core_s": record["core_s"],
        "error": record["document"].get("error"),
    }


def _sentence_of(line: Mapping[str, Any]) -> str:
    what = " + ".join(line["effects"]) or "nothing"
    if line["kind"] == "left out":
        what += " (left out)"
    since = "" if not line["effects"] else ", throughout" if line["throughout"] else ", after the calibration"
    mark = {True: "ok   ", False: "WRONG", None: "-    "}[line["right"]]
    named = line["error"] or " + ".join(line["named"]) or line["verdict"]
    probability = "" if line["probability"] is None else f" ({line['probability']:.2f})"
    gaps = ""
    if line["gap"] is not None:
        gaps = f"; gap {line['gap'][0]:.3g} -> {line['gap'][1]:.3g}, noise {line['floor']:.2g}"
    if line["realised"] is not None:
        gaps += f"; unseen {line['realised']['before']:.3g} -> {line['realised']['after']:.3g}"
    made = "" if line["generator"] == SECOND else f" {line['generator']}:"
    return f"{mark} seed {line['seed']}{made} {what}{since}: {named}{probability}{gaps}; {line['core_s']:.1f} s"


def _cell(method_scores: Mapping[str, Any], name: str, method: str) -> str:
    if name == "worst":
        shares = [share["share"] for share in method_scores["per_effect"].values()]
        return f"{100 * min(shares):.0f} %" if shares else ""
    value = method_scores[name]
    if isinstance(value, Mapping):
        return _share(value, method) if value["of"] else ""
    if value is None:
        return ""
    return f"{100 * value:.0f} %" if name == "closed" else f"{value:.2f}" if abs(value) < 10 else f"{value:.1f}"


def _share(share: Mapping[str, Any], method: str) -> str:
    """How many cases is said of ours; of a baseline they are those of HERE."""
    low, high = (f"{100 * end:.0f}" for end in share["interval"])
    if method in (OURS, HERE):
        return f"{100 * share['share']:.1f} % ({low}-{high}, {share['of']})"
    return f"{100 * share['share']:.0f} % ({low}-{high})"


def _pair(paired: Mapping[str, Any] | None) -> str:
    return f"{paired['ours']} : {paired['theirs']} ({paired['p']:.1g})" if paired else ""


@mpl.rc_context(figures.STYLE)
def confusion(document: Mapping[str, Any]) -> Figure:
    counts = np.array(document["counts"], dtype=float)
    counts = counts.reshape(len(document["truth"]), len(document["said"]))
    share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1.0)
    rows, columns = counts.shape
    made, axes = figures.figure(10.5, 0.24 * rows + 2.4)
    ax = axes[0, 0]
    ax.imshow(share, cmap="Blues", vmin=0, vmax=1.25, aspect="auto")
    for i, j in zip(*np.nonzero(counts), strict=True):
        colour = "white" if share[i, j] > 0.6 else figures.INK
        ax.text(j, i, f"{counts[i, j]:.0f}", ha="center", va="center", fontsize=7, color=colour)
    ax.set_xticks(range(columns), [_short(name) for name in document["said"]], rotation=50, ha="right", fontsize=8)
    ax.set_yticks(range(rows), [_short(name) for name in document["truth"]], fontsize=8)
    outside = [i for i, name in enumerate(document["truth"]) if name in UNKNOWN]
    for edge in (outside[0] - 0.5, outside[-1] + 0.5) if outside else ():
        ax.axhline(edge, color=figures.INK, linewidth=0.8)
    ax.grid(False)
    ax.set_xlabel("verdict")
    ax.set_ylabel("truth")
    return made


def _short(name: str) -> str:
    return name.split(".", 1)[-1].replace("_", " ")


@mpl.rc_context(figures.STYLE)
def reliability(bins: Sequence[Bin]) -> Figure:
    made, axes = figures.figure(5.2, 4.2)
    ax = axes[0, 0]
    ax.plot([0, 1], [0, 1], color=figures.GREY, linewidth=0.8, linestyle="--")
    stated = np.array([b.stated for b in bins])
    right = np.array([b.right.value or 0.0 for b in bins])
    ends = np.array([b.right.interval for b in bins]).reshape(-1, 2)
    spread = np.abs(ends.T - right)
    ax.errorbar(stated, right, yerr=spread, fmt="o", color=figures.UP, markersize=4, linewidth=1)
    for b in bins:
        ax.annotate(str(b.right.of), (b.stated, b.right.value or 0.0), (4, -10), textcoords="offset points", fontsize=7)
    ax.set(xlim=(0, 1.02), ylim=(0, 1.02), xlabel="probability given", ylabel="share that was right")
    return made


@mpl.rc_context(figures.STYLE)
def shrinkage(cases: Cases) -> Figure:
    made, axes = figures.figure(5.2, 4.2)
    ax = axes[0, 0]
    ax.plot([0, 1], [0, 1], color=figures.GREY, linewidth=0.8, linestyle="--")
    points = [
        (answer.claimed, 1.0 - answer.realised["after"] / answer.realised["before"])
        for label, answer in cases
        if label.kind == "single" and label.identifiable and answer.named and answer.realised
        if answer.claimed is not None and label.effects[0] not in EVENTS
    ]
    claimed, realised = np.array(points).reshape(-1, 2).T
    ax.plot(claimed, np.maximum(realised, -0.2), "o", color=figures.UP, markersize=3, alpha=0.6)
    ax.set(xlim=(-0.02, 1.02), ylim=(-0.22, 1.02), xlabel="shrinkage claimed", ylabel="realised on an unseen motion")
    return made
