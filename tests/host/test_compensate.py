"""taut compensate: the board's inverse run open loop against plants that share nothing with it."""

import json
from pathlib import Path

import numpy as np
import pytest
from cli_runner import Taut

from tautline.compensation import Compensator, compensate
from tautline.elements import SINGLE, Elements
from tautline.errors import TautError
from tautline.model import Effect, Model
from tautline.rig import Actuator, Coarse, Rig

GRID = np.linspace(-5.0, 5.0, 401)
COUNT = 0.001
GRADUAL = Elements((0.1, 0.7, 1.0, 1.3, 1.9), (0.2, 0.2, 0.2, 0.2, 0.2))


def law(p):
    return 12.0 * p + 6.0 * np.sin(0.5 * p)


def model(width, elements=SINGLE, falling=False, **actuator) -> Model:
    sign = -1.0 if falling else 1.0
    rig = Rig(Actuator("mm", (-5.0, 5.0), COUNT, **actuator), Coarse(sign * 12.0, 0.0))
    c_deg = sign * law(GRID)
    return Model(rig, GRID, width + 0 * GRID, 0.01 + 0 * GRID, c_deg, 0.08, (-4.0, 4.0), elements=elements)


def prandtl_ishlinskii(q, widths, weights):
    """Plays one after the other in motor space, their mean; each starts around the motor."""
    state = np.full(len(widths), q[0])
    reached = np.empty(len(q))
    for k, position in enumerate(q):
        state = np.clip(state, position - np.array(widths) / 2, position + np.array(widths) / 2)
        reached[k] = np.dot(weights, state)
    return reached


def single(q, width):
    """One play whose width is a function of its own place, by bisection of both envelopes."""
    p, path = q[0], np.empty(len(q))
    for k, position in enumerate(q):
        for side in (1, -1):
            low, high = position - 2.0, position + 2.0
            for _ in range(40):
                middle = (low + high) / 2
                low, high = (middle, high) if middle + side * width(middle) / 2 < position else (low, middle)
            p = max(p, low) if side > 0 else min(p, low)
        path[k] = p
    return path


def trajectory(seed=0, turns=14):
    """Slow strokes with rests, deg."""
    corners = np.repeat(np.random.default_rng(seed).uniform(-40, 40, turns), 2)
    return 1.5 * np.arange(len(corners)), corners


def wanted(t_s, c_deg, points):
    return np.interp(points.t_s, t_s, c_deg)


@pytest.mark.parametrize("falling", [False, True])
def test_a_single_play_is_undone(falling):
    t_s, c_deg = trajectory()
    width = lambda p: 0.5 + 0.2 * np.sin(p)  # noqa: E731
    own = model(0.5 + 0.2 * np.sin(GRID), falling=falling)
    points = compensate(own, t_s, c_deg, 100)
    tip = (-1.0 if falling else 1.0) * law(single(points.q, width))
    error = np.abs(tip - wanted(t_s, c_deg, points))
    assert error.max() < 3 * COUNT * 15  # deg: the band of two counts, and one
    assert np.sqrt(np.mean(error**2)) < 0.3 * COUNT * 15
    off = compensate(own, t_s, c_deg, 100, "off")
    lost = (-1.0 if falling else 1.0) * law(single(off.q, width)) - wanted(t_s, c_deg, off)
    assert np.sqrt(np.mean(lost**2)) > 2.0


@pytest.mark.parametrize("spread", [0.05, 0.2, 0.5, 1.0])
def test_several_plays_and_gradual_onsets_are_undone(spread):
    """Gradual onset over a share of the width: 60 thresholds, which the model's 7 elements stand for."""
    width = 0.6
    thresholds = width * (1 + spread * np.linspace(-1, 1, 60))
    centres = 1 + spread * (2 * np.arange(7) - 6) / 7
    gradual = Elements(tuple(centres / centres.mean()), (1 / 7,) * 7)
    t_s, c_deg = trajectory(1)
    rms = {}
    for name, elements in (("several", gradual), ("one", SINGLE)):
        points = compensate(model(width, elements), t_s, c_deg, 500)
        p = prandtl_ishlinskii(points.q, thresholds, np.full(60, 1 / 60))
        rms[name] = np.sqrt(np.mean((law(p) - wanted(t_s, c_deg, points)) ** 2)) / 15 / COUNT  # counts
    assert rms["several"] < max(rms["one"] / 5, 2.0), rms


