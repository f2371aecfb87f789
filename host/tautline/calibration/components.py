"""Variance components of a calibration: effects that a play with one delay does not contain, found in the residuals of
the joint fit of B, path and delay, and estimated together with it.

The residuals are a mixed model (mixed_model.py): a departure (departures.py) is one way in which a real instrument,
clock or camera differs from a play, and becomes a component where the restricted likelihood gains enough by it. Its
values are solved together with B, so that they add to B's covariance.

grid: the joint fit's positions, (grid,); B in the unit of q.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
from scipy import sparse

from tautline.calibration.counted import CountedFrames, counted_frames, on_clock
from tautline.calibration.departures import (
    SHARE,
    SPEED,
    STATES,
    SearchedParameters,
    contrasts,
    departures,
    slow_basis,
    tracker_error_length,
)
from tautline.calibration.mixed_model import MixedModel, Selected, frames_per_independent
from tautline.calibration.observations import Track
from tautline.calibration.playfit import Curves, Fitted
from tautline.encoder import count_of
from tautline.least_squares import inverse_of
from tautline.rig import Rig
from tautline.spread import of_rounding

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

_LINEARISATIONS = 14  # tolerance: at most
_STEP_SHARES = (1.0, 0.5, 0.2)  # tolerance: of a step, tried in turn
_RIDGE = 1e-10  # tolerance: of the nominal unknowns' mean information, added to each one's
WORSE = 1.02  # tolerance: ratio of what is left after and before, from which a step leads too far
_SHOWS = 0.3  # tolerance: of the noise: an encoder's count that moves the image by more shows
LAW = 0.5  # prior: of what speed adds to B: its uncertainty, as slower than what was seen it may follow another law
CORRECTS = 0.3  # prior: of a component's correction of B: its standard deviation
_SHORT_LAG = 0.1  # tolerance: of a frame's period: a shorter lag is not told from a delay
_END = 0.5  # equation: session time at its end, of t from -1/2 to 1/2 as departures have it
_LATE = 0.25  # tolerance: of the session, at its end: what has come to rest by then does not go on


@dataclass(frozen=True)
class Component:
    """One departure as it was estimated. "Held at zero": as if the component were not in the model."""

    name: str
    rms: float  # rms over the stated noise by which residuals would grow if it were held at zero
    chi2: float  # the same as a sum of squares over the noise's variance (Wald statistic)
    width_shift: Array  # (grid,) by how much B would change if it were held at zero
    delay_shift_s: float  # by how much the delay would change then
    values: Array  # (m,) of its columns


@dataclass(frozen=True)
class DifferenceFromEnd:
    """How the counted frames of one track differ from what they would show with the state at the session's end."""

    frames: Indices  # (n,) of the track
    over_noise: Array  # (n, channels) seen less what would be seen at the end, over the stated noise
    late: Array  # (late, channels) of the session's last quarter, by what changes gradually alone
    spread: Array  # (n, channels, m) standard deviation of that, a column for each direction that varies by itself
    sigma: Array  # (n,) the noise, sensor's unit


@dataclass(frozen=True)
class EndedTrack:
    """A track as if it had been seen with the state of the session's end."""

    track: Track
    spread: Array  # (n, channels, m) sensor's unit: m errors that all frames share, each one standard deviation


