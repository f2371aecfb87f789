"""What a calibration notices of its recordings, takes into account, and says beside a good or a doubtful verdict."""

from collections.abc import Callable
from dataclasses import replace

import angle_plant
import numpy as np
import numpy.typing as npt
import pytest

from tautline.calibration.calibrate import calibrate
from tautline.calibration.choice import JOINT
from tautline.calibration.components import Component, Components
from tautline.calibration.doubts import _faster_hz, _ripple, common_error, component_reasons
from tautline.calibration.findings import Findings
from tautline.calibration.holding import without_held_places
from tautline.calibration.observations import observe
from tautline.calibration.playfit import Curves
from tautline.calibration.result import Calibration
from tautline.calibration.smooth import Domain
from tautline.geometry import project
from tautline.quality import Quality, Reason, Verdict
from tautline.recording import Angle, Motor, Recording
from tautline.simulated.instrument import Instrument, preset, reference_rig
from tautline.simulated.simulate import Simulation, run
from tautline.trajectory import Trajectory, back_and_forth, through
from tautline.vision.timing import FrameTiming

Array = npt.NDArray[np.float64]
RIG = reference_rig()


def motion() -> Trajectory:
    half = RIG.actuator.span / 10
    return back_and_forth(RIG.actuator, [0.5 * half], 2.4 * half, 14, 5.0 * half)


def record(path: Trajectory, seed: int, delay_s: float = 0.0873) -> Simulation:
    plant = preset("reference", RIG, seed)
    return run(RIG, plant, path, seed=seed, timing=FrameTiming.of(RIG, delay_s=delay_s, seed=seed), noise_px=0.05)


def off(found: Calibration, plant: Instrument) -> Array:
    """B's error where it was measured, over its sigma, and in um."""
    model = found.model
    inside = (model.q > model.measured[0]) & (model.q < model.measured[1])
    error = (model.width - plant.backlash(model.q))[inside]
    return np.array([np.sqrt(np.mean((error / model.width_sigma[inside]) ** 2)), 1e3 * np.sqrt(np.mean(error**2))])


def seen_as(recording: Recording, change: Callable[[Array, Array], Array]) -> Recording:
    """With the marker's places (n, 2) at times (n,) changed."""
    marker = recording.marker
    assert marker is not None
    places = change(marker.t_s, np.column_stack([marker.u_px, marker.v_px]))
    return replace(recording, marker=replace(marker, u_px=places[:, 0], v_px=places[:, 1]))


def codes(found: Calibration, mild: bool) -> set[str]:
    return {reason.code for reason in found.model.quality.reasons if reason.mild == mild}


# ---- verdict


@pytest.mark.parametrize(
    ("kinds", "verdict"),
    [("", "good"), ("m", "good"), ("mm", "good"), ("md", "doubtful"), ("dm", "doubtful"), ("mdf", "unusable")],
)
def test_a_verdict_is_that_of_the_worst_reason(kinds: str, verdict: str) -> None:
    reasons = [Reason(f"r{i}", "says", "do", fatal=k == "f", mild=k == "m") for i, k in enumerate(kinds)]
    quality = Quality.of(reasons)
    assert quality.verdict == Verdict(verdict)
    order = [(reason.fatal, not reason.mild) for reason in quality.reasons]
    assert order == sorted(order, reverse=True)
    assert Quality.from_json(quality.to_json()) == quality


def components(
    rms: float, shift_um: float, noise: float = 1.0, effective: float = 1.0, sigma_um: float = 1.0
) -> Components:
    """One departure, of a B of 500 um."""
    flat, one = np.full(50, 0.5), np.ones(50)
    part = Component("offset.time", rms, 1e3 * rms**2, 1e-3 * shift_um * one, 0.0, np.ones(3))
    curves = Curves(np.zeros(3), np.zeros((3, 2)), 0.1)
    return Components(
        curves, curves, flat, 1e-3 * sigma_um * one, 1e-4, 0.0 * flat, 0.0, noise, 1.0, effective, (part,),
        np.zeros(2), count_visible=False,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("rms", "shift_um", "told"),
    [
        (0.5, 0.5, False),  # next to nothing
        (0.9, 0.5, True),  # without it 1.35 times the noise would be left
        (0.5, 30.0, True),  # B would be another by 6 %
        (0.5, 20.0, False),  # ... by 4 %
    ],
)
def test_a_departure_is_told_where_a_good_verdict_hangs_on_its_being_taken_out(rms, shift_um, told) -> None:
    good = component_reasons(components(rms, shift_um), np.ones(50, bool), 0.5, "mm", motor_visible=False, good=True)
    assert [(reason.code, reason.mild) for reason in good] == ([("transmission.drift", True)] if told else [])
    not_good = component_reasons(
        components(rms, shift_um), np.ones(50, bool), 0.5, "mm", motor_visible=False, good=False
    )
    assert [(reason.code, reason.mild) for reason in not_good] == [("transmission.drift", False)]


