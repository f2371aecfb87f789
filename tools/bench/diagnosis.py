"""What a diagnosis costs, calibration included: blind cases of the second instrument, and 12 minutes of recordings."""

from __future__ import annotations

import time
from collections.abc import Sequence

from threadpoolctl import threadpool_limits

from tautline import trajectory
from tautline.calibration.calibrate import calibrate
from tautline.diagnosis.diagnose import diagnose
from tautline.recording import Recording
from tautline.rig import Rig
from tautline.simulated.instrument import preset, reference_rig
from tools.blindtest import cases
from tools.blindtest.reality import Plant, Truth, record

_CASES = (("none", ()), ("single", ("transmission.lag",)), ("pair", ("transmission.creep", "camera.distortion")))
_SEED = 7
_LONG_S = 720.0


def run() -> list[tuple[str, float, str]]:
    """(name, value, unit) rows."""
    rows = []
    with threadpool_limits(1, "blas"):
        diagnose_recordings(*long_recordings(200.0))  # what is imported or built only once
        for kind, effects in _CASES:
            case = cases.make(_SEED, kind, effects)
            seconds = diagnose_recordings(case.rig, [case.calibration, *case.tests])
            rows.append((f"blind case, {' and '.join(effects) or 'nothing wrong'}", seconds, "core s"))
        rig, recordings = long_recordings(_LONG_S)
        lasts = sum(float(r.motor.t_s[-1] - r.motor.t_s[0]) for r in recordings)
        rows.append(
            (f"{lasts / 60:.0f} min of recordings, transmission.creep", diagnose_recordings(rig, recordings), "core s")
        )
    return rows


def diagnose_recordings(rig: Rig, recordings: Sequence[Recording]) -> float:
    """Core seconds; the calibration first."""
    began = time.process_time()
    diagnose(calibrate(recordings[:1], rig).model, recordings[0], recordings[1:])
    return time.process_time() - began


def long_recordings(duration_s: float) -> tuple[Rig, list[Recording]]:
    """A calibration and tests of 200 s at most, together so long, on one clock."""
    rig = reference_rig()
    actuator, instrument = rig.actuator, preset("reference", rig)
    plant = Plant(rig, instrument.grid, instrument.width, instrument.c_deg, 0.05)
    truth = Truth({"creep_share": 0.1, "creep_time": 1.5})
    motions = [trajectory.back_and_forth(actuator, [0.9, 1.8], 2.0, 20, 8.0, 0.4)]
    while (left := duration_s - sum(m.duration_s for m in motions)) > 1.0:
        quick = 1.0 + len(motions) % 3
        motions.append(trajectory.sines(actuator, quick, min(left, 200.0)).with_sway(2.0, 20.0, 17.0))
    recordings, clock = [], 0.0
    for i, motion in enumerate(motions):
        there = truth if i else Truth()
        recordings.append(record(plant, there, motion, clock, _SEED + i, f"motion-{i}", None, clock))
        clock += motion.duration_s + 5.0
    return rig, recordings