@dataclass(frozen=True)
class Components:
    """The joint fit with all components, B being that of the session's end."""

    curves: Curves  # B as it is when the session ends
    session_mean: Curves  # B as it is in the mean of the session
    width: Array  # (grid,) B of `curves`
    sigma: Array  # (grid,) standard deviation of B, model error included
    delay_sigma: float
    width_by_delay: Array  # (grid,) dB/d(delay), unit of q per s, along the posterior's correlation
    tracker_lag_s: float  # by how much a tracker may show a moving tip late
    unexplained: float  # rms over the stated noise of the residuals that no component explains
    moving_ratio: float  # rms of these while the tip moves over that while it rests
    frames_per_independent: float  # of these: how many neighbours tell as much as one independent frame
    parts: tuple[Component, ...]  # strongest first
    clock_error: Array  # (2,) s by which the sensor's clock departs, linear and quadratic over the session
    count_visible: bool  # an encoder's count shows in the image
    from_end: tuple[DifferenceFromEnd, ...] = ()  # by track; empty where nothing changed during the session

    @property
    def late_change(self) -> float:
        """rms over the noise, in the last quarter of the session, of the difference between what was seen and what
        would be seen with the end's state, by gradual changes alone; 0 if nothing changed."""
        late = [each.late for each in self.from_end if len(each.late)]
        return float(np.sqrt(np.mean(np.concatenate(late) ** 2))) if late else 0.0

    def at_the_end(self, tracks: Sequence[Track]) -> list[EndedTrack]:
        """The counted frames of the fit's tracks as if all had been seen with the state of the session's end. tracks:
        those that were fitted. Empty if nothing changed during the session; tracks without counted frames are left
        out."""
        kept = [track.only(change.frames) for track, change in zip(tracks, self.from_end, strict=True)]
        return [
            EndedTrack(
                replace(track, y=track.y - change.over_noise * change.sigma[:, None]),
                change.spread * change.sigma[:, None, None],
            )
            for track, change in zip(kept, self.from_end, strict=True)
            if len(track.t_s)
        ]

    @property
    def strongest_rms(self) -> float:
        """The largest rms of a component, over the stated noise; 0 without any."""
        return max((part.rms for part in self.parts), default=0.0)

    @property
    def tracker_errs(self) -> bool:
        """Whether the error of a marker's tracker is one of the components."""
        return any(part.name == "tracker" for part in self.parts)

    @property
    def mainly_start_of_strokes(self) -> bool:
        """Whether the strongest component is how the tip starts after a reversal (gradual or asymmetric)."""
        return bool(self.parts) and self.parts[0].name.startswith("phase")

    def applied_to(self, fitted: Fitted) -> Fitted:
        """The joint fit with the components' B, path and delay, their sigmas, and the sensor's clock corrected; its
        scale is `unexplained`. Its covariance and weights stay those of the fit without components."""
        fit = replace(fitted.fit, tracks=on_clock(fitted.fit.tracks, self.clock_error), smoothing=fitted.fit.smoothing)
        residuals, masks = fit.residuals(self.curves)
        return replace(
            fitted, fit=fit, curves=self.curves, residuals=residuals, masks=masks, scale=self.unexplained,
            spread=self.sigma, delay_spread=self.delay_sigma, width_by_delay=self.width_by_delay,
        )  # fmt: skip


def separate(fitted: Fitted, rig: Rig, without: frozenset[str] = frozenset()) -> Components:
    """Re-estimates B, path and delay of a joint fit together with the components that its residuals show. without:
    names of departures that the fit's own model contains, which are not tried."""
    return _Selection(fitted, rig, without).run()


