"""The diagnosis in words, out of the content of a diagnosis.json (`document`): one sentence, what to do next, and the
text that a terminal shows."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tautline.calibration.worth import PREDICTS
from tautline.diagnosis import simulator_words
from tautline.diagnosis.confounded import DRIFT, LOAD
from tautline.effects import BY_ID, EVENTS
from tautline.undone import COUPLED

_NOISIER = 2.0  # format: times the calibration's noise from which on this is said of the tests
_SMALL = 3.0  # format: times the noise: a smaller gap is called small
_REMAINS = {  # why no table of the board undoes an effect
    "transmission.rest_dependent_backlash": "it goes with the rest before, which no section of a table holds",
    "transmission.stick_slip": "where the tip sticks next is chance",
    "configuration.contact": "what holds the tip back is not the transmission",
    "configuration.swing": "a swing needs to be seen",
    "acquisition.jitter": "it is the frames' times",
    "acquisition.held_samples": "it is the sensor's link",
}
SHOWN = 0.005  # format: probability from which on a candidate is shown
_ROWS, _PLACES = 4, 3  # format: candidates, places to look at, that are listed
_WHOLE, _LEAST_DIGITS = 999.5, 1e-3  # format: from which numbers are whole, below which they have six decimals
_NO_PATH = "It has no path that repeats, so no model can predict it away."
_IN_WORDS = 2  # format: named effects that have a sentence each; of more only the first has
_NEAR = 0.1  # format: share of a gap that an effect or a refit must close to be mentioned
_EARLY = 0.5  # format: probability from which an unknown cause is said to have been there from the start
_CLOSED = 0.995  # format: shrinkage from which a gap is said to close
LEAST_TOLD = 0.005  # format: share of a gap below which nothing is said of what an effect closes
_HARDLY = 0.15  # format: share of a gap that a flexible model closes: below it, hardly any
_SINCE = {
    "start": " from the start",
    "calibration": " since the calibration",
    "recording": ", another in each recording",
}
_LEFT_OUT = 0.02  # format: share of the frames that are left out, from which this is said
_SHRINKS = 0.02  # format: shrinkage by an event's mean effect, from which it is said to repeat


def digits(value: float) -> str:
    """`value` with three significant digits and without an exponent: whole numbers from 1000 on, six decimals below
    0.001."""
    if abs(value) >= _WHOLE:
        return f"{value:.0f}"
    return f"{value:.3g}" if abs(value) >= _LEAST_DIGITS or value == 0 else f"{value:.6f}"


def listed(names: Sequence[str], last: str = "and") -> str:
    """Joins at least one name as "a, b and c"; `last` is the word before the last one."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} {last} {names[-1]}"


def sentence(document: Mapping[str, Any]) -> str:
    """The diagnosis in a sentence: verdict, effects and shrinkage; what cannot be told apart follows in further
    ones."""
    if document["verdict"] == "none":
        own = document.get("calibration_leaves", 0.0)
        beyond = (
            f"what it leaves of its own calibration ({digits(own)})" if _calibration_leaves_much(document) else "noise"
        )
        return (
            f"No gap beyond {beyond}: the calibrated model predicts motions that it never saw to "
            f"{_size_before(document)}, and the noise alone is {digits(document['noise_floor'])}{_noisier(document)}."
        )
    return _unknown_sentence(document) if document["verdict"] == "unknown" else _effect_sentences(document)


def _noisier(document: Mapping[str, Any]) -> str:
    """By how many times the tests are noisier than the calibration, to follow the noise; "" below _NOISIER."""
    times = document.get("noisier", 1.0)
    return f", {times:.2g} times that of the calibration" if times >= _NOISIER else ""


def _size_before(document: Mapping[str, Any]) -> str:
    """The rms of the gap before the correction, with its unit, as "0.42 deg rms"."""
    return f"{digits(document['gap']['before'])} {document['unit']} rms"


def _times_noise(document: Mapping[str, Any]) -> str:
    """The rms of the gap before the correction as a multiple of the noise, as "12 times the noise"."""
    return f"{document['gap']['before'] / document['noise_floor']:.2g} times the noise"


