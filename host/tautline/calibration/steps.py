"""Motors that step: their log jumps within one sample, so that it does not say where the motor went in between. Frames
at which the tip still follows such a step are left out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from tautline import _native
from tautline.calibration.observations import Mask, Track, turning_hysteresis
from tautline.calibration.simulated_track import half_slope_s
from tautline.quality import Reason
from tautline.recording import Motor
from tautline.rig import Rig

Array = npt.NDArray[np.float64]

_FASTER = 5.0  # prior: than in the samples beside it: a jump
_COUNTS, _SHARE = 20.0, 0.01  # prior: a jump is more than so many counts, and than this share of the motor's span
_SWEEPS = 2.0  # prior: spans that the motor must move otherwise, so that B is seen
_SIGMAS, _LEFT = 4.0, 0.05  # tolerance: a tip within so many sigma, or this share of the jump, has settled
_LAST = 4  # tolerance: the fourth part of a time, at its end, in which the tip has settled
_MOST_S = 3.0  # prior: that a tip may take to settle


def motor_jumps(motor: Motor, resolution: float) -> npt.NDArray[np.intp]:
    """Indices of the samples after which the motor jumps: by more than _COUNTS of its encoder's resolution (unit of q)
    and _SHARE of its span, and more than _FASTER times as fast as just before and after."""
    moved = np.abs(np.diff(motor.q))
    speed = moved / np.diff(motor.t_s)
    # The median speed of three samples before and after: a jump may be followed by the jump back.
    padded = np.concatenate([np.zeros(3), speed, np.zeros(3)])
    a, b, c = padded[:-2], padded[1:-1], padded[2:]
    usual = np.maximum(np.minimum(a, b), np.minimum(np.maximum(a, b), c))
    usual_nearby = np.maximum(usual[: len(speed)], usual[4:])
    least = max(_COUNTS * resolution, _SHARE * float(np.ptp(motor.q)))
    return np.flatnonzero((moved > least) & (speed > _FASTER * usual_nearby))


def without_steps(tracks: Sequence[Track], rig: Rig) -> tuple[list[Track], list[Reason], list[str]]:
    """The tracks without frames at which the tip may still follow a jump of the motor; a fatal reason for each track
    whose motor hardly moves but by jumps, which keeps its frames; and a note for each with frames left out."""
    left, reasons, notes = [], [], []
    resolution = rig.actuator.encoder_resolution
    for track in tracks:
        q = track.path.readings.q  # what a path makes of them is no jump
        at = motor_jumps(track.path.readings, resolution) if len(q) > 2 else np.zeros(0, dtype=np.intp)
        if len(at):
            settling = _following_a_step(track, at, rig.nominal_delay_s(track.sensor))
            if _moves_by_jumps(track, at, resolution):
                says = f"{track.name}: the motor steps {len(at)} times within one sample and hardly moves otherwise"
                remedy = "move it at a speed, and record its encoder, not its command"
                reasons.append(Reason("steps", says, remedy, fatal=True))
            elif settling.any():
                notes.append(
                    f"{track.name}: the motor steps {len(at)} times within one sample: {int(settling.sum())} frames at "
                    "which the tip follows were left out"
                )
                seen = ~settling
                track = track.only(seen)
        left.append(track)
    return left, reasons, notes


def _moves_by_jumps(track: Track, at: npt.NDArray[np.intp], resolution: float) -> bool:
    """Whether the jumps after the samples `at` are more than half of the way that the motor goes from turn to turn, and
    the rest is less than _SWEEPS of its span. resolution: of its encoder, unit of q."""
    q = track.path.readings.q
    turns = _native.turns(np.ascontiguousarray(q), turning_hysteresis(track.path, resolution, np.ptp(q)))
    total = float(np.abs(np.diff(q[np.concatenate([[0], turns, [len(q) - 1]]).astype(int)])).sum())
    jumped = float(np.abs(np.diff(q)[at]).sum())
    return jumped > 0.5 * total and total - jumped < _SWEEPS * float(np.ptp(q))


def _following_a_step(track: Track, at: npt.NDArray[np.intp], nominal_s: float) -> Mask:
    """(n,) frames at which the tip may still follow one of the jumps after the samples `at`: from the jump on until y
    stays near its final place, the median of the last quarter of the time to the next jump (_MOST_S at most). Frames
    just before and after are added, where a fit takes the jump for the motor's speed though the tip rests. nominal_s:
    the nominal delay."""
    settling = np.zeros(len(track.t_s), dtype=bool)
    samples_s, beside_s = track.reading.t_s, half_slope_s(track.reading)
    begins = samples_s[at] + min(nominal_s, 0.0) - beside_s
    ends = np.append(samples_s[at[1:]], np.inf)
    for begin, sample_s, end in zip(begins, samples_s[at + 1], ends, strict=True):
        inside = np.flatnonzero((track.t_s > begin) & (track.t_s < min(end, sample_s + nominal_s + _MOST_S)))
        if not len(inside):
            continue
        y, arrival_s = track.y[inside], track.t_s[inside]
        last = np.median(y[-max(1, len(y) // _LAST) :], axis=0)
        away = np.linalg.norm(y - last, axis=1)
        moving = np.flatnonzero(away > max(_SIGMAS * float(track.sigma[0]), _LEFT * float(away[0])))
        settled = min(int(moving[-1]) + 1 if len(moving) else 0, len(inside) - 1)
        settling[inside[arrival_s <= max(arrival_s[settled], sample_s + nominal_s) + beside_s]] = True
    return settling
