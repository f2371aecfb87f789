"""From recordings to the inputs of a diagnosis: all of them on the motor's clock, and a calibration on the first."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from tautline.calibration.calibrate import calibrate
from tautline.calibration.clock import on_motor_clock
from tautline.calibration.result import Calibration
from tautline.recording import Recording, shifted
from tautline.rig import Rig
from tautline.vision.marker import with_marker

Progress = Callable[[float, str], None]


def calibrated(
    recordings: Sequence[Recording], rig: Rig, progress: Progress = lambda fraction, text: None
) -> tuple[Calibration, list[Recording]]:
    """(A calibration on the first recording, all recordings on the motor's clock), with their marker tracked where they
    have a video only. progress: called with the share that is done, 0 to 1, and what is done now. TautError where
    nothing can be measured."""
    seen = [with_marker(recording, rig, progress) for recording in recordings]
    calibration = calibrate(seen[:1], rig, progress=progress, naming=False)  # a diagnosis names what is in all of them
    return calibration, [*shifted(seen[:1], calibration.offsets), *on_motor_clock(seen[1:], rig)]
