"""Variance components of a calibration: what a play with one delay does not hold, found and allowed for.

The joint fit's residuals are a mixed model, r = J d(theta) + sum_k Z_k u_k + e, u_k ~ N(0, s_k^2 P_k^-1): theta are
path, B and delay, each Z_k one way in which a real instrument, clock or camera departs from the model. A component is
added where the restricted likelihood gains by it, its variance is that likelihood's maximum (Fellner-Schall steps), and
from then on it is estimated beside B and adds to B's covariance (Henderson's equations). What is not there is free.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.linalg import cho_factor, cho_solve, eigh

from tautline.calibration.departures import (
    SHARE,
    SPEED,
    STATES,
    CountedFrames,
    Departure,
    SearchedParameters,
    Sparse,
    by_rows,
    contrasts,
    counted_frames,
    departures,
    on_clock,
    slow_basis,
    starts_anew,
)
from tautline.calibration.observations import Track
from tautline.calibration.playfit import Curves, Fitted, PlayFit
from tautline.encoder import count_of
from tautline.independence import frames_each
from tautline.rig import Rig

Array = npt.NDArray[np.float64]

GAIN = 20.0  # prior: of twice the restricted log likelihood, for a component; noise alone gives 5 to 8
_ROUNDS = 14  # tolerance: linearisations at most
_AT_ONCE = 2  # tolerance: components that may join at one linearisation
_STEPS = 6  # tolerance: of the variances, at one linearisation
_PENALTIES = np.logspace(-6, 3, 19)  # tolerance: of a component's own information
_MOST, _LEAST = 1e12, 1e-12  # tolerance: of a penalty
_SHARES = (1.0, 0.5, 0.2)  # tolerance: of a step, tried in turn
WORSE = 1.02  # tolerance: of what was left, from which a step leads too far
_STILL = 0.05  # tolerance: a change of B, in its sigma, that is none
_COUNT = 0.29  # equation: of an encoder's step: the standard deviation of a place within it
_SHOWS = 0.3  # tolerance: of the noise: an encoder's count that moves the image by more shows
_FEW = 30  # tolerance: frames that tell no scatter
LAW = 0.5  # prior: of what speed adds to B: slower than what was seen it may follow another law
CORRECTS = 0.3  # prior: of a component's correction of B: what it may be off by
_SHORT = 0.1  # tolerance: of a frame's period
_LAGS = 60  # tolerance: frames of autocorrelation
_LATE = 0.25  # equation: of the session, which goes from -1/2 to 1/2: its last quarter


@dataclass(frozen=True)
class Component:
    """What was found of one departure."""

    name: str
    rms: float  # of what is lost without it, in the stated noise
    chi2: float  # what is lost without it, over the noise's variance
    shift: Array  # (grid,) by how much B would be another without it
    later_s: float  # by how much the delay would be another without it
    values: Array


@dataclass(frozen=True)
class DifferenceFromEnd:
    """How the counted frames of one track differ from what they would show when the session ends."""

    frames: npt.NDArray[np.intp]
    over_noise: Array  # (frames, channels)
    late: npt.NDArray[np.bool_]  # frames of the last quarter of the session


@dataclass(frozen=True)
class Components:
    """B with all components beside it, as it is when the session ends. Arrays on the joint fit's grid."""

    curves: Curves
    usual: Curves  # the same with B as it is in the mean of the session
    width: Array
    sigma: Array  # of B, model error included
    delay_sigma: float
    width_by_delay: Array  # by how much B is another for each second that the delay is
    held_back_s: float  # by how much a tracker may show a moving tip late
    noise: float  # rms over the stated noise of what no component explains
    moving: float  # the same of frames at which the tip moves, over that of the others
    effective: float  # frames for each independent one
    parts: tuple[Component, ...]  # strongest first
    clock: Array  # (2,) seconds by which the sensor's clock departs, linear and quadratic over the session
    rough: bool  # an encoder's count shows in the image
    since: tuple[DifferenceFromEnd, ...] = ()  # by track; empty where nothing changed

    @property
    def late(self) -> float:
        """How much of what changed, in the noise, it still did in the last quarter of the session; rms."""
        late = [each.over_noise[each.late] for each in self.since if each.late.any()]
        return float(np.sqrt(np.mean(np.concatenate(late) ** 2))) if late else 0.0

    def at_the_end(self, tracks: Sequence[Track]) -> list[Track]:
        """The counted frames of the fit's tracks as they would be if all had been seen when the session ended."""
        if not self.since:
            return list(tracks)
        kept = [track.only(since.frames) for track, since in zip(tracks, self.since, strict=True)]
        return [
            replace(track, y=track.y - since.over_noise * track.sigma[:, None])
            for track, since in zip(kept, self.since, strict=True)
        ]

    @property
    def of_tracker(self) -> bool:
        """Whether what departs is the tracker's, not the tip's."""
        return any(part.name == "tracker" for part in self.parts)

    @property
    def of_start(self) -> bool:
        """Whether what departs is how the tip starts after a reversal, more than anything else."""
        return bool(self.parts) and self.parts[0].name.startswith("phase")

    def applied(self, fitted: Fitted) -> Fitted:
        """The joint fit as it is with the components taken into account."""
        fit = replace(fitted.fit, tracks=on_clock(fitted.fit.tracks, self.clock), smoothing=fitted.fit.smoothing)
        residuals, masks = fit.residuals(self.curves)
        return replace(
            fitted, fit=fit, curves=self.curves, residuals=residuals, masks=masks, scale=self.noise, spread=self.sigma,
            delay_spread=self.delay_sigma, width_by_delay=self.width_by_delay,
        )  # fmt: skip


