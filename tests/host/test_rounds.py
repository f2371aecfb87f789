"""Which motion a live calibration runs next, when it has seen enough, why it never will, and how that looks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import click
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tautline.calibration.calibrate import calibrate
from tautline.calibration.coverage import HOLE, gaps
from tautline.calibration.onset import Delay
from tautline.calibration.result import Calibration
from tautline.cli._live import sigma_of
from tautline.cli._picture import calibration_picture, picture, standing_line
from tautline.errors import TautError
from tautline.live.rounds import (
    FEWEST,
    CameraView,
    Means,
    Place,
    Round,
    Standing,
    Strokes,
    default_until,
    first_round,
    in_words,
    next_round,
    no_longer_reached,
    slower_pass_tells,
    why_another,
    why_not,
)
from tautline.live.session import MotionOptions, thorough_round
from tautline.live.setup import Frame
from tautline.live.until import Goal, _make_rounds, _means
from tautline.live.watch import BINS, View, Watch
from tautline.model import Model
from tautline.quality import Quality, Reason
from tautline.rig import Actuator
from tautline.simulated.instrument import preset, reference_rig
from tautline.simulated.simulate import simulate
from tautline.trajectory import through
from tautline.vision.marker import Sighting

UNTIL = 3e-3
MEANS = Means.of(-5.0, 5.0, 25.0, 16.0, 200.0)
CLEAR = CameraView(0.05, (0.0, 0.0))


def found(
    sigma: np.ndarray, measured: tuple[float, float] = (-4.8, 4.8), reasons: tuple[Reason, ...] = ()
) -> Calibration:
    """A calibration of a constant backlash of 0.4 mm whose sigma is given on a grid of 201 positions."""
    q = np.linspace(-5.0, 5.0, 201)
    model = Model(reference_rig(), q, np.full_like(q, 0.4), np.broadcast_to(sigma, q.shape), 12 * q, 0.08, measured)
    model = replace(model, quality=Quality(reasons))
    found = Calibration(model, (), Delay(0.08, 1e-4, 10), "onsets", None, None, None, {}, ())
    return replace(found, gaps=gaps(model, None))


def sigma_with(*bad: tuple[float, float, float]) -> np.ndarray:
    """1 um, but sigma where low <= q <= high."""
    q = np.linspace(-5.0, 5.0, 201)
    sigma = np.full_like(q, 1e-3)
    for low, high, value in bad:
        sigma[(q >= low - 1e-9) & (q <= high + 1e-9)] = value
    return sigma


def of(calibration: Calibration, until: float = UNTIL) -> Standing:
    return Standing.of(calibration, -5.0, 5.0, until)


def test_reached_means_everywhere_that_can_be_seen() -> None:
    assert of(found(sigma_with())).reached(UNTIL)
    spot = of(found(sigma_with((2.0, 2.0, 4e-3))))
    assert not spot.reached(UNTIL) and spot.worst == 4e-3 and spot.where == pytest.approx(2.0)
    # Beyond what was measured sigma says nothing; what is not measured and could be counts.
    assert of(found(sigma_with((4.9, 5.0, 1.0)))).reached(UNTIL)
    low_end, high_end = (-5.0, -3.05), (3.05, 5.0)  # to the first node beyond the turns
    for measured, missing in (
        ((-4.8, 3.0), [high_end]), ((-3.0, 4.8), [low_end]), ((-3.0, 3.0), [low_end, high_end])
    ):  # fmt: skip
        part = of(found(sigma_with(), measured))
        assert [(gap.low, gap.high) for gap in part.missing] == [pytest.approx(span) for span in missing]
        assert not part.covered and not part.reached(UNTIL)
    nothing = of(found(sigma_with(), (0.0, 0.0)))
    assert not np.isfinite(nothing.worst) and not nothing.reached(UNTIL) and nothing.share(UNTIL) == 0.0
    unknown = of(found(sigma_with((1.0, 1.0, np.nan))))
    assert not unknown.reached(UNTIL) and unknown.where == pytest.approx(1.0)


def test_a_middle_that_no_frame_saw_on_the_way_up_is_not_reached() -> None:
    """Both ends are measured, and a smooth B is told across the hole to less than the goal."""
    rig, low, high = reference_rig(), -0.8, 0.8
    points = [*(-5.0, 5.0) * 4, 2.5, 5.0, 2.5, -2.5, -5.0, -2.5, -5.0]
    made = simulate(rig, preset("constant", rig), through(points, 5.0, 100.0, 0.2), seed=4, name="rounds")
    marker = made.marker
    assert marker is not None
    t_s, motor = marker.t_s - rig.delay_s, made.motor
    q, before = np.interp(t_s, motor.t_s, motor.q), np.interp(t_s - 0.02, motor.t_s, motor.q)
    hidden = (q > before) & (q > low) & (q < high)
    seen = of(calibrate([made], rig), until=0.1)
    holed = replace(made, marker=replace(marker, valid=marker.valid & ~hidden))
    standing = of(calibrate([holed], rig), until=0.1)
    assert seen.reached(0.1) and standing.worst < 0.1 and not standing.reached(0.1)
    (gap,) = standing.missing
    slack = HOLE * rig.actuator.span + 0.2  # half of B: the tip is so far behind
    assert low - slack < gap.low < gap.high < high + slack
    asked = next_round(MEANS, standing, 0.1, [first_round(MEANS), Strokes((), 5.6)], 20.0)
    assert isinstance(asked, Round) and (asked.low, asked.high) == (-5.0, 5.0)


def test_the_first_round_is_fast_and_all_of_the_range() -> None:
    wanted = first_round(MEANS)
    assert (wanted.low, wanted.high) == (-5.0, 5.0)
    assert wanted.speeds == (pytest.approx(5.6),)  # facts: 12 reversals at 5.6 mm/s, above 8 too few frames a knot
    assert 4 * wanted.cycles + 2 >= 12
    assert wanted.high - wanted.low > 2 * wanted.stroke and wanted.transit**2 / wanted.acceleration < 2 * wanted.stroke


@pytest.mark.parametrize(
    ("frame_rate", "top", "fastest"),
    [(25.0, 16.0, 5.6), (10.0, 16.0, 2.24), (100.0, 100.0, 5.6), (25.0, 4.0, 1.6)],
)
def test_speed_keeps_to_the_camera_the_range_and_the_axis(frame_rate: float, top: float, fastest: float) -> None:
    means = Means.of(-5.0, 5.0, frame_rate, top, 1e4)
    assert means.speeds[0] == pytest.approx(fastest) and max(means.speeds) == means.speeds[0]
    slow_axis = Means.of(-5.0, 5.0, 25.0, 16.0, 20.0)
    assert slow_axis.acceleration <= 20.0
    assert Means.of(-5.0, 5.0, 25.0, 16.0, 200.0, (1.0, 2.0)).speeds == (1.0, 2.0)


def test_the_second_round_strokes_both_ends_and_what_is_worst() -> None:
    wanted = next_round(MEANS, of(found(sigma_with((1.0, 1.2, 6e-3)))), UNTIL, [first_round(MEANS)], 16.0)
    assert isinstance(wanted, Strokes)
    low, middle, high = wanted.places
    assert low.low == -5.0 and high.high == 5.0
    assert low.high > -4.8 + 0.2 and high.low < 4.8 - 0.2  # half the width beyond: else nothing moves
    assert middle.low < 1.0 - 0.2 and middle.high > 1.2 + 0.2
    assert middle.times > low.times == high.times == 1
    assert max(place.speed for place in wanted.places) < MEANS.speeds[0]


def test_later_rounds_go_where_sigma_is_worst_alone() -> None:
    done: list[Round | Strokes] = [first_round(MEANS), Strokes((), 5.6)]
    wanted = next_round(MEANS, of(found(sigma_with((4.6, 4.8, 9e-3)))), UNTIL, done, 20.0)
    assert isinstance(wanted, Strokes) and len(wanted.places) == 1
    assert wanted.places[0].high == 5.0 and wanted.places[0].low > 3.5
    everywhere = next_round(MEANS, of(found(sigma_with((-4.8, 4.8, 9e-3)))), UNTIL, done, 20.0)
    assert isinstance(everywhere, Round) and len(everywhere.speeds) > 1
    assert everywhere.speeds[0] != MEANS.speeds[0]  # another speed: what depends on speed is no delay
    missing = next_round(MEANS, of(found(sigma_with(), (-4.8, 2.0))), UNTIL, done, 20.0)
    assert isinstance(missing, Round) and (missing.low, missing.high) == (-5.0, 5.0)


@given(
    st.lists(st.tuples(st.floats(-4.8, 4.8), st.floats(0.0, 1.0), st.floats(1e-3, 1.0)), max_size=4),
    st.integers(0, 5),
    st.floats(1.0, 200.0),
    st.floats(1e-4, 1e-2),
)
def test_no_round_leaves_range_or_speed(
    bad: list[tuple[float, float, float]], rounds: int, seconds: float, until: float
) -> None:
    standing = of(found(sigma_with(*((low, low + more, sigma) for low, more, sigma in bad))), until)
    wanted = next_round(MEANS, standing, until, [first_round(MEANS)] * (rounds + 1), seconds)
    if isinstance(wanted, Round):
        assert -5.0 <= wanted.low < wanted.high <= 5.0 and wanted.high - wanted.low > 2 * wanted.stroke
        assert 1 <= len(wanted.speeds) <= 4 and min(wanted.speeds) > 0 and max(wanted.speeds) <= wanted.transit
        assert wanted.stroke >= 2 * wanted.approach
        return
    for place in wanted.places:
        assert -5.0 <= place.low < place.high <= 5.0 and place.times >= 1
        assert 0 < place.speed <= MEANS.speeds[0]
        assert place.high - place.low > 0.4 / 2  # at an end half the width is all that there is


def test_strokes_cover_what_needs_it_both_ways() -> None:
    standing = of(found(sigma_with((0.0, 0.5, 9e-3))))
    wanted = next_round(MEANS, standing, UNTIL, [first_round(MEANS), Strokes((), 5.6)], 20.0)
    assert isinstance(wanted, Strokes)
    place = wanted.places[0]
    # p = q - B/2 on the way up, q + B/2 on the way down: from 0.0 to 0.5 on both.
    assert place.high - 0.2 >= 0.5 and place.low + 0.2 <= 0.0
    assert standing.need == (Place(pytest.approx(0.0), pytest.approx(0.5), 9e-3),)


def test_why_not_is_said_when_it_is_hopeless_and_not_before() -> None:
    near = of(found(sigma_with((1.0, 1.2, 4e-3))))
    assert why_not(near, UNTIL, "mm", CLEAR, 20.0, 120.0, FEWEST) == ""
    noisy = of(found(sigma_with((-4.8, 4.8, 30e-3))))
    assert why_not(noisy, UNTIL, "mm", CLEAR, 20.0, 120.0, 1) == ""  # before both rounds have been made
    said = why_not(noisy, UNTIL, "mm", CameraView(0.5, (0.0, 0.0)), 20.0, 120.0, FEWEST)
    assert "0.5 px of noise" in said and "30 µm" in said and "2000 s would be needed" in said
    assert why_not(of(found(sigma_with())), UNTIL, "mm", CLEAR, 500.0, 120.0, 5) == ""
    late = why_not(near, UNTIL, "mm", CLEAR, 121.0, 120.0, 5)
    assert "4 µm at 1" in late and "--until" in late and "--at-most" in late


def test_why_not_names_what_is_not_seen_and_what_is_doubted() -> None:
    holes = of(found(sigma_with((3.5, 4.8, 0.2))))
    said = why_not(holes, UNTIL, "mm", CameraView(0.05, (3.4, 5.0)), 121.0, 120.0, 3)
    assert "the marker is not seen from 3.4 to 5 mm" in said and "actuator.range" in said
    elsewhere = why_not(
        of(found(sigma_with((-3.0, -2.0, 0.2)))), UNTIL, "mm", CameraView(0.05, (3.4, 5.0)), 121.0, 120.0, 3
    )
    assert "noise" in elsewhere
    short = of(found(sigma_with(), (-4.8, 2.0)))
    assert "not seen from 2.1 to 5" in why_not(short, UNTIL, "mm", CameraView(0.05, (2.1, 5.0)), 40.0, 120.0, FEWEST)
    assert "not measured from 2.05 to 5 mm" in why_not(short, UNTIL, "mm", CLEAR, 40.0, 120.0, FEWEST)
    stuck = replace(short, unmoved=4.5)
    assert "strokes of 4.5 mm moved nothing" in why_not(stuck, UNTIL, "mm", CLEAR, 40.0, 120.0, FEWEST)
    doubt = Reason("transmission.lag", "the tip follows late", "mend it")
    slow = of(found(sigma_with((-4.8, 4.8, 0.03)), reasons=(doubt,)))
    assert "the tip follows late: mend it" in why_not(slow, UNTIL, "mm", CLEAR, 20.0, 120.0, FEWEST)


def test_what_is_not_known_is_not_told_as_a_number() -> None:
    noisy = of(found(sigma_with((-4.8, 4.8, 30e-3))))
    said = why_not(noisy, UNTIL, "mm", CameraView(float("nan"), (0.0, 0.0)), 20.0, 120.0, FEWEST)
    assert said.startswith("sigma is 30 µm at -4.8 mm, and 2000 s would be needed: steady")
    unknown = of(found(sigma_with((1.0, 1.0, np.nan))))
    said = why_not(unknown, UNTIL, "mm", CLEAR, 121.0, 120.0, FEWEST)
    assert said.startswith("sigma is unknown at 1 mm with 0.05 px of noise in the marker: steady")
    assert why_another(unknown, UNTIL, "mm", [first_round(MEANS)]) == "sigma is unknown at 1 mm where 3 µm is wanted"


@pytest.mark.parametrize(
    ("q", "bins"),
    [((-9.0, -7.0), range(0)), ((-5.1, -5.05), range(0)), ((7.0, 9.0), range(0)), ((-9.0, -4.9), range(1)),
     ((4.9, 9.0), range(BINS - 1, BINS)), ((-9.0, 9.0), range(BINS)), ((0.01, 0.05), range(24, 25))],
)  # fmt: skip
def test_what_is_seen_beyond_the_range_covers_nothing_of_it(q: tuple[float, float], bins: range) -> None:
    ways = iter(q)
    recorder = SimpleNamespace(motor_at=lambda t_s: next(ways))
    watch = Watch(cast(Any, SimpleNamespace(virtual=True, now_us=lambda: 0, rig=reference_rig())), cast(Any, recorder),
                  View(-5.0, 5.0, "mm"))  # fmt: skip
    for k in range(2):
        watch.frame(Frame(40_000 * k, Sighting(1.0, 1.0, 0.1, 16.0, ""), None), 0)
    assert np.flatnonzero(watch.view.rising[:, 0]).tolist() == list(bins) and not watch.view.falling.any()


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [("3", "mm", 3e-3), ("3um", "mm", 3e-3), ("2.5 µm", "mm", 2.5e-3), ("0.003mm", "mm", 3e-3), ("1e1um", "mm", 1e-2),
     ("0.05", "deg", 0.05), ("0.05deg", "deg", 0.05)],
)  # fmt: skip
def test_the_goal_and_its_unit(text: str, unit: str, value: float) -> None:
    assert sigma_of(text, unit) == pytest.approx(value)


@pytest.mark.parametrize(
    ("text", "unit"), [("0", "mm"), ("-3", "mm"), ("3 furlongs", "mm"), ("1.2.3", "mm"), ("", "mm"), ("3um", "deg"),
                       ("3deg", "mm")],
)  # fmt: skip
def test_a_goal_that_is_none(text: str, unit: str) -> None:
    with pytest.raises(click.UsageError, match="--until"):
        sigma_of(text, unit)


def test_the_goal_unless_told() -> None:
    assert default_until(Actuator("mm", (-20.0, 20.0), 1e-3)) == 3e-3
    assert default_until(Actuator("deg", (-90.0, 90.0), 0.01)) == pytest.approx(0.09)
    assert in_words(3e-3, "mm") == "3 µm" and in_words(0.05, "deg") == "0.05 deg"


def view_of(calibration: Calibration | None) -> View:
    view = View(-5.0, 5.0, "mm", UNTIL, "round 1", seconds=9.0, frames=200, lost=3, reversals=8)
    view.rising[:30, 0] = 4
    view.falling[:24, 0] = 9
    view.falling[40:42, 1] = 2
    if calibration is not None:
        view.calibration, view.calibrated_s, view.standing = calibration, 9.0, of(calibration)
    return view


def test_the_picture_shows_coverage_b_and_sigma() -> None:
    view = view_of(found(sigma_with((1.0, 2.0, 5e-3)), (-4.0, 3.0)))
    lines = [text.plain for text in picture(view)]
    labels = {line[:14].strip(): line[14:] for line in lines}
    assert labels["seen rising"] == "▄" * 30 + " " * 18
    assert labels["seen falling"] == "█" * 24 + " " * 16 + "!!" + " " * 6
    sigma = labels["sigma/1 µm"]
    assert len(sigma) == BINS and set(sigma) == {"·", "1", "5"}
    at = -5.0 + (np.arange(BINS) + 0.5) * 10.0 / BINS
    assert all((mark == "·") == (not -4.0 <= q <= 3.0) for mark, q in zip(sigma, at, strict=True))
    assert all((mark == "5") == (1.0 <= q <= 2.0) for mark, q in zip(sigma, at, strict=True) if mark != "·")
    top = next(line for line in lines if line.lstrip().startswith("B 0.4 mm"))
    assert top[14:] == "".join("█" if -4.0 <= q <= 3.0 else " " for q in at)
    assert "197 of 200 frames, 8 reversals" in lines[-2] and "sigma 5 µm at worst" in lines[-1]
    assert "wanted 3 µm" in lines[-1]
    assert view.coverage == 24 / BINS and 0 < view.share < 1
    assert view.unseen == (pytest.approx(-5.0 + 40 * 10 / BINS), pytest.approx(-5.0 + 42 * 10 / BINS))


def test_the_picture_before_anything_is_known() -> None:
    lines = [text.plain for text in picture(view_of(None))]
    assert lines[0] == "round 1" and "too early" in lines[-1] and not any("sigma" in line for line in lines)


def test_without_a_terminal_a_line_for_each_step(capsys: pytest.CaptureFixture[str]) -> None:
    view = view_of(None)
    with calibration_picture(as_json=True) as show:
        show(view)
        show(view)
        view.calibration = found(sigma_with())
        view.calibrated_s, view.standing = 9.0, of(view.calibration)
        show(view)
        show(view)
    told = capsys.readouterr()
    assert told.out == "" and told.err.splitlines() == ["taut: round 1", f"taut: {standing_line(view)}"]


def test_another_round_says_why() -> None:
    passes = [first_round(MEANS)]
    near = Standing.of(found(sigma_with()), -5.0, 5.0, UNTIL)
    strokes = next_round(MEANS, near, UNTIL, passes, 20.0)
    assert isinstance(strokes, Strokes)
    assert why_another(near, UNTIL, "mm", passes) == (
        "sigma is 1 µm where 3 µm is wanted, but passes alone are not believed: turns at both ends first"
    )
    noisy = Standing.of(found(sigma_with((1.0, 1.0, 0.0068))), -5.0, 5.0, UNTIL)
    assert why_another(noisy, UNTIL, "mm", [*passes, strokes]) == "sigma is 6.8 µm at 1 mm where 3 µm is wanted"
    short = Standing.of(found(sigma_with(), (-4.8, 2.0)), -5.0, 5.0, UNTIL)
    assert "not measured from 2.05 to 5 mm" in why_another(short, UNTIL, "mm", passes)


def test_a_goal_that_was_reached_once_and_is_not_any_more_is_told() -> None:
    noisy = Standing.of(found(sigma_with((1.0, 1.0, 0.0068))), -5.0, 5.0, UNTIL)
    assert "looked like 1.7 µm" in no_longer_reached(1.7e-3, noisy, UNTIL, "mm")
    assert (
        no_longer_reached(4e-3, noisy, UNTIL, "mm") == "" and no_longer_reached(float("inf"), noisy, UNTIL, "mm") == ""
    )
    assert no_longer_reached(1e-3, Standing.of(found(sigma_with()), -5.0, 5.0, UNTIL), UNTIL, "mm") == ""


BY_SPEED = Reason(
    "transmission.rate_dependent_backlash", "the width depends on the motor's speed", "mend it", mild=True
)


def at_one_speed(sigma: float) -> Standing:
    """As passes and strokes at nearly one speed leave it, where a width by speed looks like a delay."""
    return of(found(sigma_with((-4.8, 4.8, sigma)), reasons=(BY_SPEED,)))


def test_a_width_that_may_go_with_speed_asks_for_a_slower_pass_once() -> None:
    fast, strokes, doubtful = first_round(MEANS), Strokes((), 5.6), at_one_speed(0.049)
    wanted = next_round(MEANS, doubtful, UNTIL, [fast, strokes], 20.0)
    assert isinstance(wanted, Round) and (wanted.low, wanted.high) == (-5.0, 5.0)
    assert wanted.speeds == (pytest.approx(min(MEANS.speeds)),) and min(MEANS.speeds) <= 0.5 * max(fast.speeds)
    assert "motor's speed" in why_another(doubtful, UNTIL, "mm", [fast, strokes])
    assert slower_pass_tells(MEANS, doubtful, UNTIL, [fast, strokes])
    assert not slower_pass_tells(MEANS, doubtful, UNTIL, [fast, strokes, wanted])
    assert not slower_pass_tells(MEANS, at_one_speed(1e-3), UNTIL, [fast, strokes])
    assert not slower_pass_tells(MEANS, of(found(sigma_with((-4.8, 4.8, 0.049)))), UNTIL, [fast, strokes])
    short = of(found(sigma_with((-4.8, 4.8, 0.049)), (-4.8, 2.0), reasons=(BY_SPEED,)))
    assert not slower_pass_tells(MEANS, short, UNTIL, [fast, strokes])


@pytest.mark.parametrize(("helps", "at_most_s", "count"), [(True, 120.0, 3), (False, 120.0, 3), (True, 20.0, 2)])
def test_one_does_not_give_up_before_a_slower_pass(helps: bool, at_most_s: float, count: int) -> None:
    """Passes and strokes of nearly one speed left B to 49 um, as one live calibration of many did by chance."""
    view, made = View(-5.0, 5.0, "mm", UNTIL), SimpleNamespace(reversals=0, folder=Path("rec"))
    left = [at_one_speed(1.6e-3), at_one_speed(0.049), of(found(sigma_with())) if helps else at_one_speed(0.045)]

    def settle() -> None:
        view.standing, view.seconds = left.pop(0), view.seconds + 12.0

    def run(wanted: Round | Strokes, enough: Callable[[Frame], bool]) -> None:
        """To its end."""

    motions = SimpleNamespace(made=made, run=run, stroke=run, record_rest=lambda: None)
    watch = SimpleNamespace(view=view, settle=settle, camera_view=lambda: CLEAR)
    rounds, why = _make_rounds(cast(Any, motions), cast(Any, watch), MEANS, UNTIL, at_most_s, lambda: False)
    assert len(rounds) == count and isinstance(rounds[1], Strokes)
    assert (why == "") == (helps and count == 3)
    if count == 3:
        assert isinstance(rounds[2], Round) and rounds[2].speeds == (pytest.approx(min(MEANS.speeds)),)


def test_a_round_that_a_rest_broke_off_is_made_again_though_the_rest_is_over_before_its_stroke() -> None:
    answers = [False, True, False]  # of `resting`, then False
    tried: list[bool] = []  # whether each ran to its end
    rests: list[bool] = []
    view = View(-5.0, 5.0, "mm", UNTIL)

    def resting() -> bool:
        return answers.pop(0) if answers else False

    def run(wanted: Round | Strokes, enough: Callable[[Frame], bool]) -> None:
        broken = [enough(Frame(0, Sighting(1.0, 1.0, 0.1, 16.0, ""), None)) for _ in range(3)]
        tried.append(not any(broken))

    def settle() -> None:
        view.standing = Standing.of(found(np.asarray(1e-3)), -5.0, 5.0, UNTIL)

    made = SimpleNamespace(reversals=0, folder=Path("rec"))
    motions = SimpleNamespace(made=made, run=run, stroke=run, record_rest=lambda: None)
    watch = SimpleNamespace(
        view=view, frame=lambda frame, reversals: False, settle=settle, camera_view=lambda: CLEAR,
        rest=lambda resting: rests.append(resting()),
    )  # fmt: skip
    rounds, why = _make_rounds(cast(Any, motions), cast(Any, watch), MEANS, UNTIL, 60.0, resting)
    assert tried == [False, *([True] * len(rounds))] and len(rests) == 1 and not why


def test_a_speed_above_the_axis_own_is_refused_and_moves_in_between_stay_within_it():
    board = SimpleNamespace(ask=lambda name, axis: SimpleNamespace(acceleration_s2=2000))
    live = cast(Any, SimpleNamespace(rig=reference_rig(), top_speed=2.0, board=board, axis=0, resolution=0.01))
    for too_fast in (
        lambda: thorough_round(live, MotionOptions(speeds=(0.5, 2.5))),
        lambda: _means(live, Goal(speeds=(2.5,))),
    ):
        with pytest.raises(TautError, match="the axis moves at 2 mm/s at most: give --speed up to that"):
            too_fast()
    assert thorough_round(live, MotionOptions(speeds=(1.5,))).transit == 2.0
    assert thorough_round(live, MotionOptions(speeds=(2.0,))).speeds == _means(live, Goal(speeds=(2.0,))).speeds
