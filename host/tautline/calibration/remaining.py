"""f_remain, the central fibre of the characteristic: fitted to the image directly, or the paper's morphological way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt
from scipy.interpolate import make_smoothing_spline
from scipy.optimize import isotonic_regression

from tautline.calibration.beside import FittedEffects
from tautline.calibration.observations import NoiseByPlace, Track, with_noise
from tautline.calibration.place import as_many_as_independent
from tautline.calibration.playfit import Curves, Fitted, PlayFit, View
from tautline.calibration.simulated_track import PreparedTrack
from tautline.calibration.smooth import SPANS, Domain
from tautline.elements import SINGLE, Hysteresis
from tautline.geometry import across, pose, project_with_slope, tracked_deg
from tautline.least_squares import with_ridge
from tautline.rig import Rig
from tautline.splines import Basis

Array = npt.NDArray[np.float64]

_STRAY = 6.0  # tolerance: medians of what is left
_LEAST_SLOPE = 2e-3  # limit: of f_coarse's: f_remain has an inverse everywhere
_PARTS, _FEW = 8, 4  # tolerance: of the range, in which a path is looked at; frames that tell of one
_FEWEST, _HARDLY = 8, 1e-6  # tolerance: frames, and of the range: with fewer, or of a tip that moves less, no curve
_BEND, _RIDGE = 1e-3, 1e-9  # tolerance: of a frame's weight: on the bending of the curve that a fit starts from; added
_END = 0.1  # tolerance: of the positions that were reached: the end that tells the slope beyond
_ODD = 1e-3  # tolerance: of the angles' span: by more a curve turns back
_LITTLE = 0.05  # tolerance: of the usual slope of the image by the angle: where it is less an angle is not told
_SUBPIXEL = 4  # format: bits of cv2's coordinates after the point
_CLOSED, _AROUND = 3, 4  # tolerance: pixels of the square that closes gaps; around the picture: they reach no border
_ROUNDED, _LINE_ROWS = 2, 10  # tolerance: rows at either end of the picture, where strokes ended; rows that make a line
_PICTURE = (720, 1440)  # tolerance: rows (c) and columns (q) of the characteristic as an image


@dataclass(frozen=True)
class Remaining:
    """f_remain on a grid."""

    c_deg: Array
    sigma_deg: Array
    residual: float  # rms per coordinate, px or deg, strays cut; of a median line in px: beside the rig's path
    scale: float  # the same over the stated noise
    notes: tuple[str, ...]
    fitted: Fitted | None = None  # where it was fitted directly
    noise_times: Array | None = None  # (grid,) of the noise where the tip is there, over its rms; None: one noise


def view_of(rig: Rig) -> View:
    """The rig's projection as the `View` of a fit whose followed curve is the bending angle."""

    def view(c: Array, translation: Array, rotation: Array) -> tuple[Array, Array]:
        """(n, k) image positions, px, and their slope by the bending angle, px per deg. c (n,): bending angle, deg;
        translation (n,), mm; rotation (n,), deg."""
        return project_with_slope(rig, c, translation, rotation)

    return view


def pose_of(track: Track, rig: Rig, delay_s: float) -> Array:
    """Bending angle (n,), deg, at each frame: for a marker by inverting the projection (paper, eq. 8), for an angle
    sensor what it shows. delay_s: of the sensor, s."""
    if track.unit == "deg":
        return track.y[:, 0]
    return pose(rig, track.y, *track.others_at(track.scene_s(delay_s)))[0]


def track_by_pose(track: Track, rig: Rig, delay_s: float) -> Track:
    """A marker's track turned into bending angles, deg, by pose, with the image's noise divided by the projection's
    slope. Frames at which the image hardly moves with the angle are left out. What translation and rotation do to the
    image is taken out, as exactly as camera, hand_eye and kinematics are known."""
    others = track.others_at(track.scene_s(delay_s))
    c, _ = pose(rig, track.y, *others)
    _, slope = project_with_slope(rig, c, *others)
    gain = np.linalg.norm(slope, axis=1)
    good = np.isfinite(c) & (gain > _LITTLE * np.nanmedian(gain))
    sigma = track.sigma[good] / gain[good]
    # Of a tracker that rounds to pixels the angles have no step.
    return replace(track, unit="deg", posed=True, t_s=track.t_s[good], y=c[good, None], sigma=sigma, step=0.0)


