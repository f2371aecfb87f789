"""What the tables' sections undo: the board's compensator in front of a float64 plant of the same effect."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from undone_plant import GAIN, WAVE, Plant

from tautline import _native, tables
from tautline.compensation import compensate
from tautline.effects import BY_ID, follow
from tautline.model import Effect, Model
from tautline.recording import Motor
from tautline.simulated.instrument import reference_rig
from tautline.undone import COUPLED, Joint, not_undone, onset_elements, tables_and_sections

COUNT = 0.001
COUNTS = GAIN * COUNT  # deg of a count
SIDES, SPEED = "transmission.asymmetric_backlash", "transmission.rate_dependent_backlash"
few = settings(max_examples=4, deadline=None)


def model(width: float, effect: str = "", wave: float = 0.0, **parameters: Any) -> Model:
    q = np.linspace(-5.0, 5.0, 201)
    wide = width * (1.0 + wave * np.sin(2.0 * np.pi * q / WAVE))
    made = Model(reference_rig(), q, wide, 0 * q, GAIN * q, 0.08, (-5.0, 5.0))
    return replace(made, effects=(Effect(effect, parameters),)) if effect else made


def path(speed: float = 1.0, seconds: float = 9.0) -> tuple[np.ndarray, np.ndarray]:
    """Two sines: turns at many places, no rests; at most about `speed` mm/s."""
    t = np.arange(0.0, seconds, 0.002)
    c = 0.6 * np.sin(2 * np.pi * 0.21 * t * speed) + 0.4 * np.sin(2 * np.pi * 0.33 * t * speed + 1.0)
    return t, 0.55 * GAIN * c


def errors(own: Model, plant: Plant, path_: tuple[np.ndarray, np.ndarray] | None = None) -> np.ndarray:
    """The tip's, in counts, once it has been driven through the play both ways."""
    t, c = path_ or path()
    points = compensate(own, t, c)
    off = plant.run(points.q) - np.interp(points.t_s, t, c)
    return off[points.t_s > 4.0] / COUNTS


def assert_undone(effect: str, parameters: dict[str, Any], plant: Plant, counts: float, **path_: Any) -> None:
    along = path(**path_)
    own = model(plant.width, effect, **parameters)
    rms = np.sqrt(np.mean(errors(own, replace(plant), along) ** 2))
    before = np.sqrt(np.mean(errors(model(plant.width), replace(plant), along) ** 2))
    assert rms <= counts, f"{rms:.2f} counts with the section, {before:.1f} without"
    assert before > 3.0 * counts, "too weak to say anything"


@few
@given(st.floats(-12.0, 12.0), st.floats(4.0, 12.0), st.floats(-4.0, 4.0), st.floats(-4.0, 4.0), st.floats(0.25, 1.5))
def test_an_encoder_that_errs_once_a_turn(a: float, b: float, a2: float, b2: float, turn: float) -> None:
    a, b, a2, b2 = (v * COUNT for v in (a, b, a2, b2))
    v = {"encoder_sin": a, "encoder_cos": b, "encoder_sin2": a2, "encoder_cos2": b2, "encoder_period": turn}
    assert_undone("actuator.encoder_periodic", v, Plant(0.4, encoder=(a, b, a2, b2, turn)), 0.6)


@few
@given(st.sampled_from([-1, 1]), st.floats(0.08, 0.2), st.floats(0.15, 0.5))
def test_a_side_that_starts_later_and_catches_up(side: int, late: float, travel: float) -> None:
    v = {"asymmetry": side * late, "asymmetry_travel": travel, "asymmetry_form": 1.0}
    plant = Plant(0.4, side=side, late=late, travel=travel)
    assert_undone("transmission.asymmetric_backlash", v, plant, 2.0)


def halting(seed: int, seconds: float = 9.0) -> tuple[np.ndarray, np.ndarray]:
    """Strokes at 1 to 4 mm/s, four one way and four back, after rests that are none, short or long: 0.05 s is between.
    Of those after which it goes on one each is so."""
    rng = np.random.default_rng(seed)
    t, q, way = [0.0], [0.0], 1.0
    while t[-1] < seconds:
        rests = 0.0, rng.uniform(0.005, 0.04), rng.uniform(0.065, 0.4)
        for rest in (*rng.permutation(rests), rng.choice(rests)):
            goal = float(np.clip(q[-1] + way * rng.uniform(0.1, 0.9), -4.0, 4.0))
            t.append(t[-1] + abs(goal - q[-1]) / rng.uniform(1.0, 4.0) + 1e-6)
            t.append(t[-1] + rest + 1e-6)
            q += [goal, goal]
        way = -way
    return np.array(t), GAIN * np.array(q)


