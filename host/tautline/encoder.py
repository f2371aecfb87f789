"""What an encoder's counts say of the motor's motion: where it was between them, and when it stopped, turned and
started."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt
from scipy.linalg import solveh_banded

from tautline import _native
from tautline.driven import Driven, driven, third_differences, white_noise
from tautline.encoder_steps import CHANGES, REST_S, Rest, Steps, Stops, rests_and_turns, steps_of, with_level_rests
from tautline.independence import stretches
from tautline.recording import Motor
from tautline.spread import THIRD, of_rounding

Array = npt.NDArray[np.float64]
Kept = TypeVar("Kept")

# How far the lines between a motor's knots may be from its samples: less than a camera sees.
_TOLERANCE_COUNTS, _TOLERANCE_MM, _TOLERANCE_DEG = 0.5, 5e-4, 5e-3  # tolerance: of q, in its encoder's counts; mm; deg
_TOLERANCE_LOAD = 1e-3  # tolerance: likewise of the load, of its range
_STEPS = 0.5  # tolerance: counts more for an encoder's own steps
_COARSE = 5e-4  # tolerance: of the motor's travel: finer counts are seen nowhere
_COARSE_LINES = 2e-4  # tolerance: of the travel, instead of a coarse count: how far lines may be from its path
_LEAPS = 12.0  # tolerance: times the usual step between readings: a motor that jumps
_SKIPS, _OF = 3.5, 5  # tolerance: how many of so many neighbouring readings changed
_MOVES = 10  # tolerance: readings that changed, that tell how a motor does
_OWN_STEPS = 0.6  # tolerance: counts of noise: no more than an encoder's own steps
_SCATTERS = 1.0  # tolerance: counts of noise from which readings are smoothed
_EXACT = 1e-12  # tolerance: of the largest value: next to nothing
_OF_NOISE = 4.0  # prior: standard deviations, of a third difference: more is a turn's
_WAVES = 512  # tolerance: frequencies at which a smoother's trace is summed
_STIFF = np.logspace(0, 12, 13)  # tolerance: strengths of a smoother that are tried: from a few readings to a parabola
_SMOOTHED = 12  # tolerance: readings that are smoothed, at least
_FEWEST, _CLEARLY = 100, 5.0  # tolerance: readings that tell whether a motor trembles; standard errors
_UNEVEN = 10.0  # tolerance: times a gap's shorter neighbour: beyond it noise is all that is seen
_SHARPEST = 0.98  # tolerance: quantile of the bends: single readings may be wrong
_BENT_BY_NOISE = 2.0  # tolerance: standard deviations of the readings' noise, below which a bend may be noise
_LAST = 2.0  # samples: within so many of a stop no knot tells a speed
_EXACTLY = 1e-6  # tolerance: of the motor's travel: readings with finer noise or steps are what they say
_AGREES, _STRAYS = 2.5, 5.0  # tolerance: counts, and sigmas of their noise, that readings are from a motor's path


def between_counts(motor: Motor, resolution: float) -> Motor:
    """The motor with positions between an encoder's counts: it passes the boundary of two counts where the reading
    changes, and is at a count's centre in between; a rest stays at the centre. resolution: the rig's step of the
    encoder, unit of q. Readings without steps of that size, or coarser ones (`steps_of`), stay as they are. Smoothed
    instead, as a play would follow their extremes, are readings that scatter by more than a count while the motor does
    not oscillate, and those that pass a coarse count nearly each time. A motor whose path was estimated from all of its
    readings (`posterior_of`) is on that path, with the path's knots beside its samples."""
    path = posterior_of(motor, resolution)
    return (
        _between_and_steps(motor, resolution)[0]
        if path is None
        else _with_sample_knots(motor, straight_lines(motor, resolution))
    )


