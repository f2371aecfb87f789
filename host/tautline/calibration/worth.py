"""What a model is worth: blocks of its own calibration foretold by a fit that has not seen them, beside f_coarse, a tip
that never moves, and the noise.

Near its optimum a fit is a linear least-squares problem: without a block its parameters are another by -(N - N_b)^-1
g_b, N_b and g_b being the block's own parts of the normal matrix and of the gradient. The play is then followed anew.
What departs from the model is foretold by nothing: it is in what is missed, as it will be in a motion to come.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_solve

from tautline.calibration.beside import FittedEffects
from tautline.calibration.observations import Track
from tautline.calibration.playfit import Curves, Fitted, PlayFit, PreparedTrack
from tautline.calibration.remaining import view_of
from tautline.calibration.rounding import resting, shared_variance
from tautline.calibration.smooth import SPANS
from tautline.geometry import across, project
from tautline.independence import less_its_trend, remembered, stretches
from tautline.least_squares import factor
from tautline.model import Model
from tautline.quality import Reason
from tautline.splines import Basis

Array = npt.NDArray[np.float64]
Labels = npt.NDArray[np.intp]

PREDICTS = 1.3  # format: of the noise, within which a good model predicts (formats.md)
HALVES = 2  # equation: half-cycles of a block at least, one of each direction
BLOCKS = 8  # tolerance: of which one is a small share of all; with fewer half-cycles nothing is left out
STAYS = 0.1  # tolerance: of a block: what it alone shows (the ends of a range) no other one can foretell
_FEW = 30  # tolerance: frames that tell a scatter
_SLOW = 3  # tolerance: order of what sways or breathes within a rest, which is no noise
_RIDGE = 1e-10  # tolerance: of the diagonal, for rounding
_STRAY = 4.0  # tolerance: usual misses from which a frame counts as a stray, as in every fit (playfit)


@dataclass(frozen=True)
class Worth:
    """Misses rms per coordinate, px or deg, of frames after the tip was driven both ways; strays are bounded."""

    model: float  # blocks foretold without them; where there are too few, what the model leaves of them
    coarse: float  # c = gain q + offset, no backlash
    constant: float  # the mean of what was seen
    over_noise: float  # what it misses, over the sensor's noise; 1 where it misses nothing
    unit: str
    blocks: int  # 0: too few to leave any out

    @property
    def predicts(self) -> bool:
        """Whether what it misses is within PREDICTS times the noise."""
        return self.over_noise <= PREDICTS

    @property
    def useless(self) -> bool:
        """Whether f_coarse or a tip that never moves foretells it as well. What is within the noise is right, whatever
        else is."""
        return not self.predicts and self.model >= min(self.coarse, self.constant)

    @property
    def doubts(self) -> list[Reason]:
        """A fatal reason where the model is useless, else none."""
        if not self.useless:
            return []
        return [
            Reason(
                "predicts",
                f"it predicts its own recordings to {self.model:.3g} {self.unit}, f_coarse to {self.coarse:.3g}, "
                f"a tip that never moves to {self.constant:.3g}",
                "nothing fits the rig: check camera, hand_eye, actuator.unit and the clock of the frames",
                fatal=True,
            )
        ]


def worth(model: Model, tracks: Sequence[Track], joint_fit: Fitted | None, remaining: Fitted | None) -> Worth | None:
    """tracks: on the motor's clock. joint, remaining: the fits of B and of f_remain, whose smoothness is the prior of
    both; where one is None nothing is left out. None where nothing was seen after the tip was driven both ways."""
    fit, curves = _fit_of(model, tracks, joint_fit, remaining)
    residuals, masks = fit.residuals(curves)
    if not any(mask.any() for mask in masks):
        return None
    missed, labels = residuals, _blocks(fit, masks)
    apart = labels is not None and joint_fit is not None and remaining is not None
    if labels is not None and apart:
        missed = _foretold(fit, curves, residuals, masks, labels)
    masks = _of_tip(fit, curves, missed, masks)
    in_unit = [miss * track.sigma[:, None] for miss, track in zip(missed, tracks, strict=True)]
    by_coarse = [track.y - _coarse(track, model) for track in tracks]
    seen = _counted([track.y for track in tracks], masks)
    return Worth(
        model=bounded_rms(_counted(in_unit, masks)),
        coarse=bounded_rms(_counted(by_coarse, masks)),
        constant=bounded_rms(seen - seen.mean(axis=0)),
        over_noise=_over_noise(fit, curves, missed, masks),
        unit=tracks[0].unit,
        blocks=BLOCKS if apart else 0,
    )


def bounded_rms(off: Array) -> float:
    """Per coordinate of misses (n, k), strays bounded; infinite where one cannot be in the image at all."""
    norm = np.sqrt(np.mean(off**2, axis=1))
    usual = float(np.sqrt(np.mean(np.minimum(norm, _STRAY * float(np.median(norm))) ** 2)))
    return float(np.sqrt(np.mean(np.minimum(norm, _STRAY * usual) ** 2))) if np.isfinite(usual) else float("inf")


def _of_tip(
    fit: PlayFit, curves: Curves, missed: Sequence[Array], masks: Sequence[npt.NDArray[np.bool_]]
) -> list[npt.NDArray[np.bool_]]:
    """Frames that may show the tip. Those that are off by more than all of B moves it are the sensor's: another blob,
    a lost count; not where most are."""
    usual, widest = _STRAY * bounded_rms(_counted(missed, masks)), float(fit.width(curves).max())
    kept = []
    for prepared, sim, off, mask in zip(fit.tracks, fit.simulated, missed, masks, strict=True):
        steep = np.linalg.norm(fit.slope_in_view(prepared.track, curves, sim.tip), axis=1) / prepared.track.sigma
        kept.append(mask & (np.linalg.norm(off, axis=1) <= np.maximum(usual, widest * steep)))
    return kept


def _over_noise(fit: PlayFit, curves: Curves, missed: Sequence[Array], masks: Sequence[npt.NDArray[np.bool_]]) -> float:
    """What neighbouring frames miss alike is the model's. What they do not is the sensor's: as much as is stated, or
    as where the tip rests, or as across its path in the image, where nothing moves it; a tracker's own at each place is
    added, and what its noise remembers, and rounding. What is more than that along the path is an error of times, and
    so of what is foretold."""
    limit = _STRAY * bounded_rms(_counted(missed, masks))
    alike, along, beside, still, placed = [], [], [], [], []
    still_misses: list[Array] = []
    for prepared, sim, off, mask in zip(fit.tracks, fit.simulated, missed, masks, strict=True):
        track = prepared.track
        off = np.where(mask[:, None], off, 0.0)
        norm = np.sqrt(np.mean(off**2, axis=1))
        near = off * np.minimum(1.0, limit / np.maximum(norm, limit))[:, None]
        pair, moves = mask[1:] & mask[:-1], sim.moving[1:] & sim.moving[:-1]
        step = np.diff(near, axis=0) / np.sqrt(2.0)
        slope = fit.slope_in_view(track, curves, sim.tip)
        path = slope / np.maximum(np.linalg.norm(slope, axis=1), 1e-300)[:, None]
        forward = np.sum(step * path[1:], axis=1) ** 2
        together = np.mean(near[1:] * near[:-1], axis=1)
        if track.step > 0.0:
            rests = resting(track, fit.predicted(track, curves, sim.tip))
            together = together - rests * shared_variance(track, rests) / track.sigma[1:] ** 2
        alike.append(together[pair])
        along.append(forward[pair & moves])
        still.append(forward[pair & ~moves])
        placed.append((track.placed_px / track.sigma[mask]) ** 2)
        if step.shape[1] > 1:
            sideways = np.sum(step**2, axis=1) - forward
            beside.append(sideways[pair & moves])
            still.append(sideways[pair & ~moves])
            still_misses += _at_rest(track.t_s, across(near, path)[:, None], mask & ~sim.moving)
    if not any(map(len, alike)):
        return np.inf  # no two neighbours count: nothing tells a model's misfit from noise
    memory = remembered(still_misses, _SLOW)[0] if sum(map(len, still_misses)) >= _FEW else 0.0
    at_rest, moving = _mean(still), _mean(along)
    usual = _mean(beside) if beside else at_rest
    own2 = max(at_rest, usual) / (1.0 - memory)  # of what remembers, neighbours differ by so much less
    noise2 = max(own2, 1.0) + _mean(placed)
    jitter2 = max(moving - max(usual, 1.0), 0.0) / step.shape[1]
    model2 = max(float(np.concatenate(alike).mean()) - memory * own2, 0.0)
    return float(np.sqrt(1.0 + (model2 + jitter2) / noise2))


def _at_rest(t: Array, off: Array, resting: npt.NDArray[np.bool_]) -> list[Array]:
    """Of misses (n, 1) at times (n,) those of each rest, less their trend: what its place makes is none of it."""
    rests = [rest for rest in stretches(resting) if rest.stop - rest.start >= 2 * _SLOW]
    return [less_its_trend(t[rest], off[rest], _SLOW) for rest in rests]


def _mean(squares: Sequence[Array]) -> float:
    """Mean of all these squares; 0 of too few to tell a scatter."""
    every = np.concatenate(squares)
    return float(every.mean()) if len(every) >= _FEW else 0.0


def _counted(off: Sequence[Array], masks: Sequence[npt.NDArray[np.bool_]]) -> Array:
    """(frames, k) the rows that count, of all tracks."""
    return np.concatenate([each[mask] for each, mask in zip(off, masks, strict=True)])


def _coarse(track: Track, model: Model) -> Array:
    """(n, k) what f_coarse alone, without backlash, says of each frame, in the track's unit."""
    scene, coarse = track.scene_s(model.delay_s), model.rig.coarse
    c = coarse.gain * track.motor_at(scene) + coarse.offset
    return project(model.rig, c, *track.others_at(scene)) if track.unit == "px" else np.asarray(c[:, None])