sided = st.tuples(st.sampled_from([-1, 1]), st.floats(0.08, 0.2), st.floats(0.15, 0.5))
seeds = st.integers(0, 2**32 - 1)


@few
@given(sided, seeds)
def test_a_side_that_starts_later_after_every_rest(sides: tuple[int, float, float], seed: int) -> None:
    side, late, travel = sides
    v = {"asymmetry": side * late, "asymmetry_travel": travel, "asymmetry_form": 1.0}
    plant = Plant(0.4, side=side, late=late, travel=travel, renewed=0.05)
    along = halting(seed)
    rms = [
        np.sqrt(np.mean(errors(model(0.4, SIDES, **v, asymmetry_renewed=renewed), replace(plant), along) ** 2))
        for renewed in (1.0, 0.0)
    ]
    assert rms[0] <= 2.0 and rms[1] > 3.0 * rms[0], f"{rms[0]:.2f} counts with the section, {rms[1]:.1f} without"


@few
@given(sided, seeds, st.floats(0.7, 1.8), st.sampled_from([200, 1000, 4000]), st.sampled_from([0.0, 1.0]))
def test_the_law_that_is_diagnosed_is_undone_at_any_rate(
    sides: tuple[int, float, float], seed: int, form: float, rate_hz: int, renewed: float
) -> None:
    """The board's inverse in front of the library's own float64 law, whose rest it is that the table has."""
    side, late, travel = sides
    v = {"asymmetry": side * late, "asymmetry_travel": travel, "asymmetry_form": form, "asymmetry_renewed": renewed}
    own, along = model(0.4, SIDES, **v), halting(seed)
    points = compensate(own, *along, rate_hz=rate_hz)
    c = follow(own, Motor(points.t_s, points.q), points.t_s, v).c_deg
    off = (c - np.interp(points.t_s, *along))[points.t_s > 4.0] / COUNTS
    assert np.sqrt(np.mean(off**2)) <= 2.0


@few
@given(sided, seeds, st.floats(2.0, 20.0))
def test_what_is_still_taken_up_is_no_rest(sides: tuple[int, float, float], seed: int, speed: float) -> None:
    """A motor that is slow to take the backlash up moves the tip while the command rests; what counts is the tip's own
    rest. Looked at is where nothing is taken up."""
    side, late, travel = sides
    v = {"asymmetry": side * late, "asymmetry_travel": travel, "asymmetry_form": 1.0, "asymmetry_renewed": 1.0}
    own, (t, c) = model(0.4, SIDES, **v), halting(seed, 60.0)
    at = np.arange(0.0, t[-1], 1e-3)
    want = np.interp(at, t, c)
    board = compensator(own, 0.0, limits=replace(LIMITS, takeup_speed=speed, takeup_accel=20.0 * speed))
    q, _, _, flags = board.run(deg(want))
    tip = follow(own, Motor(at, q * COUNT / 256.0), at, v).c_deg
    arrived = (flags & _native.COMPENSATOR_FLAGS["TAKE_UP"] == 0) & (at > 4.0)
    assert arrived.mean() > 0.3 and np.abs(tip - want)[arrived].max() / COUNTS <= 6.0


@few
@given(sided, seeds, st.floats(0.5, 2.0), st.sampled_from([0.0, 1.0]))
def test_a_side_that_is_pressed_where_the_width_is(
    sides: tuple[int, float, float], seed: int, share: float, renewed: float
) -> None:
    """The width varies by half of its mean, and what starts later with it: no worse than where that is alike."""
    side, late, travel = sides
    v = {"asymmetry": side * late, "asymmetry_travel": travel, "asymmetry_form": 1.0, "asymmetry_renewed": renewed}
    plant = Plant(0.4, 0.5, side=side, late=late, travel=travel, renewed=0.05 if renewed else math.inf)
    along = halting(seed)
    alike, pressed, untold = (
        np.sqrt(
            np.mean(errors(model(0.4, SIDES, 0.5, **v, asymmetry_pressed=told), replace(plant, pressed=of), along) ** 2)
        )
        for told, of in ((0.0, 0.0), (share, share), (0.0, share))
    )
    assert pressed <= min(2.0, alike + 0.5), f"{pressed:.2f} counts, {alike:.2f} where it is alike"
    assert untold > 3.0 * pressed, f"{pressed:.2f} counts with the section, {untold:.1f} without"


