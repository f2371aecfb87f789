"""Several plays on the board against float64 evaluation of the same quantised table, and against the model's."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from fixed_reference import COUNT, FIELDS, Reference
from hypothesis import given, settings
from hypothesis import strategies as st

from tautline import _native, tables
from tautline.elements import Elements, Play
from tautline.model import Model
from tautline.rig import Actuator, Coarse, Rig

TOLERANCE = 2 * COUNT
FULL, OFF = _native.MODE_FULL, _native.MODE_OFF
FLAG = _native.COMPENSATOR_FLAGS
FAST = {"speed_max": 4e6, "takeup_speed": 4e6, "takeup_accel": 2e9}  # counts


@dataclass(frozen=True)
class Several:
    """The functions of a table with section 1, from their definitions in tl_table.h; Q8 counts, float64."""

    table: Reference
    centre: np.ndarray  # Y at the nodes, periods
    r: np.ndarray
    w: np.ndarray
    narrow: float

    @classmethod
    def of(cls, blob: bytes) -> Several:
        fields = _native.FixedTable(blob).fields
        plays = fields["plays"]
        p = fields["q0"] + (np.arange(len(fields["width"])) << fields["step_log2"]).astype(float)
        reference = Reference(p, fields["width"].astype(float), fields["angle"].astype(float), fields)
        width = np.array(plays["width_q28"]) / 2.0**28
        weight = np.array(plays["weight_q16"]) / 2.0**16
        return cls(reference, plays["centre"] / 2.0 ** plays["period_log2"], width / 2, weight, float(plays["narrow"]))

    def y(self, p):
        """Beyond the grid with the width held there."""
        p = np.asarray(p, float)
        nodes, width = self.table.p, np.maximum(self.table.width, self.narrow)
        beyond = np.minimum(p - nodes[0], 0) / width[0] + np.maximum(p - nodes[-1], 0) / width[-1]
        return np.interp(p, nodes, self.centre) + beyond

    def p(self, y):
        y = np.asarray(y, float)
        width = np.maximum(self.table.width, self.narrow)
        beyond = np.minimum(y - self.centre[0], 0) * width[0] + np.maximum(y - self.centre[-1], 0) * width[-1]
        return np.interp(y, self.centre, self.table.p) + beyond

    def is_narrow(self, p) -> bool:
        span = int(np.clip(np.searchsorted(self.table.p, p, side="right") - 1, 0, len(self.table.p) - 2))
        return bool((self.table.width[span : span + 2] < self.narrow).all())

    def forward(self, q):
        edges = [self.table.envelope_inverse(q, sign) for sign in (1, -1)]
        x = [self.y(edges[0]) + 0.5, self.y(edges[1]) - 0.5]
        # around the motor at first
        lag = x[0][0] - self.y(q[0])
        z = x[0][0] - np.sign(lag) * np.minimum(gathered(abs(lag), self.r, self.w), self.r)
        single, reached, last = q[0], np.empty(len(q)), q[0]
        for k, here in enumerate(q):
            if here > last:
                z, single = np.maximum(z, x[0][k] - self.r), max(single, edges[0][k])
            elif here < last:
                z, single = np.minimum(z, x[1][k] + self.r), min(single, edges[1][k])
            last = here
            p = float(self.p(self.w @ z))
            reached[k] = single if self.is_narrow(p) else p
        reached[0] = q[0]
        return reached


def gathered(lag, r, w):
    """c with sum w min(c, r) = lag, by bisection."""
    low, high = 0.0, r[-1]
    for _ in range(60):
        c = (low + high) / 2
        low, high = (c, high) if w @ np.minimum(c, r) < lag else (low, c)
    return low


@st.composite
def models(draw, low_width: float = 0.05) -> Model:
    """Widths with a bump, a slope and a wave, any elements, f rising or falling."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    resolution = 10.0 ** draw(st.sampled_from([-4, -3, -2.5]))
    grid = np.linspace(-5, 5, 301)
    mean = draw(st.floats(0.1, 2.0))
    width = mean * (
        1 + rng.uniform(-0.4, 0.4) * np.exp(-((grid - rng.uniform(-3, 3)) ** 2)) + rng.uniform(0, 0.05) * grid
    )
    width += 0.1 * mean * np.sin(grid * rng.uniform(0.3, 1.5))
    n = draw(st.integers(2, 7))
    weight = rng.dirichlet(np.full(n, 2.0)) * (1 - 0.06 * n) + 0.06
    share = np.cumsum(rng.uniform(0.05, 1.0, n)) - 0.05 * rng.integers(0, 2)
    elements = Elements(tuple(share / (weight @ share)), tuple(weight))
    sign = draw(st.sampled_from([1.0, -1.0]))
    rig = Rig(Actuator("mm", (-5.0, 5.0), resolution), Coarse(sign * 12.0, 0.0))
    c_deg = sign * (12 * grid + 2 * np.sin(grid))
    return Model(rig, grid, np.maximum(width, low_width), 0 * grid, c_deg, 0.08, (-4.0, 4.0), elements=elements)


