"""Calibrated from use alone: what B is known by, what is not measured and why, and the motion that measures it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from cli_runner import Taut
from hypothesis import given
from hypothesis import strategies as st

from tautline.calibration.calibrate import calibrate
from tautline.calibration.coverage import HOLE, Gap, gaps
from tautline.live.closing import SECONDS, closing
from tautline.model import Model
from tautline.recording import Marker, Motor, Recording, read_motor
from tautline.reports import pages
from tautline.simulated.instrument import preset, reference_rig
from tautline.simulated.simulate import run, simulate
from tautline.trajectory import Trajectory, through
from tools.from_use import Used, calibration_motion, teleoperation

RIG = reference_rig()
LOW, HIGH = RIG.actuator.range
WIDTH = 0.4


def model(measured: tuple[float, float] = (LOW, HIGH), width: float = WIDTH) -> Model:
    q = np.linspace(LOW, HIGH, 513)
    return Model(RIG, q, np.full_like(q, width), np.full_like(q, 1e-3), 12.0 * q, 0.08, measured)


def apart(*spans: tuple[float, float]) -> np.ndarray:
    """How far the next frame is where the tip passed both ways within `spans`, without holes."""
    q = np.linspace(LOW, HIGH, 513)
    return np.min([np.maximum(np.maximum(low - q, q - high), 0.0) for low, high in spans], axis=0)


def use(speed: float, seconds: float = 10.0, rate_hz: float = 25.0) -> Recording:
    """Of a motor that goes up and down at `speed`."""
    t = np.arange(0.0, seconds, 1e-3)
    arrived = np.arange(0.0, seconds, 1.0 / rate_hz)
    seen = Marker(arrived, 0 * arrived, 0 * arrived, np.ones(len(arrived), bool))
    return Recording("use", Motor(t, speed * np.abs((t % 2.0) - 1.0)), seen)


@pytest.fixture(scope="module")
def used() -> Used:
    return Used.of(101, 90.0)


def test_b_is_known_from_use_and_the_rest_is_said(used: Used) -> None:
    print(used.score, used.found.gaps)
    assert used.found.model.quality.verdict.value == "good"
    assert used.score.z < 1.5 and used.score.both >= 0.6
    # The generator leaves at least 15 % of the range unvisited; what is said to be missing is that, to a hole's size.
    low, high = used.passed
    slack = HOLE * RIG.actuator.span
    assert used.found.gaps
    for gap in used.found.gaps:
        assert gap.high < low + slack or gap.low > high - slack
        assert f"{gap.says('mm')}, and is held there" in used.found.notes


def test_the_proposed_motion_closes_it(used: Used) -> None:
    assert used.closed is not None
    assert used.closed.gaps == ()
    assert used.closing_s <= SECONDS
    reached = (used.closed.model.q >= used.closed.model.measured[0]) & (
        used.closed.model.q <= used.closed.model.measured[1]
    )
    q = used.closed.model.q[reached]
    off = used.closed.model.width[reached] - preset("random", RIG, 101).backlash(q)
    assert np.sqrt(np.mean((off / used.closed.model.width_sigma[reached]) ** 2)) < 1.5


def test_a_gap_at_the_low_end_is_turned_at_and_closed() -> None:
    """A pass up and down turns at its top alone."""
    instrument = preset("constant", RIG)
    points = [-1.0, 5.0, 0.5, 4.0, 1.5, 5.0, 3.0, 4.8, -1.5, 1.0, -1.5, 2.5, 0.0, 5.0, -1.5, 3.0]
    led = through(points, 3.0, 30.0, 0.2)
    recorded = simulate(RIG, instrument, led, seed=6, name="use")
    found = calibrate([recorded], RIG)
    assert [gap.low for gap in found.gaps] == [LOW]
    plan = closing(found.model, found.gaps, [recorded])
    assert plan is not None and plan.duration_s <= SECONDS
    further = simulate(RIG, instrument, plan, seed=7, name="proposed")
    assert calibrate([recorded, further], RIG).gaps == ()


@given(
    edges=st.lists(st.floats(LOW, HIGH), min_size=2, max_size=6, unique=True),
    measured=st.tuples(st.floats(LOW, 0.0), st.floats(0.0, HIGH)),
)
def test_a_place_is_measured_or_in_a_gap(edges: list[float], measured: tuple[float, float]) -> None:
    """By the definition: where B can be seen, a place lies in no gap exactly where it was passed both ways, to a hole's
    size, between the first turn and the last."""
    ordered = sorted(edges)
    spans = list(zip(ordered[::2], ordered[1::2], strict=False))
    found = gaps(model(measured), apart(*spans))
    slack, free = HOLE * RIG.actuator.span, 0.05 * RIG.actuator.span + WIDTH / 2
    for p in np.linspace(LOW, HIGH, 513)[::7]:
        if not LOW + free <= p <= HIGH - free:
            continue
        passed = any(low - slack <= p <= high + slack for low, high in spans)
        inside = [gap for gap in found if gap.low <= p <= gap.high]
        assert len(inside) == (not (passed and measured[0] <= p <= measured[1]))
        assert not inside or passed or inside[0].why == "never passed both ways"


def test_where_nothing_is_measured_there_is_one_gap() -> None:
    """The middle of the range stands for no place at all then, and is one of the grid's."""
    middle = 0.5 * (LOW + HIGH)
    (gap,) = gaps(model((middle, middle)), apart((LOW, HIGH)))
    assert (gap.low, gap.high) == (LOW, HIGH)


