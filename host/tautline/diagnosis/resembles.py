"""What an unknown cause looks like and is not: effects that close much of its gap, and where the amplitude of each
would be another."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tautline.diagnosis import decide, gap
from tautline.diagnosis.fitted import Fit
from tautline.diagnosis.gather import Gathered
from tautline.diagnosis.narration import digits
from tautline.effects import SIMULATOR

_MOST = 3
_ENDS: Mapping[str, tuple[str, str]] = {  # of the axes of wander.py
    "place": ("at low positions", "at high ones"),
    "speed": ("when slow", "when fast"),
    "time": ("early", "late"),
    "side": ("when the motor falls", "when it rises"),
    "load": ("under little load", "under much"),
}


def closest_effects(gathered: Gathered, before: float) -> list[dict[str, Any]]:
    """Up to three single effects with a path that close most of an unexplained gap: the share that each closes, and in
    which conditions its amplitude would be another ("" where it wanders not). before: rms of the gap."""
    best: dict[str, dict[str, Any]] = {}
    for one, wanders in zip(gathered.candidates, decide.wanders(gathered.evidence), strict=True):
        if len(one.ids) != 1 or not one.follows:
            continue
        closes = 1.0 - gap.rms(one.left[1:]) / max(before, 1e-300)
        if closes > best.get(one.ids[0], {"closes": 0.0})["closes"]:
            says = _amplitudes_in_words(one.fit, *one.wanders[0].between) if wanders else ""
            best[one.ids[0]] = {"id": one.ids[0], "closes": closes, "says": says}
    return sorted(best.values(), key=lambda entry: -entry["closes"])[:_MOST]


def _amplitudes_in_words(fit: Fit, axis: str, low: float, high: float) -> str:
    """The amplitude at the low and the high end of an axis in words, with its unit where it is one number. low, high:
    multiples of the fitted amplitude."""
    kind = fit.hypothesis.kinds[0]
    name, unit = kind.amplitudes[0].name, kind.amplitudes[0].unit
    if len(kind.amplitudes) == 1 and name in fit.state.values:
        value = fit.state.values[name] * (1e3 if unit == "s" else 1.0)
        unit = "ms" if unit == "s" else unit.replace("unit", fit.state.model.rig.actuator.unit)
        sizes = [f"{digits(value * times)} {unit}".rstrip() for times in (low, high)]
    else:
        sizes = [f"{digits(times)} times itself" for times in (low, high)]
    first, last = _ENDS[axis]
    changed = "changed by " if kind.stage == SIMULATOR else ""
    return f"{changed}{sizes[0]} {first}, {sizes[1]} {last}"