def walk(rng, low, high, turns, samples):
    """Strokes of all lengths."""
    corners = rng.uniform(low, high, turns)
    short = rng.random(turns - 1) < 0.4
    corners[1:][short] = corners[:-1][short] + 0.1 * (high - low) * rng.normal(0, 1, short.sum())
    return np.interp(np.linspace(0, turns - 1, samples), np.arange(turns), np.clip(corners, low, high))


@given(models(), st.integers(0, 2**32 - 1))
@settings(max_examples=60)
def test_forward_stays_within_two_counts_over_any_path(model: Model, seed: int) -> None:
    blob = tables.encode(model)
    several = Several.of(blob)
    q = np.rint(walk(np.random.default_rng(seed), *several.table.q_range, 25, 800))
    p = _native.FixedPlay(_native.FixedTable(blob), int(q[0])).run(q.astype(np.int32))[0]
    assert np.abs(p - several.forward(q)).max() <= TOLERANCE


@given(models(), st.integers(0, 2**32 - 1))
@settings(max_examples=40)
def test_forward_is_the_models_to_two_counts(model: Model, seed: int) -> None:
    """Or, where that is more, to what straight lines between the nodes of the board's grid leave of B and of Y."""
    blob = tables.encode(model)
    low, high = Several.of(blob).table.q_range
    q = np.rint(walk(np.random.default_rng(seed), low, high, 25, 800))
    unit = model.rig.actuator.encoder_resolution / COUNT
    p = _native.FixedPlay(_native.FixedTable(blob), int(q[0])).run(q.astype(np.int32))[0]
    expected = model.play.forward(q * unit) / unit
    step = (1 << _native.FixedTable(blob).fields["step_log2"]) * unit
    slope = np.gradient(model.width, model.q)
    bend = np.abs(np.gradient(slope, model.q)).max() + (np.abs(slope) / model.width).max()  # 1 / unit
    assert np.abs(p - expected).max() <= max(TOLERANCE, step**2 * bend / 4 / unit)


@given(models(), st.integers(0, 2**32 - 1), st.sampled_from([0.3, 0.7, 1.0]))
@settings(max_examples=60)
def test_forward_of_the_inverse_gives_the_command_back(model: Model, seed: int, strength: float) -> None:
    rng = np.random.default_rng(seed)
    count = model.rig.actuator.encoder_resolution
    limits = replace(tables.Limits.of(model.rig), band=0.0, **{name: value * count for name, value in FAST.items()})
    blob = tables.encode(model, limits=limits)
    table, several = _native.FixedTable(blob), Several.of(blob)
    margin = 0.5 * float(model.width.max()) + 0.1
    p = walk(rng, -5 + margin, 5 - margin, 20, 300)
    p[100:110] = p[100]
    c = np.rint(several.table.angle_at(p / model.rig.actuator.encoder_resolution * COUNT))
    start = int(table.angle_inverse(c[:1].astype(np.int32))[0][0])
    hold = 40
    compensator = _native.FixedCompensator(table, 1000, FULL, start, int(c[0]))
    q, wanted, side, flags = compensator.run(np.repeat(c, hold).astype(np.int32))
    assert not np.any(flags[hold - 1 :: hold] & (FLAG["TAKE_UP"] | FLAG["CLIPPED"] | FLAG["LIMITED"]))
    reached = _native.FixedPlay(table, start).run(q)[0]
    assert np.abs(reached - wanted)[hold - 1 :: hold].max() <= TOLERANCE
    assert np.ptp(q[100 * hold + hold : 110 * hold]) == 0
    weaker = _native.FixedCompensator(table, 1000, FULL, start, int(c[0]))
    weaker.set_strength(round(strength * _native.RATIO_ONE))
    part = weaker.run(np.repeat(c, hold).astype(np.int32))[0]
    moved = np.flatnonzero(side[hold - 1 :: hold] != 0)[0] * hold + hold - 1
    offset, whole = (part - wanted)[moved::hold], (q - wanted)[moved::hold]
    assert np.abs(offset - strength * whole).max() <= TOLERANCE


