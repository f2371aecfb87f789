"""The board's inverse with take-up: exact once taken up, within its limits on the way, quiet where c* jitters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fixed_reference import COUNT, FIELDS, Reference, tables
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from tautline import _native

OFF, BACKLASH, FULL = _native.MODE_OFF, _native.MODE_BACKLASH, _native.MODE_FULL
FLAG = _native.COMPENSATOR_FLAGS
ONE = _native.RATIO_ONE
TOLERANCE = 2 * COUNT
FAST = {"speed_max_q8": _native.TABLE_VALUE_MAX, "takeup_speed_q8": _native.TABLE_VALUE_MAX, "takeup_accel": 2**31 - 1}


def table_of(reference: Reference, **fields: int) -> _native.FixedTable:
    return _native.FixedTable(replace(reference, fields={**reference.fields, **fields}).blob())


def feed(
    reference: Reference, p: np.ndarray, side: np.ndarray, mode: int, strength: float, start_q: float
) -> np.ndarray:
    """q* without what is still to be taken up, float64; p[0] is where it started."""
    half = (0.0 if mode == OFF else strength) * reference.width_at(p) / 2
    offset = np.where(side == 0, np.clip(start_q - p[0], -half, half), side * half)
    return np.clip(p + offset, *reference.q_range)


def goal(reference: Reference, c: np.ndarray, mode: int) -> np.ndarray:
    p = reference.angle_inverse(c) if mode == FULL else reference.coarse_inverse(c)
    return np.clip(p, *reference.q_range)


def sides(p: np.ndarray, band: float) -> np.ndarray:
    """The side of the backlash after each p, from the definition: it turns once p is back by more than the band."""
    side, anchor, result = 0, p[0], []
    for x in p:
        if abs(x - anchor) > band and np.sign(x - anchor) != side:
            side, anchor = int(np.sign(x - anchor)), x
        elif side * (x - anchor) > 0:
            anchor = x
        result.append(side)
    return np.array(result)


def clear_of_the_band(p: np.ndarray, band: float) -> np.ndarray:
    """Drops commands so close to the band's edge that the last bit decides."""
    kept = [0]
    for i in range(1, len(p)):
        trial = p[[*kept, i]]
        if np.array_equal(sides(trial, band - 4), sides(trial, band + 4)):
            kept.append(i)
    return np.array(kept)