def _between_and_steps(motor: Motor, resolution: float) -> tuple[Motor, Steps | None]:
    """Returns `between_counts` of a motor without a posterior, and the encoder's steps. Instead of the steps it returns
    None where the readings have none, or where they were smoothed and scatter by more than steps do: a change of count
    then does not show where the motor stops or turns."""
    steps = _steps_of(motor, resolution)
    noise_counts = reading_noise(motor) / (resolution if steps is None else steps.count)
    if _needs_smoothing(motor, steps, noise_counts):
        return replace(motor, q=_smoothed(motor.t_s, motor.q)), steps if noise_counts < _OWN_STEPS else None
    if steps is None:
        return motor, None
    return replace(motor, q=_through_changes(motor.t_s, steps)), steps


def _through_changes(t: Array, steps: Steps) -> Array:
    """(n,) Positions at the readings' times t (n,), s, on straight lines through an encoder's counts. The motor crosses
    the boundary of two counts midway between the readings that differ. It leaves the centre of the one before that, and
    arrives at the centre of the other after it, by half the shorter of the two counts' dwells, and rests at a centre in
    between. At an even speed these lines are one."""
    counts = steps.counts
    changes = np.flatnonzero(np.diff(counts))
    crossed_s = 0.5 * (t[changes] + t[changes + 1])
    boundary = 0.5 * (counts[changes] + counts[changes + 1])
    dwells_s = np.concatenate([[np.inf], np.diff(crossed_s), [np.inf]])  # the first and the last one are not known
    before_s, after_s = dwells_s[:-1], dwells_s[1:]
    # A motor that jumps by several counts is at the new one with the next sample, however long it stays there.
    jumps, sample_s = np.abs(np.diff(counts)[changes]) > 1, t[changes + 1] - t[changes]
    leaves_s = crossed_s - 0.5 * np.minimum(before_s, np.where(jumps, sample_s, after_s))
    arrives_s = crossed_s + 0.5 * np.minimum(after_s, np.where(jumps, sample_s, before_s))
    knots_t = np.column_stack([leaves_s, crossed_s, arrives_s]).ravel()
    knots_q = np.column_stack([counts[changes], boundary, counts[changes + 1]]).ravel()
    knots_t = np.concatenate([t[:1], knots_t, t[-1:]])
    knots_q = np.concatenate([counts[:1], knots_q, counts[-1:]])
    order = np.argsort(knots_t, kind="stable")  # the first count may be left before t[0], the last reached after t[-1]
    return np.asarray(steps.zero + steps.count * np.interp(t, knots_t[order], knots_q[order]))


def reading_noise(motor: Motor) -> float:
    """Standard deviation of the white noise on a motor's readings, unit of q (`white_noise`); computed once for each
    motor."""
    if motor not in _noises:
        _noises[motor] = white_noise(motor.t_s, motor.q)
    return _noises[motor]


def _needs_smoothing(motor: Motor, steps: Steps | None, noise_counts: float) -> bool:
    """Whether readings are to be smoothed: either they scatter by more than _SCATTERS counts, noise_counts being one
    standard deviation, and the motor itself does not oscillate, or they pass coarse counts about as fast as they
    come."""
    return (noise_counts > _SCATTERS and not swings(motor)) or _skips_counts(motor, steps)


def smoothed_noise(motor: Motor, resolution: float) -> float:
    """Standard deviation of the noise that smoothing takes out of the readings, unit of q, at least that of rounding; 0
    where they are not smoothed or the motor has a posterior. resolution: the rig's step of the encoder, unit of q."""
    steps, noise = _steps_of(motor, resolution), reading_noise(motor)
    count = resolution if steps is None else steps.count
    has_posterior = posterior_of(motor, resolution) is not None
    return 0.0 if has_posterior or not _needs_smoothing(motor, steps, noise / count) else max(noise, of_rounding(count))


def swings(motor: Motor) -> bool:
    """Whether the motor itself oscillates from sample to sample. Neighbouring third differences of white noise at even
    times are correlated by -3/4; those of such a motor more negatively, here by more than _CLEARLY standard errors."""
    return _third_difference_score(motor) < -_CLEARLY


