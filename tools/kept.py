"""build/results: what a long command leaves for './run dossier', a table as JSON."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path

RESULTS = Path(os.environ.get("TAUTLINE_RESULTS") or Path(__file__).resolve().parents[1] / "build" / "results")


def keep(name: str, heads: Sequence[str], rows: Sequence[Sequence[object]], folder: Path = RESULTS) -> None:
    """Rows with another first cell, of an earlier command, stay."""
    file = folder / f"{name}.json"
    before = json.loads(file.read_text("utf-8")) if file.is_file() else {"heads": list(heads), "rows": []}
    new = [[str(cell) for cell in row] for row in rows]
    old = [row for row in before["rows"] if before["heads"] == list(heads) and row[0] not in {each[0] for each in new}]
    folder.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps({"heads": list(heads), "rows": sorted(old + new)}, indent=1), "utf-8")