def separate(fitted: Fitted, rig: Rig, without: frozenset[str] = frozenset()) -> Components:
    """Re-estimates B with what departs from the model beside it, from the joint fit as it stands. without: departures
    that the fit itself holds."""
    return _Separation(fitted, rig, without).run()


@dataclass
class _Separation:
    fitted: Fitted
    rig: Rig
    without: frozenset[str] = frozenset()
    active: list[str] = field(default_factory=list)
    penalties: dict[str, float] = field(default_factory=dict)
    refused: set[str] = field(default_factory=set)  # that would have to be negative
    rough: bool = False  # an encoder's count shows in the image
    moving_noise: float = 1.0  # of frames at which the tip moves, over that of the others

    def run(self) -> Components:
        """Lets components join and moves to where they lead, linearisation by linearisation, until nothing changes."""
        self._expect_turns()
        counted = counted_frames(self.fitted, self.fitted.curves, self.rig, np.zeros(2))
        assert counted is not None  # it was fitted to frames
        searched = SearchedParameters(anew_px=starts_anew(counted))
        if (
            counted.residuals.shape[1] == 1
        ):  # no image may have moved instead: at once, before strokes stand in for a slip
            searched = searched.updated(counted, counted.residuals, set())
        solved = self._solved(self.fitted.curves, counted, np.zeros(2), searched)
        for _ in range(_ROUNDS):
            joined = solved.join()
            self.moving_noise = solved.moving_noise()
            columns = solved.updated()
            if not joined and not solved.changes:
                break
            ahead = self._ahead(solved, columns)
            if ahead is None:
                break
            solved = ahead
        return solved.result()

    def _expect_turns(self) -> None:
        """Begins with the component of turns where an encoder's count moves the image by more than a share of its
        noise: the motor's turns are known no better, whatever else is there."""
        fit, resolution = self.fitted.fit, self.rig.actuator.encoder_resolution
        count = _COUNT * max(count_of(prepared.track.reading, resolution) for prepared in fit.tracks)
        steep = np.linalg.norm(fit.follow.slope(self.fitted.curves.follow, fit.grid).reshape(len(fit.grid), -1), axis=1)
        sigma = float(np.median(np.concatenate([prepared.track.sigma for prepared in fit.tracks])))
        if count * float(np.median(steep)) > _SHOWS * sigma:
            self.rough = True
            self.active.append("turn")
            self.penalties["turn"] = (self.fitted.scale / count) ** 2

    def _at(self, curves: Curves, clock: Array, columns: SearchedParameters) -> _Solved | None:
        """The model solved at these curves and this clock (see `scene_of`); None where no frame tells of them."""
        counted = counted_frames(self.fitted, curves, self.rig, clock)
        return None if counted is None else self._solved(curves, counted, clock, columns)

    def _solved(self, curves: Curves, counted: CountedFrames, clock: Array, columns: SearchedParameters) -> _Solved:
        """The model of a scene at these curves and this clock, solved with the active components."""
        parts = [part for part in departures(counted, columns) if part.name not in self.without]
        solved = _Solved(self, curves, counted, parts, clock, columns)
        solved.settle()
        return solved

    def _ahead(self, solved: _Solved, columns: SearchedParameters) -> _Solved | None:
        """The model solved again where its step leads, or less far; None where it gets worse all the same."""
        penalties = dict(self.penalties)
        for share in _SHARES:
            curves = between(solved.curves, solved.moved, share)
            there = self._at(curves, solved.clock + share * solved.clock_step, columns)
            if there is not None and there.noise < WORSE * solved.noise:
                return there
            self.penalties = dict(penalties)
        return None