def _third_difference_score(motor: Motor) -> float:
    """The correlation of neighbouring third differences of the readings, less that of white noise, in standard errors:
    negative where the motor oscillates, far above 0 where its path is smooth but curved. Differences beyond _OF_NOISE
    standard deviations of the noise, which are turns, are cut to that. 0 for fewer than _FEWEST differences."""
    factors, third = third_differences(motor.t_s, motor.q)
    if len(third) < _FEWEST:
        return 0.0
    most = _OF_NOISE * reading_noise(motor)
    third = np.clip(third, -most, most)
    together = float(third[1:] @ third[:-1]) / max(float(third @ third), 1e-30)
    # The correlation that white noise has: neighbouring differences have three of their four readings in common.
    of_noise = float(np.mean(np.sum(factors[:-1, 1:] * factors[1:, :-1], axis=1)))
    return float((together - of_noise) * np.sqrt(len(third)))


def count_of(motor: Motor, resolution: float) -> float:
    """The encoder's step as the readings show it, their unit. Where they have no steps it is sqrt(12) times their
    noise, as a step of that size scatters as much, and at most the rig's step, `resolution`."""
    steps = _steps_of(motor, resolution)
    return min(resolution, reading_noise(motor) / of_rounding(1.0)) if steps is None else steps.count


def _skips_counts(motor: Motor, steps: Steps | None) -> bool:
    """Whether a moving motor changes its (coarse) count at most readings, so that the time of no change is seen: of the
    _OF readings around one that changed, itself included, more than _SKIPS changed on average. False where it hardly
    moves, has fine counts or no steps, or jumps."""
    moved = np.abs(np.diff(motor.q))
    moves = moved[moved > 0]
    if len(moves) < _MOVES or steps is None or steps.count < _COARSE * float(np.ptp(motor.q)):
        return False
    if moves.max() > _LEAPS * float(np.median(moves)):
        return False  # it jumps: a smooth path would not be its own
    changed_nearby = np.convolve(moved > 0, np.ones(_OF), mode="same")  # a slow motor changes its count now and then
    return bool(np.mean(changed_nearby[moved > 0]) > _SKIPS)


def between_samples(motor: Motor) -> float:
    """How far straight lines between samples may be from the motor's path, its unit; infinite for fewer than five
    readings. A path of acceleration a is a h^2 / 8 off its chord over a gap h, the sagitta, and a reading with gaps h1
    and h2 beside it is a h1 h2 / 2 off the line between its neighbours, which tells a. Returned is the sagitta of the
    longer gap at nearly the sharpest bend (quantile _SHARPEST), less what noise alone may bend the readings; 0 at
    least."""
    t_s, q = motor.t_s, motor.q
    if len(q) < 5:
        return float("inf")
    share = (t_s[1:-1] - t_s[:-2]) / (t_s[2:] - t_s[:-2])
    longer, shorter = np.maximum(share, 1.0 - share), np.minimum(share, 1.0 - share)
    off_chord = np.abs(q[1:-1] - q[:-2] - share * (q[2:] - q[:-2]))
    # equation: h^2 / 8 over h1 h2 / 2, h being the longer gap
    sagitta = off_chord / 4.0 * np.minimum(longer / np.maximum(shorter, 1e-12), _UNEVEN)
    return float(max(float(np.quantile(sagitta, _SHARPEST)) - _BENT_BY_NOISE * reading_noise(motor), 0.0))


