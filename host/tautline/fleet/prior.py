"""The prior that a fleet gives for the next robot's calibration: how B, the tip's path as its sensor sees it, and that
sensor's delay are distributed over the fleet's robots. It is kept in a file beside the fleet's results."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from tautline.calibration.beforehand import Beforehand, Spread
from tautline.errors import TautError, of_system
from tautline.fleet.population import (
    LEAST_ROBOTS,
    Population,
    delays,
    log_widths,
    population,
    population_of_single_value,
    tip_paths,
)
from tautline.fleet.rows import DATA_SET, Row
from tautline.folders import write_file
from tautline.rig import Rig

FILE, FORMAT, _WITHOUT_DELAY = "prior.json", "prior/3", "prior/2"
_SAME = 0.01  # tolerance: share of the range by which each end of a robot's range may differ


def write(rows: Sequence[Row], out: Path) -> None:
    """Writes OUT/prior.json, which `read` turns into the prior of the next robot's calibration: the distributions of B,
    path and delay. All usable sessions count, also several of one robot, so that wear is part of the spread. TautError
    where fewer than LEAST_ROBOTS robots are usable."""
    curves = log_widths(rows)
    unit = next(row.unit for row in rows if row.usable and row.q == tuple(curves.q.tolist()))
    with threadpool_limits(1, "blas"):
        width = _as_json(population(curves, of_next=True))  # B may be worn as no other's is; the path does not wear
        path = [_as_json(population(each)) for each in tip_paths(rows)]
        delay_curves = delays(rows)
        delay = None if delay_curves is None else _as_json(population_of_single_value(delay_curves))
    robots = len(set(curves.names))
    document = {"format": FORMAT, "unit": unit, "robots": robots, "width": width, "path": path, "delay": delay}
    write_file(out / FILE, json.dumps(document))


def _as_json(known: Population) -> dict[str, Any]:
    """A population as a JSON object: q, mean and scale as lists, freedom as a number."""
    arrays = {name: getattr(known, name).tolist() for name in ("q", "mean", "scale")}
    return {**arrays, "freedom": known.freedom}


def _spread_of_json(values: dict[str, Any]) -> Spread:
    """The distribution that a calibration takes as its prior, from an object that `_as_json` made. KeyError, TypeError
    or ValueError where it is damaged."""
    q, mean, scale = (np.array(values[name], dtype=float) for name in ("q", "mean", "scale"))
    return Spread(q, mean, scale, float(values["freedom"]))


def read(out: Path, rig: Rig) -> Beforehand:
    """Reads the prior for a calibration with this rig from prior.json, which `write` made in the fleet's output folder
    `out`. TautError where there is no such file, it is damaged, or the fleet's robots have another unit or range than
    the rig."""
    path = out / FILE
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        if document["format"] not in (FORMAT, _WITHOUT_DELAY):
            raise ValueError(f"format {document['format']}")
        path_spreads = tuple(_spread_of_json(each) for each in document["path"])
        delay = document.get("delay")
        delay_spread = None if delay is None else _spread_of_json(delay)
        known = Beforehand(_spread_of_json(document["width"]), path_spreads, delay_spread)
        unit, q = str(document["unit"]), known.width.q
    except FileNotFoundError as error:
        if (out / DATA_SET).is_dir():
            raise TautError(
                f"{out}: knows nothing of the next robot yet: its spread takes {LEAST_ROBOTS} calibrated robots of one "
                "range: run 'taut fleet' on more of them, or leave --prior out"
            ) from error
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
    return known