@few
@given(sided, seeds, st.floats(0.7, 1.8), st.sampled_from([200, 1000, 4000]), st.floats(0.2, 2.0))
def test_the_law_that_is_diagnosed_is_undone_where_it_is_pressed(
    sides: tuple[int, float, float], seed: int, form: float, rate_hz: int, share: float
) -> None:
    """The board's inverse in front of the library's own float64 law."""
    side, late, travel = sides
    v = {"asymmetry": side * late, "asymmetry_travel": travel, "asymmetry_form": form, "asymmetry_pressed": share}
    own, along = model(0.4, SIDES, 0.5, **v), halting(seed)
    points = compensate(own, *along, rate_hz=rate_hz)
    c = follow(own, Motor(points.t_s, points.q), points.t_s, v).c_deg
    off = (c - np.interp(points.t_s, *along))[points.t_s > 4.0] / COUNTS
    assert np.sqrt(np.mean(off**2)) <= 2.5


@few
@given(st.floats(0.03, 0.05), st.floats(1.0, 2.0), st.sampled_from([-1.0, 1.0]))
def test_a_speed_s_width_is_pressed_where_the_width_is(per_speed: float, share: float, way: float) -> None:
    v = {"width_per_speed": per_speed, "speed_time": 0.05, "width_held": 1.0}
    t = np.arange(0.0, 9.0, 0.002)
    c = way * 20.0 * (np.abs((0.11 * t) % 1.0 * 4.0 - 2.0) - 1.0)
    alike, pressed, untold = (
        np.abs(
            errors(
                model(0.4, SPEED, 0.5, **v, speed_pressed=told),
                Plant(0.4, 0.5, per_speed=per_speed, per_speed_time=0.05, pressed=of),
                (t, c),
            )
        )
        for told, of in ((0.0, 0.0), (share, share), (0.0, share))
    )
    assert np.median(pressed) <= np.median(alike) + 0.3 and 3.0 * np.median(pressed) < np.median(untold)


@few
@given(st.floats(0.02, 0.05), st.floats(0.03, 0.1), st.sampled_from([math.inf, 3.0, 0.6]))
def test_a_width_that_grows_with_the_speed(per_speed: float, time: float, end: float) -> None:
    """The plant's width knows the motor's speed, the section's that of p: apart while the backlash is crossed. Whether
    it grows without end or saturates, all it adds at the path's speed, 5 mm/s and more, is much alike."""
    usual = 0.1 * float(np.ptp(model(0.4).q))
    saturation = usual / end
    slow = -math.expm1(-saturation) / saturation if saturation else 1.0  # of what it adds at usual, of the straight law
    per_speed *= 1.0 if math.isinf(end) else 6.0 / end
    v = {"width_per_speed": per_speed * slow, "speed_time": time, "width_held": 1.0}
    v["speed_saturation"] = saturation
    t = np.arange(0.0, 9.0, 0.002)
    c = 20.0 * (np.abs((0.11 * t) % 1.0 * 4.0 - 2.0) - 1.0)
    own = model(0.4, "transmission.rate_dependent_backlash", **v)
    off = np.abs(errors(own, Plant(0.4, per_speed=per_speed, per_speed_time=time, per_speed_end=end), (t, c)))
    old = np.abs(errors(model(0.4), Plant(0.4, per_speed=per_speed, per_speed_time=time, per_speed_end=end), (t, c)))
    assert np.median(off) < 1.0 < 5.0 < np.median(old)
    assert np.sqrt(np.mean(off**2)) < 0.5 * np.sqrt(np.mean(old**2))


@few
@given(st.floats(0.04, 0.15), st.floats(0.0, 0.5))
def test_lag_of_one_stage_and_two(lag: float, second: float) -> None:
    stages = tuple(s for s in (lag * (1.0 - second), lag * second) if s > 1e-3)
    v = {"lag": lag, "lag_second": second if len(stages) == 2 else 0.0}
    if len(stages) == 1:
        v["lag"] = stages[0]
    assert_undone("transmission.lag", v, Plant(0.4, lag=stages), 0.5 + 40.0 * lag, speed=0.6)