def _smoothed(t_s: Array, q: Array) -> Array:
    """Readings q (n,) at rising times t_s (n,), s, smoothed by Whittaker's smoother with third differences: it
    minimises sum (q - smooth)^2 + stiff sum (third difference)^2. The strength `stiff` is chosen by generalised
    cross-validation, where `wave`, the penalty's spectrum at even times, stands for the smoother's trace. Fewer than
    _SMOOTHED readings stay as they are."""
    n = len(q)
    wave = (2.0 - 2.0 * np.cos(np.pi * (np.arange(_WAVES) + 0.5) / _WAVES)) ** 3
    best, least = q, np.inf
    if n < _SMOOTHED:
        return q
    factors = np.sqrt(THIRD) * third_differences(t_s, q)[0]  # of -1, 3, -3, 1 at even times
    bent = np.zeros((4, n))  # the penalty's matrix, its upper bands as solveh_banded takes them
    for i in range(4):
        for j in range(i, 4):
            bent[3 - (j - i), j : n - 3 + j] += factors[:, i] * factors[:, j]
    for stiff in _STIFF:
        system = stiff * bent
        system[3] += 1.0
        smooth = np.asarray(solveh_banded(system, q))
        spent = float(np.mean(1.0 / (1.0 + stiff * wave)))  # the trace / n
        score = float(np.mean((q - smooth) ** 2)) / (1.0 - spent) ** 2
        if score < least:
            best, least = smooth, score
    return best


def straight_lines(motor: Motor, resolution: float) -> Motor:
    """The recorded motor as straight lines between few knots, to within what no sensor sees; it rests and turns when
    the counts say so. Every prediction uses this motion. Without steps or noise the readings themselves are the knots,
    but for those on a straight line. q_cmd and columns of no joint are left out. resolution: the rig's step of the
    encoder, the motor's unit. Computed once for each motor."""
    return _kept(_lines, motor, resolution, _straight_lines)


def cut(motor: Motor, until_s: float) -> Motor:
    """The motor with its readings up to the time until_s, s; with the first one if all are later."""
    kept = slice(max(int(np.searchsorted(motor.t_s, until_s, side="right")), 1))

    def first(values: Array | None) -> Array | None:
        """The column's samples that are kept; None stays None."""
        return None if values is None else values[kept]

    return Motor(
        motor.t_s[kept],
        motor.q[kept],
        q_cmd=first(motor.q_cmd),
        translation_mm=first(motor.translation_mm),
        rotation_deg=first(motor.rotation_deg),
        load_mNm=first(motor.load_mNm),
        extra={name: values[kept] for name, values in motor.extra.items()},
    )


_noises: WeakKeyDictionary[Motor, float] = WeakKeyDictionary()
_lines: WeakKeyDictionary[Motor, dict[float, Motor]] = WeakKeyDictionary()
_evens: WeakKeyDictionary[Motor, dict[float, Motor]] = WeakKeyDictionary()
_paths: WeakKeyDictionary[Motor, dict[float, Driven | None]] = WeakKeyDictionary()
_steps: WeakKeyDictionary[Motor, dict[float, Steps | None]] = WeakKeyDictionary()
_stops: WeakKeyDictionary[Motor, dict[float, Stops]] = WeakKeyDictionary()


def _kept(
    kept: WeakKeyDictionary[Motor, dict[float, Kept]], motor: Motor, resolution: float,
    make: Callable[[Motor, float], Kept],
) -> Kept:  # fmt: skip
    """Returns make(motor, resolution), which is computed the first time and put into `kept` for as long as the motor
    lives. resolution: the encoder's step, the motor's unit."""
    known = kept.setdefault(motor, {})
    if resolution not in known:
        known[resolution] = make(motor, resolution)
    return known[resolution]


def _steps_of(motor: Motor, resolution: float) -> Steps | None:
    """The encoder's steps as the readings show them (`encoder_steps.steps_of`), None where they have none; computed
    once for each motor."""
    return _kept(_steps, motor, resolution, steps_of)


def _stops_of(motor: Motor, resolution: float) -> Stops:
    """The motor's rests and turns by the encoder's steps (`rests_and_turns`), none where readings have no steps;
    computed once for each motor."""
    return _kept(_stops, motor, resolution, _stops_by_counts)


def _stops_by_counts(motor: Motor, resolution: float) -> Stops:
    """Computes what `_stops_of` keeps."""
    steps = _steps_of(motor, resolution)
    return Stops([], False) if steps is None else rests_and_turns(motor, steps)