def fit_remaining(
    tracks: Sequence[Track],
    rig: Rig,
    domain: Domain,
    grid: Array,
    width: Array,
    delay_s: float,
    settled_only: bool,
    hysteresis: Hysteresis = SINGLE,
    effects_and_values: tuple[FittedEffects, Array] | None = None,
    shared: Sequence[Array] = (),
) -> Remaining | None:
    """f_remain: a monotone penalised spline in the play's centre, fitted to the image through the projection (or to
    angles), with B width (grid,), delay, s, hysteresis and effects held. Beyond the positions that were reached it is
    straight. None if hardly anything moved. settled_only: frames before the tip was driven both ways do not count.
    shared: by track, m errors (n, channels, m), sensor's unit, each of which all frames share, one standard deviation
    large; they add to sigma."""
    view = view_of(rig) if tracks[0].unit == "px" else None
    basis = Basis(domain.low, domain.high, SPANS)
    prepared = [PreparedTrack.of(track) for track in tracks]
    effects, values = effects_and_values or (None, np.zeros(0))
    simulated = [f.simulate(grid, width, delay_s, hysteresis, effects, values) for f in prepared]
    noise = NoiseByPlace.of(tracks, [s.tip for s in simulated])
    tracks = [with_noise(track, noise, s.tip) for track, s in zip(tracks, simulated, strict=True)]
    prepared = [PreparedTrack.of(track) for track in tracks]
    angles = [pose_of(track, rig, delay_s) for track in tracks]
    count = [s.settled if settled_only else s.known for s in simulated]
    p = np.concatenate([s.tip[k] for s, k in zip(simulated, count, strict=True)])
    c = np.concatenate([a[k] for a, k in zip(angles, count, strict=True)])
    good = np.isfinite(c)
    p, c = p[good], c[good]
    if len(p) < _FEWEST or np.ptp(p) < _HARDLY * domain.span:
        return None
    falling = float(np.polyfit(p - p.mean(), c, 1)[0]) < 0
    fit = PlayFit(
        prepared, basis, basis, view=view, fit_backlash=False, fit_delay=False, settled_only=settled_only,
        hysteresis=hysteresis, effects=effects, fit_effects=False, given_width=width,
        rising=-1.0 if falling else 1.0, least_slope=_LEAST_SLOPE * abs(rig.coarse.gain),
        slope_unit=abs(rig.coarse.gain),
    )  # fmt: skip
    start = Curves(np.zeros(basis.size), _curve_through(basis, p, c)[:, None], delay_s, values)
    fitted = as_many_as_independent(fit.solve(start))
    counted = np.concatenate([s.tip[m] for s, m in zip(fitted.fit.simulated, fitted.masks, strict=True)])
    curve = basis.value(fitted.curves.follow[:, 0], grid)
    curve = with_straight_ends(curve, grid, float(counted.min()), float(counted.max()))
    lawful = monotone(curve, grid, falling, _LEAST_SLOPE * abs(rig.coarse.gain))
    changed = np.where((grid >= p.min()) & (grid <= p.max()), np.abs(lawful - curve), 0.0)
    notes = (_note_on_turning_back(grid, changed, rig.actuator.unit),) if changed.max() > _ODD * np.ptp(curve) else ()
    variance = _variance(fitted, grid, shared, lawful - curve)
    px = float(np.hypot(max(track.tracked_px for track in tracks), _beside_the_path_px(fitted)))
    sigma = np.hypot(np.sqrt(variance), tracked_deg(px, rig, lawful))
    times = noise.times(grid) / np.sqrt(np.mean(noise.times(counted) ** 2)) if noise.differs else None
    return Remaining(lawful, sigma, _rms_residual(fitted, tracks), fitted.scale, notes, fitted, times)


def _curve_through(basis: Basis, p: Array, c: Array) -> Array:
    """Spline coefficients (size,) of a curve with little bending nearest to angles c (n,), deg, at positions p (n,),
    unit of q."""
    design = basis.design(p)
    system = (design.T @ design).toarray() + _BEND * basis.bending + _RIDGE * np.eye(basis.size)
    return np.asarray(np.linalg.solve(system, design.T @ c))


def _note_on_turning_back(grid: Array, changed: Array, unit: str) -> str:
    """The note that f_remain turned back, and between which positions: those where it was changed by more than half of
    the largest change. changed (grid,): by how much it was changed, deg, to rise or fall everywhere."""
    low, high = grid[changed > 0.5 * changed.max()][[0, -1]]
    return (
        f"f_remain turns back between {low:.3g} and {high:.3g} {unit}, by {changed.max():.2g} deg: "
        "it is level there, as only what rises or falls everywhere has an inverse"
    )


def _variance(fitted: Fitted, grid: Array, shared: Sequence[Array], changed: Array) -> Array:
    """(grid,) variance of f_remain, deg^2: by the residuals' noise; by errors that all frames share (as in
    `fit_remaining`); and the square of changed (grid,), deg, by how much the curve was changed to have an inverse."""
    size = fitted.fit.follow.size
    design = fitted.fit.follow.design(grid).toarray()
    variance = np.maximum(np.sum((design @ fitted.covariance[:size, :size]) * design, axis=1), 0.0) + changed**2
    if shared:
        variance += np.sum((design @ _change_of_solution(fitted, shared)[:size]) ** 2, axis=1)
    return np.asarray(variance)


