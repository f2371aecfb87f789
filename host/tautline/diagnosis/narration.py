"""The diagnosis in words: one sentence, what to do next, and the table that a terminal shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tautline.diagnosis import simulator_words
from tautline.diagnosis.confounded import DRIFT, LOAD
from tautline.effects import BY_ID, EVENTS
from tautline.undone import COUPLED

_SMALL = 3.0  # format: times the noise: a gap below is called small
_REMAINS = {  # why
    "transmission.stick_slip": "where the tip sticks next is chance",
    "configuration.contact": "what holds the tip back is not the transmission",
    "configuration.swing": "a swing needs to be seen",
    "acquisition.jitter": "it is the frames' times",
    "acquisition.held_samples": "it is the sensor's link",
}
SHOWN = 0.005  # format: probability from which on a candidate is shown
_NO_PATH = "It has no path that repeats, so no model can predict it away."
_TOLD = 2  # effects that are told in words
_NEAR = 0.1  # format: of a gap that an effect or a refit closes: it is told beside "unknown"
SINCE = {
    "start": " from the start",
    "calibration": " since the calibration",
    "recording": ", another in each recording",
}
_LEFT_OUT = 0.02  # format: share of the frames, from which it is told
_SHRINKS = 0.02  # format: of a gap that jumps or unsteady times leave: part of it has a path


def digits(value: float) -> str:
    """Three significant digits, without an exponent: whole numbers from 1000 on, six decimals below 0.001."""
    if abs(value) >= 999.5:
        return f"{value:.0f}"
    return f"{value:.3g}" if abs(value) >= 1e-3 or value == 0 else f"{value:.6f}"


def listed(names: Sequence[str], last: str = "and") -> str:
    """One name or more as "a, b and c", with `last` before the last one."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} {last} {names[-1]}"


def sentence(document: Mapping[str, Any]) -> str:
    """Verdict, effect and shrinkage in one sentence."""
    gap, unit, floor = document["gap"], document["unit"], document["noise_floor"]
    before = f"{digits(gap['before'])} {unit} rms"
    times = f"{gap['before'] / floor:.2g} times the noise"
    if document["verdict"] == "none":
        return (
            f"No gap beyond noise: the calibrated model predicts motions that it never saw to {before}, "
            f"and the noise alone is {digits(floor)}."
        )
    if document["verdict"] == "unknown":
        small = _is_small(document)
        what = "Nothing large is left: a small gap" if small else "A gap"
        seen = "" if small else _pattern(document)
        near = max(document["candidates"], key=lambda c: c["shrink"], default=None)
        again = 1.0 - document["gap_recalibrated"]["before"] / max(gap["before"], 1e-300)
        if near and near["shrink"] > max(_NEAR, again):
            return (
                f"{what} of {before}, {times}: of the known effects {near['id']} comes nearest and would close "
                f"{percent(near['shrink'])}, but {_why_not(document, near['id'])}{seen}."
            )
        if again > _NEAR:
            return (
                f"{what} of {before}, {times}: refitting B, f_remain and registration would close {percent(again)} of "
                f"it, but leaves what they could not{seen}."
            )
        return f"{what} of {before}, {times}, that no known effect explains{seen}."
    effects = document["effects"]
    told = [
        f"{simulator_words.says(document, e['id'])}{_since(e)} "
        f"({e['id']}, {percent(e['probability'])} sure{_brings(e)}{_or_else(e) if i else ''})"
        for i, e in enumerate(effects)
    ]
    if len(effects) > _TOLD:
        rest = [f"{e['id']} ({percent(e['probability'])}{_or_else(e)})" for e in effects[1:]]
        told = [told[0], f"beside it {listed(rest)}"]
    named = listed(told)
    if effects[0]["id"] in EVENTS and gap["shrink"] > _SHRINKS:
        text = (
            f"{_capital(named)}: what of it repeats shrinks the gap by {percent(gap['shrink'])} in the model, from "
            f"{before} to {digits(gap['after'])}; the rest has no path, so no model can predict it away."
        )
    elif effects[0]["id"] in EVENTS:
        text = f"{_capital(named)}: a gap of {before}, {times}. {_NO_PATH}"
    else:
        shrinks = "removes" if gap["shrink"] > 0.995 else f"shrinks by {percent(gap['shrink'])}"
        text = (
            f"{_capital(named)}: with {'it' if len(effects) == 1 else 'them'} in the model the gap {shrinks}, "
            f"from {before} to {digits(gap['after'])}{_beside_noise(gap)}; on another motion expect "
            f"{_between(gap['shrink_ci'])}."
        )
    others = [name for name in effects[0]["ambiguous_with"] if name not in {e["id"] for e in effects}]
    if others:
        which = "it" if len(effects) == 1 else "the former"
        text += f" These motions cannot tell {which} from {listed(others, 'or')}."
    if document["signature"]:
        text += f" The gap is {document['signature']}."
    return text


