"""What a model is worth: how well it predicts blocks of its own calibration with a fit that has not seen them
(cross-validation), beside f_coarse, a tip that never moves, and the noise.

Near its optimum a fit is a linear least-squares problem: without block b its unknowns change by -(N - N_b)^-1 g_b,
where N is the normal matrix, and N_b and g_b are the block's own parts of it and of the gradient. The play is then
simulated anew. What departs from the model is not predicted: it stays in the errors, as it will in a motion to come.

Errors are seen less predicted, (n, k) of each track: k = 2 px or 1 deg, over the stated noise where not said otherwise.
Masks (n,) say which frames count."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_solve
from scipy.spatial import KDTree

from tautline.calibration.beside import FittedEffects
from tautline.calibration.observations import Mask, Track
from tautline.calibration.playfit import STRAY, Curves, Fitted, PlayFit
from tautline.calibration.remaining import view_of
from tautline.calibration.simulated_track import PreparedTrack, Simulated
from tautline.calibration.smooth import SPANS
from tautline.core.samples import least_noise
from tautline.geometry import across, project
from tautline.independence import less_its_trend, remembered, stretches
from tautline.least_squares import factor
from tautline.model import Model
from tautline.quality import Reason
from tautline.splines import Basis

Array = npt.NDArray[np.float64]
Labels = npt.NDArray[np.intp]

PREDICTS = 1.3  # format: of the noise, within which a good model predicts (docs/calibration.md)
HALF_CYCLES = 2  # equation: half-cycles of a block at least, one of each direction
BLOCKS = 8  # tolerance: of which one is a small share of all; with fewer half-cycles nothing is left out
STAYS = 0.1  # tolerance: of a block that stays in the fit: what it alone shows (a range's ends) no other can predict
_FEW = 30  # tolerance: frames that are needed to tell a scatter
_TOGETHER = 2.0  # tolerance: times the noise, within which two passes show one place
_SLOW = 3  # tolerance: order of the trend within a rest: sway or breath, which is no noise
_RIDGE = 1e-10  # tolerance: of the diagonal, for rounding


@dataclass(frozen=True)
class Worth:
    """rms errors per coordinate, px or deg, of frames after the tip was driven both ways; outliers are cut."""

    model: float  # of blocks that were left out; where there are too few, of the fit itself
    coarse: float  # c = gain q + offset, no backlash
    constant: float  # the mean of what was seen
    over_noise: float  # the model's error with the sensor's noise, over that noise; 1 where it errs by nothing
    unit: str
    blocks: int  # 0: too few to leave any out

    @property
    def predicts(self) -> bool:
        """Whether its error is within PREDICTS times the noise."""
        return self.over_noise <= PREDICTS

    @property
    def useless(self) -> bool:
        """Whether the model does not predict to within the noise, and f_coarse or a tip that never moves predicts as
        well."""
        return not self.predicts and self.model >= min(self.coarse, self.constant)

    @property
    def doubts(self) -> list[Reason]:
        """A list of one fatal reason if the model is useless, else an empty one."""
        if not self.useless:
            return []
        of_sensor = "camera, hand_eye" if self.unit == "px" else "coarse.gain, the unit of angle.csv"
        return [
            Reason(
                "predicts",
                f"it predicts its own recordings to {self.model:.3g} {self.unit}, f_coarse to {self.coarse:.3g}, "
                f"a tip that never moves to {self.constant:.3g}",
                f"nothing fits the rig: check {of_sensor}, actuator.unit and the clock of the frames",
                fatal=True,
            )
        ]


def predictive_worth(
    model: Model, tracks: Sequence[Track], joint_fit: Fitted | None, remaining: Fitted | None
) -> Worth | None:
    """What the model is worth on these tracks, which are on the motor's clock. joint_fit, remaining: the fits of B and
    of f_remain, whose smoothness is the prior of both; if one is None, or there are too few half-cycles, no block is
    left out and the errors are the fit's own. None if nothing was seen after the tip was driven both ways."""
    if remaining is not None:
        tracks = [prepared.track for prepared in remaining.fit.tracks]  # with the noise that each place has
    fit, curves = _fit_of(model, tracks, joint_fit, remaining)
    residuals, masks = fit.residuals(curves)
    if not any(mask.any() for mask in masks):
        return None
    errors, labels = residuals, _block_numbers(fit, masks)
    apart = labels is not None and joint_fit is not None and remaining is not None
    if labels is not None and apart:
        errors = _held_out_errors(fit, curves, residuals, masks, labels)
    masks = _frames_of_tip(fit, curves, errors, masks)
    in_unit = [miss * track.sigma[:, None] for miss, track in zip(errors, tracks, strict=True)]
    by_coarse = [track.y - _predicted_by_coarse_law(track, model) for track in tracks]
    seen = _counted_rows([track.y for track in tracks], masks)
    return Worth(
        model=bounded_rms(_counted_rows(in_unit, masks)),
        coarse=bounded_rms(_counted_rows(by_coarse, masks)),
        constant=bounded_rms(seen - seen.mean(axis=0)),
        over_noise=_over_noise(fit, curves, errors, masks),
        unit=tracks[0].unit,
        blocks=BLOCKS if apart else 0,
    )