@few
@given(st.floats(0.05, 0.3) | st.floats(-0.2, -0.05), st.floats(0.5, 3.0), st.floats(0.0, 0.5))
def test_creep_of_two_times(share: float, time: float, slow: float) -> None:
    v = {"creep_share": share, "creep_time": time, "creep_slow": slow}
    elements = ((share * (1.0 - slow), time), (share * slow, 5.0 * time))
    assert_undone("transmission.creep", v, Plant(0.4, creep=elements), 1.5)


def compensator(
    own: Model, c: float, joints: dict[str, Joint] | None = None, limits: tables.Limits | None = None
) -> Any:
    blob = tables.encode(own, limits=limits or LIMITS, joints=joints)
    table = _native.FixedTable(blob)
    q = int(table.angle_inverse(np.array([deg(c)], np.int32))[0][0])
    return _native.FixedCompensator(table, 1000, _native.MODE_FULL, q, deg(c))


LIMITS = tables.Limits(speed_max=100.0, takeup_speed=50.0, takeup_accel=1e5, band=0.002, adapt=(0.5, 0.25, 1.9))


def deg(c: float | np.ndarray) -> Any:
    return np.rint(np.asarray(c) * _native.DEG_ONE).astype(np.int32) if np.ndim(c) else round(c * _native.DEG_ONE)


@few
@given(st.floats(-0.004, 0.02), st.floats(-0.004, 0.004), st.floats(-0.004, 0.004), st.floats(-60.0, 60.0))
def test_width_gain_and_offset_by_load(width: float, gain: float, offset: float, load: float) -> None:
    names = ("width_per_load", "gain_per_load", "offset_per_load")
    own = model(0.4, "transmission.load_dependence", **dict(zip(names, (width, gain, offset), strict=True)))
    t, c = path()
    board = compensator(own, float(c[0]))
    board.load(round(load * 256), 100)
    q = board.run(deg(np.interp(np.arange(0.0, t[-1], 1e-3), t, c)))[0] * COUNT / 256.0
    scale = max(1.0 + width * load, 0.0)
    plant = Plant(0.4, offset=offset * load, scale=scale, gain=1.0 + gain * load)
    off = (plant.run(q) - np.interp(np.arange(len(q)) * 1e-3, t, c))[4000:] / COUNTS
    assert np.sqrt(np.mean(off**2)) < 0.6


def test_another_axis_moves_the_angle() -> None:
    own = model(0.4, "configuration.axis_coupling", c_per_translation=0.7, c_per_rotation=0.0)
    with_joint = {"translation_mm": Joint(2, 0.002)}
    assert tables_and_sections(own)[1] == {} != tables_and_sections(own, with_joint)[1]
    t, c = path()
    board = compensator(own, float(c[0]), with_joint)
    c = np.interp(np.arange(0.0, t[-1], 1e-3), t, c)
    other = 3.0 * np.sin(np.arange(len(c)) * 1e-3)
    q = []
    for want, at in zip(deg(c), other, strict=True):
        board.joint(0, round(at / 0.002 * 256))
        q.append(int(board.run(np.array([want], np.int32))[0][0]))
    tip = Plant(0.4).run(np.array(q) * COUNT / 256.0) + 0.7 * other
    assert np.sqrt(np.mean((tip - c)[4000:] ** 2)) < 0.6 * COUNTS