def test_plays_of_the_models_own_elements_are_undone_to_two_counts():
    width = 0.6
    t_s, c_deg = trajectory(2)
    points = compensate(model(width, GRADUAL), t_s, c_deg)
    p = prandtl_ishlinskii(points.q, width * np.array(GRADUAL.width), GRADUAL.weight)
    assert np.abs(law(p) - wanted(t_s, c_deg, points)).max() < 3 * COUNT * 15
    assert not points.clipped.any()


def test_it_starts_at_rest_on_the_centre_line():
    own = model(0.5, GRADUAL)
    t_s, c_deg = np.array([2.0, 4.0]), np.array([10.0, 20.0])
    points = compensate(own, t_s, c_deg, 100)
    assert points.q[0] == pytest.approx(own.remaining_inverse(10.0), abs=COUNT)
    assert points.t_s[[0, -1]] == pytest.approx([2.0, 4.0]) and len(points.q) == 201
    elsewhere = compensate(own, t_s, c_deg, 100, start_deg=30.0)
    below = own.remaining_inverse(10.0)
    assert elsewhere.q[5] < below < elsewhere.q[-1]  # from above it comes down to 10 deg first
    coarse = compensate(own, t_s, c_deg, 100, "off")
    assert coarse.q == pytest.approx(np.linspace(10, 20, 201) / 12, abs=COUNT)


def test_no_look_ahead():
    t_s, c_deg = trajectory(3)
    own = model(0.6, GRADUAL)
    whole = compensate(own, t_s, c_deg, 200)
    cut = compensate(own, t_s[:12], c_deg[:12], 200)
    assert np.array_equal(whole.q[: len(cut.q)], cut.q)
    assert np.array_equal(whole.clipped[: len(cut.q)], cut.clipped)


def test_beyond_the_range_and_a_limit_it_is_clipped():
    t_s, c_deg = np.array([0.0, 1.0, 2.0]), np.array([0.0, 90.0, 0.0])
    points = compensate(model(0.5), t_s, c_deg, 1000)
    assert points.q.max() == 5.0 and points.clipped[950:1050].all() and not points.clipped[:300].any()
    slow = compensate(model(0.5, GRADUAL, speed_max=1.0), *trajectory(4), 1000)
    assert np.abs(np.diff(slow.q)).max() <= 1.0 / 1000 + 1e-12
    assert slow.clipped.any()
    quick = compensate(model(0.5, GRADUAL, speed_max=1000.0), *trajectory(4), 1000)
    assert not quick.clipped.any()


@pytest.mark.parametrize(
    ("c_deg", "t_s", "says"),
    [
        ("x", 0.1, "step takes an angle"),
        (None, 0.1, "step takes an angle"),
        (1.0, float("nan"), "finite"),
        (1.0, 0.0, "must rise"),
        (1.0, 1e9, "after a pause begin anew"),
    ],
)
def test_a_loop_that_gives_what_is_no_command_is_told_so_and_goes_on(c_deg, t_s, says) -> None:
    loop = Compensator(model(0.5))
    before = loop.step(1.0, 0.0)
    with pytest.raises(TautError, match=says):
        loop.step(c_deg, t_s)
    assert loop.step(1.0, 0.2) == before


@pytest.mark.parametrize("elements", [SINGLE, GRADUAL], ids=["one", "gradual"])
@pytest.mark.parametrize(("offset", "share"), [(0.3, 1.0), (-0.2, 0.6), (0.0, 1.4)])
def test_what_was_learnt_in_use_is_compensated_in_a_loop_of_ones_own(elements, offset, share) -> None:
    """The instrument is re-tensioned: its tip is where the motor at q + offset would put it, its plays are another
    share of B. From when that is told on the tip is where it should be again."""
    rate, t = 200, np.arange(0.0, 24.0, 1 / 200)
    wanted = 30.0 * np.sin(2 * np.pi * t / 8.0)
    loop, told_s = Compensator(model(0.5, elements), rate), 12.0
    q = []
    for at, c in zip(t.tolist(), wanted.tolist(), strict=True):
        if at == told_s:
            loop.adapt(offset, share)
        q.append(loop.step(c, at))
    widths = 0.5 * share * np.array(elements.width)
    reached = law(prandtl_ishlinskii(np.array(q) + offset, widths, np.array(elements.weight)))
    off = np.abs(reached - wanted)
    before, after = (np.sqrt(np.mean(off[part] ** 2)) for part in ((t > 4.0) & (t < told_s), t > told_s + 4.0))
    # Of a gradual onset the board moves the width and leaves its course over the motor's way as it is: a tenth stays.
    assert before > 1.0 and after < before * (0.003 if elements is SINGLE or share == 1.0 else 0.12)