def bounded_rms(off: Array) -> float:
    """rms per coordinate of errors (n, k), with frames cut at STRAY times the usual error; infinite if an error is, as
    that of a prediction behind the camera."""
    norm = np.sqrt(np.mean(off**2, axis=1))
    usual = float(np.sqrt(np.mean(np.minimum(norm, STRAY * float(np.median(norm))) ** 2)))
    return float(np.sqrt(np.mean(np.minimum(norm, STRAY * usual) ** 2))) if np.isfinite(usual) else float("inf")


def _frames_of_tip(fit: PlayFit, curves: Curves, errors: Sequence[Array], masks: Sequence[Mask]) -> list[Mask]:
    """The masks without frames that show something else than the tip (another blob, a lost count). Such a frame's error
    is larger than STRAY times the usual one, and larger than a shift of the tip by all of B would make in the image.
    For that the image is taken to move with the tip at least as much as on average (rms), since a model that lets it
    rest there may be wrong."""
    usual, widest = STRAY * bounded_rms(_counted_rows(errors, masks)), float(fit.width(curves).max())
    kept = []
    for prepared, sim, off, mask in zip(fit.tracks, fit.simulated, errors, masks, strict=True):
        steep = np.linalg.norm(fit.slope_in_view(prepared.track, curves, sim.tip), axis=1)
        usual_steep = float(np.sqrt(np.mean(steep[mask] ** 2))) if mask.any() else 0.0
        by_width = widest * np.maximum(steep, usual_steep) / prepared.track.sigma
        kept.append(mask & (np.linalg.norm(off, axis=1) <= np.maximum(usual, by_width)))
    return kept


def _over_noise(fit: PlayFit, curves: Curves, errors: Sequence[Array], masks: Sequence[Mask]) -> float:
    """The model's error with the sensor's noise, over that noise, at least 1: sqrt(1 + (missed^2 - noise^2) / (noise^2
    + placed^2)), mean squares per coordinate over the stated noise. missed: the errors. placed: a tracker's error that
    is drawn anew at each place. noise of resting frames: half the squared difference of neighbours. noise of moving
    frames: the smaller of those of neighbours and of passes over the same place, both across the path, where nothing
    moves the image; what passes repeat is no noise. Noise that is correlated in time makes neighbours differ less,
    which is corrected for. If only one of resting and moving noise is known it stands for both, and the stated one if
    neither is. Infinite if no two neighbouring frames count."""
    limit = STRAY * bounded_rms(_counted_rows(errors, masks))
    tracks = [
        _squares(fit, curves, prepared, sim, off, mask, limit)
        for prepared, sim, off, mask in zip(fit.tracks, fit.simulated, errors, masks, strict=True)
    ]
    if not any((mask[1:] & mask[:-1]).any() for mask in masks):
        return np.inf
    rests = [rest for track in tracks for rest in track.rests]
    # Correlation of the noise from frame to frame: neighbours differ by the share 1 - memory of the noise's variance.
    memory = remembered(rests, _SLOW)[0] if sum(map(len, rests)) >= _FEW else 0.0
    variances = [_mean_square([track.at_rest for track in tracks]), _mean_square([track.across for track in tracks])]
    at_rest, moving = (square and square / (1.0 - memory) for square in variances)
    if passes := _differ_by_passes(tracks):
        moving = min(moving, passes)
    at_rest, moving = at_rest or moving or 1.0, moving or at_rest or 1.0
    least2 = np.concatenate([track.least2 for track in tracks])
    moves = np.concatenate([track.moves for track in tracks])
    noise2 = float(np.mean(np.maximum(np.where(moves, moving, at_rest), least2)))
    missed2 = float(np.concatenate([track.missed for track in tracks]).mean())
    placed2 = float(np.concatenate([track.placed for track in tracks]).mean())
    return float(np.sqrt(1.0 + max(missed2 - noise2, 0.0) / (noise2 + placed2)))


