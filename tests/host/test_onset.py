"""Onsets: as sharp as the Cramér-Rao bound allows, honest about their uncertainty, and only where they count."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tautline import _native
from tautline.calibration import onset as room
from tautline.calibration.hinge import fit_hinge, fit_jump
from tautline.calibration.observations import observe
from tautline.calibration.onset import BOUND, BRACKET, HINGE, delayed, find_delay, find_onsets
from tautline.core.motor import MotorPath
from tautline.recording import Motor
from tautline.simulated.instrument import Instrument, preset, reference_rig
from tautline.simulated.simulate import run
from tautline.trajectory import back_and_forth, through
from tautline.vision.timing import FrameTiming

RIG = reference_rig()


def bound(x: np.ndarray, knot: float, slope: np.ndarray) -> float:
    """Cramér-Rao bound of the knot with level and slope of both coordinates unknown, unit noise."""
    blocks = []
    for c in range(2):
        block = np.zeros((len(x), 5))
        block[:, 2 * c] = 1
        block[:, 2 * c + 1] = np.maximum(x - knot, 0)
        block[:, 4] = -slope[c] * (x > knot)
        blocks.append(block)
    jacobian = np.vstack(blocks)
    return float(np.sqrt(np.linalg.inv(jacobian.T @ jacobian)[-1, -1]))


def bent(rng: np.random.Generator, x: np.ndarray, knot: float, swing: float) -> np.ndarray:
    """What a Wiener process of the slope adds to a straight path beyond the knot: from nothing that is seen to a fifth
    of the path's swing, evenly in the logarithm."""
    fine = np.linspace(0.0, 1.0, 400)
    slope = np.cumsum(rng.normal(size=(400, 2)), axis=0) / np.sqrt(400) * 0.3 * (0.2 * swing / 0.3) ** rng.uniform()
    way = np.cumsum(slope, axis=0) / 400
    at = np.maximum(x - knot, 0) / (x[-1] - knot)
    return np.column_stack([np.interp(at, fine, channel) for channel in way.T])