def with_straight_ends(curve: Array, grid: Array, low: float, high: float) -> Array:
    """The curve (grid,) with straight lines in place of what is beyond [low, high], the positions that were reached: a
    spline tells nothing there. A line's slope is the curve's mean slope over the share _END of the range at that
    end."""
    end = _END * (high - low)
    low_value, low_next, high_next, high_value = np.interp([low, low + end, high - end, high], grid, curve)
    below = low_value + (low_next - low_value) / end * (grid - low)
    above = high_value + (high_value - high_next) / end * (grid - high)
    return np.where(grid < low, below, np.where(grid > high, above, curve))


def _change_of_solution(fitted: Fitted, errors: Sequence[Array]) -> Array:
    """(unknowns, m) the change of the fit's solution, to first order, by each of m errors of the frames, one standard
    deviation each. errors: by track (n, channels, m), sensor's unit."""
    fit, curves = fitted.fit, fitted.curves
    over_noise = [each / prepared.track.sigma[:, None, None] for each, prepared in zip(errors, fit.tracks, strict=True)]
    system, gradients = fit.penalty(curves, fitted.scale)[0], []
    for k in range(errors[0].shape[2]):
        matrix, gradient = fit.normal(curves, [each[:, :, k] for each in over_noise], fitted.weights)
        gradients.append(gradient)
    return np.asarray(np.linalg.solve(with_ridge(matrix + system), np.column_stack(gradients)))


def _beside_the_path_px(fitted: Fitted) -> float:
    """Systematic error, px, of camera, hand_eye and kinematics: the rms, over equal parts of the range, of the marker's
    mean distance beside the rig's path, less the variance that the noise gives these means. Only across the path does
    such an error show, as f_remain takes it in along the path; along it the same size is assumed. Parts with fewer than
    _FEW frames do not count; 0 if none does, and for an angle sensor."""
    fit = fitted.fit
    if fit.view is None:  # an angle sensor
        return 0.0
    rows = []
    for prepared, sim, off, own in zip(fit.tracks, fit.simulated, fitted.residuals, fitted.weights, strict=True):
        use = own > 0.0
        path = fit.slope_in_view(prepared.track, fitted.curves, sim.tip)[use]
        beside = across(off[use] * prepared.track.sigma[use, None], path)
        rows.append(np.column_stack([sim.tip[use], beside, own[use] / prepared.track.sigma[use] ** 2]))
    place, beside, weight = np.concatenate(rows).T  # unit of q, px, 1/px^2 as in the fit
    part = np.digitize(place, np.linspace(fit.follow.low, fit.follow.high, _PARTS + 1)[1:-1])
    # Sums over each part's frames, for its weighted mean and variance.
    terms = (weight, weight * beside, weight * beside**2, weight**2)
    weights, first, second, squared = (np.bincount(part, term, _PARTS) for term in terms)
    told = np.bincount(part, minlength=_PARTS) >= _FEW
    if not told.any():
        return 0.0
    mean = first[told] / weights[told]
    frames = weights[told] ** 2 / squared[told]  # effective number of frames: (sum w)^2 / sum w^2
    of_noise = np.maximum(second[told] / weights[told] - mean**2, 0.0) / np.maximum(frames - 1.0, 1.0)  # of each mean
    return float(np.sqrt(max(float(np.mean(mean**2 - of_noise)), 0.0)))


def _rms_residual(fitted: Fitted, tracks: Sequence[Track]) -> float:
    """rms residual per coordinate, px or deg, of the counted frames, each cut at _STRAY times the median residual over
    noise; 0 without frames."""
    off = np.concatenate(
        [np.sqrt(np.mean(r[m] ** 2, axis=1)) for r, m in zip(fitted.residuals, fitted.masks, strict=True)]
    )
    sigma = np.concatenate([track.sigma[m] for track, m in zip(tracks, fitted.masks, strict=True)])
    if not len(off):
        return 0.0
    return float(np.sqrt(np.mean((np.minimum(off, _STRAY * float(np.median(off))) * sigma) ** 2)))


