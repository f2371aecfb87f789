"""The second instrument with a fault that its set-up hides: there before the calibration, come between it and the
first test, unseen at the one speed that it was calibrated at, or begun at its end."""

from __future__ import annotations

import zlib
from collections.abc import Mapping

import numpy as np

from tautline.diagnosis.fit import DELAY, REMAINING, STATIC, WIDTH
from tautline.diagnosis.gap import rms
from tautline.errors import TautError
from tools.blindtest.cases import VISIBLE, Case, Course, Label, course_of, fitter_of, left_by, plant_of
from tools.blindtest.draws import KNOWN as DRAWS
from tools.blindtest.draws import around
from tools.blindtest.reality import Truth

NAME = "second.setup"
MISPLACED = (STATIC,)  # the rig's hand-eye is wrong from the start
CHANGED = (WIDTH, REMAINING, "transmission.offset", DELAY)  # from the first frame of the first test
ONE_SPEED = (  # from the start, calibrated at one speed
    "transmission.rate_dependent_backlash",
    "transmission.lag",
    "transmission.asymmetric_backlash",
    "transmission.stick_slip",
)
DRIFT = "transmission.drift"  # from the calibration's end
KNOWN = (*MISPLACED, *CHANGED, *ONE_SPEED, DRIFT)
_DRAWS = 8  # tries for an effect that can be seen
_LATE_S = (0.005, 0.03)  # by which the rig's nominal delay is wrong where nothing is


def make(seed: int, kind: str, effects: tuple[str, ...] = ()) -> Case:
    """As cases.make. Where nothing is wrong the rig's delay is: calibration mends that."""
    if kind not in ("single", "none"):
        raise TautError(f"the generator '{NAME}' makes single effects and none: --unknown 0 --pairs 0")
    rng = np.random.default_rng([seed, 0x5E70, zlib.crc32(" ".join((kind, *effects)).encode())])
    chosen = effects or ((str(rng.choice(KNOWN)),) if kind == "single" else ())
    throughout = not set(chosen) & {*CHANGED, DRIFT}
    course = course_of(rng, plant_of(rng), speeds=1 if set(chosen) & set(ONE_SPEED) else 2)
    values, left = _visible(rng, course, chosen, throughout)
    recordings = [course.record(course.plant, Truth(values), throughout, i) for i in range(4)]
    label = Label(kind, chosen, seed, throughout, values, course.plant.noise_px, left, NAME)
    return Case(course.plant.rig, recordings[0], recordings[1:3], recordings[3], label)


def _visible(
    rng: np.random.Generator, course: Course, chosen: tuple[str, ...], throughout: bool
) -> tuple[Mapping[str, float], tuple[float, ...]]:
    """Amplitudes and what they leave: the strongest draw up to the first that is identifiable."""
    if not chosen:
        return {"late": around(rng, *_LATE_S)}, ()
    best: tuple[Mapping[str, float], float] = ({}, -1.0)
    calibrated_s = float(course.starts_s[0] + course.motions[0].duration_s)
    for _ in range(_DRAWS):
        values = DRAWS[chosen[0]](rng, course.plant.rig)
        if chosen[0] == DRIFT:
            values["warms_from"] = calibrated_s
        left = _left(course, chosen[0], Truth(values), throughout)
        if left > best[1]:
            best = values, left
        if left >= VISIBLE * course.plant.noise_px:
            break
    return best[0], (best[1],)


def _left(course: Course, effect: str, truth: Truth, throughout: bool) -> float:
    """px rms per coordinate on the tests, as cases.left_by. A recalibration would move a registration that was wrong
    from the start: of that counts what B, f_remain and delay cannot follow without it."""
    if effect not in MISPLACED:
        return left_by(course, truth, throughout, outside=False)
    fitter = fitter_of(course, truth, throughout)
    if fitter is None:
        return 0.0
    return rms(fitter.coarse.nominal({WIDTH, REMAINING, DELAY}).residuals[1:])
