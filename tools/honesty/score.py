"""What a run is worth: pure functions of what was said and what is true."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
WORST_Z = 1e6  # stands for a sigma of nothing


def numbers(values: Sequence[float | None]) -> Array:
    return np.array([np.nan if x is None else x for x in values], float)


def rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))


def backlash(document: Mapping[str, Any], q: Array, width: Array, um_per_unit: float) -> dict[str, float | None]:
    """z, error and sigma over the points of the grid that are inside `measured` and have a finite sigma."""
    at, found, sigma = (numbers(document[key]) for key in ("q", "width", "sigma"))
    low, high = document.get("measured") or (np.nan, np.nan)
    true = np.interp(at, q, width, left=np.nan, right=np.nan)
    keep = (at >= low) & (at <= high) & np.isfinite(sigma) & np.isfinite(found) & np.isfinite(true)
    if not keep.any():
        return {"z": None, "error_um": None, "sigma_um": None, "percent": None, "share": 0.0}
    error, sigma, true = found[keep] - true[keep], sigma[keep], true[keep]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(error == 0.0, 0.0, np.abs(error) / sigma)
    return {
        "z": min(rms(np.minimum(ratio, WORST_Z)), WORST_Z),
        "error_um": rms(error) * um_per_unit,
        "sigma_um": rms(sigma) * um_per_unit,
        "percent": 100.0 * rms(error) / float(np.mean(true)),
        "share": float(keep.sum()) / len(at),
    }


def image_rms(error: Array) -> float:
    """Per coordinate: sqrt(mean((du^2 + dv^2) / 2)); one column (deg) is a plain rms. A row without a number: 1e6."""
    error = np.where(np.isfinite(error), np.clip(error, -1e6, 1e6), 1e6)
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1) / error.shape[1])))


def best_constant(true: Array) -> float:
    return image_rms(true - true.mean(axis=0))


def right_reason(codes: Iterable[str], accepted: Iterable[str]) -> bool:
    """A code is right when it is accepted, or finer than one that is: clock accepts clock.rate."""
    known = list(accepted)
    return any(code == a or code.startswith(a + ".") for code in codes for a in known)


Run = Mapping[str, Any]


def close(run: Run) -> bool:
    return run["error_um"] is not None and (run["error_um"] < 3.0 or run["percent"] < 1.0)


def far(run: Run) -> bool:
    return run["error_um"] is not None and run["error_um"] > 20.0 and run["percent"] > 5.0


def overconfident(run: Run) -> bool:
    return run["z"] is None or run["z"] > 2.0


def interval(hits: Sequence[Sequence[bool]], draws: int = 2000) -> tuple[float, float]:
    """95 % of a share. Runs of one condition are alike, so conditions are drawn; at 0 and 1 the rule of three."""
    n = np.array([len(h) for h in hits], float)
    k = np.array([sum(h) for h in hits], float)
    if len(n) == 0 or n.sum() == 0:
        return float("nan"), float("nan")
    if k.sum() in (0.0, n.sum()):
        edge = 1 - 0.05 ** (1 / len(n))
        return (0.0, edge) if k.sum() == 0 else (1 - edge, 1.0)
    pick = np.random.default_rng(1).integers(0, len(n), (draws, len(n)))
    low, high = np.quantile(k[pick].sum(axis=1) / n[pick].sum(axis=1), [0.025, 0.975])
    return float(low), float(high)


def _share(
    name: str, runs: Sequence[Run], hit: Any, goal: str, at_most: float | None, at_least: float | None
) -> dict[str, Any]:
    groups: dict[str, list[bool]] = {}
    for run in runs:
        groups.setdefault(run["name"], []).append(bool(hit(run)))
    flat = [h for group in groups.values() for h in group]
    value = float(np.mean(flat)) if flat else None
    low, high = interval(list(groups.values()))
    met = None if value is None else (at_most is None or value <= at_most) and (at_least is None or value >= at_least)
    return {
        "what": name,
        "value": value,
        "low": low,
        "high": high,
        "runs": len(flat),
        "goal": goal,
        "met": met,
        "share": True,
    }


def _number(
    name: str, value: float | None, runs: int, goal: str, low: float | None, high: float | None
) -> dict[str, Any]:
    met = None if value is None else (low is None or value >= low) and (high is None or value <= high)
    row = {"what": name, "value": value, "low": None, "high": None, "runs": runs, "goal": goal, "met": met}
    return {**row, "share": False}


def summary(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """The benchmark's headline, for one set of runs."""
    good = [r for r in runs if r["verdict"] == "good"]
    benign = [r for r in runs if r["benign"]]
    faulty = [r for r in runs if not r["benign"]]
    named = [r for r in faulty if r["verdict"] in ("doubtful", "unusable")]
    wrong = [r for r in faulty if far(r)]
    z = [min(r["z"], 1e3) for r in benign if r["z"] is not None]
    ratio = [r["sigma_um"] / max(r["error_um"], 1e-6) for r in runs if r["sigma_um"] is not None]

    def not_good(r: Run) -> bool:
        return bool(r["verdict"] != "good")

    def fits(r: Run) -> bool:
        return close(r) and r["prediction"] is not None and r["prediction"] <= 0.83 * r["noise"]

    rows = [
        _share("good with z > 2, of all runs", runs, lambda r: r in good and overconfident(r), "<= 3 %", 0.03, None),
        _share("benign: good", benign, lambda r: not not_good(r), ">= 95 %", None, 0.95),
        _number("benign: rms z", rms(np.array(z)) if z else None, len(z), "0.7 to 1.3", 0.7, 1.3),
        _number("benign: median z", float(np.median(z)) if z else None, len(z), "", None, None),
        _share("error < 3 um or 1 %: not good", [r for r in runs if close(r)], not_good, "<= 20 %", 0.2, None),
        _share("... and predicts within 1.3 noise: not good", [r for r in runs if fits(r)], not_good, "", None, None),
        _share("error > 20 um and 5 %: not good", [r for r in runs if far(r)], not_good, ">= 90 %", None, 0.9),
        _number("sigma / |error|, median", float(np.median(ratio)) if ratio else None, len(ratio), "<= 2.5", None, 2.5),
        _share("not good, not benign: a right reason", named, _right, ">= 80 %", None, 0.8),
        _share("error > 20 um and 5 %: a right reason", wrong, _right, "", None, None),
        _share(
            "files that contradict each other: good",
            [r for r in runs if r["must_not_pass"]],
            lambda r: r in good,
            "0",
            0.0,
            None,
        ),
        _share(
            "worse than f_coarse or a constant: good",
            [r for r in runs if _useless(r)],
            lambda r: not not_good(r),
            "0",
            0.0,
            None,
        ),
        _share(
            "image clock off by seconds: found to 2 ms, or unusable",
            [r for r in runs if r.get("clock_off_s")],
            _clock_settled,
            "100 %",
            None,
            1.0,
        ),
        _share("refused (exit 1)", runs, lambda r: r["verdict"] == "refused", "", None, None),
        _share("exit status and verdict disagree", runs, lambda r: not r.get("exit_fits", True), "0", 0.0, None),
        _share("crashed, or took too long", runs, lambda r: r["verdict"] in ("crash", "timeout"), "0", 0.0, None),
    ]
    return [*rows, *_predictions(runs)]