def _unknown_sentence(document: Mapping[str, Any]) -> str:
    """As `sentence`, for a gap with an unknown cause: which effect or refit would close most of it, and why that is not
    its cause."""
    before, times = _size_before(document), _times_noise(document)
    if _was_early(document):
        return (
            f"Nothing has changed since the calibration, but a gap of {before}, {times}, was there already: the "
            f"calibration leaves as much of its own recording, and no known effect explains it{_pattern(document)}."
        )
    small = _is_small(document)
    what = "Nothing large is left: a small gap" if small else "A gap"
    pattern = "" if small else _pattern(document)
    nearest = max(document["candidates"], key=lambda c: c["shrink"], default=None)
    recalibrated = 1.0 - document["gap_recalibrated"]["before"] / max(document["gap"]["before"], 1e-300)
    if nearest and nearest["shrink"] > max(_NEAR, recalibrated):
        return (
            f"{what} of {before}, {times}: of the known effects {nearest['id']} comes nearest and would close "
            f"{percent(nearest['shrink'])}, but {_reason_against(document, nearest['id'])}{pattern}."
        )
    if recalibrated > _NEAR:
        return (
            f"{what} of {before}, {times}: refitting B, f_remain and registration would close {percent(recalibrated)} "
            f"of it, but leaves what they could not{pattern}."
        )
    return f"{what} of {before}, {times}, that no known effect explains{pattern}."


def _named_effects(document: Mapping[str, Any]) -> str:
    """The named effects in words, each with its id and probability; of more than _IN_WORDS only the first has words."""
    effects = document["effects"]
    said = [
        f"{simulator_words.says(document, e['id'])}{_since_of_part(document, e)} "
        f"({e['id']}, {percent(e['probability'])} sure{_brought_clause(e)}{_alternatives_clause(e) if i else ''})"
        for i, e in enumerate(effects)
    ]
    if len(effects) > _IN_WORDS:
        rest = [f"{e['id']} ({percent(e['probability'])}{_alternatives_clause(e)})" for e in effects[1:]]
        said = [said[0], f"beside it {listed(rest)}"]
    return listed(said)


def _without_repeats(document: Mapping[str, Any]) -> str:
    """What of the gap is left where the samples that repeat are left out, as a sentence; "" where they are not first
    among the named effects."""
    adds = document["effects"][0].get("adds")
    if adds is None:
        return ""
    fresh = math.sqrt(max(document["gap"]["before"] ** 2 - adds**2, 0.0))
    return f" Leave out the samples that repeat: {digits(fresh)} {document['unit']} of it are left."


def _effect_sentences(document: Mapping[str, Any]) -> str:
    """As `sentence`, where effects are named."""
    gap, effects = document["gap"], document["effects"]
    named, before, times = _named_effects(document), _size_before(document), _times_noise(document)
    if effects[0]["id"] in EVENTS and gap["shrink"] > _SHRINKS:
        text = (
            f"{_capitalised(named)}: what of it repeats shrinks the gap by {percent(gap['shrink'])} in the model, from "
            f"{before} to {digits(gap['after'])}; the rest has no path, so no model can predict it away."
        )
    elif effects[0]["id"] in EVENTS:
        text = f"{_capitalised(named)}: a gap of {before}, {times}. {_NO_PATH}{_without_repeats(document)}"
    else:
        shrinks = "closes" if gap["shrink"] > _CLOSED else f"shrinks by {percent(gap['shrink'])}"
        text = (
            f"{_capitalised(named)}: with {'it' if len(effects) == 1 else 'them'} in the model the gap {shrinks}, "
            f"from {before} to {digits(gap['after'])}{_closed_above_noise_clause(gap)}; on another motion expect "
            f"{_interval_in_percent(gap['shrink_ci'])}."
        )
    others = [name for name in effects[0]["ambiguous_with"] if name not in {e["id"] for e in effects}]
    if others:
        which = "it" if len(effects) == 1 else "the former"
        text += f" These motions cannot tell {which} from {listed(others, 'or')}."
    if document["signature"]:
        text += f" The gap is {document['signature']}."
    return text


def _reason_against(document: Mapping[str, Any], name: str) -> str:
    """The reason why an unknown cause is not the effect `name`, which it resembles, a clause to follow "but": its
    amplitude would have to vary, as `says` in `resembles` has it; else it leaves more than it would as the cause."""
    says = next((entry["says"] for entry in document.get("resembles", ()) if entry["id"] == name), "")
    return f"would be another law elsewhere ({says})" if says else "leaves what it could not"


