"""The second instrument of the blind cases: with nothing switched on it is the nominal model's, by other equations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tautline import _native, trajectory
from tautline.geometry import project
from tautline.simulated.instrument import preset
from tools.blindtest import cases
from tools.blindtest.cases import VISIBLE, make
from tools.blindtest.draws import KNOWN, UNKNOWN
from tools.blindtest.reality import Plant, Truth, record


def test_the_pin_in_its_slot_is_the_play() -> None:
    plant = preset("random", seed=3)
    t = np.arange(0.0, 40.0, 1e-3)
    q = 3.0 * np.sin(0.6 * t) + 1.2 * np.sin(2.0 * t)
    p, way = _native.reality_transmission({}, plant.grid, plant.width, t, q, np.ones_like(t))
    assert np.abs(p - _native.Plays(plant.grid, plant.width).forward(q, np.nan)[0]).max() < 1e-9
    assert set(np.unique(way)) == {-1.0, 0.0, 1.0}


def test_bristles_bend_by_travel_and_not_by_the_step() -> None:
    plant = preset("constant")
    t = np.arange(0.0, 20.0, 1e-3)
    q = 2.0 * np.sin(t)
    coarse = np.arange(0, len(t), 5)
    soft = {"softness": 0.5}
    fine, _ = _native.reality_transmission(soft, plant.grid, plant.width, t, q, np.ones_like(t))
    rough, _ = _native.reality_transmission(soft, plant.grid, plant.width, t[coarse], q[coarse], np.ones(len(coarse)))
    assert np.abs(fine[coarse] - rough).max() < 5e-3
    hard = _native.Plays(plant.grid, plant.width).forward(q, np.nan)[0]
    assert 0.02 < np.abs(fine - hard).max() < 0.5 * 0.625


def test_nothing_switched_on_is_seen_where_the_model_says() -> None:
    instrument = preset("reference")
    rig = instrument.rig
    plant = Plant(rig, instrument.grid, instrument.width, instrument.c_deg, noise_px=0.0)
    motion = trajectory.sines(rig.actuator, 2.0, 20.0).with_sway(2.0, 20.0, 9.0)
    recording = record(plant, Truth(), motion, 0.0, 4, "nothing")
    marker = recording.marker
    assert marker is not None and rig.camera is not None
    scene = marker.t_s - rig.camera.delay_s
    every = np.union1d(motion.t_s, scene)
    c = instrument.move(every, np.interp(every, motion.t_s, motion.q))[np.searchsorted(every, scene)]
    others = [np.interp(scene, motion.t_s, x) for x in (motion.translation_mm, motion.rotation_deg) if x is not None]
    seen = np.column_stack([marker.u_px, marker.v_px])
    assert np.nanmax(np.abs(seen - project(rig, c, *others))) < 0.05  # a chain of 96 joints is nearly an arc


@pytest.mark.parametrize("name", [*KNOWN, *UNKNOWN])
def test_every_effect_moves_the_marker(name: str) -> None:
    instrument = preset("reference")
    rig = instrument.rig
    plant = Plant(rig, instrument.grid, instrument.width, instrument.c_deg, noise_px=0.0)
    values = (KNOWN.get(name) or UNKNOWN[name])(np.random.default_rng(2), rig)
    if name == "registration.shift":
        values["slip_time"] = 10.0
    motion = trajectory.trapezoids(rig.actuator, 2.0, 3.0, 4, 20.0, 1.0).with_sway(2.0, 20.0, 9.0)
    load = 20.0 * np.sin(motion.t_s)
    without, with_it = (record(plant, truth, motion, 0.0, 4, "case", load) for truth in (Truth(), Truth(values)))
    seen = []
    for marker in (without.marker, with_it.marker):
        assert marker is not None
        seen.append(np.column_stack([marker.u_px, marker.v_px, marker.t_s]))
    n = min(map(len, seen))
    pixels_and_time = np.nanmax(np.abs(seen[0][:n] - seen[1][:n]), axis=0)
    if name == "actuator.encoder_periodic":  # the encoder errs, not the motor
        assert np.abs(without.motor.q - with_it.motor.q).max() > 0.01
    elif name == "acquisition.delay":
        assert pixels_and_time[2] > 0.01
    else:
        assert pixels_and_time[:2].max() > 0.05


def test_cases_repeat_by_seed_and_differ_by_effect() -> None:
    first, second = make(7, "single"), make(7, "single")
    assert first.label == second.label
    assert np.array_equal(first.tests[0].motor.q, second.tests[0].motor.q)
    assert np.array_equal(first.further.marker.u_px, second.further.marker.u_px)
    lag, creep = (make(7, "single", (name,)) for name in ("transmission.lag", "transmission.creep"))
    assert lag.label.noise_px != creep.label.noise_px
    assert make(8, "single").label != first.label


def test_what_recalibration_swallows_is_not_identifiable() -> None:
    nothing = make(3, "none").label
    assert nothing.effects == () and nothing.left == ()
    strong = make(3, "single", ("registration.shift",)).label
    assert strong.identifiable and strong.left[0] >= VISIBLE * strong.noise_px
    assert not replace(strong, left=(1.9 * strong.noise_px,)).identifiable


def test_two_truths_at_one_seed_share_noise_and_frames() -> None:
    instrument = preset("reference")
    rig = instrument.rig
    motion = trajectory.sines(rig.actuator, 2.0, 10.0)
    seen = []
    for noise, truth in ((0.0, Truth()), (0.05, Truth()), (0.05, Truth({"unsteady": 0.01, "stalls": 0.2}))):
        plant = Plant(rig, instrument.grid, instrument.width, instrument.c_deg, noise)
        marker = record(plant, truth, motion, 0.0, 4, "case").marker
        assert marker is not None
        seen.append(marker)
    assert np.array_equal(seen[0].t_s, seen[1].t_s) and np.array_equal(seen[1].t_s, seen[2].t_s)
    assert 0.04 < np.std(seen[1].u_px - seen[0].u_px) < 0.06


def test_a_stalled_video_repeats_a_frame_to_the_last_bit() -> None:
    instrument = preset("reference")
    rig = instrument.rig
    plant = Plant(rig, instrument.grid, instrument.width, instrument.c_deg, 0.05)
    motion = trajectory.sines(rig.actuator, 2.0, 20.0)
    marker = record(plant, Truth({"stalls": 0.3, "stall_s": 0.5}), motion, 0.0, 4, "case").marker
    assert marker is not None
    assert 10 < np.sum(np.diff(marker.u_px) == 0.0) < 400


def test_what_an_effect_of_the_library_imitates_is_not_outside_of_it(monkeypatch) -> None:
    monkeypatch.setattr(cases, "_DRAWS", 1)
    monkeypatch.setitem(UNKNOWN, "coupling", KNOWN["configuration.axis_coupling"])
    imitated = make(3, "unknown", ("coupling",)).label
    assert not imitated.identifiable
    assert make(3, "unknown", ("bouc_wen",)).label.identifiable


def test_bouc_wen_bulges_within_the_envelopes_and_forgets_by_travel() -> None:
    plant = preset("constant")
    t = np.arange(0.0, 30.0, 1e-3)
    q = 4.0 * np.sin(0.5 * t)
    bent = {"bulge": 0.1, "bulge_travel": 0.3}
    with_it, _ = _native.reality_transmission(bent, plant.grid, plant.width, t, q, np.ones_like(t))
    without, way = _native.reality_transmission({}, plant.grid, plant.width, t, q, np.ones_like(t))
    late = np.abs(q) < 1.0  # long after a reversal: settled to the side that it moves to
    assert np.allclose((with_it - without)[late & (t > 10.0)], 0.1 * way[late & (t > 10.0)], atol=2e-3)