@few
@given(st.floats(0.3, 1.5) | st.floats(-1.5, -0.3), st.floats(0.0, 1.0), st.integers(0, 2))
def test_another_axis_moves_the_motor_before_the_play(slope: float, gap: float, column: int) -> None:
    """By `slope` deg of the tip for each unit, once it has crossed its own gap: within the play that moves nothing."""
    name, play, of = (
        ("c_per_translation", "translation_play", "translation_mm"),
        ("c_per_rotation", "rotation_play", "rotation_deg"),
        ("c_per_joint", "joint_play", "wrist"),
    )[column]
    v = {name: slope, play: gap, "coupled_before": 1.0} | ({"column": of} if column == 2 else {})
    own, with_joint = model(0.4, COUPLED, **v), {of: Joint(2, 0.002)}
    assert not_undone(own) == [COUPLED] and not_undone(own, with_joint) == []
    t, c = path(0.3)
    c = np.interp(np.arange(0.0, t[-1], 1e-3), t, c)
    other = 2.0 * np.sin(np.arange(len(c)) * 8e-3) + 0.7  # quicker than the tip: it turns the motor, and not the tip
    rms = []
    for told in (own, replace(own, effects=(Effect(COUPLED, v | {"coupled_before": 0.0}),))):
        board = compensator(told, float(c[0]), with_joint)
        plant, carried = Plant(0.4), other[0]
        off = []
        for want, at in zip(deg(c), other, strict=True):
            board.joint(0, round(at / 0.002 * 256))
            q = int(board.run(np.array([want], np.int32))[0][0]) * COUNT / 256.0
            carried = min(max(carried, at - 0.5 * gap), at + 0.5 * gap)
            plant.before = slope * carried / GAIN
            off.append(plant.step(q) - want / _native.DEG_ONE)
        rms.append(np.sqrt(np.mean(np.square(off[4000:]))) / COUNTS)
    assert rms[0] < 1.0 and rms[1] > 5.0 * rms[0], f"{rms[0]:.2f} counts, {rms[1]:.1f} as if behind the play"


@few
@given(st.floats(0.1, 0.9), st.floats(0.0, 1.0))
def test_a_gradual_onset_becomes_elements(spread: float, tail: float) -> None:
    """Their half widths, weighed, are those of the spread thresholds to the fourth part of a seventh of their reach."""
    v = {"onset_spread": spread, "onset_tail": tail}
    elements = onset_elements(model(0.4).elements, v)
    lots, share = _native.onset_lots(v)
    x = np.linspace(0.0, lots.max() * 1.1, 200)

    def moved(width: np.ndarray, weight: np.ndarray) -> np.ndarray:
        return np.maximum(x[:, None] - width, 0.0) @ weight

    off = moved(lots, share) - moved(np.array(elements.width), np.array(elements.weight))
    assert np.abs(off).max() < np.ptp(lots) / 28.0
    assert elements.weight[0] >= 0.05 - 1e-9 and len(elements.width) > 4


# -- moved while in use ---------------------------------------------------------------------------------------------


@few
@given(st.floats(-0.5, 0.5), st.floats(0.25, 1.9), st.integers(1, 3000))
def test_a_table_is_moved_without_a_jump_and_arrives(offset: float, scale: float, ticks: int) -> None:
    t, c = path()
    want = np.interp(np.arange(0.0, t[-1], 1e-3), t, c)
    board = compensator(model(0.4), float(c[0]))
    first = board.run(deg(want[:3000]))[0]
    rest = board.run(deg(np.full(200, want[3000])))[0]
    assert board.adapt(round(offset / COUNT * 256), round(scale * 32768), ticks)
    blended = np.concatenate([rest[-1:], board.run(deg(np.full(3500, want[3000])))[0]]) / 256.0
    assert np.abs(np.diff(blended)).max() < 1.01
    steps = np.flatnonzero(np.abs(np.diff(blended)) > 0.0)
    assert steps.max(initial=0) <= max(ticks, 2 * abs(offset) / COUNT, 2048 * abs(scale - 1.0)) + 1
    after = board.run(deg(want[3000:]))[0]
    tip = Plant(0.4, offset=offset, scale=scale).run(
        np.concatenate([first, rest, blended[1:] * 256.0, after]) * COUNT / 256
    )
    off = (tip[-len(after) :] - want[3000:])[3000:] / COUNTS
    assert np.sqrt(np.mean(off**2)) < 0.6


def test_nobody_moves_a_table_further_than_it_says() -> None:
    board = compensator(model(0.4), 0.0)
    assert not board.adapt(round(0.501 / COUNT * 256), 32768, 100)
    assert not board.adapt(0, round(0.24 * 32768), 100)
    assert not board.adapt(0, round(1.91 * 32768), 100)
    assert board.adapt(0, 32768, 100)
    q = _native.FixedTable(tables.encode(model(0.4)))
    unlimited = _native.FixedCompensator(q, 1000, _native.MODE_FULL, 0, 0)
    assert not unlimited.adapt(1, 32768, 100)


# -- sections -------------------------------------------------------------------------------------------------------