@st.composite
def commands(draw: st.DrawFn, reference: Reference, within: tuple[float, float], beyond: float) -> np.ndarray:
    """c at positions `within`, a share of them beyond the table's range."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    count = 40
    p = rng.uniform(*within, count)
    small = rng.random(count) < 0.3  # small steps on from the one before
    p[1:][small[1:]] = p[:-1][small[1:]] + rng.normal(0, 4 * COUNT, small[1:].sum())
    p = np.clip(p, *within)
    c = np.rint(reference.angle_at(p))
    span = np.ptp(reference.angle)
    c[rng.random(count) < beyond] += rng.choice([-1, 1]) * span  # beyond the range
    return np.clip(c, -(2**31), 2**31 - 1)


@given(st.data(), tables(), st.sampled_from([BACKLASH, FULL, OFF]), st.sampled_from([0.0, 0.25, 0.7, 1.0]))
@settings(max_examples=150)
def test_once_taken_up_the_inverse_is_within_two_counts(
    data: st.DataObject, reference: Reference, mode: int, strength: float
) -> None:
    band = reference.fields["band"]
    c = data.draw(commands(reference, reference.q_range, 0.1))
    c = c[clear_of_the_band(goal(reference, c, mode), band)]
    table = table_of(reference, **FAST)
    compensator = _native.FixedCompensator(table, 50, mode, int(reference.q_range[0]), int(c[0]))
    compensator.set_strength(round(strength * ONE))
    hold = 200
    q, _, _, flags = (x[hold - 1 :: hold] for x in compensator.run(np.repeat(c, hold).astype(np.int32)))
    assert not np.any(flags & (FLAG["TAKE_UP"] | FLAG["LIMITED"]))
    p = goal(reference, c, mode)
    expected = feed(reference, p, sides(p, band), mode, strength, reference.q_range[0])
    assert np.abs(q - expected).max() <= TOLERANCE


@given(st.data(), tables(steepest=1.99))
@settings(max_examples=150)
def test_forward_of_the_inverse_gives_the_command_back(data: st.DataObject, reference: Reference) -> None:
    low, high = reference.q_range
    within = (
        reference.envelope_inverse(np.array([low]), -1)[0] + 2,
        reference.envelope_inverse(np.array([high]), 1)[0] - 2,
    )
    assume(within[0] < within[1])  # else the motor's range is shorter than its backlash
    c = data.draw(commands(reference, within, 0.0))
    p_wanted = goal(reference, c, FULL)
    c = c[(p_wanted >= within[0]) & (p_wanted <= within[1])]
    assume(len(c) > 1)
    table = table_of(reference, band=0, **FAST)
    compensator = _native.FixedCompensator(table, 50, FULL, int(goal(reference, c[:1], FULL)[0]), int(c[0]))
    play = _native.FixedPlay(table, compensator.q)
    hold = 200
    q, p_wanted, _, flags = compensator.run(np.repeat(c, hold).astype(np.int32))
    p, c_reached, _ = play.run(q)
    assert not np.any(flags[hold - 1 :: hold] & (FLAG["TAKE_UP"] | FLAG["CLIPPED"] | FLAG["LIMITED"]))
    assert np.abs(p - p_wanted)[hold - 1 :: hold].max() <= TOLERANCE
    steepest = np.abs(np.diff(reference.angle)).max() / (1 << reference.fields["step_log2"])  # deg Q16 per Q8 count
    assert np.abs(c_reached[hold - 1 :: hold] - c).max() <= TOLERANCE * steepest + 1


def board_feed(
    table: _native.FixedTable, p: np.ndarray, side: np.ndarray, mode: int, strength: float, start_offset: int
) -> np.ndarray:
    """The feed as the board rounds it, so that what is left is take-up to the last bit."""
    half = table.width(p.astype(np.int32))[0].astype(np.int64) * (0 if mode == OFF else round(strength * ONE)) >> 16
    offset = np.where(side == 0, np.clip(start_offset, -half, half), side * half)
    return np.clip(p + offset, table.fields["q_min"], table.fields["q_max"])


@st.composite
def rides(draw: st.DrawFn) -> list[tuple[str, float]]:
    """Motions, pauses and changes of settings in any order."""
    change = st.one_of(
        st.tuples(st.just("mode"), st.sampled_from([OFF, BACKLASH, FULL])),
        st.tuples(st.just("strength"), st.floats(0, 1)),
        st.tuples(st.just("table"), st.just(0)),
        st.tuples(st.just("go"), st.floats(0, 1)),
        st.tuples(st.just("wait"), st.just(0)),
    )
    return draw(st.lists(change, min_size=5, max_size=25))


@given(
    tables(),
    tables(),
    rides(),
    st.sampled_from([1000, 5000, 10000]),
    st.floats(3, 7),
    st.floats(0, 1),
    st.integers(0, 2**32 - 1),
)
@settings(max_examples=150)
def test_no_jump_and_the_take_up_keeps_its_limits_at_every_tick(
    first: Reference, second: Reference, ride: list[tuple[str, float]], rate: int, speed: float, start: float, seed: int
) -> None:
    """All but the feed of the side in force before a tick is take-up: limited in speed and acceleration."""
    rng = np.random.default_rng(seed)
    limits = {"takeup_speed_q8": int(10**speed), "takeup_accel": int(10**speed / COUNT * 10 ** rng.uniform(0.5, 3)) + 1}
    references = [first, second]
    tables_ = [table_of(r, **limits, band=int(rng.integers(0, 2000))) for r in references]
    now, mode, strength = 0, FULL, 1.0
    low, high = first.q_range
    c = int(first.angle_at(np.array(low + rng.random() * (high - low))))
    k = _native.FixedCompensator(tables_[0], rate, mode, int(low + start * (high - low)), c)
    start_offset = k.q - k.p
    v_max = limits["takeup_speed_q8"] / rate + 1  # and the output's last bit
    a_max = limits["takeup_accel"] * COUNT / rate**2 + 2
    q_before, v_before = float(k.q), 0.0
    for what, value in ride:
        reference = references[now]
        commands_ = np.full(60, c)
        if what == "go":
            goal_c = int(reference.angle_at(np.array(low + value * (high - low))))
            commands_ = np.rint(np.linspace(c, goal_c, 60))
        elif what == "mode":
            mode = int(value)
            k.set_mode(mode)
        elif what == "strength":
            strength = round(value * ONE) / ONE
            k.set_strength(round(value * ONE))
        elif what == "table":
            now = 1 - now
            reference = references[now]
            k.set_table(tables_[now])
            low, high = reference.q_range
        assert k.q == q_before
        p_last, side_last = k.p, k.side
        q, p, side, flags = k.run(commands_.astype(np.int32))
        c = int(commands_[-1])
        sides_before = np.concatenate([[side_last], side[:-1]])
        p_before = np.concatenate([[p_last], p[:-1]])
        fed, fed_before = (
            board_feed(tables_[now], x, sides_before, mode, strength, start_offset) for x in (p, p_before)
        )
        moved = np.diff(q, prepend=q_before) - (fed - fed_before)
        free = flags & FLAG["CLIPPED"] == 0
        assert np.abs(moved[free]).max(initial=0) <= v_max
        accelerated = np.abs(np.diff(moved, prepend=v_before))
        free &= np.concatenate([[free[0]], free[:-1]])
        assert accelerated[1:][free[1:]].max(initial=0) <= a_max
        q_before, v_before = float(q[-1]), float(moved[-1])


def simple(**fields: int) -> Reference:
    """10 mm at 1 um per count, B = 300 counts, f = 12 deg/mm."""
    step, nodes = 1 << 14, 158
    p = -1_290_000 + step * np.arange(nodes, dtype=float)
    angle = np.rint(p / COUNT * 0.012 * _native.DEG_ONE)
    base = {
        "step_log2": 14, "q0": int(p[0]), "q_min": -1_280_000, "q_max": 1_280_000,
        "coarse_c_min": int(-1_280_000 / COUNT * 0.012 * 65536), "coarse_c_max": int(1_280_000 / COUNT * 0.012 * 65536),
    }  # fmt: skip
    return Reference(p, np.full(nodes, 300 * COUNT), angle, {**FIELDS, **base, **fields})


@pytest.mark.parametrize("band_counts", [0.5, 2.0, 20.0])
def test_a_command_that_jitters_within_the_band_never_crosses_the_backlash(band_counts: float) -> None:
    reference = simple(band=int(band_counts * COUNT))
    rng = np.random.default_rng(5)
    t = np.arange(20_000)
    p = 1000 * COUNT * np.sin(2 * np.pi * t / 10_000) ** 3
    for share, turns in ((0.45, 3), (3.0, 100)):  # peak to peak 0.9 of the band; far more than the band
        jitter = rng.uniform(-share, share, len(t)) * band_counts * COUNT
        c = reference.angle_at(p + jitter)
        k = _native.FixedCompensator(table_of(reference), 5000, FULL, 0, 0)
        side = k.run(np.rint(c).astype(np.int32))[2]
        changes = np.count_nonzero(np.diff(side[np.flatnonzero(side)[0] :]))
        assert changes == 4 if turns == 3 else changes > turns


def test_the_take_up_takes_no_longer_than_its_limits_ask() -> None:
    speed, accel, rate = 2000, 20_000, 5000  # counts/s, counts/s^2
    reference = simple(takeup_speed_q8=speed * 256, takeup_accel=accel)
    k = _native.FixedCompensator(table_of(reference), rate, FULL, 0, 0)
    k.run(np.linspace(0, reference.angle_at(np.array(50_000.0)), 2000).astype(np.int32))
    k.run(np.full(2000, reference.angle_at(np.array(50_000.0)), np.int32))
    assert k.rest == 0
    flags = k.run(np.full(3000, reference.angle_at(np.array(40_000.0)), np.int32))[3]
    ticks = np.count_nonzero(flags & FLAG["TAKE_UP"])
    ideal = (300 / speed + speed / accel) * rate
    assert ideal - 2 <= ticks <= ideal + 4


@given(
    st.floats(0.5, 400).map(lambda width: int(width * COUNT)),
    st.integers(10, 20_000),
    st.floats(0.3, 3.0),
    st.sampled_from([1000, 5000, 10000]),
)
@settings(max_examples=100)
def test_the_take_up_arrives_without_turning_back(width: int, speed: int, ramp: float, rate: int) -> None:
    reference = replace(
        simple(takeup_speed_q8=speed * 256, takeup_accel=int(speed * 10**ramp)), width=np.full(158, width)
    )
    k = _native.FixedCompensator(table_of(reference), rate, FULL, 0, 0)
    turn, back = (np.int32(reference.angle_at(np.array(p))) for p in (50_000.0, 49_000.0))
    ticks = int(2 * rate * (width / COUNT / speed + 10**-ramp)) + 400
    k.run(np.linspace(0, turn, 500).astype(np.int32))
    k.run(np.full(ticks, turn))
    q, _, _, flags = k.run(np.full(ticks, back))
    assert np.all(np.diff(q) <= 0)
    assert k.rest == 0 and not flags[-1] & FLAG["TAKE_UP"]


def test_a_slow_feed_is_exact_over_time() -> None:
    """0.1 count/s at 10 kHz: 0.0026 of the last bit a tick."""
    steep = simple(flat_speed_q8=26, slope_min_q28=int(0.02 * 2**28))  # f is flat everywhere by this measure
    k = _native.FixedCompensator(table_of(steep), 10_000, FULL, 0, 0)
    assert table_of(steep).has_flat
    p, flags = k.run(np.full(300_000, 65536, np.int32))[1::2]
    assert np.all(flags & FLAG["FLAT"]) and np.all(flags & FLAG["LIMITED"])
    assert abs(int(p[-1]) - 26 * 30) <= 1
    assert np.abs(np.diff(p)).max() == 1


@given(tables(), st.integers(0, 2**32 - 1), st.floats(2, 5))
@settings(max_examples=80)
def test_flat_spans_are_crossed_at_the_flat_speed_and_only_those(reference: Reference, seed: int, speed: float) -> None:
    rate, step = 1000, 1 << reference.fields["step_log2"]
    slopes = np.abs(np.diff(reference.angle)) * 2**20 / step  # deg/count Q28
    least = int(min(np.median(slopes), 2**31 - 1))
    flat_speed = int(10**speed)
    table = table_of(reference, slope_min_q28=least, flat_speed_q8=flat_speed)
    flat = np.concatenate([slopes < least, [False]])
    rng = np.random.default_rng(seed)
    low, high = reference.q_range
    at = rng.uniform(low, high, 6)
    k = _native.FixedCompensator(table, rate, FULL, int(at[0]), int(reference.angle_at(at[:1])[0]))
    for goal_p in at[1:]:
        before = k.p
        p = k.run(np.full(2000, np.rint(reference.angle_at(np.array(goal_p))), np.int32))[1]
        moved = np.diff(p, prepend=before)
        start = np.concatenate([[before], p[:-1]])
        middle = (start + p) / 2
        span = np.clip((middle - reference.p[0]) // step, 0, len(flat) - 1).astype(int)
        in_flat = flat[span] & (moved != 0)
        assert np.abs(moved[in_flat]).max(initial=0) <= flat_speed / rate + 1
        assert np.all(np.abs(moved) <= step) or not flat.any()