def _fit_of(
    model: Model, tracks: Sequence[Track], joint_fit: Fitted | None, remaining: Fitted | None
) -> tuple[PlayFit, Curves]:
    """B, f_remain, the delay and what is beside them as the model has them, as unknowns that frames in the sensor's own
    coordinates tell."""
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
    design = basis.design(model.q).toarray()
    width, c = np.linalg.lstsq(design, np.column_stack([model.width, model.c_deg]), rcond=None)[0].T
    return fit, Curves(width, c[:, None], model.delay_s, values)


def _blocks(fit: PlayFit, masks: Sequence[npt.NDArray[np.bool_]]) -> list[Labels] | None:
    """Of every frame of each track the number of its block, of whole half-cycles of the tip that follow each other;
    -1 where it does not count. None where there are too few."""
    strokes, before = [], 0
    for sim, mask in zip(fit.simulated, masks, strict=True):
        stroke = before + sim.half_cycle
        strokes.append(np.where(mask, stroke, -1))
        before = int(stroke.max(initial=before - 1)) + 1
    counted = np.unique(np.concatenate([each[each >= 0] for each in strokes]))
    if len(counted) < BLOCKS * HALVES:
        return None
    number = np.arange(len(counted)) * BLOCKS // len(counted)
    return [np.where(each >= 0, number[np.searchsorted(counted, np.maximum(each, 0))], -1) for each in strokes]