def _straight_lines(motor: Motor, resolution: float) -> Motor:
    """Computes what `straight_lines` keeps. For a motor with a posterior the lines are within the posterior's median
    sigma of its path, and each rest is at one level: the path's mean for order 2 of `Driven`, the level that the
    changes of count show for order 3."""
    path = posterior_of(motor, resolution)
    if path is None:
        return _lines_by_acceleration(motor, resolution)
    steps = _steps_of(motor, resolution)
    if path.order == 2 or steps is None:
        path, at_stops = _levelled_rests(path), np.zeros(len(path.t_s), dtype=bool)
    else:
        path, at_stops = with_level_rests(path, _stops_of(motor, resolution).rests, steps.count)
    keep = _needed_knots(path.t_s, [(path.q, float(np.median(path.sigma)))]) | at_stops
    return _with_others(motor, path.t_s[keep], path.q[keep], np.zeros(int(keep.sum()), dtype=bool))


def posterior_of(motor: Motor, resolution: float) -> Driven | None:
    """The posterior of the motor's path, unit of q, or None: `_posterior` says which motors have one. Computed once for
    each motor. resolution: the rig's step of the encoder, unit of q."""
    return _kept(_paths, motor, resolution, _posterior)


def _posterior(motor: Motor, resolution: float) -> Driven | None:
    """Computes what `posterior_of` keeps. Order 3 (`Driven.order`): a motor with fine counts that slows down to its
    stops. Order 2: readings that have noise but no steps, or are farther from lines of constant acceleration at stops
    than counts and noise allow, as where speed jumps. None: too few readings, readings that are exact beside the
    motor's travel, a motor that oscillates, and all others."""
    steps, noise = _steps_of(motor, resolution), reading_noise(motor)
    unsure = noise if steps is None else steps.count
    if len(motor.q) < CHANGES[0] or unsure <= _EXACTLY * float(np.ptp(motor.q)):
        return None
    if noise >= unsure and swings(motor):  # less is an encoder's own steps
        return None
    if steps is None:
        enough = len(motor.q) >= _FEWEST + 3  # as many third differences tell noise from a bend
        noisy = enough and noise <= _SCATTERS * resolution and _third_difference_score(motor) < _CLEARLY
        return driven(motor.t_s, motor.q, noise, rounded=False) if noisy else None
    fine = steps.count <= _COARSE * float(np.ptp(motor.q)) and noise <= _SCATTERS * steps.count
    if fine and _stops_of(motor, resolution).slows_down:
        return _posterior_from_counts(motor, steps, order=3)
    lines = _lines_by_acceleration(Motor(motor.t_s, motor.q), resolution)  # q alone: no knots for other columns
    away = float(np.abs(np.interp(motor.t_s, lines.t_s, lines.q) - motor.q).max())
    if away <= _AGREES * steps.count + _STRAYS * noise:
        return None
    return _posterior_from_counts(motor, steps, order=2)


def _posterior_from_counts(motor: Motor, steps: Steps, order: int) -> Driven:
    """The posterior of the motor's path, unit of q, from its readings as whole counts. As these are integers, a log
    that was written and read again gives the same path to the last bit. order: as `Driven.order`, 2 or 3."""
    path = driven(motor.t_s, steps.counts, 1.0, rounded=True, order=order)
    count = steps.count
    return replace(path, q=steps.zero + count * path.q, sigma=count * path.sigma, noise=count * path.noise)


def _with_sample_knots(motor: Motor, lines: Motor) -> Motor:
    """`lines`, the motor's straight lines, with a further knot at each of the motor's own samples."""
    t_s = np.union1d(lines.t_s, motor.t_s)
    return lines.resampled(t_s, np.interp(t_s, lines.t_s, lines.q), lines.extra)


def _lines_by_acceleration(motor: Motor, resolution: float) -> Motor:
    """`_constant_acceleration_lines`, computed once for each motor and resolution."""
    return _kept(_evens, motor, resolution, _constant_acceleration_lines)


