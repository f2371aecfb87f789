"""The calibration motion at every tick: within its limits, at rest when told, and good for a whole calibration."""

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from onset_plant import REASON

from tautline import _native

STATE = dict(_native.MOTION_STATES)


def configure(**options):
    config = _native.MotionConfig()
    for name, value in options.items():
        setattr(config, name, value)
    return config


@st.composite
def motions(draw):
    """A valid configuration in counts and seconds, and where the axis is at the start."""
    rate = draw(st.sampled_from([1000, 2000, 5000, 10000]))
    approach = draw(st.floats(1.0, 300.0))
    stroke = approach * draw(st.floats(2.01, 10.0))
    span = stroke * draw(st.floats(2.05, 8.0))
    low = draw(st.floats(-20000.0, 20000.0))
    transit = draw(st.floats(0.05, 1.0)) * min(50.0 * rate, 4 * stroke)
    speeds = [transit * draw(st.floats(0.05, 1.0)) for _ in range(draw(st.integers(1, 3)))]
    acceleration = transit**2 / (2 * stroke * draw(st.floats(0.01, 0.8)))
    assume(min(speeds) > 1.0 and acceleration < 8e6)
    assume(acceleration * 2.0**32 / rate**2 > 2000 and transit / (acceleration / rate) < 2**19)
    start = low + span * draw(st.floats(-0.3, 1.3))
    values = {
        "low": low,
        "high": low + span,
        "transit": transit,
        "acceleration": acceleration,
        "approach": approach,
        "stroke_max": stroke,
    }
    fixed = {name: round(value * 256) for name, value in values.items()}
    config = configure(**fixed, speed=[round(s * 256) for s in speeds], cycles=draw(st.integers(1, 4)), rate_hz=rate)
    return config, round(start * 256)


def check_limits(config, start, q, velocity):
    """Every tick of a run from rest: Q8 counts, Q8 counts/s."""
    assert q.min() >= min(config.low, start) - 1
    assert q.max() <= max(config.high, start) + 1
    assert np.abs(velocity).max() <= config.transit + 2
    change = np.abs(np.diff(velocity.astype(np.int64), prepend=0))
    assert change.max() <= config.acceleration / config.rate_hz + 2
    travelled = start + np.cumsum(velocity) / config.rate_hz
    assert np.abs(travelled - q).max() <= 2 + len(q) / config.rate_hz  # velocity is rounded down, position is not


@settings(max_examples=60, deadline=None)
@given(motions(), st.integers(0, 2**32 - 1), st.floats(0.0, 1.0))
def test_limits_hold_at_every_tick_and_stop_comes_to_rest(motion, seed, when):
    config, start = motion
    rng = np.random.default_rng(seed)
    axis = _native.Motion()
    assert axis.start(config, start) == _native.MOTION_ERRORS["ok"]
    q_parts, v_parts = [], []
    for _ in range(int(1 + when * 60)):  # chunks of random length, each followed by a random onset
        q, v = axis.tick(int(rng.integers(1, 3000)))
        q_parts.append(q)
        v_parts.append(v)
        axis.onset(int(rng.choice([-1, 1])))
    running = axis.state == STATE["running"]
    v0 = int(v_parts[-1][-1])
    q0 = int(q_parts[-1][-1])
    axis.stop()
    # Velocity comes rounded to 1/256 count/s, and the acceleration inside is known to a thousandth.
    ticks = int(np.ceil(1.001 * (abs(v0) + 1) * config.rate_hz / config.acceleration)) + 1
    q, v = axis.tick(ticks)
    assert axis.state == (STATE["stopped"] if running else STATE["complete"])
    assert v[-1] == 0
    assert np.abs(q - q0).max() <= 1.001 * (abs(v0) + 1) ** 2 / (2 * config.acceleration) + 1
    check_limits(config, start, np.concatenate([*q_parts, q]), np.concatenate([*v_parts, v]))
    still, zero = axis.tick(50)
    assert np.all(still == q[-1])
    assert np.all(zero == 0)


@settings(max_examples=25, deadline=None)
@given(motions(), st.floats(0.05, 0.9))
def test_it_always_completes_with_all_its_reversals(motion, share):
    """With an onset after `share` of the longest stroke of each reversal, or none where the range ends before."""
    config, start = motion
    legs = (2 * config.cycles + 1) * 2 * len(config.speed)
    slowest = min(config.speed)
    assume(legs * (config.high - config.low) / slowest < 4000)
    axis = _native.Motion()
    assert axis.start(config, start) == 0
    chunk = max(1, int(config.rate_hz * config.approach / config.transit / 8))
    q_parts, v_parts, progress = [], [], [0]
    turned, direction = start, 0
    while axis.state == STATE["running"]:
        q, v = axis.tick(chunk)
        q_parts.append(q)
        v_parts.append(v)
        progress.append(axis.progress)
        moving = np.sign(v[-1])
        if moving != 0 and moving != direction:
            turned, direction = q[0], moving
        if abs(int(q[-1]) - int(turned)) > share * config.stroke_max:
            axis.onset(int(direction))
        assert len(q_parts) * chunk < 60 * config.rate_hz * legs * (config.high - config.low) / slowest
    assert axis.state == STATE["complete"]
    assert progress[-1] == 1000
    assert np.all(np.diff(progress) >= 0)
    q, v = np.concatenate(q_parts), np.concatenate(v_parts)
    check_limits(config, start, q, v)
    assert (q.min() <= config.low + 1) and (q.max() >= config.high - 1)
    signs = np.sign(v[v != 0])
    turns = np.count_nonzero(signs[1:] != signs[:-1])
    assert turns in (legs, legs + 1)  # one more where the way to the low end began upwards
    assert axis.tick(5)[0][-1] == q[-1]