def _why_not(document: Mapping[str, Any], name: str) -> str:
    """Why an unknown cause is not the effect that it resembles."""
    says = next((entry["says"] for entry in document.get("resembles", ()) if entry["id"] == name), "")
    return f"would be another law elsewhere ({says})" if says else "leaves what it could not"


def _beside_noise(gap: Mapping[str, Any]) -> str:
    """The share of the gap's power above the noise that is closed, where it is clearly more than the gap's shrinkage;
    else ""."""
    above = gap.get("closable_shrink")
    if above is None or above - gap["shrink"] < _NEAR:
        return ""
    return f", {percent(above)} of its power above the noise"


def _brings(effect: Mapping[str, Any]) -> str:
    """The parts of the nominal model that a named effect changed too; "" where there are none."""
    parts = [part["id"] for part in effect.get("brings", ())]
    return f"; it brings a change of {listed(parts)}" if parts else ""


def _or_else(effect: Mapping[str, Any]) -> str:
    """Which other effects may be there in the place of a further one; "" where it is told for sure."""
    others = effect["ambiguous_with"]
    return f", or else {listed(others, 'or')}" if others else ""


def _since(effect: Mapping[str, Any]) -> str:
    """Since when, for a part of the nominal model; "" for other effects."""
    return SINCE[effect["since"]] if BY_ID[effect["id"]].nominal else ""


def moved(document: Mapping[str, Any]) -> str:
    """Which parts of the nominal model had to move; "" where the sentence says it all."""
    parts = document["moved"]
    if len(parts) < 2:
        return ""
    told = [p["id"] + SINCE[p["since"]] + f" ({percent(p['share'])})" for p in parts]
    return f"What had to move: {listed(told)}."


def percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def _between(interval: Sequence[float]) -> str:
    low, high = interval
    return f"{100 * low:.0f} to {percent(high)}"


def flexible(document: Mapping[str, Any]) -> str:
    """What a Gaussian process without any physics would close of the gap; "" where none was fitted."""
    closed = document.get("flexible")
    if not closed:
        return ""
    swing = _swing(document)
    if swing:
        asked_of = "What is left" if document["verdict"] == "effect" else "The gap"
        text = (
            f"{asked_of} swings with a period of {swing:.2g} s ({60 / swing:.0f} a minute), whatever the motor does. "
        )
    else:
        text = ""
    what = "what is left" if document["verdict"] == "effect" else "the gap"
    share = closed["closable_shrink"]
    asked = "a flexible model of motor position, travel since the reversal, speed, time and the other axes"
    if share < 0.15:
        return text + (
            f"{_capital(asked)} would follow hardly any of {what}: it goes with nothing that was recorded, "
            "or does not repeat."
        )
    return text + (
        f"{_capital(asked)} would follow {percent(share)} of {what} above the noise "
        f"({digits(closed['before'])} to {digits(closed['after'])} {document['unit']} rms): so much of it repeats."
    )


@dataclass(frozen=True)
class NextStep:
    says: str
    command: str = ""


