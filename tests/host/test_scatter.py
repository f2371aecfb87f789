"""Events by the statistics of what is left: each is told from the other and from scatter that only looks like it."""

import numpy as np
import pytest

from tautline.diagnosis.explanations import Joined, frames
from tautline.diagnosis.scatter import RIVALS, Scatter, compare_explanations

FLOOR, RATE_HZ = 0.05, 25.0
JITTER, STICK = "acquisition.jitter", "transmission.stick_slip"
HELD = "acquisition.held_samples"
PX_PER_UNIT = np.array([40.0, 15.0])


def told(rng: np.random.Generator, make, per_unit: np.ndarray = PX_PER_UNIT) -> Scatter:
    """Of 80 s of strokes with rests at two speeds; make(t, p, rng) gives where the tip is seen, in
    units of p or (n, 2) px."""
    t = np.arange(0.0, 80.0, 1.0 / RATE_HZ)
    speed = np.where(t < 40.0, 0.4, 1.1)
    p = np.cumsum(speed * (np.sin(2 * np.pi * t / 9.0) > -0.2) * np.sign(np.sin(2 * np.pi * t / 18.0))) / RATE_HZ
    seen = make(t, p, rng)
    seen = seen if seen.ndim > 1 else seen[:, None] * per_unit
    seen = seen + rng.normal(0.0, FLOOR, seen.shape)
    block = (t // 8.0).astype(np.int64)
    return compare_explanations([frames(t, seen, p[:, None] * per_unit, p, block)], FLOOR, int(block[-1]) + 1)


def unsteady(t, p, rng):
    return np.interp(t + rng.normal(0.0, 0.012, len(t)), t, p)


def waiting(t, p, rng):
    """Frames that wait for a busy bus: mostly a little, now and then long."""
    return np.interp(t - rng.exponential(0.03, len(t)) + 0.03 * np.log(2.0), t, p)


def lagging(t, p, rng):
    """A tip that falls behind by lengths of its own, whatever the speed."""
    return p - np.sign(np.diff(p, prepend=p[0])) * (rng.exponential(0.012, len(t)) - 0.012 * np.log(2.0))


def sticking(t, p, rng):
    held, tip = p[0], np.empty_like(p)
    for i, drive in enumerate(p):
        if abs(drive - held) > 0.12:
            held = drive
        tip[i] = held
    return tip


def repeating(t, p, rng):
    seen = p.copy()
    for i in np.flatnonzero(rng.random(len(p)) < 0.15):
        if i:
            seen[i] = seen[i - 1]
    return seen


def wandering(t, p, rng):
    return p + np.cumsum(rng.normal(0.0, 0.004, len(p)))


def blurred(t, p, rng):
    px = p[:, None] * PX_PER_UNIT
    speed = np.linalg.norm(np.gradient(px, t, axis=0), axis=1)
    return px + 0.006 * speed[:, None] * rng.normal(size=px.shape)


def swinging(t, p, rng):
    return p + 0.02 * np.sin(2 * np.pi * t / 3.3)


def coughing(t, p, rng):
    """What pushes the tip aside three times in a row, now and then."""
    seen = p.copy()
    for begin in np.arange(6.0, 78.0, 9.0):
        for after, size in ((0.0, 1.0), (0.4, 0.7), (0.75, 0.35)):
            x = np.maximum(t - begin - after, 0.0) / 0.09
            seen += 0.25 * size * x * np.exp(1.0 - x)
    return seen


def extrapolating(t, p, rng):
    """A tracker that goes on as the marker last moved while it is hidden for a moment."""
    seen = p.copy()
    for begin in np.arange(5.0, 78.0, 3.7):
        hidden = np.flatnonzero((t > begin) & (t < begin + 0.6))
        k = int(hidden[0]) - 1
        seen[hidden] = p[k] + (t[hidden] - t[k]) * (p[k] - p[k - 2]) / (t[k] - t[k - 2])
    return seen


def sticking_and_swinging(t, p, rng):
    """A tip that sticks in slow strokes alone, beside what is as smooth as it is large."""
    return np.where(t < 40.0, sticking(t, p, rng), p) + 0.08 * np.sin(2 * np.pi * t / 3.3)


def rippling(t, p, rng):
    """What pulls the tip to and fro by the place, other waves either way."""
    moves = np.diff(p, prepend=p[0]) != 0.0
    way = np.sign(np.diff(p, prepend=p[0]))[np.maximum.accumulate(np.where(moves, np.arange(len(p)), 0))]
    return p + 0.02 * np.where(way > 0.0, np.sin(9.0 * p), np.sin(14.0 * p + 1.0))


@pytest.mark.parametrize(
    ("make", "name"),
    [
        *[(unsteady, JITTER), (waiting, JITTER), (sticking, STICK), (repeating, HELD), (lagging, "behind")],
        *[(wandering, "memory"), (swinging, "memory"), (blurred, "blur"), (rippling, "place")],
        *[(extrapolating, "bursts"), (sticking_and_swinging, STICK)],
    ],
)
def test_each_says_its_own_best(make, name):
    said = told(np.random.default_rng(5), make)
    mean = {key: float(np.mean(said.loss[key])) for key in (JITTER, STICK, *RIVALS)}
    assert min(mean, key=lambda key: mean[key]) == name, mean


@pytest.mark.parametrize("make", [coughing, extrapolating, swinging, rippling])
@pytest.mark.parametrize("per_unit", [PX_PER_UNIT, PX_PER_UNIT[:1]], ids=["px", "deg"])
def test_what_comes_and_goes_is_no_event(make, per_unit):
    said = told(np.random.default_rng(12), make, per_unit)
    assert not said.beats_rivals(JITTER) and not said.beats_rivals(STICK)


@pytest.mark.parametrize(
    ("make", "name"),
    [(waiting, JITTER), (sticking, STICK), (lagging, "behind"), (swinging, "memory"), (rippling, "place")],
)
def test_an_angle_alone_says_the_same(make, name):
    said = told(np.random.default_rng(9), make, PX_PER_UNIT[:1])
    mean = {key: float(np.mean(said.loss[key])) for key in (JITTER, STICK, *RIVALS)}
    assert min(mean, key=lambda key: mean[key]) == name, mean


@pytest.mark.parametrize("make", [unsteady, waiting, sticking, repeating, lagging, blurred, wandering])
def test_the_likeliest_of_a_grid_is_found_though_not_all_of_it_is_tried(make):
    at = told(np.random.default_rng(3), make)

    def all_tried(self, family, scales):
        tried = [self._with_broad(family(float(s))) for s in scales]
        best = int(np.argmax([float(np.sum(x)) for x in tried]))
        return tried[best], float(scales[best])

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Joined, "likeliest", all_tried)
        everywhere = told(np.random.default_rng(3), make)
    assert at.amount == everywhere.amount
    assert all(np.array_equal(at.loss[name], loss) for name, loss in everywhere.loss.items())