@dataclass
class _Selection:
    """The forward selection of components in a joint fit's residuals."""

    fitted: Fitted
    rig: Rig
    without: frozenset[str] = frozenset()
    selected: Selected = field(default_factory=Selected)
    count_visible: bool = False  # an encoder's count shows in the image

    def run(self) -> Components:
        """Selects components. In turns, components join and are estimated at one linearisation, and path, B and delay
        move by the solution (Gauss-Newton); until no component joins and B stays where it is, or no step helps."""
        self._begin_with_turns()
        counted = counted_frames(self.fitted, self.fitted.curves, self.rig, np.zeros(2))
        assert counted is not None  # it was fitted to frames
        searched = SearchedParameters(tracker_length_px=tracker_error_length(counted))
        if counted.residuals.shape[1] == 1:
            # An angle sensor has no image that may have moved instead: a slip is looked for before components that
            # differ by stroke stand in for it.
            searched = searched.updated(counted, counted.residuals, set())
        model = self._model(self.fitted.curves, counted, np.zeros(2), searched)
        for _ in range(_LINEARISATIONS):
            joined = model.join()
            self.selected.moving_noise = model.moving_noise()
            searched = model.searched_again()
            if not joined and not model.moves_width:
                break
            relinearised = self._relinearised(model, searched)
            if relinearised is None:
                break
            model = relinearised
        return _Estimated(model, self.count_visible).components()

    def _begin_with_turns(self) -> None:
        """Makes `turn` a component at once, and sets count_visible, if an encoder's count shows: if its standard
        deviation moves the image by more than _SHOWS of the noise. The motor's turns are known no better then, whatever
        else departs."""
        fit, resolution = self.fitted.fit, self.rig.actuator.encoder_resolution
        count = of_rounding(max(count_of(prepared.track.reading, resolution) for prepared in fit.tracks))
        steep = np.linalg.norm(fit.follow.slope(self.fitted.curves.follow, fit.grid).reshape(len(fit.grid), -1), axis=1)
        sigma = float(np.median(np.concatenate([prepared.track.sigma for prepared in fit.tracks])))
        if count * float(np.median(steep)) > _SHOWS * sigma:
            self.count_visible = True
            self.selected.active.append("turn")
            # lambda = sigma^2 / s^2 (mixed_model.py), s the count's standard deviation.
            self.selected.penalties["turn"] = (self.fitted.scale / count) ** 2

    def _model(
        self, curves: Curves, counted: CountedFrames, clock_error: Array, searched: SearchedParameters
    ) -> MixedModel:
        """The mixed model linearised at these curves, solved with the active components. counted: the frames at these
        curves and this clock error (2,), s."""
        candidates = [part for part in departures(counted, searched) if part.name not in self.without]
        model = MixedModel(self.fitted, self.selected, curves, counted, candidates, clock_error, searched)
        model.solve_with_variances()
        return model

    def _relinearised(self, model: MixedModel, searched: SearchedParameters) -> MixedModel | None:
        """The model linearised and solved anew at the curves of its solution or, if the residuals grow by more than the
        factor WORSE there, at a share of the step (_STEP_SHARES); None if they do at all shares. `selected` is as
        before each trial that fails."""
        active, penalties = list(self.selected.active), dict(self.selected.penalties)
        for share in _STEP_SHARES:
            curves = interpolated(model.curves, model.solution, share)
            clock_error = model.clock_error + share * model.clock_step
            counted = counted_frames(self.fitted, curves, self.rig, clock_error)
            trial = None if counted is None else self._model(curves, counted, clock_error, searched)
            if trial is not None and trial.noise < WORSE * model.noise:
                return trial
            self.selected.active, self.selected.penalties = list(active), dict(penalties)
        return None


def interpolated(start: Curves, end: Curves, share: float) -> Curves:
    """The curves at this share, 0 to 1, of the way from `start` to `end`. Values of effects are left out."""
    return Curves(
        start.backlash + share * (end.backlash - start.backlash),
        start.follow + share * (end.follow - start.follow),
        start.delay_s + share * (end.delay_s - start.delay_s),
    )