def steps(document: Mapping[str, Any], folder: str) -> list[NextStep]:
    """What to do next, the most useful first. folder: where the diagnosis is kept."""
    verdict, following = document["verdict"], document["next_motion"]
    effects = document["effects"]
    event = bool(effects) and effects[0]["id"] in EVENTS
    if verdict == "none" or _is_small(document):
        return [NextStep("Use the model as it is: these motions show nothing large that it lacks.")]
    told = []
    swing = _swing(document)
    if swing and not effects:
        told.append(NextStep(f"Look for what moves every {swing:.2g} s: breathing, a heartbeat, a loose mount, a fan."))
    elif verdict == "unknown":
        where = listed([f"{c['says']} ({c['axis']})" for c in document["where"]["conditions"][:3]])
        told.append(NextStep(f"Look at the instrument where the gap is largest: {where}."))
    ambiguous = {name for e in effects for name in (e["id"], *e["ambiguous_with"])}
    if {LOAD, DRIFT} <= ambiguous:
        told.append(
            NextStep(
                "Record the first load once more, or a third one, and diagnose with it too: no drift comes back, "
                "and one slope serves all loads."
            )
        )
    elif following and (verdict == "unknown" or any(e["ambiguous_with"] for e in effects)):
        told.append(
            NextStep(
                f"Record the motion that tells the leading candidates apart ({following['why']}), and diagnose with it "
                "too.",
                f"taut record --motion {folder}/{following['file']} --rig {folder}/nominal/rig.toml --out more",
            )
        )
    if event:
        kind = BY_ID[effects[0]["id"]].event
        assert kind
        told.append(NextStep(f"Mend the cause, {kind.cause}: no table and no model takes its {kind.what} away."))
    if effects and (not event or document["gap"]["shrink"] > _SHRINKS):
        told.append(
            NextStep("Predict with the corrected model.", f"taut predict {folder}/corrected RECORDING --csv OUT.csv")
        )
    if any(p["since"] == "start" and p["id"] == "registration.static" for p in document["moved"]):
        told.append(
            NextStep(
                "Put the corrected hand-eye transform into the rig, and calibrate with it again: f_remain was bent "
                f"by the wrong one ([hand_eye] of {folder}/corrected/rig.toml)."
            )
        )
    if "simulator" in document:
        return [*told, *map(NextStep, simulator_words.steps(document))]
    if effects and not event:
        told.append(
            NextStep(
                "Try the tables against an instrument that has this effect.",
                f"taut follow {folder}/corrected --simulate {folder}/corrected",
            )
        )
        told.append(board(effects, folder))
        if effects[0]["swallowed_by_recalibration"]:
            told.append(
                NextStep(
                    "Or calibrate on all these recordings: that closes the gap as well, without knowing why.",
                    "taut calibrate CALIBRATION TEST... --out MODEL",
                )
            )
    return told


def board(effects: Sequence[Mapping[str, Any]], folder: str) -> NextStep:
    """The next step at the board: what `taut flash` can load of the named effects."""
    left = [e["id"] for e in effects if not e["loads_on_board"]]
    if left:
        why = [f"{name} ({_REMAINS[name]})" if name in _REMAINS else name for name in left]
        return NextStep(
            f"No table can undo {listed(why)}; the rest of what was named they do.",
            f"taut flash {folder}/corrected --without-effects",
        )
    if any(e["id"] == COUPLED for e in effects):
        return NextStep(
            "Load the corrected tables into the board, and say which of its axes moves the column that couples in.",
            f"taut flash {folder}/corrected --joint COLUMN=AXIS:RESOLUTION",
        )
    return NextStep("Load the corrected tables into the board.", f"taut flash {folder}/corrected")


def tip(document: Mapping[str, Any]) -> str:
    """The simulated error of the tip with the old and the new tables; "" where it was not simulated."""
    errors = document.get("tip")
    if not errors:
        return ""
    before, after = digits(errors["before_deg"]), digits(errors["after_deg"])
    return (
        f"On the instrument that this diagnosis says, the calibrated tables leave the tip off by {before} deg rms, the "
        f"corrected ones by {after} (simulated on a smooth trajectory)."
    )


