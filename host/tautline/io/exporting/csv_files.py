"""A folder of CSV files: one for each series and curve, and what they are in columns.json."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd

from tautline.folders import replaced_folder, write_file
from tautline.io.exporting.log import Curve, Log, Series
from tautline.plain import plain

INDEX = "columns.json"


def write(log: Log, out: Path) -> list[Path]:
    """Writes a log into the folder `out`: a CSV file for each series and curve, and columns.json. Cells without a value
    are empty; times are in s. Returns the files written."""
    with replaced_folder(out, INDEX, stale=("*.csv",)) as folder:
        listed = []
        parts: list[Series | Curve] = [*log.series, *log.curves]
        for part in parts:
            file = f"{part.name.replace('/', '-')}.csv"
            table = pd.DataFrame(_columns(part))
            table.to_csv(folder / file, index=False, float_format="%.15g", lineterminator="\n")
            listed.append({"file": file, "says": part.says, "columns": list(table.columns), "rows": len(table)})
        document = plain({"files": listed, **log.facts})
        write_file(folder / INDEX, json.dumps(document, indent=1, allow_nan=False) + "\n")
    return [out / INDEX, *(out / str(each["file"]) for each in listed)]


def _columns(part: Series | Curve) -> dict[str, object]:
    """The columns of a series' or a curve's file, by name; those of a series begin with its times, t_s."""
    return {"t_s": part.t_s, **part.columns} if isinstance(part, Series) else dict(part.columns)
