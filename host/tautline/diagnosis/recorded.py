"""From recordings to the inputs of a diagnosis: all of them on the motor's clock, and a calibration on the first."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from tautline.calibration.calibrate import calibrate
from tautline.calibration.clock import on_motor_clock
from tautline.calibration.result import Calibration
from tautline.quality import Reason
from tautline.recording import Recording, shifted
from tautline.rig import Rig
from tautline.vision.marker import with_marker

Progress = Callable[[float, str], None]

_TRACKING = 0.5  # format: share of a calibration's progress that is of videos


def with_markers(recordings: Sequence[Recording], rig: Rig, progress: Progress) -> list[Recording]:
    """The recordings, with the marker tracked in those that have only a video. progress: called while a video is
    tracked, with the share of the recordings that is done, 0 to 1, and what is done now. TautError as `with_marker`."""
    seen = []
    for i, recording in enumerate(recordings):
        done = i / len(recordings)

        def report_of_all(fraction: float, text: str, done: float = done) -> None:
            """Reports the progress of one recording as a part of all."""
            progress(done + fraction / len(recordings), text)

        seen.append(with_marker(recording, rig, report_of_all))
    return seen


def calibrated(
    recordings: Sequence[Recording], rig: Rig, progress: Progress = lambda fraction, text: None
) -> tuple[Calibration, list[Recording], tuple[Reason, ...]]:
    """(A calibration on the first recording, all recordings on the motor's clock, what there is to say of the others'
    clocks); the marker is tracked in recordings that have only a video. progress: called with the share that is done, 0
    to 1, and what is done now. TautError where nothing can be measured."""
    seen = with_markers(recordings, rig, lambda fraction, text: progress(_TRACKING * fraction, text))
    before = 0.0 if all(new is old for new, old in zip(seen, recordings, strict=True)) else _TRACKING

    def report_calibration(fraction: float, text: str) -> None:
        """Reports the calibration's progress as the part that comes after the videos."""
        progress(before + (1.0 - before) * fraction, text)

    calibration = calibrate(
        seen[:1], rig, progress=report_calibration, naming=False
    )  # a diagnosis names what is in all of them
    tests, of_clocks = on_motor_clock(seen[1:], rig, one_clock=not calibration.offsets)
    return calibration, [*shifted(seen[:1], calibration.offsets), *tests], of_clocks
