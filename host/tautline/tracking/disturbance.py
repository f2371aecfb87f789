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
    """Watches two running mean squares, in standard deviations: of the tip's distance from its track in the image, and
    of its motion while the motor rests. Remembers, too, when evidence was last judged to be disturbed. resolution: of
    the encoder, unit of q."""

    def __init__(self, resolution: float) -> None:
        """Begins without frames. resolution: of the encoder, unit of q."""
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
        """Updates both running means by a frame. The tip's motion counts only if the motor moved by at most REST_COUNTS
        encoder counts since the frame before; its mean begins anew where the last such frame is _QUIET_S or more ago.
        q: the motor's position at the frame, unit of q; seen: the angle that it shows; level: rms, in standard
        deviations, of the residuals that the law is known to leave; arrival_s: when the frame arrived, s."""
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
        """Whether evidence was judged to be disturbed less than _QUIET_S before this time, s (`note_judgement`)."""
        return arrival_s < self._quiet_s

    def is_disturbed(self, arrival_s: float) -> bool:
        """Whether something that is no play moves the tip at this time, s: by either running mean, or because evidence
        was judged to be disturbed less than _QUIET_S before."""
        wanders = self._wanders > _WANDERS and self._rested_lately(arrival_s)
        return self.was_judged(arrival_s) or self._off_track > _OFF_TRACK or wanders

    def _rested_lately(self, arrival_s: float) -> bool:
        """Whether a frame less than _QUIET_S before this time, s, was at rest: only such frames show how the tip
        wanders."""
        return arrival_s < self._rested_s + _QUIET_S


class ImageJump:
    """Notices when the image jumps away from where a law that held puts the tip, as with a marker tracker that follows
    another blob, and when it is back. What it showed meanwhile says nothing of the law."""

    def __init__(self) -> None:
        """Begins without frames."""
        self.clear()

    def clear(self) -> None:
        """Forgets the last frame, as at another recording or law: the next frame is no jump away from it."""
        self._before = (np.nan, np.nan)  # the last frame: motor, residual
        self._away, self._foretold = False, 0

    def add(self, q: float, off: float, sigma: float, trusted: bool) -> bool:
        """Adds a frame; returns whether the image is back with it: after a jump, the _BACK-th frame in a row that the
        law foretells. A jump is a change of the residual since the last frame, while the law held, by more than _JUMPS
        sigma and AHEAD times the motor's way. q: the motor's position; off: the frame's residual; sigma: its standard
        deviation, all in the unit of q; trusted: whether the law held until now."""
        q_before, off_before = self._before
        self._before = (q, off)
        if trusted and abs(off - off_before) > _JUMPS * sigma + AHEAD * abs(q - q_before):
            self._away = True
        self._foretold = self._foretold + 1 if abs(off) < OUTLYING * sigma else 0
        back = self._away and self._foretold == _BACK
        self._away &= not back
        return back
