"""Inverse, then plant: with tables flashed over USB, how far the tip of the true instrument is from what was asked.

The error is rms of c - c*, deg, from the moment at which the play has been driven through in both directions; every
take-up after that counts in full. Uncompensated: the motor follows f_coarse's inverse.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from conftest import Bench
from tautline.device import wire
from tautline.live.following import follow_run, record
from tautline.live.session import MotionOptions, calibrate_live
from tautline.live.setup import Live, PointSource
from tautline.model import Effect, Model
from tautline.rig import Coarse
from tautline.simulated.instrument import Instrument, preset, reference_rig
from tautline.simulated.simlink import SimulatedAxis

pytestmark = pytest.mark.minutes

FALLING = replace(reference_rig(), coarse=Coarse(-12.0, 3.0))


def model_of(instrument: Instrument) -> Model:
    q = np.linspace(*instrument.rig.actuator.range, 401)
    width, c = instrument.backlash(q), instrument.bend(q)
    return Model(instrument.rig, q, width, 0.001 + 0 * q, c, 0.08, instrument.rig.actuator.range)


def report(name: str, shape: str, off: float, full: float) -> None:
    print(
        f"{name:>12} {shape:>10}: {off:.3f} deg uncompensated, {full:.3f} deg with tables: {off / full:.1f} times less"
    )


@pytest.mark.parametrize("shape", ["trapezoids", "smooth"])
@pytest.mark.parametrize("name", ["reference", "davinci", "random", "falling"])
def test_ten_times_smaller_with_the_true_tables(bench: Bench, name: str, shape: str) -> None:
    instrument = preset("reference", FALLING) if name == "falling" else preset(name, seed=7)
    with bench.open() as board:
        live = Live(board, instrument.rig, 0, None, SimulatedAxis(bench.sim, instrument))
        model = model_of(instrument)
        off = follow_run(live, shape, compensation="off", model=model, seed=3)
        full = follow_run(live, shape, compensation="full", model=model, seed=3)
        assert full.counters["set_points_dropped"] == 0 and full.counters["telemetry_dropped"] == 0
    report(name, shape, off.rms_deg, full.rms_deg)
    assert off.counted.mean() > 0.5 and full.counted.mean() > 0.5
    assert full.rms_deg * 10.0 <= off.rms_deg


def test_a_slow_axis_takes_up_without_overshoot(bench: Bench) -> None:
    """The axis may accelerate less than the table's take-up asks for: it gets there later, not too far."""
    instrument = preset("davinci")
    with bench.open() as board:
        limits = dict(board.ask("get_limits", axis=0).values)
        limits["acceleration_s2"] = 40_000.0
        board.ask("limits", **limits)
        live = Live(board, instrument.rig, 0, None, SimulatedAxis(bench.sim, instrument))
        off = follow_run(live, "smooth", compensation="off", model=model_of(instrument), seed=3)
        full = follow_run(live, "smooth", model=model_of(instrument), seed=3)
    report("slow axis", "smooth", off.rms_deg, full.rms_deg)
    assert full.rms_deg * 10.0 <= off.rms_deg


class Sided(Instrument):
    """A play of 0.4 mm that the motor, rising, has to cross by 0.15 mm more, which the tip catches up within 0.3 mm of
    its way; so again after every rest of more than 0.05 s. Where the play is of another width, that goes with it."""

    rested_s, way, rising, before_s = 0.0, 0.0, False, np.nan

    def reach(self, p: float, late: float) -> float:
        """From p to the motor whose rising end carries there."""
        width = float(self.backlash(np.array([p]))[0])
        return 0.5 * width + late * width / 0.4

    def centre(self, t_s: np.ndarray, q: np.ndarray) -> np.ndarray:
        if self.p != self.p:
            self.p, self.before_s = float(q[0]), float(t_s[0])
        p = np.empty(len(q))
        for k, (t, motor) in enumerate(zip(t_s.tolist(), q.tolist(), strict=True)):
            self.rested_s += t - self.before_s
            self.before_s = t
            way = self.way if self.rising and self.rested_s < 0.05 else 0.0
            beyond = motor - self.p - self.reach(self.p, 0.15 * np.exp(-way / 0.3))
            if beyond > 0.0:
                self.way, self.rising, self.rested_s = way + beyond, True, 0.0
                for _ in range(20):
                    self.p = motor - self.reach(self.p, 0.15 * float(np.exp(-self.way / 0.3)))
            elif motor + self.reach(self.p, 0.0) < self.p:
                self.rising, self.rested_s = False, 0.0
                for _ in range(20):
                    self.p = motor + self.reach(self.p, 0.0)
            p[k] = self.p
        return p


