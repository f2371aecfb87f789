"""All causes by id: those that formats.md lists, those of them that only move, those that no list holds."""

from tools.family_three.causes import drive, eye
from tools.family_three.causes.base import Cause
from tools.family_three.causes.hidden_drive import DRIVE
from tools.family_three.causes.hidden_eye import EYE

LISTED: dict[str, type[Cause]] = {
    c.id: c
    for c in (
        drive.EncoderPeriodic, drive.SmoothOnset, drive.AsymmetricBacklash, drive.RateDependentBacklash, drive.Lag,
        drive.Creep, drive.StickSlip, drive.Drift, drive.LoadDependence, drive.Slip, drive.Backlash, drive.Offset,
        drive.Remaining, drive.Swing, drive.AxisCoupling, drive.Contact, eye.NonconstantCurvature, eye.Static,
        eye.DirectionDependent, eye.Shift, eye.Distortion, eye.Delay, eye.Jitter, eye.ClockRate, eye.HeldSamples,
    )
}  # fmt: skip
NOMINAL = ("transmission.backlash", "transmission.offset", "configuration.remaining")
UNLISTED: dict[str, type[Cause]] = {c.id: c for c in (*DRIVE, *EYE)}

__all__ = ["LISTED", "NOMINAL", "UNLISTED", "Cause"]
