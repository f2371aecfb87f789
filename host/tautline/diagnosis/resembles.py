"""Which effects an unknown cause resembles: those that close most of its gap, and for which their amplitude would have
to vary, which a right effect's does not (wander.py)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tautline.diagnosis import decide, gap
from tautline.diagnosis.fitted import Fit
from tautline.diagnosis.gather import Gathered
from tautline.diagnosis.narration import digits
from tautline.effects import SIMULATOR

_MOST = 3  # format: effects that are listed
_MS = 1e3  # equation: in a second
_ENDS: Mapping[str, tuple[str, str]] = {  # in words, the low and the high end of each axis of wander.py
    "place": ("at low positions", "at high ones"),
    "speed": ("when slow", "when fast"),
    "time": ("early", "late"),
    "side": ("when the motor falls", "when it rises"),
    "load": ("under little load", "under much"),
}


def closest_effects(gathered: Gathered, before: float) -> list[dict[str, Any]]:
    """The list `resembles` of diagnosis.json: the up to _MOST single effects that would close most of an unexplained
    gap. Each has the share of the rms that it closes, and in words its amplitude at both ends of the axis along which
    it varies ("" where it does not vary). before: rms of the tests' gap, px or deg."""
    best: dict[str, dict[str, Any]] = {}
    for candidate, varies in zip(gathered.candidates, decide.wanders(gathered.evidence), strict=True):
        if len(candidate.ids) != 1 or not candidate.predicts_an_effect:
            continue
        name = candidate.ids[0]
        of_tests = candidate.held_out[1:]  # the calibration's recording is the first
        closes = 1.0 - gap.rms(of_tests) / max(before, 1e-300)
        if closes > best.get(name, {"closes": 0.0})["closes"]:
            says = _amplitudes_in_words(candidate.fit, *candidate.wanders[0].between) if varies else ""
            best[name] = {"id": name, "closes": closes, "says": says}
    return sorted(best.values(), key=lambda entry: -entry["closes"])[:_MOST]


def _amplitudes_in_words(fit: Fit, axis: str, low: float, high: float) -> str:
    """The amplitude of the fit's first effect at the low and the high end of an axis, in words ("30 ms when slow, 80 ms
    when fast"); as multiples where the effect has several amplitudes. low, high: multiples of the fitted amplitude."""
    kind = fit.hypothesis.kinds[0]
    name, unit = kind.amplitudes[0].name, kind.amplitudes[0].unit
    if len(kind.amplitudes) == 1 and name in fit.state.values:
        value = fit.state.values[name] * (_MS if unit == "s" else 1.0)
        unit = "ms" if unit == "s" else unit.replace("unit", fit.state.model.rig.actuator.unit)
        sizes = [f"{digits(value * factor)} {unit}".rstrip() for factor in (low, high)]
    else:
        sizes = [f"{digits(factor)} times itself" for factor in (low, high)]
    first, last = _ENDS[axis]
    changed = "changed by " if kind.stage == SIMULATOR else ""
    return f"{changed}{sizes[0]} {first}, {sizes[1]} {last}"