@dataclass(frozen=True)
class _Squares:
    """Squares over the stated noise of the counted frames of one track, and those of neighbouring ones."""

    missed: Array  # (frames,) mean over coordinates
    moves: Mask  # (frames,) the tip moves
    least2: Array  # (frames,) least that is noise; as stated where one place repeats it: of rounding, of our tracker
    placed: Array  # (frames,) of a tracker's error at each place
    at_rest: Array  # of resting pairs, half the squared difference in either direction
    across: Array  # (moving pairs,) the same across the path of the tip's image; empty for one channel
    sideways: Array  # (moving frames,) errors across the path; empty for one channel, and where one place repeats noise
    place: Array  # (moving frames, k) where the model has the tip in the image, px
    sigma: Array  # (moving frames,) the stated noise, px
    rises: Mask  # (moving frames,) by a rising motor
    rests: list[Array]  # (frames of a rest, 1) errors across the path, less their trend; empty for one channel


def _squares(
    fit: PlayFit, curves: Curves, prepared: PreparedTrack, sim: Simulated, off: Array, mask: Mask,
    limit: float,
) -> _Squares:  # fmt: skip
    """The squares of one track. off (n, k): errors over the stated noise; mask (n,): frames that count; limit: rms per
    coordinate to which larger errors are cut. If one place repeats its error (a sensor that rounds, our own tracker)
    passes that agree tell nothing of the noise: then `sideways` is empty, and the noise is at least the stated one."""
    track = prepared.track
    counted = np.where(mask[:, None], off, 0.0)
    norm = np.sqrt(np.mean(counted**2, axis=1))
    cut = counted * np.minimum(1.0, limit / np.maximum(norm, limit))[:, None]
    pair, moves = mask[1:] & mask[:-1], sim.moving[1:] & sim.moving[:-1]
    squares, place_repeats = 0.5 * np.diff(cut, axis=0) ** 2, track.step > 0.0 or track.placed_px > 0.0
    across_moving, sideways, rests, moving = np.zeros(0), np.zeros(0), list[Array](), mask & sim.moving
    if cut.shape[1] > 1:
        path = fit.slope_in_view(track, curves, sim.tip)
        across_path = across(cut, path)
        across_moving = 0.5 * np.diff(across_path)[pair & moves] ** 2
        rests = _at_rest(track.t_s, across_path[:, None], mask & ~sim.moving)
        sideways = sideways if place_repeats else across_path[moving]
    least = np.ones(len(off)) if place_repeats else least_noise(track.unit) / track.sigma
    return _Squares(
        missed=np.mean(cut**2, axis=1)[mask],
        moves=sim.moving[mask],
        least2=least[mask] ** 2,
        placed=(track.placed_px / track.sigma[mask]) ** 2,
        at_rest=squares[pair & ~moves].ravel(),
        across=across_moving,
        sideways=sideways,
        place=fit.predicted(track, curves, sim.tip)[moving],
        sigma=track.sigma[moving],
        rises=(sim.side > 0)[moving],
        rests=rests,
    )


def _differ_by_passes(tracks: Sequence[_Squares]) -> float:
    """Half the mean squared difference between the errors across the path of each frame on the way up and of the
    nearest frame on the way down, within _TOGETHER times the noise; 0 with fewer than _FEW such pairs."""
    counted = [track for track in tracks if len(track.sideways)]
    if not counted:
        return 0.0
    off, place, rises, sigma = (
        np.concatenate([getattr(track, name) for track in counted]) for name in ("sideways", "place", "rises", "sigma")
    )
    if not rises.any() or rises.all():
        return 0.0
    within = _TOGETHER * float(np.median(sigma))
    apart, nearest = KDTree(place[~rises]).query(place[rises], distance_upper_bound=within)
    near = np.isfinite(apart)
    return _mean_square([0.5 * (off[rises][near] - off[~rises][np.asarray(nearest)[near]]) ** 2])


def _at_rest(t: Array, off: Array, resting: Mask) -> list[Array]:
    """The errors off (n, 1), at times t (n,), s, in each rest of at least 2 _SLOW frames, less their trend of order
    _SLOW: what the place or a slow sway adds is no noise. resting (n,): frames at which the tip rests."""
    rests = [rest for rest in stretches(resting) if rest.stop - rest.start >= 2 * _SLOW]
    return [less_its_trend(t[rest], off[rest], _SLOW) for rest in rests]


def _mean_square(squares: Sequence[Array]) -> float:
    """Mean of the squares of all tracks; 0 of fewer than _FEW."""
    every = np.concatenate(squares)
    return float(every.mean()) if len(every) >= _FEW else 0.0


def _counted_rows(off: Sequence[Array], masks: Sequence[Mask]) -> Array:
    """(counted, k) the rows of `off` (n, k), by track, at which the masks hold, of all tracks one after the other."""
    return np.concatenate([each[mask] for each, mask in zip(off, masks, strict=True)])