def test_a_departure_that_is_as_likely_not_there_is_no_reason() -> None:
    told = component_reasons(components(0.01, 0.1), np.ones(50, bool), 0.5, "mm", motor_visible=False, good=False)
    assert told == []


def test_frames_that_are_elsewhere_are_outliers_and_scatter_of_all_is_noise() -> None:
    few = component_reasons(
        components(0.1, 0.1, noise=5.0), np.ones(50, bool), 0.5, "mm", motor_visible=False, good=True
    )
    scattered = replace(components(0.1, 0.1, noise=1.8), parts=())
    every = component_reasons(scattered, np.ones(50, bool), 0.5, "mm", motor_visible=False, good=False)
    alike = component_reasons(
        replace(scattered, frames_per_independent=6.0), np.ones(50, bool), 0.5, "mm", motor_visible=False, good=False
    )
    assert [(r.code, r.mild) for r in few] == [("outliers", True)]
    assert [(r.code, r.mild) for r in every] == [("noise", False)]
    assert [(r.code, r.mild) for r in alike] == [("residual", False)]


@pytest.mark.parametrize(
    ("name", "added_um", "told"),
    [("width.speed.10", 5.0, False), ("width.speed.0.3", 30.0, True), ("width.speed.1.0%", 30.0, True)],
)
def test_what_speed_adds_to_b_is_told_by_how_much_it_is(name: str, added_um: float, told: bool) -> None:
    found = components(0.5, 0.1)
    added = 1e-3 * added_um / (0.5 if name.endswith("%") else 1.0)
    found = replace(found, parts=(replace(found.parts[0], name=name, values=np.array([added])),))
    reasons = component_reasons(found, np.ones(50, bool), 0.5, "mm", motor_visible=False, good=True)
    assert [reason.code for reason in reasons] == (["transmission.rate_dependent_backlash"] if told else [])


# ---- what is noticed


def test_places_that_a_tracker_holds_while_the_tip_moves_are_left_out() -> None:
    made = record(motion(), 911)
    rng = np.random.default_rng(5)

    def held(t: Array, y: Array) -> Array:
        y = y.copy()
        for start in rng.choice(np.arange(50, len(t) - 60), 12, replace=False):
            y[start : start + 15] = y[start]
        return y

    covered = seen_as(made.recording, held)
    plain, mended = calibrate([made.recording], RIG), calibrate([covered], RIG)
    assert "acquisition.held_samples" in codes(mended, mild=True)
    assert mended.model.quality.verdict is Verdict.GOOD
    plant = preset("reference", RIG, 911)
    z, um = off(mended, plant)
    assert um < 3.0 and z < 2.0
    assert not codes(plain, mild=True) and not codes(plain, mild=False)


def test_a_tip_that_rests_is_held_by_nobody() -> None:
    """Without noise a tip at rest repeats its place: a play does so while the motor crosses its backlash."""
    made = run(RIG, preset("reference", RIG, 912), motion(), seed=912, noise_px=0.0)
    tracks = observe([made.recording], RIG)
    domain = Domain(*RIG.actuator.range)
    kept = without_held_places(tracks, lambda: tracks, domain, RIG.nominal_delay_s(tracks[0].sensor))
    assert sum(len(track.t_s) for track in kept) == sum(len(track.t_s) for track in tracks)


def test_recordings_whose_cameras_kept_other_clocks_within_a_delay_are_put_on_one() -> None:
    pair = [record(motion(), seed, delay) for seed, delay in ((921, 0.0873), (922, 0.2173))]
    first, second = (made.recording for made in pair)
    found = calibrate([first, replace(second, name="later")], RIG)
    assert "clock.offset" in codes(found, mild=True) and found.model.quality.verdict is Verdict.GOOD
    assert found.offsets == pytest.approx({"later": 0.13}, abs=2e-3)
    z, um = off(found, preset("reference", RIG, 921))
    assert um < 2.0 and z < 2.0


def test_a_hole_in_what_was_passed_both_ways_is_in_sigma_and_said() -> None:
    """Strokes at both ends and one crossing: between them B is whatever it likes, as with the reference's bump."""
    low, high = RIG.actuator.range
    ends = [low, low + 2.4, low, low + 2.4, low, high, high - 2.4, high, high - 2.4, high]
    made = record(through(np.array(ends), 0.6, 4.0), 931)
    found = calibrate([made.recording], RIG)
    assert "coverage" in codes(found, mild=False)
    model = found.model
    hole = np.abs(model.q - 0.5 * (low + high)) < 1.0
    covered = (model.q > low + 0.8) & (model.q < low + 1.6)
    assert model.width_sigma[hole].min() > 10.0 * np.median(model.width_sigma[covered])
    assert off(found, preset("reference", RIG, 931))[0] < 2.0