def test_a_silent_host_brings_it_to_rest():
    config = configure(
        low=-5000 * 256, high=5000 * 256, speed=[350 * 256], cycles=9, transit=3500 * 256, acceleration=20000 * 256,
        approach=170 * 256, stroke_max=1500 * 256, host_timeout_us=500_000, rate_hz=5000,
    )  # fmt: skip
    axis = _native.Motion()
    assert axis.start(config, 0) == 0
    axis.tick(5000, 200)
    assert axis.state == STATE["running"]
    axis.tick(2200)  # the last frame came 200 ticks before
    assert axis.state == STATE["running"]
    _, v = axis.tick(1500)
    assert axis.state == STATE["host_lost"]
    assert v[-1] == 0


def calibrate(speeds, seed):
    """The whole loop on a board's own code: motion, encoder, image 80 ms late at 25 Hz, onsets back to the motion."""
    rng = np.random.default_rng(seed)
    config = configure(
        low=-5000 * 256, high=5000 * 256, speed=[s * 256 for s in speeds], cycles=9, transit=3500 * 256,
        acceleration=20000 * 256, approach=170 * 256, stroke_max=1500 * 256, host_timeout_us=500_000, rate_hz=5000,
    )  # fmt: skip
    grid = np.linspace(-6000.0, 6000.0, 1201)
    width = 500 + 300 * np.exp(-(((grid - 300) / 850) ** 2)) + 0.02 * grid
    axis, detector = _native.Motion(), _native.OnsetDetector(_native.OnsetConfig())
    axis.start(config, 0)
    p, ms, late, found = float("nan"), 0, [], []
    while axis.state == STATE["running"]:
        q = axis.tick(200, 200)[0][::5].astype(float) / 256
        t_us = (ms + np.arange(40)) * 1000
        ms += 40
        p = _native.Plays(grid, width).forward(q, p)[0][-1]
        late.append((t_us[-1] + 80_000, *(np.array([360, 200]) + 0.06 * p * np.array([0.9, 0.4]))))
        due = np.array([f for f in late if f[0] <= t_us[-1]]).reshape(-1, 3)
        late = [f for f in late if f[0] > t_us[-1]]
        image = np.round((due[:, 1:] + rng.normal(0, 0.05, (len(due), 2))) * 4096).astype(np.int32)
        none = np.zeros(len(due), np.int32)
        new = detector.run(
            t_us.astype(np.uint64), (np.floor(q) * 256).astype(np.int32), due[:, 0].astype(np.uint64),
            np.ascontiguousarray(image[:, 0]), np.ascontiguousarray(image[:, 1]), none, none == 0, none != 0,
        )  # fmt: skip
        for k in range(len(new["width"])):
            found.append({name: new[name][k] for name in new})
            if new["started"][k]:
                axis.onset(int(new["direction"][k]))
    middle = np.array([(int(o["q1"]) + int(o["q2"])) / 512 for o in found])
    error = np.array([o["width"] / 256 for o in found]) - np.interp(middle, grid, width)
    return axis, found, middle, error, ms / 1000


def test_a_calibration_takes_little_and_measures_everywhere():
    axis, found, middle, error, seconds = calibrate([350], seed=2)
    assert axis.state == STATE["complete"]
    assert len(found) == 38
    assert all(o["reason"] == REASON["used"] for o in found)
    assert seconds < 120
    assert np.sqrt(np.mean(error**2)) < 1.5  # um; the target for B(q) is 3
    gaps = np.diff(np.sort(middle))
    assert gaps.max() < 2 * 10000 / 38  # evenly over the range, but for half a width at either end
    direction = np.array([o["direction"] for o in found])
    for sign in (-1, 1):
        assert np.diff(np.sort(middle[direction == sign])).max() < 4 * 10000 / 38
    assert abs(middle).max() > 5000 - 420


def test_several_speeds_are_all_measured():
    axis, found, _, error, seconds = calibrate([350, 700], seed=3)
    assert axis.state == STATE["complete"]
    assert len(found) == 76
    speeds = np.array([o["speed_start"] for o in found]) / 256
    assert np.all(np.abs(speeds[:38] / 350 - 1) < 0.05)
    assert np.all(np.abs(speeds[38:] / 700 - 1) < 0.05)
    assert np.sqrt(np.mean(error**2)) < 1.5
    assert seconds < 180