def simple(elements: Elements, **limits: float) -> tuple[Model, bytes]:
    grid = np.linspace(-5, 5, 301)
    rig = Rig(Actuator("mm", (-5.0, 5.0), 0.001), Coarse(12.0, 0.0))
    own = Model(rig, grid, 0.4 + 0.02 * grid, 0 * grid, 12 * grid, 0.08, (-4.0, 4.0), elements=elements)
    return own, tables.encode(own, limits=replace(tables.Limits.of(rig), **limits))


CHANGES = ["go", "mode", "strength", "table", "wait"]
GRADUAL = Elements((0.2, 0.6, 1.0, 1.4, 1.8), (0.2,) * 5)


def test_within_the_band_the_elements_stay() -> None:
    _, blob = simple(GRADUAL, band=0.01)
    table = _native.FixedTable(blob)
    rng = np.random.default_rng(2)
    for share, quiet in ((0.45, True), (3.0, False)):
        compensator = _native.FixedCompensator(table, 1000, FULL, 0, 0)
        compensator.run(np.linspace(0, 12 * 65536, 2000).astype(np.int32))
        compensator.run(np.full(500, 12 * 65536, np.int32))
        jitter = 12 * 65536 * (1 + 0.01 * share * rng.uniform(-1, 1, 2000))
        q, p, side, _ = compensator.run(jitter.astype(np.int32))
        assert (np.ptp(q.astype(float) - p) < 30 * COUNT) == quiet  # the first element's width is 80 counts
        assert (len(set(side)) == 1) == quiet


@given(
    st.lists(st.tuples(st.sampled_from(CHANGES), st.floats(0, 1)), min_size=5, max_size=20),
    st.floats(1.0, 3.0),
    st.integers(0, 2**32 - 1),
)  # fmt: skip
@settings(max_examples=80)
def test_nothing_jumps(ride: list[tuple[str, float]], speed: float, seed: int) -> None:
    """What a tick moves beyond p*'s own way is at most what the take-up may, twice; whatever is switched."""
    rng = np.random.default_rng(seed)
    limits = {"takeup_speed": 10.0**speed, "takeup_accel": 10.0 ** (speed + rng.uniform(0.5, 2.0)), "speed_max": 50.0}
    single = Elements((1.0,), (1.0,))
    kinds = (GRADUAL, Elements((0.0, 2.0), (0.5, 0.5)), single)
    loaded = [_native.FixedTable(simple(elements, **limits)[1]) for elements in kinds]
    rate = 1000
    k = _native.FixedCompensator(loaded[0], rate, FULL, int(rng.integers(-300, 300)) * 256, 0)
    v_max = 2 * 10.0**speed / rate / 0.001 * COUNT + 4
    c = 0.0
    for what, value in ride:
        goal = c
        if what == "go":
            goal = (2 * value - 1) * 40 * 65536
        elif what == "mode":
            k.set_mode(int(3 * value) % 3)
        elif what == "strength":
            k.set_strength(round(value * _native.RATIO_ONE))
        elif what == "table":
            k.set_table(loaded[int(3 * value) % 3])
        q_before, p_before = k.q, k.p
        q, p, _, flags = k.run(np.rint(np.linspace(c, goal, 200)).astype(np.int32))
        c = goal
        moved = np.abs(np.diff(q, prepend=q_before) - np.diff(p, prepend=p_before))
        slack = 0.05 * np.abs(np.diff(p, prepend=p_before))  # of a width that changes on the way
        assert np.all((moved <= v_max + slack) | (flags & FLAG["CLIPPED"] != 0))


@pytest.mark.parametrize("start", [-0.3, -0.1, 0.0, 0.2, 0.5])
def test_it_starts_where_the_motor_is(start: float) -> None:
    own, blob = simple(GRADUAL)
    table = _native.FixedTable(blob)
    compensator = _native.FixedCompensator(table, 1000, FULL, round(start * 256_000), 0)
    q, _, side, _ = compensator.run(np.zeros(3000, np.int32))
    assert side[-1] == 0
    reach = 0.5 * float(np.interp(0.0, own.q, own.width))  # as far as the backlash goes
    assert q[-1] == pytest.approx(np.clip(start, -reach, reach) * 256_000, abs=2 * TOLERANCE)
    up = compensator.run(np.linspace(0, 24 * 65536, 4000).astype(np.int32))
    later = compensator.run(np.full(1000, 24 * 65536, np.int32))
    assert up[2][-1] == 1 and later[0][-1] == pytest.approx((2.0 + 0.5 * 0.44) * 256_000, abs=TOLERANCE)