def test_what_no_table_allows_is_refused_and_tables_stay() -> None:
    loop, other = Compensator(model(0.5)), Compensator(model(0.5))
    for each in (loop, other):
        each.adapt(0.1, 0.8)
        each.step(0.0, 0.0)
    for offset, share in ((1.01, 1.0), (0.0, -0.1), (0.0, 2.1), (float("nan"), 1.0)):
        with pytest.raises(TautError, match="calibrate again"):
            loop.adapt(offset, share)
    assert loop.step(5.0, 1.0) == other.step(5.0, 1.0)


def write(path: Path, rows: str) -> Path:
    path.write_text("t_s,c_deg\n" + rows)
    return path


def test_the_command(taut: Taut, tmp_path: Path) -> None:
    model(0.5, GRADUAL).save(tmp_path / "m")
    file = write(tmp_path / "c.csv", "0,0\n1,10\n2,0\n")
    done = taut("compensate", tmp_path / "m", "--trajectory", file, "--csv", tmp_path / "o.csv", "--rate", 50, "--json")
    assert done.code == 0, done.err
    assert json.loads(done.out) == {
        "csv": str(tmp_path / "o.csv"), "rows": 101, "clipped": 0, "mode": "full", "rate_hz": 50,
    }  # fmt: skip
    lines = (tmp_path / "o.csv").read_text().splitlines()
    assert lines[0] == "t_s,q_mm,clipped" and len(lines) == 102
    t, q, clipped = (np.array(column, float) for column in zip(*(line.split(",") for line in lines[1:]), strict=True))
    assert t == pytest.approx(np.arange(101) / 50) and not clipped.any()
    expected = compensate(model(0.5, GRADUAL), np.array([0.0, 1, 2]), np.array([0.0, 10, 0]), 50)
    assert q == pytest.approx(expected.q, abs=1e-6)


def test_what_it_says_where_it_cannot(taut: Taut, tmp_path: Path) -> None:
    own = model(0.5)
    own.save(tmp_path / "m")
    good = write(tmp_path / "c.csv", "0,0\n1,10\n")
    out = ("--csv", tmp_path / "o.csv")
    for rows, says in (("0,0\n0,1\n0,2\n", "t_s"), ("0,x\n", "c_deg"), ("", "no rows")):
        bad = write(tmp_path / "bad.csv", rows)
        assert says in taut.refuses("compensate", tmp_path / "m", "--trajectory", bad, *out)
    assert "taut calibrate" in taut.refuses("compensate", tmp_path / "none", "--trajectory", good, *out)
    missing = tmp_path / "none.csv"
    assert "none.csv" in taut.refuses("compensate", tmp_path / "m", "--trajectory", missing, *out)
    assert taut("compensate", tmp_path / "m", "--trajectory", good, *out, "--rate", 5).code == 2
    far = write(tmp_path / "far.csv", "0,0\n1,400\n")
    done = taut("compensate", tmp_path / "m", "--trajectory", far, *out)
    assert done.code == 0 and "were clipped" in done.err
    contact = Effect("configuration.contact", {"contact_hold": 0.5, "contact_c": 20.0})
    Model(**{**own.__dict__, "effects": (contact,)}).save(tmp_path / "held")
    done = taut("compensate", tmp_path / "held", "--trajectory", good, *out)
    assert done.code == 0 and "configuration.contact" in done.err


def test_a_rate_is_a_whole_number() -> None:
    assert Compensator(model(0.5), 1000.0).run([0.0, 0.1], [0.0, 1.0]) == compensate(model(0.5), [0.0, 0.1], [0.0, 1.0])
    for rate in (1000.5, np.nan, 5):
        with pytest.raises(TautError, match="16 to 100000 Hz, a whole number"):
            Compensator(model(0.5), rate)
