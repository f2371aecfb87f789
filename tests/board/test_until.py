"""Live calibration until B(q) is known: reached and covered, or said why not; stopped at any time."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_calibration import live_on, off

from conftest import Bench
from tautline.calibration.calibrate import calibrate
from tautline.device import wire
from tautline.errors import TautError
from tautline.live.rounds import Strokes
from tautline.live.session import record_calibration
from tautline.live.setup import Frame, Live, PointSource
from tautline.live.until import Goal, calibrate_until
from tautline.live.watch import View
from tautline.recording import load
from tautline.rig import Coarse
from tautline.simulated.instrument import Instrument, preset, reference_rig
from tautline.vision.marker import Sighting

pytestmark = pytest.mark.minutes

LOST = Sighting(np.nan, np.nan, np.nan, np.nan, "no marker of this colour")
SECONDS = 30.0  # of board time, for 3 um


class Veiled(PointSource):
    """The marker is not found while `hidden` says so of (seconds, q)."""

    def __init__(self, live: Live, hidden: Callable[[float, float], bool], noise_px: float = 0.05) -> None:
        assert live.plant is not None
        super().__init__(live.plant, noise_px)
        self._live, self._hidden = live, hidden

    def look(self) -> Frame:
        frame = super().look()
        q = self._live.board.status(0).q * self._live.resolution
        return replace(frame, sighting=LOST) if self._hidden(frame.t_us * 1e-6, q) else frame


def falling(seed: int) -> Instrument:
    return preset("reference", replace(reference_rig(), coarse=Coarse(-12.0, 0.0)), seed)


@pytest.mark.parametrize(
    "instrument",
    [
        pytest.param(preset("reference", seed=1), id="reference"),
        pytest.param(preset("davinci", seed=2), id="davinci", marks=pytest.mark.long),
        pytest.param(preset("random", seed=1), id="random", marks=pytest.mark.long),
        pytest.param(falling(3), id="falling"),
    ],
)
def test_three_micrometres_in_half_a_minute_and_sigma_covers(
    bench: Bench, tmp_path: Path, instrument: Instrument
) -> None:
    with live_on(bench, instrument) as live:
        found, made = calibrate_until(live, tmp_path / "rec")
        assert off(live.board)
    assert made.reached and made.motion.seconds <= SECONDS
    q, sigma = found.model.q, found.model.width_sigma
    low, high = found.model.measured
    inside = (q >= low) & (q <= high)
    assert low < -4.6 and high > 4.5 and sigma[inside].max() <= 3e-3
    z = (found.model.width - instrument.backlash(q))[inside] / sigma[inside]
    print(f"{instrument.name}: {made.motion.seconds:.1f} s, sigma at most {1e3 * sigma[inside].max():.2f} um, "
          f"rms z {np.sqrt(np.mean(z**2)):.2f}, worst {np.abs(z).max():.1f}")  # fmt: skip
    assert np.sqrt(np.mean(z**2)) < 2.0 and np.abs(z).max() < 5.0
    again = calibrate([load(tmp_path / "rec")], live.rig)  # the recording is all that there is to it, but for its end
    off_sigma = np.abs(again.model.width - found.model.width) / found.model.width_sigma
    assert off_sigma.max() < 1e-3, "the motor was read on: another horizon, another path, within next to nothing"


def test_the_command_says_what_was_reached(tmp_path: Path) -> None:
    taut = Path(sys.executable).with_name("taut")
    done = subprocess.run(
        [taut, "calibrate", "--simulate", "davinci", "--out", tmp_path / "model", "--json"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    motion = result["motion"]
    assert motion["reached"] and motion["sigma"] <= motion["until"] == 3e-3 and motion["seconds"] <= SECONDS
    lines = done.stderr.splitlines()
    assert any(line.startswith("taut: round 1: -5 to 5 mm at 5.6 mm/s") for line in lines)
    assert sum("wanted 3 µm" in line for line in lines) >= 3  # it grows while it runs
    assert Path(result["recording"]).is_dir() and (tmp_path / "model" / "report.html").is_file()


def test_a_coarser_goal_still_makes_both_rounds_and_a_finer_one_more_work(bench: Bench, tmp_path: Path) -> None:
    with live_on(bench, preset("davinci")) as live:
        _, coarse = calibrate_until(live, tmp_path / "coarse", Goal(0.05))
        _, fine = calibrate_until(live, tmp_path / "fine", Goal(0.6e-3))
    assert coarse.reached and len(coarse.rounds) == 2 and isinstance(coarse.rounds[1], Strokes)
    assert fine.reached and fine.standing.worst <= 0.6e-3 and fine.motion.seconds > coarse.motion.seconds
    assert any(isinstance(made, Strokes) for made in fine.rounds)


def test_noise_that_is_too_high_is_said_at_once(bench: Bench, tmp_path: Path) -> None:
    with live_on(bench, preset("reference")) as live:
        live.marker_source = Veiled(live, lambda t, q: False, noise_px=2.0)
        found, made = calibrate_until(live, tmp_path / "rec", Goal(at_most_s=40.0))
        assert off(live.board)
    assert not made.reached and "px of noise in the marker" in made.why and "--until" in made.why
    assert made.motion.seconds < 45.0 and found.model.width_sigma.max() > 3e-3
    assert float(made.why.split(" px of noise")[0].rsplit(" ", 1)[1]) == pytest.approx(2.0, rel=0.3)


def test_time_that_is_up_ends_a_round(bench: Bench, tmp_path: Path) -> None:
    with live_on(bench, preset("reference")) as live:
        _, made = calibrate_until(live, tmp_path / "rec", Goal(1e-3, at_most_s=12.0))
        assert off(live.board)
    assert not made.reached and made.why and 12.0 <= made.motion.seconds < 14.0


def test_a_marker_that_leaves_the_view_is_named_with_its_place(bench: Bench, tmp_path: Path) -> None:
    with live_on(bench, preset("reference")) as live:
        live.marker_source = Veiled(live, lambda t, q: q > 2.5)
        _, made = calibrate_until(live, tmp_path / "rec")
    assert not made.reached and "the marker is not seen from" in made.why and "to 5 mm" in made.why


def test_a_marker_that_is_lost_ends_it(bench: Bench, tmp_path: Path) -> None:
    with live_on(bench, preset("reference")) as live:
        assert live.plant is not None
        live.marker_source = Veiled(live, lambda t, q: t > 8.0)
        with pytest.raises(TautError, match=r"the marker was last seen 3 s ago.*taut marker"):
            calibrate_until(live, tmp_path / "rec")
        assert off(live.board) and live.plant.now_s < 14.0
    assert len(load(tmp_path / "rec").motor.t_s) > 5000


def test_a_tip_that_never_moves_is_told_before_the_motion(bench: Bench, tmp_path: Path) -> None:
    stuck = Instrument.of(reference_rig(), lambda p: np.full_like(p, 8.0), lambda p: 12.0 * p)
    with live_on(bench, stuck) as live, pytest.raises(TautError, match="or the backlash larger"):
        calibrate_until(live, tmp_path / "rec")


@pytest.mark.parametrize("when", ["round 1", "round 2"])
def test_stopped_in_any_round_it_rests_and_keeps_what_there_is(bench: Bench, tmp_path: Path, when: str) -> None:
    seen: list[float] = []

    def stop(view: View) -> None:
        if view.doing.startswith(when):
            seen.append(view.seconds)
            if len(seen) > 30:
                raise KeyboardInterrupt

    with live_on(bench, preset("davinci")) as live:
        with pytest.raises(TautError, match=r"the axis is at rest.*taut calibrate"):
            calibrate_until(live, tmp_path / "rec", show=stop)
        assert off(live.board) and live.board.status(0).fault == 0
        q = live.board.status(0).q
        live.wait(0.5)
        assert live.board.status(0).q == pytest.approx(q, abs=1.0)
    assert calibrate([load(tmp_path / "rec")], live.rig).onsets


def test_unplugged_between_two_strokes_it_rests(bench: Bench, tmp_path: Path) -> None:
    def pull(view: View) -> None:
        if view.doing.startswith("round 2") and bench.sim.ask("state")["attached"]:
            bench.sim.ask("unplug")

    with live_on(bench, preset("davinci")) as live, pytest.raises(TautError, match="the board is gone"):
        calibrate_until(live, tmp_path / "rec", show=pull)
    for _ in range(100):
        bench.sim.ask("advance 20000")
    before = bench.sim.ask("state")["q"][0]
    bench.sim.ask("advance 500000")
    assert bench.sim.ask("state")["q"][0] == pytest.approx(before, abs=256.0)


def test_a_goal_in_the_wrong_unit_moves_nothing(bench: Bench, tmp_path: Path) -> None:
    with live_on(bench, preset("reference")) as live:
        with pytest.raises(TautError, match="with its unit"):
            calibrate_until(live, tmp_path / "rec", Goal(3e-6))
        assert off(live.board)


def test_the_thorough_motion_is_what_it_was(bench: Bench, tmp_path: Path) -> None:
    asked: dict[str, object] = {}

    def stop(share: float, what: str) -> None:
        if asked:
            raise KeyboardInterrupt

    with live_on(bench, preset("reference")) as live:
        ask = live.board.ask

        def listening(name: str, **values: object) -> wire.Message:
            if name == "motion_start":
                asked.update(values)
            return ask(name, **values)  # type: ignore[arg-type]

        live.board.ask = listening  # type: ignore[method-assign, assignment]
        with pytest.raises(TautError, match="the axis is at rest"):
            record_calibration(live, tmp_path / "rec", progress=stop)
    # Counts of 1 um: 8 and 4 deg/s of the tip, 50 reversals each.
    assert asked["cycles"] == 12 and (asked["low"], asked["high"]) == (-5000.0, 5000.0)
    assert asked["speed_s"] == pytest.approx([2000.0 / 3, 1000.0 / 3, 0.0, 0.0])
    expected = {"transit_s": 4000.0 / 3, "acceleration_s2": 40000.0 / 3, "approach": 300.0, "stroke_max": 2500.0,
                "sigma_wanted": 1.5, "sigma_usable": 25.0, "turn": 4.0, "delay_us": 80000}  # fmt: skip
    assert {name: asked[name] for name in expected} == pytest.approx(expected)
