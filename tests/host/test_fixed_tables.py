"""The board's look-ups, inverses and play against float64 evaluation of the same quantised table."""

from __future__ import annotations

import numpy as np
from fixed_reference import COUNT, VALUE_MAX, Reference, positions, tables
from hypothesis import given, settings
from hypothesis import strategies as st

from tautline import _native

TOLERANCE = 2 * COUNT  # two encoder counts


def raw(x: np.ndarray) -> np.ndarray:
    return np.rint(x).astype(np.int32)


@given(st.data(), tables())
@settings(max_examples=200)
def test_lookups_and_inverses_stay_within_two_counts(data: st.DataObject, reference: Reference) -> None:
    table = _native.FixedTable(reference.blob())
    q = positions(data.draw, reference, 400)

    assert np.abs(table.width(raw(q))[0] - reference.width_at(q)).max() <= TOLERANCE

    # c is held to what two counts of p make of it, and to its own last bit.
    one, other = reference.angle_at(q - TOLERANCE), reference.angle_at(q + TOLERANCE)
    angle = table.angle(raw(q))[0]
    assert np.all(angle >= np.minimum(one, other) - 1)
    assert np.all(angle <= np.maximum(one, other) + 1)

    for name, sign in (("p_low", 1), ("p_high", -1)):
        p = getattr(table, name)(raw(q))[0]
        error = np.abs(p - reference.envelope_inverse(q, sign))
        assert error[np.abs(q) <= VALUE_MAX].max() <= TOLERANCE, name

    c = np.rint(np.concatenate([reference.angle_at(q), data.draw(angles(reference))]))
    assert np.abs(table.angle_inverse(raw(c))[0] - reference.angle_inverse(c)).max() <= TOLERANCE

    p = reference.coarse_inverse(c)
    assert np.abs(table.coarse_inverse(raw(c))[0] - p).max() <= TOLERANCE
    assert np.abs(table.coarse(raw(q))[0] - reference.coarse_at(q)).max() <= 2  # deg Q16


@st.composite
def angles(draw: st.DrawFn, reference: Reference) -> np.ndarray:
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    span = reference.angle.max() - reference.angle.min()
    return rng.uniform(reference.angle.min() - 0.2 * span, reference.angle.max() + 0.2 * span, 200)


@given(st.data(), tables())
@settings(max_examples=100)
def test_flags_say_which_end_was_passed(data: st.DataObject, reference: Reference) -> None:
    table = _native.FixedTable(reference.blob())
    q = positions(data.draw, reference, 200)
    below, above = q < reference.p[0], q > reference.p[-1]
    for lookup in (table.width, table.angle):
        assert np.array_equal(lookup(raw(q))[1], below + 2 * above)
    for name, sign in (("p_low", 1), ("p_high", -1)):
        phi = 2 * reference.p + sign * reference.width
        expected = (2 * q < phi[0]) + 2 * (2 * q > phi[-1])
        assert np.array_equal(getattr(table, name)(raw(q))[1], expected), name
    c = np.rint(data.draw(angles(reference)))
    upper, lower = c > reference.angle.max(), c < reference.angle.min()
    below, above = (lower, upper) if reference.angle[-1] > reference.angle[0] else (upper, lower)
    assert np.array_equal(table.angle_inverse(raw(c))[1], below + 2 * above)


@given(st.data(), tables())
@settings(max_examples=150)
def test_forward_stays_within_two_counts_over_any_path(data: st.DataObject, reference: Reference) -> None:
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    q = path(rng, reference, 600)
    play = _native.FixedPlay(_native.FixedTable(reference.blob()), int(q[0]))
    p, c, _ = play.run(raw(q))
    expected = reference.play(q, float(q[0]))
    assert np.abs(p - expected).max() <= TOLERANCE
    one, other = reference.angle_at(expected - TOLERANCE), reference.angle_at(expected + TOLERANCE)
    assert np.all((c >= np.minimum(one, other) - 1) & (c <= np.maximum(one, other) + 1))


@given(tables(steepest=1.99), st.integers(0, 2**32 - 1))
@settings(max_examples=100)
def test_a_turn_just_past_the_backlash_moves_the_instrument(reference: Reference, seed: int) -> None:
    """To the last bits of q: where |B'| is nearly 2, each is up to 200 of p."""
    rng = np.random.default_rng(seed)
    table = _native.FixedTable(reference.blob())
    last_bits = 1.5 + 2.0 ** (reference.fields["step_log2"] - 19)  # a lookup's own error
    for q in rng.uniform(reference.p[0], reference.p[-1], 20).round():
        for side in (1, -1):
            play = _native.FixedPlay(table, int(q - side * reference.width.max()))
            p = float(play.run(raw([q]))[0][0])
            back = np.floor(p - side * reference.width_at(np.array([p]))[0] / 2) - side * np.arange(1, 16)
            back = back[np.abs(back) < VALUE_MAX]
            reached = play.run(raw(back))[0]
            expected = reference.envelope_inverse(back, -side)
            moved = side * (expected - p) < 0
            assert np.all(np.abs(reached - expected)[moved] <= last_bits)