def _closed_above_noise_clause(gap: Mapping[str, Any]) -> str:
    """A clause that says which share of the gap's power above the noise is closed; "" unless this share is clearly
    larger than the shrinkage of the rms."""
    share = gap.get("closable_shrink")
    if share is None or share - gap["shrink"] < _NEAR:
        return ""
    return f", {percent(share)} of its power above the noise"


def _brought_clause(effect: Mapping[str, Any]) -> str:
    """A clause that lists the parts of the nominal model that a named effect changed too; "" where there are none."""
    parts = [part["id"] for part in effect.get("brings", ())]
    return f"; it brings a change of {listed(parts)}" if parts else ""


def _alternatives_clause(effect: Mapping[str, Any]) -> str:
    """A clause that lists the other effects that may be there in the place of a named one; "" where there are none."""
    others = effect["ambiguous_with"]
    return f", or else {listed(others, 'or')}" if others else ""


def since(document: Mapping[str, Any], part: Mapping[str, Any]) -> str:
    """A phrase, to follow a sentence, that says since when an effect or part of the nominal model (an entry of
    diagnosis.json) is there. "" for "calibration" beside a simulator, whose runs stand in for the calibration: the
    effect is then in all of the robot's recordings."""
    in_robot = "simulator" in document and part["since"] == "calibration"
    return "" if in_robot else _SINCE[part["since"]]


def _since_of_part(document: Mapping[str, Any], effect: Mapping[str, Any]) -> str:
    """As `since`, if the effect is a part of the nominal model; "" for other effects."""
    return since(document, effect) if BY_ID[effect["id"]].nominal else ""


def moved(document: Mapping[str, Any]) -> str:
    """A sentence that lists the parts of the nominal model that moved, with their shares; "" for one part or none, as
    `sentence` names it."""
    parts = document["moved"]
    if len(parts) < 2:
        return ""
    said = [p["id"] + since(document, p) + f" ({percent(p['share'])})" for p in parts]
    return f"What had to move: {listed(said)}."


def percent(share: float) -> str:
    """A share, 0 to 1, as whole percent: "12 %"."""
    return f"{round(100 * share)} %"


def _interval_in_percent(interval: Sequence[float]) -> str:
    """An interval (low, high) of shares, 0 to 1, as "12 to 34 %"."""
    low, high = interval
    return f"{round(100 * low)} to {percent(high)}"


def flexible(document: Mapping[str, Any]) -> str:
    """Sentences on what a Gaussian process, which knows no physics, would close of the gap, or with named effects of
    what is left of it, and on an oscillation if there is one; "" where no process was fitted."""
    closed = document.get("flexible")
    if not closed:
        return ""
    what = "what is left" if document["verdict"] == "effect" else "the gap"
    swing = _swing_period(document)
    text = ""
    if swing:
        text = (
            f"{_capitalised(what)} swings with a period of {swing:.2g} s ({60 / swing:.0f} a minute), whatever the "
            "motor does. "
        )
    share = closed["closable_shrink"]
    process = "a flexible model of motor position, travel since the reversal, speed, time and the other axes"
    if share < _HARDLY:
        return text + (
            f"{_capitalised(process)} would follow hardly any of {what}: it goes with nothing that was recorded, "
            "or does not repeat."
        )
    return text + (
        f"{_capitalised(process)} would follow {percent(share)} of {what} above the noise "
        f"({digits(closed['before'])} to {digits(closed['after'])} {document['unit']} rms): so much of it repeats."
    )


@dataclass(frozen=True)
class NextStep:
    """Something that the user should do next."""

    says: str  # in a sentence
    command: str = ""  # that does it; "" where none does


def steps(document: Mapping[str, Any], folder: str) -> list[NextStep]:
    """What the user should do next, the most useful first. folder: where the diagnosis is kept, for the commands."""
    if document["verdict"] == "none" or _is_small(document):
        as_it_is = NextStep("Use the model as it is: these motions show nothing large that it lacks.")
        of_simulator = simulator_words.steps({**document, "effects": []})  # no effect is large enough to be added
        return [*map(NextStep, of_simulator), as_it_is]
    effects, kept = document["effects"], shlex.quote(folder)
    is_event = bool(effects) and effects[0]["id"] in EVENTS
    todo = [*_steps_to_look(document), *_steps_to_record(document, kept)]
    if is_event:
        event = BY_ID[effects[0]["id"]].event
        assert event
        todo.append(NextStep(f"Mend the cause, {event.cause}: no table and no model takes its {event.what} away."))
    if effects and (not is_event or document["gap"]["shrink"] > _SHRINKS):
        todo.append(
            NextStep("Predict with the corrected model.", f"taut predict {kept}/corrected RECORDING --csv OUT.csv")
        )
    if any(p["since"] == "start" and p["id"] == "registration.static" for p in document["moved"]):
        todo.append(
            NextStep(
                "Put the corrected hand-eye transform into the rig, and calibrate with it again: f_remain was bent "
                f"by the wrong one ([hand_eye] of {folder}/corrected/rig.toml)."
            )
        )
    if "simulator" in document:
        return [*todo, *map(NextStep, simulator_words.steps(document))]
    return todo + (_steps_with_tables(effects, kept) if effects and not is_event else [])