def left_out_frames(document: Mapping[str, Any]) -> str:
    """Which share of the videos' frames was not scored, and why; "" where hardly any."""
    tracked = document.get("tracker")
    if not tracked or tracked["left_out"] < _LEFT_OUT:
        return ""
    return (
        f"{percent(tracked['left_out'])} of the frames are left out: at these places the marker is seen wrong in the "
        "calibration too (glare, or something in front of it)."
    )


def text(document: Mapping[str, Any], folder: str) -> str:
    """The diagnosis as text for a terminal: sentence, gap, candidates, next steps, and where its page is."""
    gap, unit = document["gap"], document["unit"]
    low, high = gap["after_ci"]
    lines = [sentence(document), ""]
    lines.append(f"  gap before      {digits(gap['before']):>8} {unit} rms")
    if document["verdict"] == "effect":
        lines.append(f"  gap after       {digits(gap['after']):>8} {unit} rms ({digits(low)} to {digits(high)})")
    again = document["gap_recalibrated"]["before"]
    if "simulator" not in document:  # that is not calibrated
        lines.append(f"  recalibrated    {digits(again):>8} {unit} rms (B, f_remain and registration refitted on all)")
    lines.append(f"  noise           {digits(document['noise_floor']):>8} {unit} rms")
    if moved(document):
        lines += ["", f"  {moved(document)}"]
    lines.append("")
    for name, probability, closes in rows(document, 4):
        if probability < SHOWN:
            continue
        lines.append(f"  {name:<40} {percent(probability):>6}  {closes}".rstrip())
    closed = flexible(document)
    if closed:
        lines += ["", closed]
    for told in (tip(document), left_out_frames(document)):
        lines += ["", told] if told else []
    lines.append("")
    for step in steps(document, folder):
        lines += [f"- {step.says}", *([f"    {step.command}"] if step.command else [])]
    lines += ["", f"{folder}/report.html"]
    return "\n".join(lines)


def rows(document: Mapping[str, Any], most: int) -> list[tuple[str, float, str]]:
    """Up to `most` candidates, unknown and none, each with its probability to lead and what it closes in words (""
    where next to nothing), the likeliest first."""
    least = least_told(document)
    candidates = [
        (c["id"], c["probability"], f"closes {percent(c['shrink'])}" if c["shrink"] > least else "")
        for c in document["candidates"][:most]
    ]
    for name, probability in (
        ("none of these (unknown)", document["probability_unknown"]),
        ("no gap", document["probability_none"]),
    ):
        if probability >= SHOWN:
            candidates.append((name, probability, ""))
    return sorted(candidates, key=lambda row: -row[1])


def least_told(document: Mapping[str, Any]) -> float:
    """The share of the gap below which nothing is said of what an effect closes."""
    return {"effect": 0.005, "unknown": _NEAR, "none": 1.0}[str(document["verdict"])]


def _pattern(document: Mapping[str, Any]) -> str:
    """The pattern of an unexplained gap: a swing's period or the signature; "" where none was seen."""
    swing = _swing(document)
    if swing:
        return f"; it swings with a period of {swing:.2g} s, whatever the motor does"
    return f"; it is {document['signature']}" if document["signature"] else ""


def _swing(document: Mapping[str, Any]) -> float | None:
    """The period, s, in which the gap swings whatever the motor does; None where it does not, or nobody looked."""
    closed = document.get("flexible")
    return closed.get("swing_s") if closed else None


def _is_small(document: Mapping[str, Any]) -> bool:
    """Whether the gap has an unknown cause and its rms is below _SMALL times the noise."""
    return document["verdict"] == "unknown" and bool(document["gap"]["before"] < _SMALL * document["noise_floor"])


def _capital(sentence: str) -> str:
    return sentence[:1].upper() + sentence[1:]