def _predicted_by_coarse_law(track: Track, model: Model) -> Array:
    """(n, k) the prediction of each frame by f_coarse alone, without backlash, in the track's unit."""
    scene, coarse = track.scene_s(model.delay_s), model.rig.coarse
    c = coarse.gain * track.motor_at(scene) + coarse.offset
    return project(model.rig, c, *track.others_at(scene)) if track.unit == "px" else np.asarray(c[:, None])


def _fit_of(
    model: Model, tracks: Sequence[Track], joint_fit: Fitted | None, remaining: Fitted | None
) -> tuple[PlayFit, Curves]:
    """The model as a PlayFit, and its curves: B, f_remain (seen through the projection if the sensor is a camera),
    delay and effects. Smoothing and priors are those of the two fits that they are from; a new PlayFit's own if one of
    these is None."""
    basis = Basis(float(model.q[0]), float(model.q[-1]), SPANS)
    fit = PlayFit(
        [PreparedTrack.of(track) for track in tracks], basis, basis,
        view=view_of(model.rig) if tracks[0].unit == "px" else None, hysteresis=model.friction or model.elements,
    )  # fmt: skip
    if joint_fit is not None and remaining is not None:
        fit.smoothing = {name: of.fit.smoothing[name] for name, of in (("backlash", joint_fit), ("follow", remaining))}
        fit.fit_delay, fit.delay_sigma_s = joint_fit.fit.fit_delay, joint_fit.fit.delay_sigma_s
        fit.beforehand = joint_fit.fit.beforehand
    values = np.zeros(0)
    if model.effects:
        fit.effects, values = FittedEffects.of(model.effects, model)
    width, c = basis.nearest(model.q, np.column_stack([model.width, model.c_deg])).T
    return fit, Curves(width, c[:, None], model.delay_s, values)


def _block_numbers(fit: PlayFit, masks: Sequence[Mask]) -> list[Labels] | None:
    """By track, (n,) the number of each frame's block, 0 to BLOCKS - 1; -1 where it does not count. A block is a run of
    whole half-cycles of the tip. None if there are fewer than HALF_CYCLES half-cycles for each block."""
    strokes, before = [], 0
    for sim, mask in zip(fit.simulated, masks, strict=True):
        stroke = before + sim.half_cycle
        strokes.append(np.where(mask, stroke, -1))
        before = int(stroke.max(initial=before - 1)) + 1
    counted = np.unique(np.concatenate([each[each >= 0] for each in strokes]))
    if len(counted) < BLOCKS * HALF_CYCLES:
        return None
    number = np.arange(len(counted)) * BLOCKS // len(counted)
    return [np.where(each >= 0, number[np.searchsorted(counted, np.maximum(each, 0))], -1) for each in strokes]


def _held_out_errors(
    fit: PlayFit,
    curves: Curves,
    residuals: Sequence[Array],
    masks: Sequence[Mask],
    labels: Sequence[Labels],
) -> list[Array]:
    """By track, (n, k) the errors over noise of each frame by a fit without the frame's block (module docstring), in
    which the share STAYS of the block stays. labels: by track, of `_block_numbers`."""
    scale = bounded_rms(_counted_rows(residuals, masks))
    limit = STRAY * scale
    norms = [np.sqrt(np.mean(row**2, axis=1)) for row in residuals]
    weights = fit.weights_with_rounding([limit / np.maximum(norm, limit) for norm in norms], curves, scale)

    def weights_of(number: int) -> list[Array]:
        """By track, (n,) weights of this block's frames, less than 1 for outliers; 0 of all other frames."""
        return [np.where(label == number, weight, 0.0) for label, weight in zip(labels, weights, strict=True)]

    parts = [fit.normal(curves, list(residuals), weights_of(number)) for number in range(BLOCKS)]
    whole = np.sum([matrix for matrix, _ in parts], axis=0) + fit.penalty(curves, 1.0)[0]
    whole[np.diag_indices_from(whole)] += _RIDGE * np.diag(whole)
    errors = [row.copy() for row in residuals]
    for number, (matrix, gradient) in enumerate(parts):
        share = 1.0 - STAYS
        # `gradient` lowers the cost with the block in the fit: without it the unknowns move the other way.
        step = -cho_solve(factor(whole - share * matrix), share * gradient, check_finite=False)
        block = [
            replace(prepared, use=label == number).counting for prepared, label in zip(fit.tracks, labels, strict=True)
        ]
        without_block = replace(fit, tracks=block).residuals(fit.moved(curves, step))[0]
        for error, row, label, prepared in zip(errors, without_block, labels, block, strict=True):
            error[label == number] = row[prepared.use]
    return errors