def _steps_to_look(document: Mapping[str, Any]) -> list[NextStep]:
    """The step that says where to look at the instrument for the cause: what swings with a known period, or, if the
    cause is unknown, where the gap is largest. [] for a known cause."""
    swing = _swing_period(document)
    if swing and not document["effects"]:
        return [NextStep(f"Look for what moves every {swing:.2g} s: breathing, a heartbeat, a loose mount, a fan.")]
    if document["verdict"] != "unknown":
        return []
    if _was_early(document):
        return [NextStep("See what the calibration's own verdict says, and calibrate again once that is mended.")]
    where = listed([f"{c['says']} ({c['axis']})" for c in document["where"]["conditions"][:_PLACES]])
    return [NextStep(f"Look at the instrument where the gap is largest: {where}.")]


def _steps_to_record(document: Mapping[str, Any], folder: str) -> list[NextStep]:
    """The step that says what to record so that effects which could not be told apart can be; [] where there is nothing
    to tell apart. folder: the diagnosis', quoted for a shell."""
    effects, following = document["effects"], document["next_motion"]
    ambiguous = {name for e in effects for name in (e["id"], *e["ambiguous_with"])}
    if {LOAD, DRIFT} <= ambiguous:
        return [
            NextStep(
                "Record the first load once more, or a third one, and diagnose with it too: no drift comes back, "
                "and one slope serves all loads."
            )
        ]
    if following and (document["verdict"] == "unknown" or any(e["ambiguous_with"] for e in effects)):
        return [
            NextStep(
                f"Record the motion that tells the leading candidates apart ({following['why']}), and diagnose with it "
                "too.",
                f"taut record --motion {folder}/{following['file']} --rig {folder}/nominal/rig.toml --out more",
            )
        ]
    return []


def _steps_with_tables(effects: Sequence[Mapping[str, Any]], folder: str) -> list[NextStep]:
    """The steps that use the corrected tables, in the order in which they are told. effects: the named ones, the
    leading one first; folder: where the diagnosis wrote `corrected`, quoted for a shell."""
    todo = [
        NextStep(
            "Try the tables against an instrument that has this effect.",
            f"taut follow {folder}/corrected --simulate {folder}/corrected",
        ),
        board(effects, folder),
    ]
    if effects[0]["swallowed_by_recalibration"]:
        todo.append(
            NextStep(
                "Or calibrate on all these recordings: that closes the gap as well, without knowing why.",
                "taut calibrate CALIBRATION TEST... --out MODEL",
            )
        )
    return todo


def board(effects: Sequence[Mapping[str, Any]], folder: str) -> NextStep:
    """The step that loads the corrected tables into a board: the command, and which of the named effects (entries of
    diagnosis.json) no table can undo, with the reasons. folder: the diagnosis', quoted for a shell."""
    command = f"taut flash {folder}/corrected"
    coupled = any(e["id"] == COUPLED for e in effects)
    if coupled:
        command += " --joint COLUMN=AXIS:RESOLUTION"
    left = [e["id"] for e in effects if not e["loads_on_board"]]
    if left:
        why = listed([f"{name} ({_REMAINS[name]})" if name in _REMAINS else name for name in left])
        rest = (
            "the rest of what was named they do"
            if len(left) < len(effects)
            else "what they hold is B and f_remain as fitted beside it"
        )
        return NextStep(f"No table can undo {why}; {rest}.", f"{command} --without-effects")
    if coupled:
        says = "Load the corrected tables into the board, and say which of its axes moves the column that couples in."
        return NextStep(says, command)
    return NextStep("Load the corrected tables into the board.", command)


