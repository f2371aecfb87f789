"""The diagnosis in words: one sentence, what to do next, and the table that a terminal shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tautline.diagnose.confounded import DRIFT, LOAD
from tautline.effects import BY_ID

_EVENTS = ("transmission.stick_slip", "acquisition.jitter")
_SMALL = 3.0  # times the noise: a gap below is called small
_SHOWN = 0.005  # probability from which on a terminal shows a candidate
_NO_PATH = "It has no path that repeats, so no model can predict it away."


def digits(value: float) -> str:
    """Three significant digits, no exponent."""
    return f"{value:.3g}" if abs(value) >= 1e-3 or value == 0 else f"{value:.6f}"


def listed(names: Sequence[str], last: str = "and") -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} {last} {names[-1]}"


def sentence(document: Mapping[str, Any]) -> str:
    """Verdict, effect and shrinkage."""
    gap, unit, floor = document["gap"], document["unit"], document["noise_floor"]
    before = f"{digits(gap['before'])} {unit} rms"
    times = f"{gap['before'] / floor:.2g} times the noise"
    if document["verdict"] == "none":
        return (
            f"No gap beyond noise: the calibrated model predicts motions that it never saw to {before}, "
            f"and the noise alone is {digits(floor)}."
        )
    if document["verdict"] == "unknown":
        small = gap["before"] < _SMALL * floor
        return (
            f"{'Nothing large is left: a small' if small else 'A'} gap of {before}, {times}, "
            f"that no known effect explains{'' if small else _seen(document)}."
        )
    effects = document["effects"]
    named = listed([f"{BY_ID[e['id']].says} ({e['id']}, {percent(e['probability'])} sure)" for e in effects])
    if effects[0]["id"] in _EVENTS:
        text = f"{_capital(named)}: a gap of {before}, {times}. {_NO_PATH}"
    else:
        shrinks = "removes" if gap["shrink"] > 0.995 else f"shrinks by {percent(gap['shrink'])}"
        text = (
            f"{_capital(named)}: with {'it' if len(effects) == 1 else 'them'} in the model the gap {shrinks}, "
            f"from {before} to {digits(gap['after'])}."
        )
    others = [name for name in effects[0]["ambiguous_with"] if name not in {e["id"] for e in effects}]
    if others:
        which = "it" if len(effects) == 1 else "the former"
        text += f" These motions cannot tell {which} from {listed(others, 'or')}."
    if document["signature"]:
        text += f" The gap is {document['signature']}."
    return text


def percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def flexible(document: Mapping[str, Any]) -> str:
    """What a model without any physics would close; "" where it was not asked."""
    found = document.get("flexible")
    if not found:
        return ""
    swing = found.get("swing_s")
    if swing:
        asked_of = "What is left" if document["verdict"] == "effect" else "The gap"
        text = (
            f"{asked_of} swings with a period of {swing:.2g} s ({60 / swing:.0f} a minute), whatever the motor does. "
        )
    else:
        text = ""
    what = "what is left" if document["verdict"] == "effect" else "the gap"
    share = found["closable_shrink"]
    asked = "a flexible model of motor position, travel since the reversal, speed, time and the other axes"
    if share < 0.15:
        return text + (
            f"{_capital(asked)} would close hardly any of {what}: it goes with nothing that was recorded, "
            "or does not repeat."
        )
    return text + (
        f"{_capital(asked)} would close {percent(share)} of {what} above the noise "
        f"({digits(found['before'])} to {digits(found['after'])} {document['unit']} rms): so much of it repeats."
    )


def steps(document: Mapping[str, Any], folder: str) -> list[str]:
    """What to do next, most useful first; `folder` is the diagnosis' own."""
    verdict, following = document["verdict"], document["next_motion"]
    told = []
    if verdict == "none":
        return ["Use the model as it is: these motions show nothing that it lacks."]
    if verdict == "unknown":
        where = ", ".join(f"{c['says']} ({c['axis']})" for c in document["where"]["conditions"][:3])
        told.append(f"Look at the instrument where the gap is: {where}.")
    effects = document["effects"]
    event = bool(effects) and effects[0]["id"] in _EVENTS
    ambiguous = {name for e in effects for name in (e["id"], *e["ambiguous_with"])}
    if {LOAD, DRIFT} <= ambiguous:
        told.append(
            "Record the first load once more, or a third one, and diagnose with it too: a drift does not come back, "
            "and one slope serves all loads."
        )
    elif following and (verdict == "unknown" or any(e["ambiguous_with"] for e in effects)):
        told.append(
            f"Record the motion that tells the leading candidates apart ({following['why']}) and diagnose with it too: "
            f"taut record --motion {folder}/{following['file']} --rig {folder}/nominal/rig.toml --out more"
        )
    if effects and not event:
        told.append(f"Predict with the corrected model: taut predict {folder}/corrected RECORDING --csv OUT.csv")
        if effects[0]["swallowed_by_recalibration"]:
            told.append(
                "A calibration on all these recordings closes the gap as well, without knowing why: "
                "taut calibrate CALIBRATION TEST... --out MODEL"
            )
    if event:
        cause = "friction" if effects[0]["id"] == "transmission.stick_slip" else "the camera's timing"
        told.append(f"Mend {cause}: no table and no model can.")
    told += board(document, folder)
    return told


