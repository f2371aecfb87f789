"""Whether something that is no play moves the tip: a hand, a breath, tissue."""

from __future__ import annotations

import numpy as np

from tautline.tracking.beyond import OUTLYING
from tautline.tracking.doubt import CAP
from tautline.tracking.fit import AHEAD
from tautline.tracking.projection import AngleEstimate

_OFF_PACE, _OFF_TRACK = 0.04, 2.0  # prior: of the running mean of squares off the marker's track, where it is disturbed
_WANDER_PACE, _WANDERS = 0.15, 5.0  # prior: of that of squares of the tip's motion while the motor rests
_QUIET_S = 15.0  # loss: without a disturbance, before anything is learnt after one
_JUMPS = 12.0  # prior: standard deviations beside the motor's way, from which no play moves the tip between two frames
_BACK = 10  # loss: frames in a row that the law must foretell after such a jump
REST_COUNTS = 2.0  # prior: of the encoder: a motor that moved by no more between two frames rests


class Disturbance:
    """Running mean squares, in standard deviations, of the tip's distance from its track in the image and of its motion
    while the motor rests; and since when a judgement of the evidence saw none. resolution: of the encoder, unit of
    q."""

    def __init__(self, resolution: float) -> None:
        """Begins without frames."""
        self._resolution = resolution
        self.begin_recording()

    def begin_recording(self) -> None:
        """Forgets all frames and judgements: they are of another recording, with another clock and perhaps another
        place of the tip."""
        self._off_track, self._wanders = 1.0, 1.0
        self._rested_s = -np.inf  # the last frame at rest
        self._before = (np.nan, np.nan, np.nan)  # the last frame: motor, tip (deg), its sigma
        self._quiet_s = -np.inf  # when learning may go on

    def add(self, q: float, seen: AngleEstimate, level: float, arrival_s: float) -> None:
        """Updates both running means by a frame. That of the tip's motion while the motor rests counts a frame before
        which the motor moved by at most REST_COUNTS counts, and begins anew where the last such frame is _QUIET_S or
        more ago. q: the motor's position at the frame, its unit; level: rms, in standard deviations, of the residuals
        that the law is known to leave; arrival_s: when the frame arrived."""
        self._off_track += _OFF_PACE * ((seen.off / level) ** 2 - self._off_track)
        q_before, c_deg, sigma = self._before
        self._before = (q, seen.c_deg, seen.sigma * level)
        if abs(q - q_before) <= REST_COUNTS * self._resolution:  # of the first frame NaN: it is not at rest
            wander = (seen.c_deg - c_deg) / float(np.hypot(sigma, self._before[2]))
            if not self._rested_lately(arrival_s):
                self._wanders = 1.0
            self._rested_s = arrival_s
            self._wanders += _WANDER_PACE * (min(wander**2, CAP) - self._wanders)

    def note_judgement(self, arrival_s: float) -> None:
        """Notes that the evidence up to this time, s, was judged to be disturbed: for _QUIET_S nothing is learnt."""
        self._quiet_s = arrival_s + _QUIET_S

    def was_judged(self, arrival_s: float) -> bool:
        """Whether evidence was judged to be disturbed less than _QUIET_S before this time, s."""
        return arrival_s < self._quiet_s

    def is_disturbed(self, arrival_s: float) -> bool:
        """Whether something that is no play moves the tip, or was judged to less than _QUIET_S before this time, s."""
        wanders = self._wanders > _WANDERS and self._rested_lately(arrival_s)
        return self.was_judged(arrival_s) or self._off_track > _OFF_TRACK or wanders

    def _rested_lately(self, arrival_s: float) -> bool:
        """Whether a frame less than _QUIET_S before this time, s, was at rest: only such frames show how the tip
        wanders."""
        return arrival_s < self._rested_s + _QUIET_S


class Aside:
    """Whether the image jumped away from where a law that held puts the tip, as a tracker that follows another blob
    does, and is back: what it showed meanwhile says nothing of the law."""

    def __init__(self) -> None:
        """Begins without frames."""
        self.clear()

    def clear(self) -> None:
        """Forgets the frame before, as at another recording or law: the next frame is no jump away from it."""
        self._before = (np.nan, np.nan)  # the last frame: motor, residual
        self._away, self._foretold = False, 0

    def add(self, q: float, off: float, sigma: float, trusted: bool) -> bool:
        """Adds a frame. q: the motor's position; off: the frame's residual, sigma its standard deviation, all in the
        unit of q; trusted: whether the law held until now. Returns whether the image is back with this frame."""
        q_before, off_before = self._before
        self._before = (q, off)
        if trusted and abs(off - off_before) > _JUMPS * sigma + AHEAD * abs(q - q_before):
            self._away = True
        self._foretold = self._foretold + 1 if abs(off) < OUTLYING * sigma else 0
        back = self._away and self._foretold == _BACK
        self._away &= not back
        return back
