"""Scores as text, Markdown and a picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.table import Table

from tools.honesty import score

Row = Mapping[str, Any]
HEAD = ("", "value", "95 %", "runs", "goal", "met")
COLUMNS = (
    "condition",
    "set",
    "verdicts",
    "error, um",
    "%",
    "sigma, um",
    "z",
    "measured",
    "prediction",
    "noise",
    "reason",
    "right",
    "s",
)


def short(x: float | None, digits: int = 3) -> str:
    return "-" if x is None else f"{x:.{digits}g}"


def _cells(row: Row) -> tuple[str, ...]:
    if row["share"]:
        value = "-" if row["value"] is None else f"{100 * row['value']:.1f} %"
        interval = "" if row["value"] is None else f"{100 * row['low']:.0f} to {100 * row['high']:.0f}"
    else:
        value, interval = short(row["value"]), ""
    met = "" if row["met"] is None or not row["goal"] else ("yes" if row["met"] else "NO")
    return row["what"], value, interval, str(row["runs"]), row["goal"], met


def _condition_cells(row: Row) -> tuple[str, ...]:
    verdicts = " ".join(f"{count} {verdict}" for verdict, count in row["verdicts"].items())
    right = "" if row["right"] is None else f"{100 * row['right']:.0f} %"
    return (
        row["name"],
        row["set"],
        verdicts,
        short(row["error_um"]),
        short(row["percent"], 2),
        short(row["sigma_um"]),
        short(row["z"]),
        short(row["share"], 2),
        short(row["prediction"]),
        short(row["noise"], 2),
        row["reason"] or "",
        right,
        short(row["seconds"], 2),
    )


def headline(title: str, rows: Sequence[Row]) -> Table:
    table = Table(title=title, box=None, pad_edge=False, padding=(0, 3, 0, 0), title_justify="left")
    for name in HEAD:
        table.add_column(name, justify="left" if name in ("", "goal", "met") else "right")
    for row in rows:
        table.add_row(*_cells(row))
    return table


def conditions(rows: Sequence[Row]) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for name in COLUMNS:
        table.add_column(
            name, justify="left" if name in ("condition", "set", "verdicts", "reason") else "right", no_wrap=True
        )
    family = None
    for row in rows:
        if row["family"] != family:
            family = row["family"]
            table.add_row(f"[bold]{family}")
        table.add_row(*_condition_cells(row))
    return table


def markdown(parts: Mapping[str, Sequence[Row]], rows: Sequence[Row]) -> str:
    lines = []
    for title, part in parts.items():
        lines += [f"## {title}", "", _line(HEAD), _rule(len(HEAD)), *(_line(_cells(row)) for row in part), ""]
    lines += ["## Conditions", "", _line(("family", *COLUMNS)), _rule(len(COLUMNS) + 1)]
    lines += [_line((row["family"], *_condition_cells(row))) for row in rows]
    return "\n".join(lines) + "\n"


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _rule(n: int) -> str:
    return "|" + " --- |" * n


COLOURS = {"good": "#2a9d5c", "doubtful": "#e0a020", "unusable": "#c0392b"}


def picture(runs: Sequence[Row], path: Path) -> None:
    """Every run: B's error against the sigma that was stated, coloured by the verdict."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 7), layout="constrained")
    axes = figure.subplots()
    for verdict, colour in COLOURS.items():
        for which, mark in (("tuning", "o"), ("aside", "^")):
            seen = [r for r in runs if r["verdict"] == verdict and r["set"] == which and r["sigma_um"] is not None]
            if seen:
                x, y = [max(r["sigma_um"], 0.01) for r in seen], [max(r["error_um"], 0.01) for r in seen]
                axes.scatter(x, y, s=16, c=colour, marker=mark, alpha=0.7, label=f"{verdict}, {which}")
    span = [0.03, 1e4]
    for factor, style in ((1.0, "-"), (2.0, "--")):
        axes.plot(span, [factor * s for s in span], style, color="0.5", lw=1, label=f"error = {factor:g} sigma")
    axes.set(xscale="log", yscale="log", xlabel="stated sigma of B, rms, um", ylabel="error of B, rms, um")
    axes.legend(fontsize=8)
    figure.savefig(path, dpi=120)


def scores(runs: Sequence[Row]) -> dict[str, list[dict[str, Any]]]:
    """The headline of each set that was run, and of all together."""
    parts = {which: [r for r in runs if r["set"] == which] for which in ("tuning", "aside")}
    summaries = {which: score.summary(part) for which, part in parts.items() if part}
    return summaries if len(summaries) < 2 else {**summaries, "all": score.summary(runs)}
