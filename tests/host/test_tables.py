"""Models as blobs and back, in physical units."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tautline import _native, tables
from tautline.errors import TautError
from tautline.model import Effect, Model
from tautline.rig import Actuator, Coarse, Rig


def model(low: float = -5.0, high: float = 5.0, resolution: float = 0.001, gain: float = 12.0, n: int = 201) -> Model:
    rig = Rig(Actuator("mm", (low, high), resolution), Coarse(gain, 0.5))
    q = np.linspace(low, high, n)
    x = (q - low) / (high - low)
    width = (high - low) * (0.03 + 0.05 * np.exp(-(((x - 0.5) / 0.12) ** 2)))
    c = gain * (q - 0.04 * (high - low) * np.sin(2 * np.pi * x)) + 0.5
    return Model(rig, q, width, np.full(n, 1e-3), c, 0.0815, (low, high))


@given(
    low=st.floats(-3, 2),
    span=st.floats(0.5, 400),
    counts=st.floats(200, 2e5),
    bend=st.floats(10, 400).flatmap(lambda b: st.sampled_from([b, -b])),
)
@settings(max_examples=100)
def test_a_table_says_what_the_model_says(low: float, span: float, counts: float, bend: float) -> None:
    low *= span
    gain = bend / span
    original = model(low, low + span, span / counts, gain)
    count = original.rig.actuator.encoder_resolution
    limits = tables.Limits(2 * span, span, 5 * span, 3 * count, 0.01 * abs(gain), span / 7, 0.75)
    table = tables.decode(tables.encode(original, 2, limits, "rotation", created_s=1_760_000_000), axis=2)
    assert (table.axis, table.kind, table.unit, table.created_s) == (2, "rotation", "mm", 1_760_000_000)
    assert table.encoder_resolution == pytest.approx(count, abs=1e-9)
    scale = table.encoder_resolution / count  # the nano-unit rounds a very fine encoder's step
    assert table.q_range == pytest.approx((low * scale, (low + span) * scale), abs=count)
    assert table.coarse_gain == pytest.approx(gain / scale, rel=1e-3)
    assert table.delay_s == pytest.approx(0.0815, abs=1e-6)
    for name in ("speed_max", "takeup_speed", "takeup_accel", "band", "slope_min", "flat_speed", "strength"):
        assert getattr(table.limits, name) == pytest.approx(getattr(limits, name), rel=2e-2), name
    assert 129 <= len(table.q) <= 257
    assert table.q[0] <= table.q_range[0] + count and table.q[-1] >= table.q_range[1] - count
    inside = table.q / scale <= low + span
    q = table.q[inside] / scale
    assert np.abs(table.width[inside] / scale - np.interp(q, original.q, original.width)).max() <= count
    steepest = np.abs(np.gradient(original.c_deg, original.q)).max()
    assert np.abs(table.c_deg[inside] - np.interp(q, original.q, original.c_deg)).max() <= count * steepest + 1e-4


def test_the_last_node_lies_beyond_the_range_with_the_last_slope() -> None:
    original = model()
    table = tables.decode(tables.encode(original))
    assert table.q[-1] > 5.0
    slope = (original.c_deg[-1] - original.c_deg[-2]) / (original.q[-1] - original.q[-2])
    assert table.c_deg[-1] == pytest.approx(original.c_deg[-1] + slope * (table.q[-1] - 5.0), abs=1e-3)
    assert table.width[-1] == pytest.approx(original.width[-1], abs=1e-3)


def test_a_table_without_nodes_is_the_coarse_kinematics() -> None:
    fields = _native.FixedTable(tables.encode(model(), 1, kind="translation")).fields | {"q0": 0, "step_log2": 0}
    none = np.empty(0, np.int32)
    table = tables.decode(_native.table_encode(fields, none, none, bytes(8)))
    assert len(table.q) == 0 and table.kind == "translation"
    assert (table.coarse_gain, table.coarse_offset) == pytest.approx((12.0, 0.5), abs=1e-4)


def test_a_model_is_known_again_by_its_id() -> None:
    one = model()
    assert tables.decode(tables.encode(one)).model_id == tables.model_id(one)
    assert tables.model_id(one) == tables.model_id(model())
    assert tables.model_id(one) != tables.model_id(replace(one, width=one.width * (1 + 1e-12)))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda m: replace(m, width=m.width - 1.0), "negative"),
        (lambda m: replace(m, width=m.width * 8), "changes by 2 or more"),
        (lambda m: replace(m, c_deg=np.maximum(m.c_deg, 0.0)), "not strictly rising"),
        (lambda m: replace(m, c_deg=-m.c_deg), "check the sign of its gain"),
        (lambda m: replace(m, c_deg=np.where(m.q > 1, np.nan, m.c_deg)), "f_remain"),
        (lambda m: replace(m, delay_s=3.0), "more than 2 s"),
        (lambda m: replace(m, delay_s=float("nan")), "delay_s"),
        (lambda m: replace(m, rig=replace(m.rig, actuator=Actuator("mm", (-5.0, 5.0), 1e-6))), "is -5000000 counts"),
        (lambda m: replace(m, rig=replace(m.rig, actuator=Actuator("mm", (0.0, 2.2), 1e-6))), "is 2200000 counts"),
        (
            lambda m: replace(m, rig=replace(m.rig, actuator=Actuator("mm", (-2.0, 2.0), 2e-6)), width=0 * m.q + 2.2),
            "a width of more than 1048575",
        ),
        (lambda m: replace(m, rig=replace(m.rig, actuator=Actuator("mm", (-5.0, 5.0), 1e4))), "one encoder step"),
    ],
)
def test_a_model_that_no_board_would_take_is_refused_with_the_reason(change, words: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(TautError, match=words):
        tables.encode(change(model()))


def test_a_range_of_a_million_counts_to_both_sides_is_taken() -> None:
    one = model(low=-5.0, high=5.0, resolution=5e-6)
    table = tables.decode(tables.encode(one))
    assert table.q_range == pytest.approx((-5.0, 5.0))
    assert np.interp(one.q, table.q, table.width) == pytest.approx(one.width, abs=5e-3)


def test_flat_spans_are_refused_unless_a_speed_to_cross_them_is_given() -> None:
    one = model()
    dead = np.interp(one.q, [-5.0, -0.5, 0.5, 5.0], [-54.0, -0.05, 0.05, 54.0])  # 0.1 deg/mm near the straight pose
    flat = replace(one, c_deg=dead)
    limits = tables.Limits.of(one.rig)
    with pytest.raises(TautError, match="flatter"):
        tables.encode(flat, limits=replace(limits, flat_speed=0.0))
    assert _native.FixedTable(tables.encode(flat)).has_flat
    assert not _native.FixedTable(tables.encode(one)).has_flat


def test_what_is_not_a_table_is_refused_with_the_reason() -> None:
    blob = tables.encode(model(), axis=1)
    for damaged, words in (
        (b"", "shorter"), (b"x" * 500, "magic"), (blob[:-1], "size"), (blob[:-1] + bytes([blob[-1] ^ 1]), "CRC")
    ):  # fmt: skip
        with pytest.raises(TautError, match=words):
            tables.decode(damaged)
    with pytest.raises(TautError, match="another axis"):
        tables.decode(blob, axis=0)


def test_the_rig_s_instrument_is_in_the_blob(tmp_path: Path) -> None:
    one = model()
    assert tables.decode(tables.encode(one)).instrument == ""
    named = replace(one, rig=replace(one.rig, actuator=replace(one.rig.actuator, instrument="SN-0042")))
    named.save(tmp_path / "model")
    assert tables.decode(tables.encode(Model.load(tmp_path / "model"))).instrument == "SN-0042"
    assert tables.model_id(named) == tables.model_id(one)
    for bad in ("", "SN-004299", "two of", "ä"):
        document = one.rig.to_document()
        document["actuator"]["instrument"] = bad
        with pytest.raises(TautError, match=r"actuator\.instrument is"):
            Rig.from_document(document, "rig.toml")


def test_what_does_not_fit_into_a_blob_is_said() -> None:
    with pytest.raises(TautError, match="serial has 8 characters at most"):
        tables.encode(model(), instrument="SN-1234567")
    with pytest.raises(TautError, match="created_s"):
        tables.encode(model(), created_s=2**32)
    for effect in (
        Effect("transmission.lag", {"lag": 1e6}),
        Effect("transmission.load_dependence", {"width_per_load": 1e4}),
        Effect("transmission.load_dependence", {"offset_per_load": 1e4}),
    ):
        with pytest.raises(TautError, match="too large for the board's numbers"):
            tables.encode(replace(model(), effects=(effect,)))