def between(start: Curves, end: Curves, share: float) -> Curves:
    """The curves at this share, 0 to 1, of the way from `start` to `end`."""
    return Curves(
        start.backlash + share * (end.backlash - start.backlash),
        start.follow + share * (end.follow - start.follow),
        start.delay_s + share * (end.delay_s - start.delay_s),
    )


def nominal_columns(fit: PlayFit, counted: CountedFrames) -> Sparse:
    """(channels * n, unknowns), sparse: how the whitened image changes by the coefficients of the path (channel by
    channel), those of B, and the delay."""
    path = by_rows(counted.inverse, fit.follow.design(counted.p))
    by_width = by_rows(counted.by_width, fit.backlash.design(counted.p))
    shared = sparse.csr_matrix(sparse.hstack([by_width, sparse.csr_matrix(counted.by_delay[:, None])]))
    return sparse.csr_matrix(sparse.hstack([counted.per_channel(path), counted.along_path(shared)]))


class _Solved:
    """The mixed model at one linearisation: normal equations of path, B, delay and all departures."""

    def __init__(
        self,
        owner: _Separation,
        curves: Curves,
        counted: CountedFrames,
        parts: list[Departure],
        clock: Array,
        columns: SearchedParameters,
    ) -> None:
        """Sums the normal equations; unknowns: path (channel by channel), B, delay, then each part's values. clock
        (2,): as in `scene_of`; columns: what was looked for; nothing is solved yet."""
        self.owner, self.curves, self.counted, self.clock, self.columns = owner, curves, counted, clock, columns
        self.fit = fit = owner.fitted.fit
        nominal = nominal_columns(fit, counted)
        design = sparse.hstack([nominal, *(part.columns for part in parts)], format="csr")
        self.design = design
        moving = np.where(counted.moving, owner.moving_noise**-2, 1.0)
        self.weight = np.tile(counted.weight * moving, counted.residuals.shape[1])
        self.target = counted.residuals.T.ravel()
        heavy = by_rows(self.weight, design)
        self.gram = np.asarray((heavy.T @ design).toarray())
        self.force = np.asarray(heavy.T @ self.target).ravel()
        self.total = float(self.weight @ self.target**2)
        self.head = int(nominal.shape[1])
        ends = np.cumsum([self.head, *(part.size for part in parts)])
        self.parts = {part.name: part for part in parts}
        self.places = {part.name: np.arange(a, b) for part, a, b in zip(parts, ends[:-1], ends[1:], strict=True)}
        self.noise = owner.fitted.scale
        self.base, self.pull = fit.penalty(curves, max(self.noise, 1e-6))

    # ---- the active components

    def settle(self) -> None:
        """Solves with the active components, whose variances move towards the likelihood's maximum."""
        self.owner.active = [name for name in self.owner.active if name in self.parts]
        self._solve()
        for _ in range(_STEPS if self.owner.active else 0):
            if not self._adapt():
                break
            self._solve()

    def _solve(self) -> None:
        """Solves for path, B, delay and the active components at their present penalties; sets their values, the
        system's inverse and the noise that is left, over the stated one."""
        self.kept = np.concatenate([np.arange(self.head), *(self.places[name] for name in self.owner.active)])
        system = self.gram[np.ix_(self.kept, self.kept)].copy()
        system[: self.head, : self.head] += self.base
        for name, at in self._blocks():
            system[np.ix_(at, at)] += self.owner.penalties[name] * self.parts[name].penalty
        diagonal = np.diag_indices_from(system)
        system[diagonal] += 1e-10 * system[diagonal] + 1e-12 * float(np.mean(system[diagonal]))
        pull = np.zeros(len(self.kept))
        pull[: self.head] = self.pull
        factor = cho_factor(system, check_finite=False)
        self.inverse = np.asarray(cho_solve(factor, np.eye(len(system)), check_finite=False))
        self.values = self.inverse @ (self.force[self.kept] - pull)
        gram = self.gram[np.ix_(self.kept, self.kept)]
        squares = self.total - 2 * float(self.values @ self.force[self.kept]) + float(self.values @ gram @ self.values)
        count = float(self.weight.sum()) - float(np.sum(self.inverse * gram))
        self.noise = float(np.sqrt(max(squares, 1e-12) / max(count, 1.0)))

    def _blocks(self) -> list[tuple[str, npt.NDArray[np.intp]]]:
        """Each active component's name and the indices of its values among what is solved for."""
        blocks, at = [], self.head
        for name in self.owner.active:
            size = self.parts[name].size
            blocks.append((name, np.arange(at, at + size)))
            at += size
        return blocks

    def _adapt(self) -> bool:
        """A Fellner-Schall step of the active components' penalties, longer by the exponent 1.5; whether any changed by
        more than a tenth."""
        changed = False
        for name, at in self._blocks():
            now, penalty = self.owner.penalties[name], self.parts[name].penalty
            used = len(at) - now * float(np.sum(self.inverse[np.ix_(at, at)] * penalty))
            size = float(self.values[at] @ penalty @ self.values[at])
            ratio = self.noise**2 * max(used, 1e-4) / max(now * size, 1e-30)
            then = float(np.clip(now * np.clip(ratio**1.5, 0.01, 100.0), _LEAST, _MOST))
            changed |= abs(np.log(then / now)) > 0.1
            self.owner.penalties[name] = then
        return changed

    # ---- further ones

    def join(self) -> bool:
        """Adds the components, at most two, by which the restricted likelihood gains most, if it is enough; whether any
        was tried. One whose value came out negative and must not is refused for good."""
        joined = False
        for _ in range(_AT_ONCE):
            active = set(self.owner.active) | self.owner.refused
            open_parts = [p for p in self.parts.values() if p.name not in active and not p.not_beside & active]
            gains = {part.name: self._gain(part) for part in open_parts}
            if not gains:
                break
            name = max(gains, key=lambda each: gains[each][0] - self.parts[each].price)
            if gains[name][0] < (GAIN + self.parts[name].price) * self._effective():
                break
            self.owner.active.append(name)
            self.owner.penalties[name] = gains[name][1]
            self.settle()
            if self.parts[name].one_way and self.values[dict(self._blocks())[name][0]] < 0:
                self.owner.active.remove(name)
                self.owner.refused.add(name)
                self.settle()
            joined = True
        return joined

    def _gain(self, part: Departure) -> tuple[float, float]:
        """By how much twice the restricted log likelihood grows with this part at its best penalty, and that penalty; 0
        and 1 where no frame tells of it."""
        at = self.places[part.name]
        across = self.gram[np.ix_(self.kept, at)]
        information = self.gram[np.ix_(at, at)] - across.T @ self.inverse @ across
        force = self.force[at] - across.T @ self.values
        roots, vectors = eigh(information, part.penalty, check_finite=False)
        roots = np.maximum(roots, 0.0)
        squares = (vectors.T @ force) ** 2 / max(self.noise**2, 1e-30)
        if not roots.max() > 0:
            return 0.0, 1.0
        penalties = _PENALTIES * float(roots.max())
        gains = [float(np.sum(squares / (roots + each) - np.log1p(roots / each))) for each in penalties]
        best = int(np.argmax(gains))
        return gains[best], float(penalties[best])

    def _left(self) -> Array:
        """(n, channels) what is not explained of the whitened residuals."""
        left = self.target - self.design[:, self.kept] @ self.values
        return np.asarray(left.reshape(self.counted.residuals.shape[1], -1).T)

    def moving_noise(self) -> float:
        """Scatter from frame to frame where the tip moves, over that where it rests, 1 to 30; 1 where too few frames do
        either."""
        step = np.mean(np.diff(self._left(), axis=0) ** 2, axis=1)
        moves = self.counted.moving[1:] & self.counted.moving[:-1]
        rests = ~self.counted.moving[1:] & ~self.counted.moving[:-1]
        if moves.sum() < _FEW or rests.sum() < _FEW:
            return 1.0
        return float(np.clip(np.sqrt(np.median(step[moves]) / max(float(np.median(step[rests])), 1e-30)), 1.0, 30.0))

    def _effective(self) -> float:
        """Frames for each independent one of what is not explained."""
        return effective(self._left())

    def updated(self) -> SearchedParameters:
        """The moments of a shift and a slip, and the rhythm of a breath, that fit what is left; those in use stay."""
        return self.columns.updated(self.counted, self._left(), set(self.owner.active))

    # ---- what it says

    @property
    def moved(self) -> Curves:
        """The curves to which the solution leads."""
        return self.fit.moved(self.curves, self.values[: self.head])

    @property
    def clock_step(self) -> Array:
        """(2,) by how much the solution moves the clock's rate and drift, s, as in `scene_of`; 0 for what is not
        active."""
        steps = np.zeros(2)
        for i, name in enumerate(("clock.rate", "clock.drift")):
            if name in self.owner.active:
                steps[i] = self.values[dict(self._blocks())[name][0]]
        return steps

    @property
    def changes(self) -> bool:
        """Whether B is another than where this was linearised."""
        shift = np.abs(self._width_step(self.values))
        return bool(shift.max() > _STILL * float(np.median(self._width_sigma())))

    def _width_columns(self) -> tuple[slice, Array]:
        """Where B's coefficients are among the unknowns, and what each adds to B, (grid, coefficients)."""
        cut = self.curves.follow.size
        return slice(cut, cut + self.fit.backlash.size), np.asarray(self.fit.backlash.design(self.fit.grid).toarray())

    def _width_step(self, values: Array) -> Array:
        """(grid,) by how much these values of the unknowns change B, unit of q."""
        block, design = self._width_columns()
        return np.asarray(design @ values[block])

    def _width_sigma(self, inverse: Array | None = None) -> Array:
        """(grid,) standard deviation of B, unit of q. inverse: covariance in units of the noise's variance, by default
        the system's."""
        block, design = self._width_columns()
        covariance = (self.inverse if inverse is None else inverse)[block, block]
        return np.asarray(self.noise * np.sqrt(np.maximum(np.sum((design @ covariance) * design, axis=1), 0.0)))

    def result(self) -> Components:
        """What was found: B as it is when the session ends, and its sigma by noise, by components that are right to a
        share of themselves, and by what differs between recordings and speeds."""
        left = self._left()
        number = effective(left)
        # Frames whose residuals go together tell as much as one; what is known beforehand is known all the same.
        alone, fewer = self._alone(1.0), self._alone(number)
        plain, own = self._width_sigma(alone), self._width_sigma()
        # A linear correction is right to a share of itself.
        parts = sorted((self._component(name, at) for name, at in self._blocks()), key=lambda part: -part.chi2)
        corrected = sum((np.mean(part.shift**2) for part in parts), 0.0)
        independent = self._width_sigma(fewer)
        sigma = np.sqrt(np.maximum(own**2 - plain**2, 0.0) + independent**2 + CORRECTS**2 * corrected)
        moved = self.moved
        moved = replace(moved, delay_s=moved.delay_s + self._as_a_delay())
        curves = replace(moved, backlash=self._at_the_end(moved.backlash))
        changed = float(np.mean((curves.backlash - moved.backlash) ** 2))
        width = self.fit.width(curves)
        between, slower = self._between_recordings() * width, LAW * self._by_speed(width)
        sigma = np.sqrt(sigma**2 + CORRECTS**2 * changed + between**2 + slower**2)
        beside = max(self.inverse[self.head - 1, self.head - 1] - alone[-1, -1], 0.0)
        own_delay = self.noise * float(np.sqrt(beside + fewer[-1, -1]))
        later = CORRECTS * float(np.sqrt(sum(part.later_s**2 for part in parts)))
        delay = float(np.hypot(own_delay, later))
        power = np.mean(left**2, axis=1)
        moves = self.counted.moving
        rests = np.mean(power[~moves]) if (~moves).sum() > _FEW else np.mean(power)
        moving = np.sqrt(np.mean(power[moves]) / max(float(rests), 1e-30)) if moves.any() else 1.0
        return Components(
            curves, moved, width, sigma, delay, self._by_delay(fewer), self._held_back_s(parts), self.noise,
            float(moving), number, tuple(parts), self.clock + self.clock_step, self.owner.rough, self._since(),
        )  # fmt: skip

    def _alone(self, number: float) -> Array:
        """Covariance of path, B and delay without components, in units of the noise's variance, where one of `number`
        frames is independent."""
        system = self.gram[: self.head, : self.head] / number + self.base
        system[np.diag_indices_from(system)] += 1e-10 * float(np.mean(np.diag(system)))
        return np.asarray(cho_solve(cho_factor(system, check_finite=False), np.eye(self.head), check_finite=False))

    def _by_delay(self, covariance: Array) -> Array:
        """(grid,) by how much B is another, unit of q, for each second that the delay is. covariance: of path, B and
        delay."""
        block, design = self._width_columns()
        return np.asarray(design @ covariance[block, -1] / covariance[-1, -1])

    def _since(self) -> tuple[DifferenceFromEnd, ...]:
        """By track, how its frames differ from what they would show when the session ends; empty where no state
        changes."""
        changed = [(name, at) for name, at in self._blocks() if name in STATES]
        if not changed:
            return ()
        counted = self.counted
        ended = {part.name: part for part in departures(counted.at_the_end(), self.columns, apart=True)}
        rows = np.zeros(counted.residuals.size)
        for name, at in changed:
            rows += (self.parts[name].columns - ended[name].columns) @ self.values[at]
        by_frame = rows.reshape(counted.residuals.shape[1], -1).T
        own = [counted.recording == k for k in range(len(self.fit.tracks))]
        return tuple(DifferenceFromEnd(counted.frame[k], by_frame[k], counted.t[k] > _LATE) for k in own)

    def _offset_at_the_end(self) -> float:
        """Of the motor's positions, unit of q: the tip is where it was at q + offset."""
        offset = 0.0
        for name, at in self._blocks():
            values = self.values[at]
            if name == "offset.recording":
                offset += float(contrasts(len(values) + 1)[-1] @ values)
            elif name == "offset.slip":
                offset += float(values[0])
            elif name == "offset.time":
                slow = slow_basis(np.array([0.5]), len(values) - 3)
                offset += float((slow @ values)[0])
        return offset

    def _at_the_end(self, backlash: Array) -> Array:
        """B's coefficients as they are when the session ends, of slow strokes: others are wider by what a departure
        says. What offsets the transmission takes B along."""
        values = {name: self.values[at] for name, at in self._blocks() if name.startswith("width.")}
        if offset := self._offset_at_the_end():
            basis, grid = self.fit.backlash, self.fit.grid
            there = basis.value(backlash, np.clip(grid + offset, grid[0], grid[-1]))
            backlash = np.linalg.lstsq(basis.design(grid).toarray(), there, rcond=None)[0]
        grown = 1.0 + 0.5 * float(values["width.time"][0]) if "width.time" in values else 1.0
        if "width.recording" in values:
            each = values["width.recording"]
            grown += float(contrasts(len(each) + 1)[-1] @ each)
        return np.maximum(backlash * grown - self._by_speed(backlash), 0.0)

    def _as_a_delay(self) -> float:
        """A lag, s, that is so short that frames do not tell it from a delay; 0 where it is longer."""
        lags = sum(float(self.values[at][0]) for name, at in self._blocks() if name.startswith("lag"))
        return lags if lags < _SHORT * float(np.median(np.diff(self.counted.time_s))) else 0.0

    def _held_back_s(self, parts: Sequence[Component]) -> float:
        """By how much, s, a tracker shows a moving tip late that holds back what begins: what all strokes share of that
        is as much as what they do not. 0 where the tracker does not err so."""
        rms = {part.name: part.rms for part in parts if part.name in ("tracker", "phase.even")}
        speed = (np.linalg.norm(self.counted.slope, axis=1) * np.abs(self.counted.speed))[self.counted.moving]
        if "tracker" not in rms or not len(speed):
            return 0.0
        return sum(rms.values()) / max(float(np.median(speed)), 1e-12)

    def _by_speed(self, width: Array) -> Array:
        """(grid,) by how much a width, B (grid,), at the usual speed is more than that of slow strokes, unit of q."""
        added = [(name, float(self.values[at][0])) for name, at in self._blocks() if name.startswith(SPEED)]
        return np.asarray(sum((v * (width if name.endswith(SHARE) else 1.0) for name, v in added), 0.0 * width))

    def _between_recordings(self) -> float:
        """Standard deviation of B, as a share of it, from one recording to the next: no B is known better."""
        values = [self.values[at] for name, at in self._blocks() if name == "width.recording"]
        return float(np.sqrt(np.mean(values[0] ** 2))) if values else 0.0

    def _component(self, name: str, at: npt.NDArray[np.intp]) -> Component:
        """What was found of an active component whose values are at these places: its strength, and how B and the delay
        would change if it were held at zero."""
        values = self.values[at]
        own = self.inverse[np.ix_(at, at)]
        pulled = np.linalg.solve(own + 1e-12 * float(np.trace(own)) / len(at) * np.eye(len(at)), values)
        chi2 = float(values @ pulled) / max(self.noise**2, 1e-30)
        rms = self.noise * float(np.sqrt(max(chi2, 0.0) / max(float(self.weight.sum()), 1.0)))
        without = -self.inverse[:, at] @ pulled
        return Component(name, rms, chi2, self._width_step(without), float(without[self.head - 1]), values)


def effective(left: Array) -> float:
    """Frames for each independent one, outliers bounded, while the autocorrelation is more than chance."""
    clipped = np.clip(left / max(float(np.sqrt(np.mean(left**2))), 1e-30), -4.0, 4.0)
    return frames_each(clipped, min(_LAGS, len(clipped) // 4), least=2.0 / float(np.sqrt(clipped.size)))