def _foretold(
    fit: PlayFit,
    curves: Curves,
    residuals: Sequence[Array],
    masks: Sequence[npt.NDArray[np.bool_]],
    labels: Sequence[Labels],
) -> list[Array]:
    """(n, k) of each track: what a fit without a frame's block misses it by, over the noise."""
    scale = bounded_rms(_counted(residuals, masks))
    limit = _STRAY * scale
    norms = [np.sqrt(np.mean(row**2, axis=1)) for row in residuals]
    weights = fit.weights_with_rounding([limit / np.maximum(norm, limit) for norm in norms], curves, scale)

    def weighed(number: int) -> list[Array]:
        """(n,) of each track: weights of this block's frames, those of a stray less than 1; 0 of all other frames."""
        return [np.where(label == number, weight, 0.0) for label, weight in zip(labels, weights, strict=True)]

    parts = [fit.normal(curves, list(residuals), weighed(number)) for number in range(BLOCKS)]
    whole = np.sum([matrix for matrix, _ in parts], axis=0) + fit.penalty(curves, 1.0)[0]
    whole[np.diag_indices_from(whole)] += _RIDGE * np.diag(whole)
    missed = [row.copy() for row in residuals]
    for number, (matrix, gradient) in enumerate(parts):
        share = 1.0 - STAYS
        step = -cho_solve(factor(whole - share * matrix), share * gradient, check_finite=False)
        there = fit.residuals(fit.moved(curves, step))[0]
        for miss, row, label in zip(missed, there, labels, strict=True):
            miss[label == number] = row[label == number]
    return missed