def monotone(curve: Array, grid: Array, falling: bool, least_slope: float) -> Array:
    """The nearest curve, deg on grid (n,), that rises (or falls, if `falling`) by at least least_slope, deg per unit of
    q, everywhere: isotonic regression of the curve less that slope."""
    # Rising by least_slope everywhere is rising at all once that slope is subtracted.
    tilt = least_slope * (grid - grid[0])
    sign = -1.0 if falling else 1.0
    rising = isotonic_regression(sign * curve - tilt).x + tilt
    # Strictly: isotonic regression may leave equal neighbours.
    strict = rising + 1e-9 * (grid - grid[0]) * max(least_slope, 1e-6)
    return np.asarray(sign * strict)


# ---- the paper's way: the characteristic as an image


def _median_line(courses: Sequence[Array]) -> tuple[Array, Array]:
    """The paper's median line (section IV): motor positions (m,), unit of q, and angles (m,), deg. Each recording's
    course (n, 2) of both is drawn as a picture, gaps are closed, and the middle between the leftmost and the rightmost
    pixel of each row (angle) is taken. Empty if nothing can be drawn."""
    courses = [course[np.isfinite(course).all(axis=1)] for course in courses]
    q, c = np.concatenate(courses).T
    if len(q) < 3 or np.ptp(q) == 0 or np.ptp(c) == 0:
        return np.zeros(0), np.zeros(0)
    rows, columns = _PICTURE
    low, span = np.array([q.min(), c.min()]), np.array([np.ptp(q), np.ptp(c)])
    picture = np.zeros(_PICTURE, dtype=np.uint8)
    lines = [np.rint((course - low) / span * (columns - 1, rows - 1) * 2**_SUBPIXEL) for course in courses]
    cv2.polylines(
        picture, [line.astype(np.int32).reshape(-1, 1, 2) for line in lines if len(line)], False, 255, 1, cv2.LINE_8,
        _SUBPIXEL,
    )  # fmt: skip
    closed = cv2.morphologyEx(np.pad(picture, _AROUND), cv2.MORPH_CLOSE, np.ones((_CLOSED, _CLOSED), dtype=np.uint8))
    filled = closed[_AROUND:-_AROUND, _AROUND:-_AROUND] > 0  # at its rows' ends: what is inside does not matter
    some = filled.any(axis=1)
    # The first and last rows are where strokes ended: their extremes are not the envelope's.
    index = np.flatnonzero(some)[_ROUNDED:-_ROUNDED]
    left = filled[index].argmax(axis=1)
    right = columns - 1 - filled[index, ::-1].argmax(axis=1)
    pitch = np.ptp(q) / (columns - 1)
    middle = 0.5 * ((q.min() + left * pitch) + (q.min() + right * pitch))
    return middle, c.min() + index * np.ptp(c) / (rows - 1)


def fit_morphologically(tracks: Sequence[Track], rig: Rig, grid: Array, delay_s: float) -> Remaining | None:
    """f_remain in the paper's way: the median line of the filled characteristic of all frames by pose, smoothed by a
    spline. Errors of registration bend it (paper, Fig. 7). None if the line has fewer than _LINE_ROWS rows."""
    line, c_of_line = _median_line(
        [np.column_stack([each.motor_at(each.scene_s(delay_s)), pose_of(each, rig, delay_s)]) for each in tracks]
    )
    if len(line) < _LINE_ROWS:
        return None
    falling = bool(np.polyfit(line, c_of_line, 1)[0] < 0)
    order = np.argsort(line, kind="stable")
    centre, first = np.unique(np.round(line[order], 9), return_index=True)
    c = c_of_line[order][first]
    spline = make_smoothing_spline(centre, c) if len(centre) >= 5 else None
    inside = np.clip(grid, centre[0], centre[-1])
    curve = spline(inside) if spline is not None else np.interp(inside, centre, c)
    slope = np.polyfit(centre, c, 1)[0]
    lawful = monotone(curve + slope * (grid - inside), grid, falling, _LEAST_SLOPE * abs(rig.coarse.gain))
    off_deg = float(np.sqrt(np.mean((np.interp(centre, grid, lawful) - c) ** 2)))
    sigma = np.hypot(off_deg, tracked_deg(max(track.tracked_px for track in tracks), rig, lawful))
    residual = _beside_rig_px(tracks, rig, delay_s) if tracks[0].unit == "px" else off_deg
    return Remaining(lawful, sigma, residual, np.nan, ("f_remain is the paper's median line",))


def _beside_rig_px(tracks: Sequence[Track], rig: Rig, delay_s: float) -> float:
    """rms per coordinate, px, of the distance between the markers and the nearest place that the rig has for them, cut
    at _STRAY times the median."""
    beside = np.concatenate([pose(rig, each.y, *each.others_at(each.scene_s(delay_s)))[1] for each in tracks])
    off = beside[np.isfinite(beside)] / np.sqrt(2.0)
    return float(np.sqrt(np.mean(np.minimum(off, _STRAY * float(np.median(off))) ** 2)))
