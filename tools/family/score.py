"""The score of diagnoses on cases whose truth is known.

DIAGNOSES/NAME/diagnosis.json (or DIAGNOSES/NAME.json) for each case; PREDICTIONS/NAME/nominal.csv and corrected.csv are
`taut predict` of DIR/nominal and DIR/corrected at the unseen motion's times. Without a diagnosis a case is wrong.
"""

import argparse
import csv
import json
import math
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

BINS = ((2.0, 5.0), (5.0, 20.0), (20.0, math.inf))  # times the noise
LEAST = 1e-4  # probability below which the log score punishes no more
RELIABILITY_BINS = 10
WORSE = 1.05  # a corrected model is worse than the nominal from this ratio on
LARGEST_SET = 3


@dataclass(frozen=True)
class Verdict:
    """What a diagnosis says, in the words of the score."""

    label: str  # id of the leading effect, "none", "unknown" or "missing"
    in_set: tuple[str, ...]  # the leading effect and what it cannot be told from, three at most
    first_three: tuple[str, ...]  # the three likeliest candidates
    named: frozenset[str]  # every named effect and everything that moved
    chances: dict[str, float]  # of each label, summing to 1
    shrink: float | None
    shrink_ci: tuple[float, float] | None


def read_verdict(diagnosis: dict[str, Any]) -> Verdict:
    effects, moved = diagnosis.get("effects", []), diagnosis.get("moved", [])
    candidates = diagnosis.get("candidates", [])
    verdict = diagnosis["verdict"]
    if verdict != "effect":
        label, in_set = verdict, (verdict,)
    else:
        ranked = [e["id"] for e in (effects or moved or candidates)]
        label = ranked[0] if ranked else "missing"
        unsure = effects[0].get("ambiguous_with", []) if effects else []
        in_set = (label, *(i for i in unsure if i != label))[:LARGEST_SET]
    chances = {c["id"]: float(c["probability"]) for c in candidates}
    chances["none"] = float(diagnosis.get("probability_none", 0.0))
    chances["unknown"] = float(diagnosis.get("probability_unknown", 0.0))
    total = sum(chances.values())
    chances = {k: v / total for k, v in chances.items()} if total > 0 else {}
    gap = diagnosis.get("gap", {})
    interval = gap.get("shrink_ci")
    return Verdict(
        label,
        in_set,
        tuple(c["id"] for c in candidates[:3]),
        frozenset(e["id"] for e in (*effects, *moved)),
        chances,
        gap.get("shrink"),
        (float(interval[0]), float(interval[1])) if interval else None,
    )


MISSING = Verdict("missing", (), (), frozenset(), {}, None, None)


def expected(truth: dict[str, Any]) -> frozenset[str]:
    """The labels that are right as the leading one."""
    if truth["verdict"] != "effect":
        return frozenset([truth["verdict"]])
    return frozenset(c["id"] for c in truth["causes"] if c["listed"])


def share(hits: Iterable[bool]) -> dict[str, float | int | None]:
    """A share with its 95 % Wilson interval."""
    answers = list(hits)
    n, k = len(answers), sum(answers)
    if n == 0:
        return {"right": 0, "of": 0, "share": None, "low": None, "high": None}
    z = 1.959964
    p = k / n
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return {"right": k, "of": n, "share": p, "low": middle - half, "high": middle + half}


def reliability(pairs: list[tuple[float, bool]]) -> float | None:
    """Expected calibration error of the likeliest label: mean |stated - hit share| over ten bins, by their counts."""
    if not pairs:
        return None
    total = 0.0
    for b in range(RELIABILITY_BINS):
        inside = [(p, hit) for p, hit in pairs if min(int(p * RELIABILITY_BINS), RELIABILITY_BINS - 1) == b]
        total += abs(sum(p - hit for p, hit in inside))
    return total / len(pairs)


def rms(prediction: Path, seen: Path, since: float) -> float:
    """rms per coordinate of a prediction at the unseen motion, from `since` on. Raises ValueError where rows differ."""
    with seen.open(newline="") as file:
        rows = list(csv.DictReader(file))
    with prediction.open(newline="") as file:
        predicted = list(csv.DictReader(file))
    if len(rows) != len(predicted):
        raise ValueError(f"{prediction}: {len(predicted)} rows, but {seen} has {len(rows)}: predict at its t_s")
    names = ("c_deg",) if "c_deg" in rows[0] else ("u_px", "v_px")
    total, count = 0.0, 0
    for row, other in zip(rows, predicted, strict=True):
        if abs(float(row["t_s"]) - float(other["t_s"])) > 1e-6:
            raise ValueError(f"{prediction}: t_s {other['t_s']} where {seen} has {row['t_s']}")
        if float(row["t_s"]) >= since:
            total += sum((float(row[n]) - float(other[n])) ** 2 for n in names)
            count += len(names)
    if not count or not math.isfinite(total):
        raise ValueError(f"{prediction}: no finite prediction from {since} s on")
    return math.sqrt(total / count)


