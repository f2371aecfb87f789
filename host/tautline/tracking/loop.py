"""The tracker in a loop of one's own: motor samples as they come, frames as they arrive."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from tautline.errors import TautError
from tautline.model import Model
from tautline.rig import MARKER, Sensor
from tautline.tracking.tracker import Change, LawTracker, Row, State

Array = npt.NDArray[np.float64]


class Tracker:
    """Keeps a model calibrated while the instrument is used, row by row as `track` does from files.

    `motor` takes the samples that came since, `see` a frame once the samples up to its scene time are there; each
    returns what was predicted for the frame before it was seen. Of samples beyond a frame nothing is used for it, so
    it does not matter how many come at once.
    """

    def __init__(self, model: Model, sensor: Sensor | None = None) -> None:
        """Begins the first recording. sensor: MARKER or ANGLE, by default the one that the model was calibrated with.
        TautError where the rig has no camera for a marker."""
        self.model, self.sensor = model, sensor or model.sensor
        self._laws = LawTracker(model, self.sensor)
        self._delay_s = model.delay_of(self.sensor)
        self.begin()

    def begin(self) -> None:
        """Begins another recording, whose clock and place of the tip may be others. What was learnt stays; samples of
        the motor that were not used yet are dropped."""
        self._laws.begin()
        self._frame_s = -np.inf  # the last frame's arrival
        self._t_s = np.empty(0)  # (n,) of samples; those after the last frame wait for the next one
        self._moved = np.empty((0, 3))  # (n, 3) their q, translation, mm, and rotation, deg
        self._taken = 0  # how many of them were handed over

    def motor(
        self,
        t_s: npt.ArrayLike,
        q: npt.ArrayLike,
        translation_mm: npt.ArrayLike | None = None,
        rotation_deg: npt.ArrayLike | None = None,
        load_mNm: npt.ArrayLike | None = None,
    ) -> None:
        """Takes samples of the motor, (n,) or one of them, in order of time: t_s, s; q in the rig's unit; translation
        and rotation, at rest (0) where they are None; load_mNm is not used. They are kept until a frame asks for them
        (`see`). TautError for columns of different lengths, times that do not rise, or values that are not finite."""
        times = np.atleast_1d(np.asarray(t_s, dtype=float))
        columns = [times, np.atleast_1d(np.asarray(q, dtype=float))]
        for values in (translation_mm, rotation_deg, load_mNm):
            columns.append(np.zeros(len(times)) if values is None else np.atleast_1d(np.asarray(values, dtype=float)))
        if any(column.shape != times.shape for column in columns):
            raise TautError("the motor's samples and their times differ in number")
        if not (np.diff(times, prepend=self._t_s[-1:]) > 0.0).all() or not np.isfinite(columns[:4]).all():
            raise TautError("the motor's times must rise, and its positions be finite: begin() starts another clock")
        done = max(self._taken - 1, 0)  # drops what was handed over, but the last: later times must be above its own
        self._t_s = np.concatenate([self._t_s[done:], times])
        self._moved = np.concatenate([self._moved[done:], np.column_stack(columns[1:4])])
        self._taken -= done

    def see(self, t_s: float, *seen: float) -> Row:
        """Returns what was predicted for the frame that arrived at t_s, s; what the frame shows is learnt from before
        the next one is predicted. seen: u, v (px) of a marker and, if known, their sigma (px); c (deg) of an angle
        sensor; nothing where the tip was not seen. TautError for a frame that is not later than the last one, before
        any motor sample, or with another count of numbers."""
        if not self._frame_s < t_s < np.inf:
            raise TautError(f"a frame at {t_s:g} s after one at {self._frame_s:g} s: give frames in order of time")
        if seen and len(seen) not in ((2, 3) if self.sensor == MARKER else (1,)):
            raise TautError("a marker is seen at u, v (and sigma) px, an angle sensor's reading is one c in deg")
        scene_s = t_s - self._delay_s
        self._hand_over(scene_s)
        self._frame_s = t_s
        row = self._laws.predict(scene_s, t_s)
        if seen:
            self._laws.see(*seen) if self.sensor == MARKER else self._laws.read(*seen)
        return row

    def _hand_over(self, scene_s: float) -> None:
        """Gives the tracker the motor samples up to a scene time, s on the motor's clock, that it has not got yet; for
        the first frame at least one. TautError where there is none then."""
        upto = int(np.searchsorted(self._t_s, scene_s, side="right"))
        if not np.isfinite(self._frame_s):
            if not len(self._t_s):
                raise TautError("no motor sample came before the first frame: motor(t, q) goes first")
            upto = max(upto, 1)
        if upto > self._taken:
            new = slice(self._taken, upto)
            self._laws.motor(self._t_s[new], self._moved[new, 0], self._moved[new, 1:])
            self._taken = upto

    @property
    def state(self) -> State:
        """Whether the law in use is trusted, stale or being adapted, as of the last frame."""
        return self._laws.state

    @property
    def changes(self) -> list[Change]:
        """Each change of state so far, with the frame at which the new state began, and why."""
        return self._laws.changes

    @property
    def compensation(self) -> float:
        """The share of the calibrated B that may be taken up: the lower bound that the evidence allows; 1 is all of
        it."""
        return self._laws.compensation