def board(document: Mapping[str, Any], folder: str) -> list[str]:
    """What `taut flash` can do about it."""
    effects = document["effects"]
    if not effects:
        return []
    left = [e["id"] for e in effects if not e["loads_on_board"]]
    if left:
        return [
            f"The board's tables cannot carry {listed(left)}; B and f_remain alone: "
            f"taut flash {folder}/corrected --without-effects"
        ]
    return [f"Load the corrected tables: taut flash {folder}/corrected"]


def text(document: Mapping[str, Any], folder: str) -> str:
    """For a terminal: the sentence, the gap, the candidates, what to do next, where it is."""
    gap, unit = document["gap"], document["unit"]
    low, high = gap["after_ci"]
    lines = [sentence(document), ""]
    lines.append(f"  gap before      {digits(gap['before']):>8} {unit} rms")
    if document["verdict"] == "effect":
        lines.append(f"  gap after       {digits(gap['after']):>8} {unit} rms ({digits(low)} to {digits(high)})")
    again = document["gap_recalibrated"]["before"]
    lines.append(f"  recalibrated    {digits(again):>8} {unit} rms (B, f_remain and registration refitted on all)")
    lines.append(f"  noise           {digits(document['noise_floor']):>8} {unit} rms")
    lines.append("")
    for name, probability, closes in rows(document, 4):
        if probability < _SHOWN:
            continue
        lines.append(f"  {name:<40} {percent(probability):>6}  {closes}".rstrip())
    said = flexible(document)
    if said:
        lines += ["", said]
    lines += ["", *(f"- {step}" for step in steps(document, folder)), "", f"{folder}/report.html"]
    return "\n".join(lines)


def rows(document: Mapping[str, Any], most: int) -> list[tuple[str, float, str]]:
    """Candidate, its probability to be the leading one, and what it closes: the likeliest, unknown and none."""
    found = [
        (c["id"], c["probability"], f"closes {percent(max(c['shrink'], 0.0))}" if c["shrink"] > 0.005 else "")
        for c in document["candidates"][:most]
    ]
    found.append(("none of these (unknown)", document["probability_unknown"], ""))
    found.append(("no gap", document["probability_none"], ""))
    return sorted(found, key=lambda row: -row[1])


def _seen(document: Mapping[str, Any]) -> str:
    return f"; it is {document['signature']}" if document["signature"] else ""


def _capital(said: str) -> str:
    return said[:1].upper() + said[1:]