HYSTERESES = (
    ("several plays, gradual onsets", ("plays", "gradual"), 0.1),
    ("Bouc-Wen", ("bouc_wen",), 0.2),
    ("Dahl", ("dahl",), 1.0),
)


def _predictions(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """Unseen motions without noise: what a good day gives, and hystereses that are no single play."""
    known = [r for r in runs if r["prediction"] is not None]
    benign = [r["prediction"] / r["noise"] for r in known if r["benign"]]
    shares = [r["share"] for r in runs if r["benign"]]
    rows = [
        _number("benign: prediction / noise, median", _median(benign), len(benign), "<= 0.25", None, 0.25),
        _number("benign: share of the range that is measured, median", _median(shares), len(shares), "", None, None),
    ]
    for what, families, most in HYSTERESES:
        # In px: none of these families has a rig without a camera. What is called unusable promises nothing.
        group = [r for r in known if r["family"] in families and r["verdict"] != "unusable"]
        medians = [row["prediction"] for row in by_condition(group)]
        if any(r["family"] in families for r in runs):
            worst = max(medians) if medians else None
            rows.append(
                _number(f"{what}: prediction, px, worst condition", worst, len(group), f"<= {most:g}", None, most)
            )
    return rows


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if values else None


def _right(run: Run) -> bool:
    return right_reason(run["reasons"], run["codes"])


def _clock_settled(run: Run) -> bool:
    settled = run["clock_error_ms"] is not None and abs(run["clock_error_ms"]) <= 2.0
    return settled or run["verdict"] in ("unusable", "refused")


def _useless(run: Run) -> bool:
    return run["prediction"] is not None and run["prediction"] > min(run["coarse"], run["constant"])


def by_condition(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """A row for each condition: medians over its seeds."""
    groups: dict[str, list[Run]] = {}
    for run in runs:
        groups.setdefault(run["name"], []).append(run)
    return [_row(name, group) for name, group in groups.items()]


def _row(name: str, group: Sequence[Run]) -> dict[str, Any]:
    def median(key: str) -> float | None:
        values = [run[key] for run in group if run[key] is not None]
        return float(np.median(values)) if values else None

    tops = [run["reasons"][0] for run in group if run["reasons"]]
    verdicts = [run["verdict"] for run in group]
    return {
        "name": name,
        "family": group[0]["family"],
        "set": group[0]["set"],
        "runs": len(group),
        "verdicts": {v: verdicts.count(v) for v in sorted(set(verdicts))},
        "reason": max(set(tops), key=tops.count) if tops else None,
        "right": float(np.mean([_right(run) for run in group])) if not group[0]["benign"] else None,
        **{
            key: median(key)
            for key in ("error_um", "percent", "sigma_um", "z", "share", "prediction", "coarse", "constant", "noise")
        },
        **{key: median(key) for key in ("delay_error_ms", "remaining_deg", "seconds")},
    }