def _constant_acceleration_lines(motor: Motor, resolution: float) -> Motor:
    """Straight lines for a motor that stops and starts at a constant acceleration, within a tolerance of its positions
    between counts that goes by the size of a count, and with knots where it rests and turns. A motor without steps or
    noise only loses the samples on straight lines."""
    smooth, steps = _between_and_steps(motor, resolution)
    if smooth is motor:
        return _without_collinear(motor)
    count, travel = resolution if steps is None else steps.count, float(np.ptp(motor.q))
    tolerance = (_TOLERANCE_COUNTS + (0.0 if steps is None else _STEPS)) * count
    tolerance = _COARSE_LINES * travel if count > _COARSE * travel else tolerance
    t_s, q, fixed = _knots(smooth, tolerance, [] if steps is None else _stops_of(motor, resolution).rests)
    return _with_others(motor, t_s, q, fixed, smooth.q)


def _levelled_rests(path: Driven) -> Driven:
    """The path with each rest at its mean. The motor rests where it would move by less than its own sigma in REST_S, if
    that lasts for longer than REST_S and the path stays within two sigmas meanwhile."""
    slow = np.abs(np.diff(path.q)) * REST_S < path.sigma[1:] * np.diff(path.t_s)
    q = path.q.copy()
    for step in stretches(slow):
        rest = slice(step.start, step.stop + 1)
        if np.ptp(path.t_s[rest]) > REST_S and np.ptp(q[rest]) < 2.0 * float(np.median(path.sigma[rest])):
            q[rest] = np.mean(q[rest])
    return replace(path, q=q)


def _with_others(
    motor: Motor, t_s: Array, q: Array, fixed: npt.NDArray[np.bool_], smooth: Array | None = None
) -> Motor:
    """The motor on straight lines between knots t_s, q (n,), with knots added that the other axes, the load and the
    joints need. smooth: if given, positions at the motor's samples, to which the knots are fitted by least squares,
    except those that are `fixed` (n,), at rests and turns."""
    others = [motor.translation_mm, motor.rotation_deg, motor.load_mNm]
    swing = 0.0 if motor.load_mNm is None else _TOLERANCE_LOAD * float(np.ptp(motor.load_mNm))
    tolerances = zip(others, (_TOLERANCE_MM, _TOLERANCE_DEG, swing), strict=True)
    channels = [(values, tolerance) for values, tolerance in tolerances if values is not None]
    channels += [(v, _TOLERANCE_DEG if name.endswith("_deg") else _TOLERANCE_MM) for name, v in motor.joints.items()]
    if channels:  # their knots are the bending motor's too, but it stays at rest where it rests
        at = np.union1d(t_s, motor.t_s[_needed_knots(motor.t_s, channels)])
        left = np.searchsorted(t_s, at, side="right") - 1
        right = np.minimum(left + (t_s[left] < at), len(t_s) - 1)
        fixed = fixed[left] & fixed[right] & (q[left] == q[right])
        t_s, q = at, np.interp(at, t_s, q)
    level = q if smooth is None else _least_squares_knots(motor.t_s, smooth, t_s, q, fixed)
    return motor.resampled(t_s, level, motor.joints)


def _without_collinear(motor: Motor) -> Motor:
    """The motor without the samples that lie on the straight line between their neighbours, but for rounding."""
    return _with_few_knots(motor, lambda values: _EXACT * float(np.abs(values).max()) + 1e-300)


def with_few_knots(motor: Motor, share: float) -> Motor:
    """The motor with only those samples that straight lines need to stay within `share` of each column's travel, its
    largest less its smallest value."""
    return _with_few_knots(motor, lambda values: share * float(np.ptp(values)))