def hinges(sigma_per_frame: float, repeats: int, seed: int, *, bends: bool = False) -> tuple[float, float]:
    """rms error over the bound of a straight path, and rms error over the stated sigma."""
    rng = np.random.default_rng(seed)
    over_bound, over_sigma = [], []
    for _ in range(repeats):
        still, moving = rng.integers(8, 40), rng.integers(10, 50)
        knot, angle = still - 1 + rng.uniform(), rng.uniform(0, 2 * np.pi)
        x = np.arange(still + moving, dtype=float)
        slope = sigma_per_frame * np.array([np.cos(angle), np.sin(angle)])
        y = 300.0 + np.maximum(x - knot, 0)[:, None] * slope + rng.normal(size=(len(x), 2))
        if bends:
            y += bent(rng, x, knot, sigma_per_frame * moving)
        found = fit_hinge(x, y, float(x[-1]))
        over_bound.append((found.knot - knot) / bound(x, knot, slope))
        over_sigma.append((found.knot - knot) / found.sigma)
    return float(np.sqrt(np.mean(np.square(over_bound)))), float(np.sqrt(np.mean(np.square(over_sigma))))


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 1000), st.integers(4, 40), st.integers(1, 10), st.integers(1, 2), st.booleans())
def test_a_hinges_fits_are_those_of_its_equations(seed, frames, pieces, channels, jump):
    """Against dense solutions, the path as the second integral of what is constant in each piece."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0.0, 3.0, frames), rng.normal(0.0, 20.0, (frames, channels))
    knots = rng.uniform(0.0, 0.8 * x.max(), 3)
    flat, steep, *bends = 10.0 ** rng.uniform(-3.0, 1.0, 4)
    hinge = _native.Hinge(x, y, pieces, jump, flat, steep, np.array(bends), 0.5, 1e-3)
    deviance, residual, used, slope, jumped = hinge.fit(knots)
    assert deviance.shape == (3, 2) and slope.shape == (3, 2, channels) and len(jumped) == 3 * jump
    fine = (np.arange(20000) + 0.5) / 20000
    bend = np.sqrt(pieces) * (np.arange(pieces) == (pieces * fine[:, None]).astype(int))
    shape = np.cumsum(np.cumsum(bend, axis=0), axis=0) / 20000**2
    for k, knot in enumerate(knots):
        unit = np.maximum(x - knot, 0.0) / x.max()
        basis = [np.ones(frames), unit, *(np.interp(unit, fine, piece) for piece in shape.T)]
        basis = np.column_stack(basis + [(x > knot).astype(float)] * jump)
        for v, bend in enumerate(bends):
            each = np.array([flat, steep, *[bend] * pieces, *[flat] * jump])
            system = basis.T @ basis + np.diag(each)
            best = np.linalg.solve(system, basis.T @ y)
            left = y - basis @ best
            path = slice(2 + pieces)
            mean = basis[np.argmax(x), 1 : 2 + pieces] @ best[1 : 2 + pieces] / (1.0 - knot / x.max())
            near = {"rtol": 1e-3, "atol": 1e-3}  # of the reference's sums
            np.testing.assert_allclose(residual[k, v], np.sum(left**2), **near)
            np.testing.assert_allclose(used[k, v], np.trace(np.linalg.solve(system, basis.T @ basis)), **near)
            np.testing.assert_allclose(slope[k, v], best[1], rtol=1e-3, atol=0.05)
            if jump:
                np.testing.assert_allclose(jumped[k, v], best[-1], rtol=1e-3, atol=0.05)
            squares, count = np.sum(left**2) + np.sum(each[:, None] * best**2), (frames - 2) * channels
            noise = max(squares / count, 1.0)
            volume = np.linalg.slogdet(system[path, path])[1] - np.log(each[path]).sum()
            share = np.log(max(slope[k, v] @ mean / max(mean @ mean, 1e-12), 1e-3)) / 0.5
            expected = count * np.log(noise) + squares / noise + channels * volume
            if abs(mean @ mean) > 1.0 and slope[k, v] @ mean / (mean @ mean) > 0.1:
                np.testing.assert_allclose(deviance[k, v] - share**2, expected, rtol=1e-3, atol=0.1)


@pytest.mark.parametrize("sigma_per_frame", [3.0, 6.0, 12.0, 40.0])
def test_a_hinge_is_as_sharp_as_the_bound(sigma_per_frame):
    over_bound, over_sigma = hinges(sigma_per_frame, 400, seed=int(17 * sigma_per_frame))
    print(f"{sigma_per_frame:g} sigma/frame: {over_bound:.3f} x the Cramér-Rao bound, z {over_sigma:.2f}")
    assert over_bound < 1.1
    assert over_sigma < 1.12  # and less where it cannot know that the path is straight


@pytest.mark.parametrize("sigma_per_frame", [3.0, 12.0, 40.0])
def test_a_hinge_of_any_path_states_its_uncertainty(sigma_per_frame):
    _, over_sigma = hinges(sigma_per_frame, 300, seed=int(19 * sigma_per_frame), bends=True)
    print(f"{sigma_per_frame:g} sigma/frame, bent: z {over_sigma:.2f}")
    assert 0.88 < over_sigma < 1.12


@pytest.mark.parametrize("sigma_per_frame", [0.15, 0.4, 1.0, 2.0])
def test_a_slow_hinge_states_its_uncertainty(sigma_per_frame):
    over_bound, over_sigma = hinges(sigma_per_frame, 300, seed=int(100 * sigma_per_frame))
    print(f"{sigma_per_frame:g} sigma/frame: {over_bound:.3f} x the Cramér-Rao bound, z {over_sigma:.2f}")
    assert 0.7 < over_sigma < 1.2


def test_a_jump_brackets_the_onset_within_a_frame():
    rng = np.random.default_rng(3)
    for _ in range(200):
        knot = rng.uniform(10, 30)
        x = np.arange(50, dtype=float)
        path = np.maximum(x - knot, 0) * 2.0 + 30.0 * (x > knot)
        found = fit_jump(x, np.column_stack([path, -path]) + rng.normal(size=(50, 2)), 49.0)
        assert found.low <= knot <= found.high
        assert found.high - found.low == pytest.approx(1.0)


def simulated(seed: int, motion, *, noise: float = 0.05, delay: float = 0.0873, instrument: Instrument | None = None):
    instrument = instrument or preset("reference", RIG)
    timing = FrameTiming.of(RIG, delay_s=delay, seed=seed)
    made = run(RIG, instrument, motion, noise_px=noise, timing=timing, seed=seed)
    return made, observe([made.recording], RIG)


def test_widths_and_the_delay_of_a_whole_recording():
    delays, z, errors = [], [], []
    for seed in range(20, 26):
        motion = back_and_forth(RIG.actuator, [0.35], 2.4, 10, 4.0)
        made, tracks = simulated(seed, motion, delay=0.07 + 0.004 * (seed - 20), instrument=preset("random", RIG, seed))
        delay = find_delay(tracks, RIG, RIG.delay_s)
        delays.append((delay.delay_s - made.timing.delay_s) / np.hypot(delay.sigma_s, 3e-4))
        for onset in find_onsets(tracks, RIG, delay.delay_s, delay.sigma_s):
            if onset.used and onset.kind == HINGE:
                error = onset.width - float(made.instrument.backlash(np.array([onset.q_mean]))[0])
                errors.append(error)
                z.append(error / onset.sigma)
    rms = 1e3 * float(np.sqrt(np.mean(np.square(errors))))
    print(f"{len(z)} onsets: {rms:.2f} um rms, z {np.sqrt(np.mean(np.square(z))):.2f}; delays z {np.round(delays, 1)}")
    assert len(z) > 100
    assert rms < 3.0
    assert np.sqrt(np.mean(np.square(z))) < 1.5 and np.mean(np.abs(z) < 2) > 0.85
    assert np.max(np.abs(delays)) < 3.5


@pytest.mark.parametrize("speed", [1.0, 5.6])
def test_quick_passes_where_the_backlash_is_steep_state_what_they_do_not_know(speed):
    """At 5.6 mm/s and 25 frames a second the path bends within few frames: B of 'reference' doubles within 1.5 mm."""
    z, errors = [], []
    for seed in range(20, 23):
        made, tracks = simulated(seed, back_and_forth(RIG.actuator, [speed], 2.4, 10, 4.0))
        for onset in find_onsets(tracks, RIG, made.timing.delay_s, 2e-4):
            if onset.used and onset.kind == HINGE:
                errors.append(onset.width - float(made.instrument.backlash(np.array([onset.q_mean]))[0]))
                z.append(errors[-1] / onset.sigma)
    rms, worst = 1e3 * float(np.sqrt(np.mean(np.square(errors)))), 1e3 * float(np.max(np.abs(errors)))
    print(f"{len(z)} onsets: {rms:.2f} um rms, {worst:.1f} at worst, z {np.sqrt(np.mean(np.square(z))):.2f}")
    assert len(z) > 55
    assert np.sqrt(np.mean(np.square(z))) < 1.5 and np.max(np.abs(z)) < 4.5  # 4.5: once in 2000 such sets by chance
    assert worst < 30.0  # of 500 to 800 um, and of a way of 220 um between two frames


@pytest.mark.parametrize("later", [-1.5e-3, 0.8e-3])
def test_onsets_of_a_little_more_delay_are_those_that_would_be_found(later):
    _, tracks = simulated(8, back_and_forth(RIG.actuator, [0.5], 1.6, 30, 4.0))
    old, new = find_onsets(tracks, RIG, 0.0873), find_onsets(tracks, RIG, 0.0873 + later)
    moved = delayed(old, tracks, later)
    pairs = [
        (a, b, c) for a, b, c in zip(old, new, moved, strict=True) if a.kind == b.kind == HINGE and a.used and b.used
    ]
    assert len(pairs) > 10
    before = np.array([(a.width - b.width) / b.sigma for a, b, _ in pairs])
    after = np.array([(c.width - b.width) / b.sigma for _, b, c in pairs])
    assert np.sqrt(np.mean(after**2)) < 0.3 < np.sqrt(np.mean(before**2))
    assert np.abs([c.t_s - b.t_s for _, b, c in pairs]).max() < 4e-3


def test_delay_and_onsets_are_of_the_motors_path_whatever_its_knots():
    """Knots that a straight line passes say nothing: without them a stroke has none between its ends."""
    motion = back_and_forth(RIG.actuator, [1.0], 2.4, 10, 4.0)
    _, (track,) = simulated(8, motion)
    ends = np.concatenate([[0], np.flatnonzero(np.diff(np.sign(np.diff(motion.q)))) + 1, [len(motion.q) - 1]])
    corners = Motor(motion.t_s[ends], motion.q[ends])
    q = np.interp(motion.t_s, corners.t_s, corners.q)
    few, every = (
        replace(track, path=MotorPath(Motor(motion.t_s, q), lines)) for lines in (corners, Motor(motion.t_s, q))
    )
    assert len(few.motor.t_s) < 0.01 * len(every.motor.t_s)
    delays = [find_delay([each], RIG, RIG.delay_s) for each in (few, every)]
    assert delays[0].stops == delays[1].stops > 8
    assert delays[0].delay_s == pytest.approx(delays[1].delay_s, abs=1e-8)
    found = [find_onsets([each], RIG, delays[1].delay_s) for each in (few, every)]
    assert len(found[0]) == len(found[1]) > 8
    for a, b in zip(*found, strict=True):
        assert (a.kind, a.used, a.reason) == (b.kind, b.used, b.reason)
        assert a.t_s == pytest.approx(b.t_s, abs=1e-6, nan_ok=True) and a.q2 == pytest.approx(b.q2, abs=1e-7)


def test_a_stroke_within_the_backlash_is_a_lower_bound_and_the_next_one_counts_for_nothing():
    plant = Instrument.of(RIG, lambda p: np.full_like(p, 0.6), lambda p: 12.0 * p)
    made, tracks = simulated(1, through([-4.0, 0.0, -0.5, 1.0, -1.0], 0.35, 4.0), instrument=plant)
    onsets = find_onsets(tracks, RIG, made.timing.delay_s)
    assert [o.kind for o in onsets] == [BOUND, "none", HINGE]
    assert onsets[0].low == pytest.approx(0.5, abs=0.01)
    assert not onsets[1].used and "not on an envelope" in onsets[1].reason
    assert onsets[2].used and onsets[2].width == pytest.approx(0.6, abs=0.005)


def test_reversals_during_which_another_axis_moves_are_not_used():
    motion = through([-4.0, 0.0, -2.0, 1.0], 0.35, 4.0)
    made, _ = simulated(2, motion)
    motor = made.recording.motor
    middle = 0.5 * motor.t_s[-1]
    shift = np.clip((motor.t_s - middle) / 2.0, 0.0, 1.0)
    moved = replace(made.recording, motor=Motor(motor.t_s, motor.q, translation_mm=shift))
    onsets = find_onsets(observe([moved], RIG), RIG, made.timing.delay_s)
    reasons = [o.reason for o in onsets]
    assert any("translation or rotation" in reason for reason in reasons)
    assert all(not o.used for o in onsets if "translation or rotation" in o.reason)


def test_a_registration_that_turns_with_the_motion_makes_brackets():
    made, _ = simulated(4, back_and_forth(RIG.actuator, [0.35], 2.4, 10, 4.0))
    marker = made.recording.marker
    moving = np.diff(made.p, prepend=made.p[0])
    latest = np.maximum.accumulate(np.where(moving != 0, np.arange(len(moving)), 0))
    side = np.sign(moving[latest])[np.searchsorted(made.t_s, made.scene_s) - 1]
    shifted = replace(made.recording, marker=replace(marker, u_px=marker.u_px + 8.0 * side))
    onsets = [o for o in find_onsets(observe([shifted], RIG), RIG, made.timing.delay_s) if o.used and o.kind != BOUND]
    assert len(onsets) > 12
    assert all(o.kind == BRACKET for o in onsets)
    for onset in onsets:
        truth = float(made.instrument.backlash(np.array([onset.q_mean]))[0])
        assert onset.low - 0.002 <= truth <= onset.high + 0.002


def test_dither_of_the_encoder_is_no_reversal():
    made, _ = simulated(5, through([-4.0, 4.0], 0.35, 4.0))
    motor = made.recording.motor
    rng = np.random.default_rng(0)
    dithering = Motor(motor.t_s, motor.q + 0.001 * rng.integers(-1, 2, len(motor.q)))
    assert find_onsets(observe([replace(made.recording, motor=dithering)], RIG), RIG, made.timing.delay_s) == []


@given(sigma_s=st.floats(2e-5, 1.2e-2), off_s=st.floats(-0.03, 0.03))
def test_a_delay_is_as_uncertain_as_its_stops_leave_it(sigma_s: float, off_s: float) -> None:
    """Of one stop whose squares are known: with the nominal delay's own its posterior is normal."""
    stop = SimpleNamespace(freedom=40, squares=lambda delays: 40.0 + ((delays - RIG.delay_s - off_s) / sigma_s) ** 2)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(room, "_stops_of_track", lambda track, rig, delay_s: [stop])
        found = find_delay([None], RIG, RIG.delay_s)
    both_s = (sigma_s**-2 + room.NOMINAL_S**-2) ** -0.5
    assert found.sigma_s == pytest.approx(both_s, rel=0.01)
    assert abs(found.delay_s - RIG.delay_s - off_s * (both_s / sigma_s) ** 2) < 0.01 * both_s