def test_sections_travel() -> None:
    own = model(0.4, "transmission.lag", lag=0.05, lag_second=0.3)
    encoder = Effect("actuator.encoder_periodic", {"encoder_sin": 0.01, "encoder_period": 0.4})
    own = replace(own, effects=(*own.effects, encoder))
    read = tables.decode(tables.encode(own, limits=LIMITS))
    assert read.limits.adapt == pytest.approx(LIMITS.adapt, abs=1e-4)
    assert read.sections["encoder"] == {
        "sine": 2560,
        "cosine": 0,
        "sine2": 0,
        "cosine2": 0,
        "period_q12": 400 * 4096,
    }
    assert set(read.sections) == {"encoder", "late", "adapt"}
    assert tables.model_id(own) != tables.model_id(model(0.4))


def test_a_model_without_effects_is_the_table_that_it_was() -> None:
    blob = tables.encode(model(0.4), created_s=0)
    assert int.from_bytes(blob[4:6], "little") == 1 and tables.decode(blob).sections == {}


@pytest.mark.parametrize(
    ("section", "reason"),
    [
        ({"encoder": {"period_q12": 4096 * 100, "sine": 256 * 8, "cosine": 0, "sine2": 0, "cosine2": 0}}, "ENCODER"),
        ({"encoder": {"period_q12": 0, "sine": 0, "cosine": 0, "sine2": 0, "cosine2": 0}}, "ENCODER"),
        ({"sides": {"side": 0, "step_log2": 4, "late": [0] * 17}}, "SIDES"),
        ({"sides": {"side": 1, "step_log2": 4, "late": [17, *[0] * 16]}}, "SIDES"),
        ({"sides": {"side": 1, "step_log2": 4, "late": [0, 1, *[0] * 15]}}, "SIDES"),
        ({"speed": {"step_log2": 4, "time_us": 0, "held": 0, "extra": [-1, *[0] * 16]}}, "SPEED"),
        ({"speed": {"step_log2": 23, "time_us": 0, "held": 0, "extra": [0] * 17}}, "SPEED"),
        ({"late": {"gain_q16": [1, 0, 0, 0], "time_us": [0, 0, 0, 0]}}, "LATE"),
        ({"late": {"gain_q16": [1, 0, 0, 0], "time_us": [999, 0, 0, 0]}}, "LATE"),
        ({"load": {"reference": 0, "width": 1 << 25, "gain": 0, "offset": 0, "middle": 0}}, "LOAD"),
        ({"joints": {"axis": [1, 0, 0], "play": [0, 0, 0], "slope": [0, 0, 0]}}, "JOINTS"),
        ({"joints": {"axis": [5, 0, 0], "play": [0, 0, 0], "slope": [0, 0, 0]}}, "JOINTS"),
        ({"adapt": {"offset": -1, "width_least_q15": 0, "width_most_q15": 32768}}, "ADAPT"),
        ({"adapt": {"offset": 0, "width_least_q15": 0, "width_most_q15": 32767}}, "ADAPT"),
        ({"anew": {"rest_us": 50_000}}, "ANEW"),
        ({"pressed": {"mean": 25600, "sides_q16": 1, "speed_q16": 0}}, "PRESSED"),
        ({"pressed": {"mean": 25600, "sides_q16": 0, "speed_q16": 1}}, "PRESSED"),
        ({"pressed": {"mean": 0, "sides_q16": 0, "speed_q16": 0}}, "PRESSED"),
        ({"pressed": {"mean": 12799, "sides_q16": 0, "speed_q16": 0}}, "PRESSED"),
        ({"before": {"slope_q20": [0, 0, 0]}}, "BEFORE"),
        (
            {
                "joints": {"axis": [3, 0, 0], "play": [0, 0, 0], "slope": [0, 0, 0]},
                "before": {"slope_q20": [0, 1, 0]},
            },
            "BEFORE",
        ),
        ({"anew": {"rest_us": 0}, "sides": {"side": 1, "step_log2": 4, "late": [0] * 17}}, "ANEW"),
    ],
)
def test_sections_that_say_nonsense_are_refused(section: dict[str, Any], reason: str) -> None:
    fields = _native.FixedTable(tables.encode(model(0.4))).fields
    width, angle, identity = fields.pop("width"), fields.pop("angle"), fields.pop("model_id")
    blob = _native.table_encode(fields, width, angle, identity, sections=section)
    assert _native.table_check(blob)[0] == reason


