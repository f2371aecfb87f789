"""How often the name is right, and the same in both commands."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

VISIBLE, CLEAR = 2.0, 5.0  # times the noise: less is not asked for; more is to be right in 95 %
Row = Mapping[str, Any]


def first(row: Row, what: str) -> str:
    """The name that is given first; "" where there is none."""
    said = row[what]
    if what == "diagnosis" and said["verdict"] != "effect":
        return "" if said["verdict"] == "none" else str(said["verdict"])
    return str(said["ids"][0]) if said["ids"] else ""


def right(row: Row, what: str) -> bool:
    return first(row, what) == row["effect"]


def same(row: Row) -> bool:
    """Whether a session's calibration and a diagnosis of it say one thing."""
    return first(row, "session") == first(row, "diagnosis")


def table(rows: Sequence[Row]) -> str:
    """Effect by effect, as markdown; a row where the calibration's own model holds the effect is not counted but in
    the last column."""
    head = "| effect | times the noise | cases | calibration | session | diagnosis | same | held |"
    lines = [head, "| --- | --- | --- | --- | --- | --- | --- | --- |"]
    for effect in sorted({row["effect"] for row in rows}):
        own = [row for row in rows if row["effect"] == effect]
        groups: list[tuple[str, Callable[[Row], bool]]] = (
            [("any", lambda row: True)]
            if not effect
            else [
                (f"{VISIBLE:g} to {CLEAR:g}", lambda row: VISIBLE <= row["recalibrated"] < CLEAR),
                (f"over {CLEAR:g}", lambda row: row["recalibrated"] >= CLEAR),
            ]
        )
        held = sum(row["recalibrated"] < VISIBLE for row in own) if effect else 0
        for name, belongs in groups:
            some = [row for row in own if belongs(row)]
            told = [sum(right(row, what) for row in some) for what in ("calibration", "session", "diagnosis")]
            cells = [effect or "nothing", name, len(some), *told, sum(map(same, some)), held]
            lines.append(f"| {' | '.join(str(cell) for cell in cells)} |")
    return "\n".join(lines)
