"""Locks a device's exposure where its automatic one has settled: where the exposure changes, the middle of a frame
moves in time by half of the change, and what is followed looks otherwise."""

from __future__ import annotations

from dataclasses import dataclass

import cv2

_SETTLES = 20  # tolerance: frames that an automatic exposure is given: most settle within ten
_V4L2 = "V4L2"
_MANUAL = {_V4L2: 1.0}  # format: of OpenCV's backends: the menu entry of V4L2's control, else a quarter
_MANUAL_ELSE = 0.25  # format: the same
_ALIKE = 1e-3  # tolerance: share: a driver that rounds has obeyed
_UNIT_MS = 0.1  # format: of V4L2's exposure


@dataclass(frozen=True)
class Exposure:
    """The result of `lock`."""

    locked: bool  # the exposure stays as it is
    says: str  # that, or what the camera refused, in a line
    before: float | None = None  # OpenCV's CAP_PROP_AUTO_EXPOSURE as it was found; None where nothing was changed


def lock(capture: cv2.VideoCapture) -> Exposure:
    """Locks an open device's exposure: drops _SETTLES frames, in which the automatic one settles, then sets the same
    value as a manual one. An exposure that is manual already stays. Where the camera refuses, or takes another value,
    it is set back to automatic. Returns what came of it; `before` is set, for `release`, only where the exposure was
    changed."""
    for _ in range(_SETTLES):
        capture.grab()
    backend = capture.getBackendName()
    manual = _MANUAL.get(backend, _MANUAL_ELSE)
    before, value = capture.get(cv2.CAP_PROP_AUTO_EXPOSURE), capture.get(cv2.CAP_PROP_EXPOSURE)
    shown = f"{_UNIT_MS * value:.4g} ms" if backend == _V4L2 else f"{value:g} in the units of {backend}"
    if before == manual:
        return Exposure(True, f"exposure is manual, {shown}")
    if not capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, manual) or capture.get(cv2.CAP_PROP_AUTO_EXPOSURE) != manual:
        capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, before)  # it may have obeyed, and say otherwise
        return Exposure(False, "exposure stays automatic, the camera refuses a manual one: keep the light as it is")
    capture.set(cv2.CAP_PROP_EXPOSURE, value)
    now = capture.get(cv2.CAP_PROP_EXPOSURE)
    if abs(now - value) > _ALIKE * abs(value):
        capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, before)
        return Exposure(
            False, f"exposure stays automatic, the camera takes {now:g} where it was {value:g}: keep the light as it is"
        )
    return Exposure(True, f"exposure locked at {shown}", before)


def release(capture: cv2.VideoCapture, exposure: Exposure | None) -> None:
    """Undoes `lock` on an open device: sets the exposure back to automatic where that was changed."""
    if exposure is not None and exposure.before is not None:
        capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, exposure.before)
