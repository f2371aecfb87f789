"""All causes by id: those that formats.md lists, those of them that only move, those that no list holds."""

from tools.family_four.causes import drive, watch
from tools.family_four.causes.base import Cause
from tools.family_four.causes.hidden_drive import DRIVE
from tools.family_four.causes.hidden_watch import WATCH

LISTED: dict[str, type[Cause]] = {
    c.id: c
    for c in (
        drive.EncoderPeriodic, drive.SmoothOnset, drive.AsymmetricBacklash, drive.RateDependentBacklash, drive.Lag,
        drive.Creep, drive.StickSlip, drive.Drift, drive.LoadDependence, drive.Slip, drive.Backlash, drive.Offset,
        drive.Remaining, drive.Contact, drive.Swing, drive.AxisCoupling, watch.NonconstantCurvature, watch.Static,
        watch.DirectionDependent, watch.Shift, watch.Distortion, watch.Delay, watch.Jitter, watch.ClockRate,
        watch.HeldSamples,
    )
}  # fmt: skip
NOMINAL = ("transmission.backlash", "transmission.offset", "configuration.remaining")
UNLISTED: dict[str, type[Cause]] = {c.id: c for c in (*DRIVE, *WATCH)}

__all__ = ["LISTED", "NOMINAL", "UNLISTED", "Cause"]