def test_their_sizes_are_found():
    assert told(np.random.default_rng(6), unsteady).amount[JITTER] == pytest.approx(0.012, rel=0.3)
    assert told(np.random.default_rng(6), sticking).amount[STICK] == pytest.approx(0.12, rel=0.4)


def test_frames_count_whose_times_scatter_by_more_than_a_period():
    rng = np.random.default_rng(8)
    scene = np.arange(0.0, 80.0, 1.0 / RATE_HZ)
    late = rng.gamma(1.5, 0.04 / np.sqrt(1.5), len(scene))
    arrival = np.maximum.accumulate(scene + late)
    arrival += 1e-4 * np.arange(len(arrival)) / len(arrival)  # none at the same time
    at = lambda t: 2.0 * np.sin(2 * np.pi * t / 9.0)  # noqa: E731
    seen = at(scene)[:, None] * PX_PER_UNIT + rng.normal(0.0, FLOOR, (len(scene), 2))
    p = at(arrival - 0.045)
    block = (arrival // 8.0).astype(np.int64)
    counted = frames(arrival, seen, p[:, None] * PX_PER_UNIT, p, block)
    assert len(counted.block) > 0.5 * len(scene)
    said = compare_explanations([counted], FLOOR, int(block[-1]) + 1)
    assert min((JITTER, STICK, *RIVALS), key=lambda key: float(np.mean(said.loss[key]))) == JITTER
    assert said.amount[JITTER] == pytest.approx(0.04, rel=0.3)


def test_times_of_arrival_tell_which_frame_waited():
    """At 100 Hz a frame that waits holds the next ones up: what is left remembers, as nothing random does."""
    rng = np.random.default_rng(10)
    scene = np.flatnonzero(rng.random(8000) > 0.02) / 100.0  # one in fifty is lost
    arrival = np.maximum.accumulate(scene + rng.exponential(0.03, len(scene)))
    arrival += 1e-6 * np.arange(len(arrival))  # none at the same time
    at = lambda t: 2.0 * np.sin(2 * np.pi * t / 9.0)  # noqa: E731
    seen = at(scene)[:, None] * PX_PER_UNIT + rng.normal(0.0, FLOOR, (len(scene), 2))
    p = at(arrival - 0.07)
    block = (arrival // 8.0).astype(np.int64)
    said = compare_explanations([frames(arrival, seen, p[:, None] * PX_PER_UNIT, p, block)], FLOOR, int(block[-1]) + 1)
    mean = {key: float(np.mean(said.loss[key])) for key in (JITTER, STICK, *RIVALS)}
    assert min(mean, key=lambda key: mean[key]) == JITTER, mean
    assert said.amount[JITTER] == pytest.approx(float(np.std(arrival - scene)), rel=0.3)


def test_noise_alone_is_neither():
    said = told(np.random.default_rng(7), lambda t, p, rng: p)
    for name in (JITTER, STICK):
        assert np.mean(said.loss[name]) > np.mean(said.loss["level"]) - 0.01


def test_of_frames_that_come_in_bunches_nothing_is_told():
    t = np.repeat(np.arange(0.0, 40.0, 1.0), 3) + np.tile([0.0, 0.001, 0.002], 40)
    p = np.sin(t)
    seen = p[:, None] * PX_PER_UNIT
    block = (t // 10.0).astype(np.int64)
    said = compare_explanations([frames(t, seen, seen, p, block)], FLOOR, int(block[-1]) + 1)
    assert not any(said.beats_rivals(event) for event in (JITTER, STICK, HELD))
    assert all(loss.tolist() == [0.0] * 4 for loss in said.loss.values()) and set(RIVALS) < set(said.loss)


def test_a_recording_of_another_rate_keeps_its_own_time():
    """Regimes last for seconds: what a recording's frames say does not hang on the rate of the recording beside it."""
    rng, parts = np.random.default_rng(7), []
    for number, rate_hz in enumerate((25.0, 120.0)):
        t = np.arange(0.0, 20.0, 1.0 / rate_hz)
        p = 3.0 * np.sin(t)
        seen = p[:, None] * PX_PER_UNIT + FLOOR * rng.normal(size=(len(t), 2))
        seen[(t > 8.0) & (t < 9.0)] += 6.0 * FLOOR
        parts.append(frames(t, seen, p[:, None] * PX_PER_UNIT, p, np.full(len(t), number)))
    together, alone = Joined(parts, FLOOR), [Joined([part], FLOOR) for part in parts]
    np.testing.assert_allclose(together.returns(FLOOR), np.concatenate([one.returns(FLOOR) for one in alone]))