def test_one_element_is_written_as_before() -> None:
    single, gradual = simple(Elements((1.0,), (1.0,)))[1], simple(GRADUAL)[1]
    assert single[4] == 1 and gradual[4] == 2
    assert _native.FixedTable(single).fields["plays"] is None
    decoded = tables.decode(gradual).elements
    assert decoded.width == pytest.approx(GRADUAL.width, abs=1e-4)
    assert decoded.weight == pytest.approx(GRADUAL.weight, abs=2e-5)
    assert tables.decode(single).elements.single


def test_a_first_element_that_moves_too_little_is_refused() -> None:
    with pytest.raises(Exception, match=r"at least 0\.05"):
        simple(Elements((0.5, 1.0 + 0.5 * 0.02 / 0.98), (0.02, 0.98)))


@given(models(), st.integers(0, 2**32 - 1), st.data())
@settings(max_examples=60)
def test_garbage_in_the_section_never_harms(model: Model, seed: int, data: st.DataObject) -> None:
    rng = np.random.default_rng(seed)
    fields = dict(_native.FixedTable(tables.encode(model)).fields)
    width, angle, model_id, plays = (fields.pop(name) for name in ("width", "angle", "model_id", "plays"))
    what = data.draw(st.sampled_from(["period_log2", "narrow", "width_q28", "weight_q16", "centre"]))
    if what == "centre":
        at = rng.integers(0, len(width), 3)
        plays["centre"] = plays["centre"].copy()
        plays["centre"][at] = rng.integers(-(2**31), 2**31, 3)
    elif what in ("width_q28", "weight_q16"):
        plays[what] = [int(rng.integers(0, 2**32)) if rng.random() < 0.3 else value for value in plays[what]]
    else:
        plays[what] = int(rng.integers(0, 256)) if what == "period_log2" else int(rng.integers(-(2**31), 2**31))
    odd = _native.table_encode(fields, width, angle, model_id, plays=plays)
    if _native.table_check(odd)[0] == "OK":
        anything = rng.integers(-(2**31), 2**31, 300, dtype=np.int32)
        table = _native.FixedTable(odd)
        table.centre(anything), table.centre_inverse(anything)
        _native.FixedPlay(table, int(anything[0])).run(anything)
        _native.FixedCompensator(table, 1000, 2, int(anything[0]), int(anything[1])).run(anything)


def test_any_flipped_bit_is_refused() -> None:
    blob = simple(GRADUAL)[1]
    for bit in [*range(100 * 8), *range(len(blob) * 8 - 1500 * 8, len(blob) * 8 - 1100 * 8), len(blob) * 8 - 1]:
        damaged = bytearray(blob)
        damaged[bit // 8] ^= 1 << bit % 8
        assert _native.table_check(bytes(damaged))[0] != "OK", bit


def test_a_warp_that_does_not_fit_the_width_is_refused() -> None:
    fields = dict(_native.FixedTable(simple(GRADUAL)[1]).fields)
    width, angle, model_id, plays = (fields.pop(name) for name in ("width", "angle", "model_id", "plays"))
    wrong = {**plays, "centre": (plays["centre"] * 0.9).astype(np.int32)}
    assert _native.table_check(_native.table_encode(fields, width, angle, model_id, plays=plays))[0] == "OK"
    assert _native.table_check(_native.table_encode(fields, width, angle, model_id, plays=wrong))[0] == "WARP"


def test_the_reference_is_the_models_play() -> None:
    """What the board is held against, on a table whose grid is fine, is what the model does."""
    _, blob = simple(GRADUAL)
    several = Several.of(blob)
    q = walk(np.random.default_rng(1), -1_200_000, 1_200_000, 20, 500)
    exact = Play(several.table.p, several.table.width, GRADUAL, COUNT).forward(q)
    assert np.abs(several.forward(q) - exact).max() < 0.5 * COUNT
    assert FIELDS["axis"] == several.table.fields["axis"]