@pytest.mark.parametrize("nodes", [201, 401, 513, 1001])
def test_a_gap_reaches_the_end_of_the_range_also_where_a_node_is_where_seeing_ends(nodes: int) -> None:
    """B can be seen up to 4.3 mm, which is a node of three of these grids, but for rounding."""
    q = np.linspace(LOW, HIGH, nodes)
    half = Model(RIG, q, np.full_like(q, WIDTH), np.full_like(q, 1e-3), 12.0 * q, 0.08, (-2.0, 2.0))
    assert [(gap.low, gap.high) for gap in gaps(half, None)] == [
        (LOW, pytest.approx(-2.0, abs=0.06)), (pytest.approx(2.0, abs=0.06), HIGH)
    ]  # fmt: skip


def test_a_hole_between_two_places_and_a_missing_turn_are_told_apart() -> None:
    hole, end = gaps(model((-4.8, 2.0)), apart((-4.8, -1.0), (1.0, 4.8)))
    assert hole.low == pytest.approx(-0.7, abs=0.03) and hole.high == pytest.approx(0.7, abs=0.03)
    assert hole.says("mm") == f"B is not measured from {hole.low:.3g} to {hole.high:.3g} mm: never passed both ways"
    assert (end.low, end.high) == (pytest.approx(2.0, abs=0.03), HIGH)
    assert end.why == "passed both ways, but no turn there gave a width"


@given(
    low=st.floats(LOW, HIGH - 0.6), length=st.floats(0.6, HIGH - LOW), width=st.floats(0.01, 1.2),
    speed=st.floats(2.0, 40.0),
)  # fmt: skip
def test_the_proposed_motion_crosses_the_gap_both_ways(low: float, length: float, width: float, speed: float) -> None:
    gap = Gap(low, min(low + length, HIGH), "")
    plan = closing(model(width=width), [gap], [use(speed)])
    assert plan is not None
    q, quick = plan.q, np.abs(np.diff(plan.q)).max() * 1e3
    assert q.min() >= LOW - 1e-9 and q.max() <= HIGH + 1e-9
    assert quick <= speed * (1 + 1e-6)
    # Its play's centre comes through all of it that can be seen, up and down; to what it goes from sample to sample.
    path = centre(plan, width)
    way, step = np.diff(path), 2 * float(np.abs(np.diff(path)).max())
    first, last = max(gap.low, LOW + width / 2), min(gap.high, HIGH - width / 2)
    for sign in (1.0, -1.0):
        moving = path[1:][sign * way > 1e-9]
        assert moving.min() <= first + step and moving.max() >= last - step


def centre(plan: Trajectory, width: float) -> np.ndarray:
    """The centre of a play of constant width that is driven along `plan`."""
    p, out = plan.q[0], []
    for q in plan.q[::5]:
        p = min(max(p, q - width / 2), q + width / 2)
        out.append(p)
    return np.array(out)


def test_all_gaps_are_gone_through_without_a_jump() -> None:
    missing = [Gap(LOW, -3.0, ""), Gap(-0.5, 0.5, ""), Gap(3.5, HIGH, "")]
    plan = closing(model(), missing, [use(10.0)])
    assert plan is not None and plan.duration_s <= SECONDS
    assert np.abs(np.diff(plan.q)).max() * 1e3 <= 10.0
    assert (plan.q.min(), plan.q.max()) == (pytest.approx(LOW), pytest.approx(HIGH))


def test_the_command_writes_the_motion_and_takes_it_away(taut: Taut, tmp_path: Path) -> None:
    led, out = tmp_path / "use", tmp_path / "model"
    run(RIG, preset("constant", RIG), teleoperation(RIG.actuator, 30.0, 102), seed=5).save(led)
    done = taut("calibrate", led, "--out", out, "--json")
    assert done.code == 0
    told = json.loads(done.out)
    assert told["coverage"]["missing"] and told["next_motion"]["file"] == str(out / "next_motion.csv")
    proposed = read_motor(out / "next_motion.csv", RIG)
    assert list(pd.read_csv(out / "next_motion.csv").columns) == ["t_s", "q_mm"]
    assert proposed.t_s[-1] == pytest.approx(told["next_motion"]["seconds"], abs=0.01)
    for gap in told["coverage"]["missing"]:
        assert gap["says"] in (out / "report.html").read_text(encoding="utf-8")
    pages.save_model(Model.load(out), [], out)  # another model in its place
    assert not (out / "next_motion.csv").exists()


def test_a_calibration_motion_leaves_nothing_to_close() -> None:
    recorded = simulate(RIG, preset("constant", RIG), calibration_motion(RIG.actuator), seed=5)
    found = calibrate([recorded], RIG)
    assert found.gaps == () and found.to_json()["coverage"] == {"missing": []}
    assert closing(found.model, found.gaps, [recorded]) is None


def test_teleoperation_stays_in_its_part_of_the_range() -> None:
    for seed in range(5):
        led = teleoperation(replace(RIG.actuator, range=(-2.0, 6.0)), 60.0, seed)
        assert led.duration_s == pytest.approx(60.0, abs=0.01)
        assert led.q.min() >= -2.0 and led.q.max() <= 6.0 and np.ptp(led.q) <= 0.85 * 8.0