def stops(folder: Path) -> str:
    """Up in steps and down, a little further each time, with rests of which some are longer than 0.05 s, some not."""
    t, c = [0.0], [0.0]
    for turn in range(6):
        for step, rest in zip((1, 1, 1, 1, -1, -1, -1, -1), (0.3, 0.1, 0.03, 0.3) * 2, strict=True):
            t += [t[-1] + rest, t[-1] + rest + 0.7]
            c += [c[-1], c[-1] + step * (8.0 + 0.3 * turn)]
    file = folder / "stops.csv"
    np.savetxt(file, np.column_stack([t, c]), "%.5f", ",", header="t_s,c_deg", comments="")
    return str(file)


def test_a_side_that_begins_anew_after_rests(bench: Bench, tmp_path: Path) -> None:
    """By what nine of ten samples are off at most: what a turn takes up is in the last one."""
    rig = reference_rig()
    made = Sided.of(rig, lambda p: 0.4 + 0 * p, lambda p: 12.0 * p)
    law = {"asymmetry": 0.15, "asymmetry_travel": 0.3, "asymmetry_form": 1.0}
    off = []
    with bench.open() as board:
        live = Live(board, rig, 0, None, SimulatedAxis(bench.sim, made))
        for renewed in (0.0, 1.0):
            sides = Effect("transmission.asymmetric_backlash", law | {"asymmetry_renewed": renewed})
            followed = follow_run(live, stops(tmp_path), model=replace(model_of(made), effects=(sides,)))
            off.append(float(np.percentile(np.abs(followed.error_deg), 90)))
    print(f"{off[0]:.3f} deg where the table's sides begin anew at turns alone, {off[1]:.3f} after rests, too")
    assert off[1] < 0.1 < 0.5 < off[0]


def test_a_side_that_is_pressed_where_the_width_is(bench: Bench, tmp_path: Path) -> None:
    """The width varies by half of its mean, and what starts later with it."""
    rig = reference_rig()
    made = Sided.of(rig, lambda p: 0.4 + 0.2 * np.sin(1.3 * p), lambda p: 12.0 * p)
    law = {"asymmetry": 0.15, "asymmetry_travel": 0.3, "asymmetry_form": 1.0, "asymmetry_renewed": 1.0}
    mean = float(np.mean(model_of(made).width))
    law["asymmetry"] *= mean / 0.4  # 0.15 is at a width of 0.4
    off = []
    with bench.open() as board:
        live = Live(board, rig, 0, None, SimulatedAxis(bench.sim, made))
        for pressed in (0.0, 1.0):
            sides = Effect("transmission.asymmetric_backlash", law | {"asymmetry_pressed": pressed})
            followed = follow_run(live, stops(tmp_path), model=replace(model_of(made), effects=(sides,)))
            off.append(float(np.percentile(np.abs(followed.error_deg), 90)))
    print(f"{off[0]:.3f} deg where the side is late alike everywhere, {off[1]:.3f} where it goes with the width")
    assert off[1] < 0.1 < 0.25 < off[0]


@pytest.mark.parametrize("what", ["follow", "record"])
def test_stopped_by_the_user_the_axis_rests(bench: Bench, tmp_path: Path, what: str) -> None:
    def stop(share: float, doing: str) -> None:
        if share > 0.4:
            raise KeyboardInterrupt

    instrument = preset("reference")
    with bench.open() as board:
        live = Live(board, instrument.rig, 0, None, SimulatedAxis(bench.sim, instrument))
        if what == "follow":
            with pytest.raises(KeyboardInterrupt):
                follow_run(live, "trapezoids", model=model_of(instrument), progress=stop)
        else:
            made = record(live, tmp_path / "rec", "trapezoids", progress=stop)
            assert made["motor_samples"] > 3000  # kept, and no failure
        status = board.status(0)
        assert status.mode == wire.code("MODES", "OFF") and status.fault == 0
        live.wait(0.5)
        assert abs(board.status(0).q - status.q) <= 1.0


def test_ten_times_smaller_with_what_a_live_calibration_measured(bench: Bench, tmp_path: Path) -> None:
    instrument = preset("reference")
    with bench.open() as board:
        plant = SimulatedAxis(bench.sim, instrument)
        live = Live(board, instrument.rig, 0, PointSource(plant), plant)
        found, _ = calibrate_live(live, tmp_path / "rec", MotionOptions(cycles=6, speeds=(1.0,)))
        live.marker_source = None
        runs = {
            how: follow_run(live, "trapezoids", compensation=how, model=found.model)
            for how in ("off", "backlash", "full")
        }
        half = follow_run(live, "trapezoids", compensation="full", model=found.model, strength=0.5)
    report("measured", "trapezoids", runs["off"].rms_deg, runs["full"].rms_deg)
    assert runs["full"].rms_deg * 10.0 <= runs["off"].rms_deg
    assert runs["full"].rms_deg < half.rms_deg < runs["backlash"].rms_deg < runs["off"].rms_deg