@dataclass(frozen=True)
class _Estimated:
    """What a mixed model that is solved says: components, B with its sigma, and the state at the session's end."""

    model: MixedModel
    count_visible: bool

    def components(self) -> Components:
        """The components and all that follows from them. B is that of slow strokes at the session's end."""
        residuals = self.model.residuals_left()
        frames_each = frames_per_independent(residuals)
        # Covariances of the nominal unknowns without components: if all frames were independent, and with as many as
        # are. Only the frames' information is divided by `frames_each`, that of the priors is not.
        without_components, of_independent = self._nominal_inverse(1.0), self._nominal_inverse(frames_each)
        found = (self._component(name, at) for name, at in self.model.active_blocks())
        parts = sorted(found, key=lambda part: -part.chi2)
        mean = self.model.solution
        mean = replace(mean, delay_s=mean.delay_s + self._lag_taken_for_delay())
        curves = replace(mean, backlash=self._width_at_the_end(mean.backlash))
        width = self.model.fit.width(curves)
        changed = float(np.mean((curves.backlash - mean.backlash) ** 2))
        return Components(
            curves=curves,
            session_mean=mean,
            width=width,
            sigma=self._total_width_sigma(without_components, of_independent, parts, changed, width),
            delay_sigma=self._total_delay_sigma(without_components, of_independent, parts),
            width_by_delay=self._width_by_delay(of_independent),
            tracker_lag_s=self._tracker_lag_s(parts),
            unexplained=self.model.noise,
            moving_ratio=self.model.moving_ratio(residuals),
            frames_per_independent=frames_each,
            parts=tuple(parts),
            clock_error=self.model.clock_error + self.model.clock_step,
            count_visible=self.count_visible,
            from_end=self._from_end(),
        )

    def _nominal_inverse(self, frames_each: float) -> Array:
        """Covariance (nominal, nominal) of path, B and delay without components, in units of the noise's variance, if
        `frames_each` frames tell as much as one independent frame."""
        system = self.model.gram[: self.model.nominal, : self.model.nominal] / frames_each + self.model.nominal_penalty
        system[np.diag_indices_from(system)] += _RIDGE * float(np.mean(np.diag(system)))
        return inverse_of(system)

    def _total_width_sigma(
        self, without_components: Array, of_independent: Array, parts: Sequence[Component], changed: float, width: Array
    ) -> Array:
        """(grid,) standard deviation of B, unit of q; in quadrature: what the components add to its variance; the noise
        of the independent frames; CORRECTS times the rms over the grid of each component's correction of B, and times
        the rms difference of B's coefficients between slow strokes at the session's end and the session's mean
        (changed: its square); the scatter between recordings; and LAW times what speed adds to `width`, B (grid,).
        without_components, of_independent: `_nominal_inverse` of all frames and of the independent ones."""
        without, own = self.model.width_sigma(without_components), self.model.width_sigma()
        corrected = sum((np.mean(part.width_shift**2) for part in parts), 0.0)
        independent = self.model.width_sigma(of_independent)
        sigma = np.sqrt(np.maximum(own**2 - without**2, 0.0) + independent**2 + CORRECTS**2 * corrected)
        between, by_speed = self._scatter_between_recordings() * width, LAW * self._added_by_speed(width)
        return np.asarray(np.sqrt(sigma**2 + CORRECTS**2 * changed + between**2 + by_speed**2))

    def _total_delay_sigma(self, without_components: Array, of_independent: Array, parts: Sequence[Component]) -> float:
        """Standard deviation of the delay, s, in quadrature: what the components add to its variance, the noise of as
        many frames as are independent, and CORRECTS of what the components correct. without_components, of_independent:
        `_nominal_inverse` of all frames and of the independent ones, the delay last."""
        delay = self.model.nominal - 1
        added = max(self.model.inverse[delay, delay] - without_components[delay, delay], 0.0)
        own = self.model.noise * float(np.sqrt(added + of_independent[delay, delay]))
        corrected = CORRECTS * float(np.sqrt(sum(part.delay_shift_s**2 for part in parts)))
        return float(np.hypot(own, corrected))

    def _width_by_delay(self, covariance: Array) -> Array:
        """(grid,) cov(B, delay) / var(delay): by how much B changes, unit of q, for each second that the delay does.
        covariance (nominal, nominal)."""
        block, design = self.model.width_block()
        return np.asarray(design @ covariance[block, -1] / covariance[-1, -1])

    def _component(self, name: str, at: Indices) -> Component:
        """The active component `name`, whose values are at the indices `at` of the model's: its strength, and how B and
        the delay would change if its values u were held at zero. The Wald statistic is u' C_uu^-1 u, the others'
        conditional mean changes by -C_xu C_uu^-1 u, where C is the covariance."""
        values = self.model.values[at]
        own = self.model.inverse[np.ix_(at, at)]
        # C_uu^-1 u, with a ridge that keeps C_uu regular.
        pulled = np.linalg.solve(own + 1e-12 * float(np.trace(own)) / len(at) * np.eye(len(at)), values)
        chi2 = float(values @ pulled) / max(self.model.noise**2, 1e-30)
        rms = self.model.noise * float(np.sqrt(max(chi2, 0.0) / max(float(self.model.weight.sum()), 1.0)))
        without = -self.model.inverse[:, at] @ pulled
        return Component(
            name, rms, chi2, self.model.width_step(without), float(without[self.model.nominal - 1]), values
        )

    def _tracker_lag_s(self, parts: Sequence[Component]) -> float:
        """By how much, s, a tracker that holds back small motions may show a moving tip late: the rms of the components
        that it causes over the median speed in the image. These components show only what differs from stroke to
        stroke; a lag that all strokes share is taken to be as large. 0 without a component `tracker`."""
        rms = {part.name: part.rms for part in parts if part.name in ("tracker", "phase.even")}
        speed = np.linalg.norm(self.model.counted.slope, axis=1) * np.abs(self.model.counted.speed)
        speed = speed[self.model.counted.moving]
        if "tracker" not in rms or not len(speed):
            return 0.0
        return sum(rms.values()) / max(float(np.median(speed)), 1e-12)

    def _lag_taken_for_delay(self) -> float:
        """The sum of the lags, s, if it is shorter than _SHORT_LAG of a frame's period, so that frames do not tell it
        from a delay, to which it is to be added; else 0."""
        lags = sum(float(self.model.values[at][0]) for name, at in self.model.active_blocks() if name.startswith("lag"))
        return lags if lags < _SHORT_LAG * float(np.median(np.diff(self.model.counted.time_s))) else 0.0

    def _added_by_speed(self, width: Array) -> Array:
        """(k,) how much wider B is at the usual speed than in slow strokes, unit of q, by the components of speed;
        width (k,): B at the usual speed, or its coefficients."""
        added = [
            (name, float(self.model.values[at][0])) for name, at in self.model.active_blocks() if name.startswith(SPEED)
        ]
        return np.asarray(sum((v * (width if name.endswith(SHARE) else 1.0) for name, v in added), 0.0 * width))

    def _scatter_between_recordings(self) -> float:
        """rms, as a share of B, by which B differs from one recording to the next; 0 without such a component."""
        values = [self.model.values[at] for name, at in self.model.active_blocks() if name == "width.recording"]
        return float(np.sqrt(np.mean(values[0] ** 2))) if values else 0.0

    # ---- the state at the session's end

    def _from_end(self) -> tuple[DifferenceFromEnd, ...]:
        """By track, how its frames differ from what they would show with the state of the session's end: the columns of
        components that are a state (STATES), less the same columns at the end, times their values. The spread has a
        column for each eigenvector of the values' covariance. Empty if no component is a state."""
        changed = [(name, at) for name, at in self.model.active_blocks() if name in STATES]
        if not changed:
            return ()
        counted = self.model.counted
        ended = {part.name: part for part in departures(counted.at_the_end(), self.model.searched, apart=True)}
        columns = sparse.hstack([self.model.candidates[name].columns - ended[name].columns for name, _ in changed])
        places, shape = np.concatenate([at for _, at in changed]), (counted.residuals.shape[1], -1)
        values = self.model.values[places]
        gradual = np.concatenate([np.full(len(at), name.endswith("time")) for name, at in changed])
        by_frame, gradually = ((columns @ each).reshape(shape).T for each in (values, values * gradual))
        covariance = self.model.inverse[np.ix_(places, places)] * self.model.frames_per_independent()
        variance, directions = np.linalg.eigh(covariance)
        spread = columns @ (directions * (self.model.noise * np.sqrt(np.maximum(variance, 0.0))))
        spread = spread.reshape(*shape, len(places)).transpose(1, 0, 2)
        differences = []
        for number, prepared in enumerate(self.model.fit.tracks):
            own = counted.recording == number
            frames, late = counted.frame[own], own & (counted.t > _END - _LATE)
            sigma = prepared.track.sigma[frames]
            differences.append(DifferenceFromEnd(frames, by_frame[own], gradually[late], spread[own], sigma))
        return tuple(differences)

    def _offset_at_the_end(self) -> float:
        """Offset of the motor's positions at the session's end against its mean, unit of q: the tip at q is where, in
        the mean, it was at q + offset. 0 without such components."""
        offset = 0.0
        for name, at in self.model.active_blocks():
            values = self.model.values[at]
            if name == "offset.recording":
                offset += float(contrasts(len(values) + 1)[-1] @ values)
            elif name == "offset.slip":
                offset += float(values[0])
            elif name == "offset.time":
                slow = slow_basis(np.array([_END]), len(values) - 3)  # a cubic spline has 3 more values than spans
                offset += float((slow @ values)[0])
        return offset

    def _width_at_the_end(self, backlash: Array) -> Array:
        """B's coefficients (m,) for slow strokes at the session's end, from those of the session's mean, `backlash`
        (m,): shifted by the transmission's offset, times B's growth until the end and in the last recording, less what
        speed adds."""
        values = {name: self.model.values[at] for name, at in self.model.active_blocks() if name.startswith("width.")}
        if offset := self._offset_at_the_end():
            basis, grid = self.model.fit.backlash, self.model.fit.grid
            there = basis.value(backlash, np.clip(grid + offset, grid[0], grid[-1]))
            backlash = basis.nearest(grid, there)
        grown = 1.0 + _END * float(values["width.time"][0]) if "width.time" in values else 1.0
        if "width.recording" in values:
            each = values["width.recording"]
            grown += float(contrasts(len(each) + 1)[-1] @ each)
        return np.maximum(backlash * grown - self._added_by_speed(backlash), 0.0)