def score(
    truths: list[dict[str, Any]], verdicts: dict[str, Verdict], errors: dict[str, tuple[float, float]]
) -> dict[str, Any]:
    """All figures. errors: rms of the nominal and of the corrected model on the unseen motion, by case."""
    said = [(t, verdicts.get(t["case"], MISSING)) for t in truths]

    def of(*kinds: str) -> list[tuple[dict[str, Any], Verdict]]:
        return [(t, v) for t, v in said if t["kind"] in kinds]

    def leads(some: list[tuple[dict[str, Any], Verdict]]) -> dict[str, float | int | None]:
        return share(v.label in expected(t) for t, v in some)

    single = of("single")
    out: dict[str, Any] = {
        "cases": len(truths),
        "missing": sum(v is MISSING for _, v in said),
        "single leads": leads(single),
        "single in set": share(bool(expected(t) & set(v.in_set)) for t, v in single),
        "single in first three": share(bool(expected(t) & set(v.first_three)) for t, v in single),
    }
    for lo, hi in BINS:
        there = [(t, v) for t, v in single if lo <= t["causes"][0]["strength"] < hi]
        out[f"single leads, {lo:g} to {hi:g} times the noise"] = leads(there)
    out |= {
        "unknown called unknown": leads(of("unknown")),
        "none called none": leads(of("none")),
        "nominal: what moved leads": leads(of("nominal")),
    }
    for kind in ("pair", "triple"):
        some = of(kind)
        out[f"{kind}: one of them leads"] = leads(some)
        out[f"{kind}: all named"] = share(expected(t) <= v.named for t, v in some)
        out[f"{kind}: effects covered"] = share(i in v.named for t, v in some for i in expected(t))
        out[f"{kind}: named and not there"] = sum(len(v.named - expected(t)) for t, v in some)
    chances = [(t, v) for t, v in said if v.chances]
    top = [(max(v.chances, key=lambda k: v.chances[k]), v, expected(t)) for t, v in chances]
    out["calibration error of probabilities"] = reliability(
        [(v.chances[label], label in right) for label, v, right in top]
    )
    logs = [math.log(max(sum(v.chances.get(i, 0.0) for i in expected(t)), LEAST)) for t, v in said]
    out["log score"] = sum(logs) / len(logs) if logs else None
    out |= _claims(said, errors)
    out["by id"] = {
        i: leads([(t, v) for t, v in single if t["causes"][0]["id"] == i])
        for i in sorted({t["causes"][0]["id"] for t, _ in single})
    }
    return out


def _claims(said: list[tuple[dict[str, Any], Verdict]], errors: dict[str, tuple[float, float]]) -> dict[str, Any]:
    """What is claimed against what comes true on the unseen motion, where a gap is named."""
    claimed = [
        (v, 1 - errors[t["case"]][1] / errors[t["case"]][0])
        for t, v in said
        if t["case"] in errors and v.label not in ("none", "missing") and v.shrink is not None
    ]
    both = [errors[t["case"]] for t, _ in said if t["case"] in errors]
    misses = sorted(abs(float(v.shrink or 0.0) - real) for v, real in claimed)
    return {
        "claim error, mean": sum(misses) / len(misses) if misses else None,
        "claim error, median": misses[len(misses) // 2] if misses else None,
        "claims": len(misses),
        "shrink_ci covers": share(v.shrink_ci[0] <= real <= v.shrink_ci[1] for v, real in claimed if v.shrink_ci),
        "corrected worse than nominal": share(c > WORSE * n for n, c in both),
    }  # fmt: skip


def collect(diagnoses: Path, truth: Path, predictions: Path | None) -> dict[str, Any]:
    truths = [json.loads(p.read_text()) for p in sorted(truth.glob("*.json"))]
    if not truths:
        sys.exit(f"{truth}: no truths; `python -m tools.family make` writes them")
    verdicts, errors = {}, {}
    for t in truths:
        name = t["case"]
        for path in (diagnoses / name / "diagnosis.json", diagnoses / f"{name}.json"):
            if path.exists():
                verdicts[name] = read_verdict(json.loads(path.read_text()))
        if predictions is not None and (predictions / name / "nominal.csv").exists():
            seen, since = truth / f"{name}-unseen.csv", t["unseen_valid_from_s"]
            errors[name] = (
                rms(predictions / name / "nominal.csv", seen, since),
                rms(predictions / name / "corrected.csv", seen, since),
            )
    return score(truths, verdicts, errors)


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("diagnoses", type=Path)
    parser.add_argument("--truth", type=Path, required=True)
    parser.add_argument("--predictions", type=Path)
    parser.add_argument("--json", action="store_true")


def text(result: dict[str, Any]) -> str:
    lines = []
    for name, value in result.items():
        if name == "by id":
            continue
        if isinstance(value, dict):
            shown = "-" if value["share"] is None else (
                f"{value['right']} of {value['of']}  {value['share']:.0%} ({value['low']:.0%} to {value['high']:.0%})"
            )  # fmt: skip
        else:
            shown = "-" if value is None else f"{value:.3f}" if isinstance(value, float) else str(value)
        lines.append(f"{name:48s} {shown}")
    return "\n".join(lines)


def command(args: argparse.Namespace) -> None:
    result = collect(args.diagnoses, args.truth, args.predictions)
    print(json.dumps(result, indent=1) if args.json else text(result))