def test_a_table_says_after_which_rest_its_sides_begin_anew_and_nothing_where_they_do_not() -> None:
    law = {"asymmetry": 0.1, "asymmetry_travel": 0.3}
    bare = model(0.4, SIDES, **law)
    once, anew = (model(0.4, SIDES, **law, asymmetry_renewed=renewed) for renewed in (0.0, 1.0))
    assert not_undone(once) == not_undone(anew) == []
    assert tables_and_sections(anew)[1] == tables_and_sections(once)[1] | {"anew": {"rest_us": 50_000}}
    assert tables.encode(bare, created_s=0) == tables.encode(once, created_s=0)
    assert tables.decode(tables.encode(anew)).sections["anew"] == {"rest_us": 50_000}
    assert tables.model_id(once) != tables.model_id(anew)
    assert tables_and_sections(model(0.4, SIDES, asymmetry=1e-9, asymmetry_travel=0.3, asymmetry_renewed=1.0))[1] == {}


def test_a_table_says_what_is_pressed_and_nothing_where_nothing_is() -> None:
    law, speed = {"asymmetry": 0.1, "asymmetry_travel": 0.3}, {"width_per_speed": 0.05}
    sides, fast = Effect(SIDES, law | {"asymmetry_pressed": 1.5}), Effect(SPEED, speed | {"speed_pressed": 0.25})
    uneven = model(0.4, wave=0.5)
    both = tables_and_sections(replace(uneven, effects=(sides, fast)))[1]
    assert both["pressed"] == {"mean": 400 * 256, "sides_q16": 3 << 15, "speed_q16": 1 << 14}
    assert tables_and_sections(replace(uneven, effects=(fast,)))[1]["pressed"]["sides_q16"] == 0
    assert tables.decode(tables.encode(replace(uneven, effects=(sides, fast)))).sections["pressed"] == both["pressed"]
    bare, alike = (model(0.4, SIDES, **law, **told) for told in ({}, {"asymmetry_pressed": 0.0}))
    assert tables.encode(bare, created_s=0) == tables.encode(alike, created_s=0)
    assert (
        "pressed" not in tables_and_sections(model(0.0, SIDES, **law, asymmetry_pressed=1.0))[1]
    )  # without a width nothing is
    assert tables_and_sections(model(0.4, SIDES, asymmetry=1e-9, asymmetry_travel=0.3, asymmetry_pressed=1.0))[1] == {}


def test_a_table_says_what_moves_the_motor() -> None:
    v = {"c_per_translation": 0.6, "translation_play": 0.2, "c_per_rotation": 0.0}
    joints = {"translation_mm": Joint(2, 0.002), "rotation_deg": Joint(3, 0.01)}
    behind, before = (tables_and_sections(model(0.4, COUPLED, **v, coupled_before=b), joints)[1] for b in (0.0, 1.0))
    assert "before" not in behind and before["joints"] == behind["joints"] | {"slope": [0, 0, 0]}
    assert before["before"] == {"slope_q20": [round(0.6 * 0.002 / GAIN / COUNT * 2**20), 0, 0]}
    falling = model(0.4, COUPLED, **v, coupled_before=1.0)
    falling = replace(falling, c_deg=-falling.c_deg)
    assert tables_and_sections(falling, joints)[1]["before"]["slope_q20"][0] == -before["before"]["slope_q20"][0]


def test_what_is_undone_is_said_of_the_effects() -> None:
    """An effect that becomes a section says so; what the board cannot take away does not."""
    strong = {
        "actuator.encoder_periodic": {"encoder_sin": 0.01, "encoder_period": 0.4},
        "transmission.asymmetric_backlash": {"asymmetry": 0.1, "asymmetry_travel": 0.3},
        "transmission.rate_dependent_backlash": {"width_per_speed": 0.05},
        "transmission.lag": {"lag": 0.05},
        "transmission.creep": {"creep_share": 0.1, "creep_time": 1.0},
        "transmission.load_dependence": {"offset_per_load": 0.01},
        "transmission.smooth_onset": {"onset_spread": 0.3},
    }
    for name, parameters in strong.items():
        own, sections = tables_and_sections(model(0.4, name, **parameters))
        assert BY_ID[name].on_board and (sections or not own.elements.single), name
    for name in ("transmission.stick_slip", "configuration.contact", "configuration.swing", "acquisition.jitter"):
        assert not BY_ID[name].on_board, name
