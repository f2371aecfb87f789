"""Every cause, by its id."""

from tools.family.causes import sensing, transmission, unlisted
from tools.family.causes.base import Cause

LISTED: dict[str, type[Cause]] = {
    c.id: c
    for c in (
        transmission.Eccentric, transmission.Rounded, transmission.OneWayBreakaway, transmission.SpeedFriction,
        transmission.Viscous, transmission.Creep, transmission.StickSlip, transmission.Drift, transmission.Load,
        transmission.Slip, transmission.Width, transmission.Offset, transmission.Swing, sensing.Coupled, sensing.Wall,
        sensing.Law, sensing.Uneven, sensing.HandEye, sensing.ChannelPlay, sensing.Knock, sensing.Lens, sensing.Later,
        sensing.Jitter, sensing.OtherClock, sensing.Held,
    )
}  # fmt: skip
UNLISTED: dict[str, type[Cause]] = {
    c.id: c
    for c in (
        unlisted.ThermalGain, unlisted.RubAfterStroke, unlisted.Walking, unlisted.Refocus, unlisted.Glint,
        unlisted.Cogging, unlisted.Ageing, unlisted.RollingShutter, unlisted.SnapThrough, unlisted.WarmUp,
        unlisted.MainsBeat, unlisted.Breath, unlisted.MarkerSwap, unlisted.Thixotropy, unlisted.Mullins,
        unlisted.CreepingBelt,
    )
}  # fmt: skip
NOMINAL = ("transmission.offset", "transmission.backlash", "configuration.remaining")  # what only moved
