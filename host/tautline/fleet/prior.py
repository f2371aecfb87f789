"""What a fleet teaches of the next robot: B's distribution over it, kept beside its results."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from tautline.calibration.beforehand import Beforehand
from tautline.errors import TautError, of_system
from tautline.fleet.population import log_widths, population
from tautline.fleet.rows import Row
from tautline.folders import write_file
from tautline.rig import Rig

FILE, FORMAT = "prior.json", "prior/1"
_SAME = 0.01  # of the range, by which a robot's may differ


def write(rows: Sequence[Row], out: Path) -> None:
    """OUT/prior.json, from all usable sessions: a fleet's worn states are in its spread as its robots are. Raises
    TautError where too few robots tell."""
    curves = log_widths(rows)
    unit = next(row.unit for row in rows if row.usable and row.q == tuple(curves.q.tolist()))
    with threadpool_limits(1, "blas"):
        known = population(curves, of_next=True)
    arrays = {name: getattr(known, name).tolist() for name in ("q", "mean", "scale")}
    document = {"format": FORMAT, "unit": unit, "robots": len(set(curves.names)), **arrays, "freedom": known.freedom}
    write_file(out / FILE, json.dumps(document))


def read(out: Path, rig: Rig) -> Beforehand:
    """The prior that the fleet in `out` gives a calibration with this rig. TautError where it taught nothing, or its
    robots are others."""
    path = out / FILE
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        if document["format"] != FORMAT:
            raise ValueError(f"format {document['format']}")
        q, mean, scale = (np.array(document[name], dtype=float) for name in ("q", "mean", "scale"))
        unit, freedom = str(document["unit"]), float(document["freedom"])
    except FileNotFoundError as error:
        raise TautError(f"{out}: holds no {FILE}: make it with 'taut fleet FOLDER --out {out}'") from error
    except OSError as error:
        raise TautError(of_system(error)) from error
    except (KeyError, TypeError, ValueError) as error:
        raise TautError(f"{path}: damaged ({error}): make it again with taut fleet") from error
    low, high = rig.actuator.range
    near = _SAME * (high - low)
    if unit != rig.actuator.unit or abs(q[0] - low) > near or abs(q[-1] - high) > near:
        raise TautError(
            f"{path}: its robots go from {q[0]:g} to {q[-1]:g} {unit}, this one from {low:g} to {high:g} "
            f"{rig.actuator.unit}: use a fleet of its own make"
        )
    return Beforehand(q, mean, scale, freedom)