def _with_few_knots(motor: Motor, tolerance_of: Callable[[Array], float]) -> Motor:
    """The motor with only those samples that straight lines need to stay within each column's tolerance. tolerance_of:
    gives it, in the column's unit, for the column's values (n,). q_cmd and columns of no joint are left out."""
    columns = [motor.q, motor.translation_mm, motor.rotation_deg, motor.load_mNm, *motor.joints.values()]
    channels = [(values, tolerance_of(values)) for values in columns if values is not None]
    keep = _needed_knots(motor.t_s, channels)
    q, translation, rotation, load, *joints = (None if values is None else values[keep] for values in columns)
    named = {name: values for name, values in zip(motor.joints, joints, strict=True) if values is not None}
    assert q is not None
    return Motor(
        motor.t_s[keep], q, translation_mm=translation, rotation_deg=rotation, load_mNm=load, extra=named
    )  # fmt: skip


def _needed_knots(t_s: Array, channels: list[tuple[Array, float]]) -> npt.NDArray[np.bool_]:
    """(n,) Which samples at times t_s (n,), s, straight lines need as knots to stay within every channel's tolerance.
    channels: each one's values (n,) and its tolerance, in their unit."""
    values, tolerances = np.concatenate([v for v, _ in channels]), np.array([tolerance for _, tolerance in channels])
    return np.asarray(_native.thin(t_s, values, tolerances, REST_S), dtype=bool)


def _knots(motor: Motor, tolerance: float, stops: list[Rest]) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
    """Returns knots for straight lines within `tolerance`, the motor's unit, of its positions: times (k,), s, positions
    (k,), and which of them (k,) are at rests or turns. Knots where each of `stops` begins and ends, at its position,
    replace those within or close to it."""
    keep = _needed_knots(motor.t_s, [(motor.q, tolerance)])
    t, q = motor.t_s[keep], motor.q[keep]
    fixed = np.zeros(len(t), dtype=bool)
    rests = np.flatnonzero(np.diff(q) == 0)
    fixed[rests] = fixed[rests + 1] = True
    if stops:
        margin = _LAST * float(np.median(np.diff(motor.t_s)))
        ends = np.array([(min(s.since_s, s.start_s - margin), max(s.until_s, s.end_s + margin)) for s in stops])
        before = np.searchsorted(ends[:, 0], t, side="right") - 1  # the last stop that begins before each knot
        outside = (before < 0) | (t > ends[before, 1])
        at = np.array([s.start_s for s in stops] + [s.end_s for s in stops])
        stands = np.array([s.q for s in stops] * 2)
        t, first = np.unique(np.concatenate([t[outside], at]), return_index=True)
        q = np.concatenate([q[outside], stands])[first]
        fixed = np.concatenate([fixed[outside], np.ones(len(at), dtype=bool)])[first]
    return t, q, fixed


def _least_squares_knots(t_s: Array, values: Array, knots: Array, level: Array, fixed: npt.NDArray[np.bool_]) -> Array:
    """(k,) Positions at knots (k,), s, whose straight lines fit all samples, values (n,) at times t_s (n,), best, so
    that an encoder's steps average out. level (k,): the positions so far; those that are `fixed` (k,) stay."""
    if len(knots) < 2 or fixed.all():
        return level
    left = np.clip(np.searchsorted(knots, t_s, side="right") - 1, 0, len(knots) - 2)
    share = (t_s - knots[left]) / (knots[left + 1] - knots[left])
    off = values - ((1 - share) * level[left] + share * level[left + 1])
    count = len(level)
    # Tridiagonal normal equations for what is added to each level; that of a fixed knot is 0.
    diagonal = np.bincount(left, (1 - share) ** 2, count) + np.bincount(left + 1, share**2, count)
    beside = np.bincount(left, share * (1 - share), count)
    force = np.bincount(left, (1 - share) * off, count) + np.bincount(left + 1, share * off, count)
    diagonal[fixed], force[fixed] = 1.0, 0.0
    beside[:-1][fixed[:-1] | fixed[1:]] = 0.0
    system = np.stack([np.concatenate([[0.0], beside[:-1]]), diagonal + 1e-9])
    best: Array = level + np.asarray(solveh_banded(system, force))
    return best
