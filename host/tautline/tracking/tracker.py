"""Stays calibrated while the instrument is used: a causal, recursive estimate of what changed since the calibration.

A row is predicted from the motor up to its scene time and the frames before it; then its own frame may be shown. The
law in use is chosen among hypotheses that are fitted to the frames since the last law stopped holding, a piece of work
in each frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np
import numpy.typing as npt

from tautline import _native
from tautline.errors import TautError
from tautline.model import Model
from tautline.rig import MARKER, Sensor
from tautline.tracking.beyond import Beyond
from tautline.tracking.disturbance import Disturbance, ImageJump
from tautline.tracking.doubt import JUMP, ONSET, Doubt
from tautline.tracking.fit import REACH, SURE, Work
from tautline.tracking.hypotheses import Inference, judge
from tautline.tracking.judgement import Judgement
from tautline.tracking.law import OFFSET, TIP, LawFamily, calibrated_theta
from tautline.tracking.passes import Passes
from tautline.tracking.path import CausalPath, knots
from tautline.tracking.projection import AngleEstimate, Projection
from tautline.tracking.scatter import CommonError, Scatter
from tautline.tracking.strokes import Strokes
from tautline.tracking.taken_up import TakenUp
from tautline.tracking.visit import Visit
from tautline.tracking.window import Window, WindowKnots

Array = npt.NDArray[np.float64]

_LEAST_COUNTS = 4.0  # tolerance: of the encoder: the least that the mean B is taken for
_APART, _APART_SIGMAS = 1 / 40, 4.0  # tolerance: of B, of a frame's noise: nearer frames tell the same
_TURN_COUNTS, _TURN_SHARE = 8.0, 0.02  # prior: of the encoder, of B: a motor that goes back by more has turned
_PACE = 0.08  # prior: of the running mean of what a model in doubt is off
_WELL_STROKES = 3  # loss: that a law must foretell until it holds again
_STALE_STROKES = 5  # prior: that a change is looked for in by themselves
_MOVED = 0.25  # prior: of B, by which the offset is another posture's
_FEW_STROKES = 3  # prior: since a law began to be learnt: the last two may refine it by themselves
_POSTURE = 1.5  # limit: of B: an offset that one stroke may tell where a recording begins, more than a width can be
_ELSEWHERE, _STRANGE_FRAMES = 2.0, 5  # limit: of B, that so many first frames are off: another posture
_SETTLED_TURNS = 5  # loss: reversals since the change after which the law is settled
_MOST_LEVEL = 5.0  # loss: of the calibration's residual, that a law may leave and be trusted
_SCATTERS = 1.5  # loss: times the calibration's noise: worth a word
_UNKNOWN = 1.0  # prior: of B: what a width's sigma is at most taken for


class State(StrEnum):
    TRUSTED = "trusted"
    STALE = "stale"  # evidence against the model, not yet enough to mend it
    ADAPTING = "adapting"


@dataclass(frozen=True)
class Row:
    """What was predicted for a frame before it was seen, and by which law. Offset: as if the motor were so much
    further, unit of q."""

    state: State
    c_deg: float
    u_px: float  # NaN without a camera
    v_px: float
    offset: float  # of the transmission, unit of q: added to q
    offset_sigma: float
    scale: float  # of B; where its shape changed, or two passes left less, the least share of B that was found
    scale_sigma: float
    reason: str


@dataclass(frozen=True)
class Change:
    """A change of state: the recording, and the arrival, s, of the frame with which the new state began, and why."""

    recording: int
    t_s: float
    state: State
    says: str


class LawTracker:
    """Tracks one instrument in use. Call `begin` at each recording, then for each frame, in order of time: `motor` with
    the samples that came, `predict`, and `see` or `read` where the frame shows the tip. Takes at most 1 ms a frame."""

    def __init__(self, model: Model, sensor: Sensor) -> None:
        """Begins with the calibrated law, trusted. sensor: MARKER or ANGLE. TautError where the model cannot be tracked
        with it."""
        if sensor == MARKER and not model.rig.has_camera:
            raise TautError("the model's rig has no camera: track an angle sensor's recordings, or calibrate with one")
        if model.simulator is not None:
            raise TautError(
                "a model that begins with a simulator is over its tip, not the motor: calibrate, track that"
            )
        self.model, self.sensor = model, sensor
        self._unseen = self.nominal = LawFamily(Beyond.prior(model))
        self.projection = Projection(model, sensor)
        low, high = model.measured
        inside = (model.q >= low) & (model.q <= high)
        width = model.width[inside] if inside.any() else model.width
        # The mean B: the unit in which ways and offsets are judged.
        self._width = max(float(np.mean(width)), _LEAST_COUNTS * model.rig.actuator.encoder_resolution)
        sigma = np.minimum(model.width_sigma[inside] if inside.any() else model.width_sigma, _UNKNOWN * self._width)
        # The calibration's own sigmas of the offset, unit of q (half of B's), and of the scale.
        self._calibration_sigmas = (
            0.5 * float(np.sqrt(np.mean(sigma**2))),
            float(np.sqrt(np.mean(sigma**2))) / self._width,
        )
        count = model.rig.actuator.encoder_resolution
        self._window = Window(max(_APART * self._width, _APART_SIGMAS * self._frame_sigma(), count))
        self._path = CausalPath()
        self.recording = -1
        self.state, self.reason = State.TRUSTED, ""
        self.changes: list[Change] = []
        self._arrival_s = 0.0
        self._theta, self._sigma = calibrated_theta(), self._calibration_sigmas
        self._law = self._calibrated = self.nominal.law(self._theta)
        self._passes = Passes(model, self._width)
        self._offset = 0.0
        self._taken_up = TakenUp(self.nominal.model)
        self._misfit = 1.0  # the level that the law leaves where frames scatter as in the calibration
        self._scatter = Scatter()
        self._play = _native.TrackState(0.0)
        self._started = False
        self._start_q = np.nan  # the motor at the recording's begin; inf once it has carried every element since
        self._placed = False  # whether the play was set to where the tip was seen, before anything carried it
        self._pending: tuple[float, tuple[float, ...] | None] | None = None  # the predicted frame: scene time, reading
        self._strokes = Strokes(max(_TURN_COUNTS * count, _TURN_SHARE * self._width))
        self._doubts = Doubt(), Doubt()  # that the law changed; that its onsets did
        self._doubted_in = 0  # the last stroke in which the law was in doubt
        self._off = 0.0  # running mean of the residuals' size, unit of q
        self._disturbance, self._image_jump = Disturbance(count), ImageJump()
        self._recording_entry = 0  # the recording's first entry in the window
        self._since = 0  # the entry from which on the evidence is judged
        self._anchor: int | None = None  # the entry since which the law in use was learnt
        self._origin = self._theta  # the law before that
        self._offset_before = 0.0  # the offset with which the recording began, unit of q
        self._judgement = Judgement()
        self._fresh_until = -1  # stroke up to which a recording may turn out to be another posture
        self._strange = 0  # frames at a recording's begin in which the tip was far off
        self._visit: Visit | None = None  # the present stay beyond the measured range
        self._common_error = CommonError()  # of the frames with which a recording begins

    def begin(self) -> None:
        """Begins a new recording, whose clock, place of the tip and posture may be others: forgets the motor's path and
        what was judged of the last one. The law that was learnt stays in use."""
        self.recording += 1
        self._path, self._started, self._placed, self._pending = CausalPath(), False, False, None
        self._disturbance.begin_recording()
        self._image_jump.clear()
        self._strokes.begin_recording(self._window.end)
        self._fresh_until = self._strokes.number + 1
        self._window.cut()
        self._passes.clear()
        self._since = self._recording_entry = self._window.end
        self._clear_doubts(self._since)
        self._anchor, self._visit = None, None
        self._judgement.drop()
        self._strange, self._common_error = 0, CommonError()
        self._offset_before = self._offset

    def _frame_sigma(self) -> float:
        """Standard deviation of one frame's centre coordinate in the middle of the measured range by the sensor's
        noise, unit of q; 0 where the image does not show the tip move there."""
        middle = 0.5 * (self.model.measured[0] + self.model.measured[1])
        c = float(self.model.remaining(middle))
        slope = max(abs(self.nominal.tip_slope), 1e-9)
        if self.sensor == MARKER:
            u, v = self.projection.image(c, 0.0, 0.0)
            seen = self.projection.from_image(u, v, 0.0, 0.0, c)
            return seen.sigma / slope if seen is not None else 0.0
        return self.projection.noise / slope

    @property
    def _level(self) -> float:
        """rms of the residuals over their stated sigmas that the law in use is known to leave: by its misfit, and by
        the frames' own scatter at present. 1 is the calibration's noise alone."""
        return float(np.sqrt(self._misfit**2 + self._scatter.ratio**2 - 1.0))

    def motor(self, t_s: Array, q: Array, others: Array | None = None) -> None:
        """Adds samples of the motor, in order of time. t_s (n,): when they were taken, s; q (n,): its position, unit of
        q; others (n, 2): translation (mm) and rotation (deg), by default 0."""
        self._path.add(t_s, q, np.zeros((len(t_s), 2)) if others is None else others)

    def predict(self, scene_s: float, arrival_s: float | None = None) -> Row:
        """Learns from the last frame, does a piece of the judgement of hypotheses, then predicts the tip at scene_s: a
        time on the motor's clock, s, later than that of the last frame. arrival_s: when the frame of that scene
        arrived, s, by default scene_s."""
        self._arrival_s = scene_s if arrival_s is None else arrival_s
        self._use_last_frame()
        self._work_on_verdict()
        path = self._path
        if not self._started:
            self._start(float(path.q[0]))
        q = path.predicted_position(scene_s)
        ahead = knots(self._window.last_q, path.new_positions(scene_s), q)  # the motor's way since the last frame
        law = self._law
        p = float(law.followed.run(self._play.copy(), ahead + self._theta[OFFSET])[0][-1])
        c = float(law.angle(p)) + self._persistent_error()
        u = v = np.nan
        if self.model.rig.has_camera:
            translation, rotation = path.other_axes_at(scene_s)
            u, v = self.projection.image(c, translation, rotation)
        self._pending = (scene_s, None)
        offset_sigma, scale_sigma = self._sigma
        if self.state is State.STALE:  # the law is off by _off at present: the offset by that, B by that at both ends
            offset_sigma = float(np.hypot(offset_sigma, self._off))
            scale_sigma = float(np.hypot(scale_sigma, 2.0 * self._off / self._width))
        return Row(self.state, c, u, v, self._offset, offset_sigma, self._taken_up.scale, scale_sigma, self.reason)

    def see(self, u_px: float, v_px: float, sigma_px: float | None = None) -> None:
        """Keeps the marker's position, px, in the frame that was predicted last; the next `predict` learns from it.
        sigma_px: its standard deviation; None where it is not known. The calibration's noise counts where that is
        larger."""
        assert self._pending is not None
        self._pending = (self._pending[0], (u_px, v_px, sigma_px or 0.0))

    def read(self, c_deg: float) -> None:
        """Keeps the angle sensor's reading, deg, for the time that was predicted last; the next `predict` learns from
        it."""
        assert self._pending is not None
        self._pending = (self._pending[0], (c_deg,))

    @property
    def dialled_down(self) -> bool:
        """Whether less of B is taken up than the law in use has, as two passes of one place showed a narrower B."""
        return bool(self._taken_up.why_dialled)

    @property
    def compensation(self) -> float:
        """The share of the calibrated B that may be taken up: the scale, less two of its standard deviations unless it
        is exactly 1; 0 at least."""
        scale = self._taken_up.scale
        return min(scale, max(0.0, scale - (0.0 if scale == 1.0 else 2.0 * self._sigma[1])))

    def _start(self, q: float) -> None:
        """Starts the play with the tip on the centre line at motor position q, unit of q."""
        self._play = _native.TrackState(q + float(self._theta[OFFSET]))
        self._window.last_q = self._start_q = q
        self._started = True

    def _use_last_frame(self) -> None:
        """Moves the play to the scene time of the last frame, as the motor's path to it is known now, and learns from
        what the frame showed. Does nothing if no frame was predicted since the last call."""
        if self._pending is None:
            return
        scene_s, reading = self._pending
        self._pending = None
        path = self._path
        q = path.position_at(scene_s)
        way = knots(self._window.last_q, path.new_positions(scene_s), q)
        before = self._play.copy()
        ps, moving, _ = self._law.followed.run(self._play, way + self._theta[OFFSET], True)
        p = float(ps[-1])
        path.forget(scene_s)
        self._follow_beyond(before, way, p, bool(moving[-1]))
        for knot in way.tolist():
            self._follow_motor(knot)
        seen = None if reading is None else self._angle_of(scene_s, reading, p)
        self._window.add_path(way, self._strokes.number)
        if seen is not None:
            self._learn_from(scene_s, seen, p)

    def _angle_of(self, scene_s: float, reading: tuple[float, ...], p: float) -> AngleEstimate | None:
        """The angle that a reading at scene_s shows: (c_deg,), or (u_px, v_px, sigma_px) of a marker, whose angle is
        looked for near that of the predicted centre coordinate p. None where the reading is of no angle."""
        if len(reading) == 1:
            seen: AngleEstimate | None = self.projection.from_angle(reading[0])
        else:
            translation, rotation = self._path.other_axes_at(scene_s)
            near = float(self._law.angle(p))
            seen = self.projection.from_image(reading[0], reading[1], translation, rotation, near, reading[2])
        return None if seen is None or not np.isfinite(seen.c_deg) else seen

    def _follow_motor(self, q: float) -> None:
        """Follows the motor to q, unit of q. If it turns there, a stale model that was not in doubt in the last
        _WELL_STROKES strokes is trusted again."""
        if self._strokes.follow(q, self._window.end) and (
            self.state is State.STALE and self._strokes.number > self._doubted_in + _WELL_STROKES
        ):
            self._become_trusted("the model holds again as it was" + self._scatter_in_words())

    def _scatter_in_words(self) -> str:
        """By how much the frames scatter more than in the calibration, as the end of a message; "" if it is not clearly
        more."""
        times = self._scatter.ratio
        return f"; places scatter {times:.1f} times as much as in the calibration" if times > _SCATTERS else ""

    def _learn_from(self, scene_s: float, seen: AngleEstimate, p: float) -> None:
        """Learns from a frame, whose law predicted centre coordinate p, unit of q: keeps it as evidence, and updates
        passes, disturbance, doubts, running means and, beyond the measured range, the law. Returns early at the frame
        with which a recording is found to begin at another posture, and for frames too near to the last one."""
        law = self._law
        y = float(law.place(seen.c_deg))
        sigma = float(self.nominal.sigma(y, seen.sigma / law.slope(y)))
        loose = self._play.driven == 0.0  # nothing has carried the tip yet: it is where it is seen
        within = self._clipped_to_play(y) if loose else y
        # Farther from the play than a play can be off: the recording begins at another posture, if it stays so.
        strange = abs(y - within) > _ELSEWHERE * self._width + SURE * sigma * self._level
        if strange and not self._disturbance.is_disturbed(self._arrival_s):
            self._strange += 1
            if self._strange == _STRANGE_FRAMES:
                self._begin_with_offset(y - within, within)
                return
        kept = self._window.add_frame(scene_s, seen.c_deg, seen.sigma, seen.off, self._strokes.number)
        if not kept:
            return
        off = y - p
        if loose:
            off = self._off_while_loose(y, p, within)
            if not strange:  # a tip out of the play would be carried from there at once
                self._play.restart(y)
                self._placed = True
        place = self._calibrated.place(seen.c_deg)
        # travel: from the turn, such that the law is on its envelope from B on (`Passes.add`).
        q, travel = self._window.last_q, abs(self._window.last_q - self._strokes.turned_at) / self._law.most
        self._passes.add(q, float(place), sigma, seen.off, self._strokes.number, travel, self._window.end - 1)
        self._disturbance.add(q, seen, self._level, self._arrival_s)
        if self.state is not State.TRUSTED:
            self._reduce_scale()
        self._learn_beyond(seen, p)
        self._judgement.add_frame()
        if self._begun_lately:
            self._common_error.add(seen.c_deg - float(law.angle(p)))
        self._off += _PACE * (abs(off) - self._off)
        self._scatter.add(off / sigma)
        back = self._image_jump.add(q, off, sigma * self._level, self.state is State.TRUSTED)
        self._add_to_doubts(off / (sigma * self._level), scene_s)
        if back and self.state is State.STALE:
            self._become_trusted("the image is back from something else, and the model holds")

    def _add_to_doubts(self, z: float, scene_s: float) -> None:
        """Adds a residual, z standard deviations, to the doubt that the law holds and, near a turn, to the doubt that
        its onsets do. A trusted law becomes stale once the log odds of either are above JUMP."""
        onset = abs(self._window.last_q - self._strokes.turned_at) < ONSET * self._width
        for doubt in self._doubts if onset else self._doubts[:1]:
            doubt.add(z, self._strokes.number, scene_s, self._window.end - 1)
            if doubt.odds_of_part > 0.0:
                self._doubted_in = self._strokes.number
        worst = max(self._doubts, key=lambda doubt: doubt.odds)
        if self.state is State.TRUSTED and worst.odds > JUMP:
            self._become_stale(worst.since)

    def _clear_doubts(self, entry: int) -> None:
        """Forgets both doubts: frames count from this entry of the window on."""
        for doubt in self._doubts:
            doubt.clear(entry)

    def _follow_beyond(self, before: Any, way: Array, p: float, moving: bool) -> None:
        """Begins, continues or ends a stay of the tip beyond the measured range (`Visit`), where the law is learnt only
        while it is trusted, and once the motor has carried every element of the play. before: the play's state before
        the motor went this path `way` (n,); p: the predicted centre coordinate after it; all in the unit of q. moving:
        whether the motor carries the tip; if it does, a full visit is replaced."""
        if np.abs(way - self._start_q).max() > REACH * float(np.interp(p, self._law.grid, self._law.width)):
            self._start_q = np.inf  # every element was carried
        sure = self.state is State.TRUSTED and self._start_q == np.inf
        if not (sure and self.nominal.beyond.curves(p).any()):
            self._visit = None
            return
        if self._visit is None or (self._visit.full and moving):
            self._visit = Visit(self.nominal, before)
        self._visit.move(way)

    def _learn_beyond(self, seen: AngleEstimate, p: float) -> None:
        """Updates the law beyond the measured range, and the play, by a frame of the present stay; p: its predicted
        centre coordinate, unit of q. Does nothing without a stay, when that is full, or while the tip is disturbed."""
        if self._visit is None or self._visit.full or self._disturbance.is_disturbed(self._arrival_s):
            return
        slope = float(self._law.slope(p))
        sigma = self._level * abs(slope) * float(self.nominal.sigma(p, seen.sigma / slope))
        self.nominal, self._play = self._visit.see(self.nominal, self._theta, seen.c_deg, sigma)
        self._law = self.nominal.law(self._theta)

    def _persistent_error(self) -> float:
        """What is added to the predicted angle, deg: while a recording has only begun and the law is not trusted, the
        error that its frames have in common. It most likely goes on until the other direction tells an offset from a
        width. Else 0."""
        return 0.0 if self.state is State.TRUSTED or not self._begun_lately else self._common_error.common_deg

    @property
    def _begun_lately(self) -> bool:
        """Whether the recording has only begun, so that it may turn out to be of another posture."""
        return self._strokes.number <= self._fresh_until

    def _off_while_loose(self, y: float, p: float, within: float) -> float:
        """The residual, unit of q, of a tip at centre coordinate y that nothing has carried yet: the larger of two. One
        is y less `within`, the nearest place in the play. The other, if the tip was seen before, is y less p, where it
        was then, as it has no reason to move: over sqrt(2), as both frames have noise."""
        since = (y - p) / np.sqrt(2.0) if self._placed else 0.0
        return max(y - within, since, key=abs)

    def _clipped_to_play(self, y: float) -> float:
        """The centre coordinate nearest to y, unit of q, at which the tip can be with the motor where it is: within
        B/2."""
        half = 0.5 * float(np.interp(y, self._law.grid, self._law.width))
        q = self._window.last_q + float(self._theta[OFFSET])
        return min(max(y, q - half), q + half)

    def _begin_with_offset(self, off: float, within: float) -> None:
        """Takes a rough offset `off`, unit of q, into use where a recording begins so far from the law that no play can
        be the cause. Its sigma is the mean B, and a quarter of `off`, in quadrature. within: the centre coordinate of
        the tip with this offset, from which the play starts anew."""
        theta = self._theta.copy()
        theta[TIP.start] += off * self.nominal.tip_slope
        self._use_law(theta)
        self._sigma = (float(np.hypot(self._width, 0.5 * abs(off) / _ELSEWHERE)), self._sigma[1])
        self._play.restart(within)
        self._since = self._recording_entry
        self._clear_doubts(self._since)
        self._change_state(State.ADAPTING, f"transmission.offset: {self._offset:+.4g} or so, another posture")

    def _use_law(self, theta: Array) -> None:
        """Takes the law of theta (PARAMETERS,) into use. Forgets the stay beyond the measured range and the common
        error by the law before, and, if the widest element of the play has become wider, the passes, which may no
        longer lie on an envelope."""
        self._theta, self._visit, before = theta, None, self._law
        self._law = self.nominal.law(theta)
        self._common_error = CommonError()  # that of the law before says nothing of this one
        self._image_jump.clear()
        if self._law.most > before.most:  # it reaches its envelope later
            self._passes.clear()
        self._offset = self.nominal.offset(theta)

    def _become_stale(self, since: int) -> None:
        """Sets the state to STALE, lets evidence count from the window's entry `since` on, and a judgement begin at
        once."""
        self._since = since
        self._judgement.hurry()
        self._change_state(State.STALE, "the tip is not where the model says: more reversals will tell why")

    def _become_trusted(self, why: str) -> None:
        """Sets the state to TRUSTED: drops the judgement of hypotheses, takes up again all of B that the law in use
        allows, and lets doubts count from the next frame. why: in words, for the user."""
        self._judgement.drop()
        self._taken_up.take_up_all_allowed(self._theta)
        self._clear_doubts(self._window.end)
        self._change_state(State.TRUSTED, why)

    def _change_state(self, state: State, why: str) -> None:
        """Sets the state and the reason, in words; adds to `changes` if the state is another one than before."""
        if state is not self.state:
            self.changes.append(Change(self.recording, self._arrival_s, state, why))
        self.state, self.reason = state, why

    def _work_on_verdict(self) -> None:
        """Does a frame's share of the judgement of hypotheses, and acts on its verdict once there is one. If none is at
        work, one begins, unless the law is trusted or too few frames came since."""
        if self.state is not State.TRUSTED and self._judgement.may_begin:
            self._judgement.begin(self._new_judgement())
        verdict = self._judgement.advance()
        if verdict is not None:
            self._act_on(verdict)

    def _new_judgement(self) -> Work[Inference] | None:
        """Returns a judgement of the evidence so far, as work that is not begun yet; None where there is too little
        evidence. The posture is taken for another one where the law that is being learnt has moved the offset by more
        than _MOVED of B since the recording began. Where that has only begun, one stroke may tell an offset of more
        than _POSTURE of B."""
        adapting, away = self.state is State.ADAPTING, abs(self._offset - self._offset_before)
        moved = adapting and self._anchor is not None and away > _MOVED * self._width
        evidence = self._stretches(moved)
        if not evidence:
            return None
        least_offset = _POSTURE * self._width if self._begun_lately else None
        proposal = self._judgement.proposal
        return judge(self._unseen, evidence, self._theta, adapting, least_offset, moved, self._level, proposal)

    def _stretches(self, moved: bool) -> list[tuple[WindowKnots, Array]]:
        """The evidence in the order in which it is judged, each with the law before anything was learnt of it: since
        the law in use began to be learnt; since what counts began; then, of a stale model, the last _STALE_STROKES
        strokes alone, or, if another posture (`moved`) began to be learnt only in the last _FEW_STROKES, the last two.
        Stretches with too few frames are left out."""
        starts = {} if self._anchor is None else {self._anchor: self._origin}  # by first entry: the law before it
        starts.setdefault(self._since, self._theta)
        if self.state is State.STALE:
            starts.setdefault(max(self._since, self._strokes_ago(_STALE_STROKES)), self._theta)
        elif moved and self._strokes_ago(_FEW_STROKES) <= self._since:
            starts.setdefault(self._strokes_ago(1), self._theta)
        noise = self._scatter.ratio
        stretches = [(self._window.evidence_since(since), origin) for since, origin in starts.items()]
        return [(replace(evidence, noise=noise), origin) for evidence, origin in stretches if evidence is not None]

    def _strokes_ago(self, count: int) -> int:
        """The number of the first entry of the stroke that was so many strokes before the present one."""
        return self._strokes.first_entry_of(self._strokes.number - count, self._window.end)

    def _act_on(self, verdict: Inference) -> None:
        """Draws the consequences of a verdict. If it names a law, and the tip was not disturbed lately, the law is
        adopted, and trusted if it is settled and enough reversals agree, or if it is the calibrated one. Otherwise a
        stale model gives the verdict as its reason; one that is being learnt becomes stale after too many strokes
        without a law (`Judgement.note_unexplained`), and evidence counts from the last stroke on."""
        self._judgement.keep_proposal(verdict, self._strokes.number)
        if verdict.disturbed:
            self._disturbance.note_judgement(self._arrival_s)
        if verdict.theta is None or self._disturbance.was_judged(self._arrival_s):
            if self.state is State.STALE:
                self.reason = self._taken_up.why_dialled or verdict.says
            elif not verdict.early and self._judgement.note_unexplained(self._strokes.number):
                self._anchor = None
                self._since = self._strokes_ago(1)
                self._change_state(State.STALE, verdict.says)
            return
        self._judgement.note_explained()
        self._adopt(verdict)
        calibrated = verdict.settled and np.array_equal(self._theta, calibrated_theta())
        if calibrated or (verdict.turns >= _SETTLED_TURNS and verdict.settled):
            # What the law leaves beyond the frames' own scatter, as if that were the calibration's (1).
            misfit = float(np.sqrt(max(verdict.level**2 - verdict.evidence.noise**2, 0.0) + 1.0))
            self._misfit = min(misfit, _MOST_LEVEL)
            self._become_trusted(verdict.says)
        else:
            self._change_state(State.ADAPTING, verdict.says)

    def _reduce_scale(self) -> None:
        """Lowers the share of B that is taken up where two passes of one place show a narrower B than that. The law in
        use goes on predicting, as it may hold elsewhere. Does nothing while the tip is disturbed."""
        if self._disturbance.is_disturbed(self._arrival_s):
            return
        narrow = self._passes.narrowing(self._law, self._theta, self._level, self._anchor or 0)
        if narrow is not None and narrow.share < self._taken_up.scale:
            self._taken_up.dial_down(narrow.share)
            self._sigma = (self._sigma[0], float(np.hypot(self._calibration_sigmas[1], narrow.sigma)))
            self.reason = self._taken_up.why_dialled

    def _adopt(self, verdict: Inference) -> None:
        """Takes a verdict's law into use: runs the play along its evidence again by that law, clears doubts, and sets
        how much of B is taken up. A law that refines the one in use keeps its anchor, the entry since which it is
        learnt."""
        assert verdict.theta is not None
        anchor = self._window.entry_number_at(verdict.evidence.t_s[0], self._recording_entry)
        if verdict.refines and self._anchor is not None:
            anchor = self._anchor
        elif anchor != self._anchor:
            self._anchor, self._origin = anchor, self._theta
        self._since = anchor
        if verdict.nominal is not None:
            self.nominal = verdict.nominal
        self._use_law(verdict.theta)
        self._sigma = (
            float(np.hypot(self._calibration_sigmas[0], verdict.offset_sigma)),
            float(np.hypot(self._calibration_sigmas[1], verdict.scale_sigma)),
        )
        evidence = self._window.evidence_since(anchor)  # frames came since the verdict's
        assert evidence is not None
        self._play = _native.TrackState(float(self._law.place(evidence.c_deg[0])))
        path = np.concatenate([evidence.q, self._window.path_since_entry])
        self._law.followed.run(self._play, path + self._theta[OFFSET], True)
        self._clear_doubts(self._window.end)
        if verdict.narrower:
            self._taken_up.limit_to(self._theta)
        else:
            self._taken_up.follow_law(self.nominal, self._law, self._theta, verdict.passed)
        self._reduce_scale()