def test_a_start_that_is_late_one_way_only_is_no_width() -> None:
    """After turns one way the tip starts 60 um late and is on its envelope at once: the envelopes are as far apart as
    before, and the other way's onsets tell it."""
    made = record(motion(), 941)
    late, rising, start, p = 0.06, False, made.p[0], made.p.copy()
    for k in range(1, len(p)):
        if made.p[k] < made.p[k - 1]:
            rising = False
        elif made.p[k] > made.p[k - 1] and not rising:
            rising, start = True, made.p[k - 1]
        if rising and made.p[k] - start < late:
            p[k] = start
    assert (p != made.p).any()
    order = np.argsort(made.p)
    image = [
        project(RIG, np.interp(made.scene_s, made.t_s, np.interp(at, made.p[order], made.c_deg[order])))
        for at in (p, made.p)
    ]
    shift, plant = image[0] - image[1], made.instrument
    found = calibrate([seen_as(made.recording, lambda t, y: y + shift)], RIG)
    assert found.source == JOINT
    assert off(found, plant)[1] < 10.0


SHAPES: dict[str, Callable[[Array], Array]] = {
    "flat": lambda q: 0.5 + 0.0 * q,
    "bump": lambda q: 0.4 + 0.3 * np.exp(-((q / 0.8) ** 2) / 2),
    "narrow": lambda q: 0.4 + 0.3 * np.exp(-((q / 0.3) ** 2) / 2),
    "bump and dip": lambda q: 0.4 + 0.2 * np.exp(-(((q - 1) / 0.5) ** 2) / 2) - 0.1 * np.exp(-(((q + 2) / 0.7) ** 2)),
    "step": lambda q: 0.4 + 0.2 * np.tanh(q / 0.3),
}


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("sigma", [0.0005, 0.002])
def test_a_ripple_is_a_wave_that_goes_on_and_no_shape_of_b(shape: str, sigma: float) -> None:
    """Of 0.03 on B of about half a unit, every 0.9; B's errors are alike over half a unit."""
    q, rng = np.linspace(-4.5, 4.5, 900), np.random.default_rng(71)
    error = np.convolve(rng.normal(size=999), np.hanning(100), "valid")
    b, stated = SHAPES[shape](q) + sigma * error / error.std(), np.full(900, sigma)
    usual = float(np.median(b))
    assert _ripple(q, b, stated, usual)[0] == 0.0
    rms, period = _ripple(q, b + 0.03 * np.sin(2 * np.pi * q / 0.9 + 1.0), stated, usual)
    assert rms == pytest.approx(0.03 / np.sqrt(2.0), rel=0.35) and period == pytest.approx(0.9, rel=0.02)


@pytest.mark.parametrize(
    ("period_s", "off", "hz"), [(0.1, 2.0, 20), (10.0, 2.0, 0.2), (5.0, 1.5, 0.5), (60.0, 1.1, 0.02)]
)
def test_a_motor_that_is_logged_too_seldom_is_told_a_rate_that_is_enough(
    period_s: float, off: float, hz: float
) -> None:
    assert _faster_hz(period_s, off, 1.0) == pytest.approx(hz)


def told_of_rate(recordings: list[Recording]) -> tuple[float, list[str]]:
    """The error that all strokes share, deg, and what is to be done about it. B is 2 deg."""
    grid, findings = np.linspace(-30.0, 30.0, 100), Findings()
    flat, tracks = np.ones_like(grid), observe(recordings, angle_plant.RIG)
    error = common_error(tracks, grid, 2.0 * flat, 0.05 * flat, 2.0, "deg", findings)
    return error, [reason.remedy for reason in findings.noticed if reason.code == "rate"]


def test_the_recording_whose_motor_is_logged_too_seldom_is_the_one_whose_rate_is_told() -> None:
    """Another one has fewer samples still, but hardly moves."""
    motion = angle_plant.Motion.through
    fast = angle_plant.record(motion((-35, 35, -35), speed=60.0), motor_hz=20.0)
    slow = angle_plant.record(motion((-3, 3, -3), speed=0.1), motor_hz=2.0, sensor_hz=20.0)
    assert told_of_rate([slow, fast]) == told_of_rate([fast])
    assert told_of_rate([fast])[1] == ["log the motor at 500 Hz or more"]


def test_readings_that_are_too_few_for_a_turn_leave_the_others_error() -> None:
    whole = angle_plant.record(angle_plant.Motion.through((-35, 35, -35), speed=14.0))
    t_s = np.linspace(100.0, 100.8, 3)
    few = replace(whole, motor=Motor(t_s, np.array([0.0, 1.0, 2.0])), angle=Angle(t_s, np.zeros(3)))
    assert told_of_rate([whole, few]) == told_of_rate([whole])


def test_what_is_said_of_an_angle_sensors_clock_is_of_no_camera() -> None:
    joint = angle_plant.record(angle_plant.Motion.through((-35, 35, -30, 25, -35, 0, -20, 30, -35), speed=14.0))
    assert joint.angle is not None
    fast = replace(joint, angle=Angle(joint.angle.t_s * 1.003, joint.angle.c_deg))
    reasons = calibrate([fast], angle_plant.RIG, naming=False).model.quality.reasons
    assert any(reason.code == "clock.rate" for reason in reasons)
    assert not any("camera" in reason.says for reason in reasons)