def path(rng: np.random.Generator, reference: Reference, count: int) -> np.ndarray:
    """Strokes of every length with pauses, over the grid and beyond it."""
    first, last = reference.p[0] - reference.width[0], reference.p[-1] + reference.width[-1]
    turns = rng.uniform(first, last, count // 20)
    turns[1::3] = turns[::3][: len(turns[1::3])] + rng.normal(0, reference.width.max() + 1, len(turns[1::3]))
    q = np.interp(np.arange(count), np.linspace(0, count, len(turns)), turns)
    q[rng.integers(0, count, count // 10)] = np.nan
    held = np.maximum.accumulate(np.where(np.isnan(q), 0, np.arange(count)))
    q[0] = turns[0]
    return np.clip(np.rint(q[held]), -VALUE_MAX, VALUE_MAX)


@given(tables())
@settings(max_examples=100)
def test_a_blob_gives_back_what_it_was_made_of(reference: Reference) -> None:
    blob = reference.blob()
    assert _native.table_check(blob)[0] == "OK"
    fields = _native.FixedTable(blob).fields
    width, angle, model_id = fields.pop("width"), fields.pop("angle"), fields.pop("model_id")
    assert fields.pop("plays") is None and fields.pop("sections") == {} and fields.pop("instrument") == ""
    assert np.array_equal(width, reference.width) and np.array_equal(angle, reference.angle)
    assert fields == reference.fields
    assert _native.table_encode(fields, width, angle, model_id) == blob


@given(tables(), st.data())
@settings(max_examples=50)
def test_any_flipped_bit_is_refused(reference: Reference, data: st.DataObject) -> None:
    blob = reference.blob()
    for bit in [*range(96 * 8), *data.draw(st.lists(st.integers(0, len(blob) * 8 - 1), max_size=50))]:
        damaged = bytearray(blob)
        damaged[bit // 8] ^= 1 << bit % 8
        assert _native.table_check(bytes(damaged))[0] != "OK", bit


@given(tables(), st.integers(0, 2**32 - 1), st.integers(1, 40), st.data())
@settings(max_examples=150)
def test_garbage_never_passes_for_a_table(reference: Reference, seed: int, changes: int, data: st.DataObject) -> None:
    """Random bytes, truncated and lengthened blobs; random content behind a right CRC never crashes a look-up."""
    rng = np.random.default_rng(seed)
    blob = reference.blob()
    assert _native.table_check(rng.bytes(data.draw(st.integers(0, 4096))))[0] != "OK"
    assert _native.table_check(blob[: data.draw(st.integers(0, len(blob) - 1))])[0] != "OK"
    assert _native.table_check(blob + rng.bytes(changes))[0] != "OK"

    fields = dict(reference.fields)
    name = data.draw(st.sampled_from(sorted(fields)))
    sizes = {"axis": 255, "kind": 255, "unit": 255, "step_log2": 255, "strength_q15": 65535}
    unsigned = sizes.get(name, 2**32 - 1 if name in ("nano_units_per_count", "delay_us", "created_s") else None)
    fields[name] = data.draw(st.integers(0, unsigned) if unsigned else st.integers(-(2**31), 2**31 - 1))
    width, angle = raw(reference.width), raw(reference.angle)
    if data.draw(st.booleans()):
        width[rng.integers(0, len(width), changes)] = rng.integers(-(2**31), 2**31, changes, dtype=np.int32)
        angle[rng.integers(0, len(angle), changes)] = rng.integers(-(2**31), 2**31, changes, dtype=np.int32)
    odd = _native.table_encode(fields, width, angle, bytes(8))
    if _native.table_check(odd)[0] == "OK":
        table = _native.FixedTable(odd)
        anything = rng.integers(-(2**31), 2**31, 500, dtype=np.int32)
        for name in ("width", "angle", "angle_inverse", "p_low", "p_high", "coarse", "coarse_inverse"):
            getattr(table, name)(anything)
        _native.FixedPlay(table, int(anything[0])).run(anything)
        _native.FixedCompensator(table, 1000, 2, int(anything[0]), int(anything[1])).run(anything)