def tip(document: Mapping[str, Any]) -> str:
    """A sentence on the simulated error of the tip with the old and with the new tables; "" where it was not
    simulated."""
    errors = document.get("tip")
    if not errors:
        return ""
    before, after = digits(errors["before_deg"]), digits(errors["after_deg"])
    return (
        f"On the instrument that this diagnosis says, the calibrated tables leave the tip off by {before} deg rms, the "
        f"corrected ones by {after} (simulated on a smooth trajectory)."
    )


def left_out_frames(document: Mapping[str, Any]) -> str:
    """A sentence on the share of the videos' frames that were not scored, and why; "" where hardly any were left
    out."""
    tracked = document.get("tracker")
    if not tracked or tracked["left_out"] < _LEFT_OUT:
        return ""
    return (
        f"{percent(tracked['left_out'])} of the frames are left out: at these places the marker is seen wrong in the "
        "calibration too (glare, or something in front of it)."
    )


def text(document: Mapping[str, Any], folder: str) -> str:
    """The whole diagnosis as text for a terminal: sentence, sizes of the gap, candidates, next steps, and the path of
    its page. folder: where the diagnosis is kept."""
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
    for paragraph in (moved(document), simulator_words.step(document)):
        lines += ["", f"  {paragraph}"] if paragraph else []
    lines.append("")
    for name, probability, closes in rows(document, _ROWS):
        lines.append(f"  {name:<40} {percent(probability):>6}  {closes}".rstrip())
    closed = flexible(document)
    if closed:
        lines += ["", closed]
    for paragraph in (tip(document), left_out_frames(document)):
        lines += ["", paragraph] if paragraph else []
    lines.append("")
    for step in steps(document, folder):
        lines += [f"- {step.says}", *([f"    {step.command}"] if step.command else [])]
    lines += ["", f"{folder}/report.html"]
    return "\n".join(lines)


def rows(document: Mapping[str, Any], most: int) -> list[tuple[str, float, str]]:
    """[(id or words, probability to lead, what it closes in words)], the likeliest first: up to `most` candidates, an
    unknown cause and no gap, if their probability is at least SHOWN. The words are "" where an effect closes next to
    nothing."""
    least = least_told(document)
    said = [
        (c["id"], c["probability"], f"closes {percent(c['shrink'])}" if c["shrink"] > least else "")
        for c in document["candidates"][:most]
    ]
    said += [
        ("none of these (unknown)", document["probability_unknown"], ""),
        ("no gap", document["probability_none"], ""),
    ]
    return sorted((row for row in said if row[1] >= SHOWN), key=lambda row: -row[1])


def least_told(document: Mapping[str, Any]) -> float:
    """The share of the gap that an effect must close for it to be said; it depends on the verdict."""
    return {"effect": LEAST_TOLD, "unknown": _NEAR, "none": 1.0}[str(document["verdict"])]


def _pattern(document: Mapping[str, Any]) -> str:
    """A clause on the pattern of an unexplained gap: its period if it swings, else its signature; "" where neither was
    seen."""
    swing = _swing_period(document)
    if swing:
        return f"; it swings with a period of {swing:.2g} s, whatever the motor does"
    return f"; it is {document['signature']}" if document["signature"] else ""


def _swing_period(document: Mapping[str, Any]) -> float | None:
    """The period, s, of an oscillation of the gap that no motion drives. None where there is none, or where no Gaussian
    process was fitted."""
    closed = document.get("flexible")
    return closed.get("swing_s") if closed else None


def _calibration_leaves_much(document: Mapping[str, Any]) -> bool:
    """Whether the calibrated model leaves more than PREDICTS times the noise on its own calibration."""
    return bool(document.get("calibration_leaves", 0.0) > PREDICTS * document["noise_floor"])


def _was_early(document: Mapping[str, Any]) -> bool:
    """Whether the cause is unknown and was probably there while calibrating already, with nothing changed since."""
    return document["verdict"] == "unknown" and bool(document.get("unknown_from_start", 0.0) > _EARLY)


def _is_small(document: Mapping[str, Any]) -> bool:
    """Whether the gap has an unknown cause that came later, and its rms is below _SMALL times the noise."""
    small = bool(document["gap"]["before"] < _SMALL * document["noise_floor"])
    return document["verdict"] == "unknown" and small and not _was_early(document)


def _capitalised(sentence: str) -> str:
    """The sentence with its first letter in upper case; the rest stays as it is."""
    return sentence[:1].upper() + sentence[1:]
