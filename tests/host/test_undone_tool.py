"""tools.undone: its instruments do what they are told, and its figures tell good tables from others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tautline as tl
from tautline import trajectory
from tautline.rig import Actuator
from tools.undone import hysteresis
from tools.undone.__main__ import tip_off
from tools.undone.plants import INSTRUMENTS, Instrument

T = np.arange(0.0, 20.0, 1e-3)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.fixture(scope="module", params=list(INSTRUMENTS))
def instrument(request: pytest.FixtureRequest) -> Instrument:
    if request.param.startswith("mujoco"):
        pytest.importorskip("mujoco", reason="the package mujoco is not installed")
    made: Instrument = INSTRUMENTS[request.param]()
    return made


def test_the_true_tables_lead_an_instrument_without_an_effect(instrument: Instrument) -> None:
    low, high = np.sort(0.5 * instrument.model.c_deg[[0, -1]])
    path = trajectory.random_smooth(Actuator("deg", (float(low), float(high)), 1e-3), 15.0, 16.0, 2)
    off = tip_off(instrument, instrument.model, {}, path.t_s, path.q)
    half = replace(instrument.model, width=0.5 * instrument.model.width)
    assert off < 0.1 < 0.5 * tip_off(instrument, half, {}, path.t_s, path.q)


def test_every_strength_of_every_effect_moves_the_tip_more_than_the_one_before(instrument: Instrument) -> None:
    reach = 0.6 * instrument.rig.actuator.range[1]
    q = reach * np.sin(2 * np.pi * T / 7.0) * np.cos(2 * np.pi * T / 31.0)
    load, other = 20.0 * np.sin(2 * np.pi * T / 17.0), 2.0 * np.sin(2 * np.pi * T / 13.0)
    plain = instrument.moved({}, T, q, load, other)
    for name, strengths in instrument.strengths.items():
        moved = [rms(instrument.moved(values, T, q, load, other) - plain) for values in strengths]
        assert 0.01 < moved[0] < moved[1] < moved[2], name


@pytest.mark.long
def test_several_plays_are_told_from_one() -> None:
    rig = INSTRUMENTS["second"]().rig
    plant = hysteresis.gradual(0.35)
    recording = hysteresis.recorded(plant, rig)
    model = tl.calibrate(recording).model
    path = trajectory.random_smooth(Actuator("deg", (-38.0, 38.0), 1e-3), 15.0, 25.0, 3)
    several, one = (
        hysteresis.tip_off(plant, m, path.t_s, path.q) for m in (model, hysteresis.one_play(model, recording))
    )
    assert len(model.elements.width) > 2 and several < 0.03 and 3.0 * several < one


@pytest.mark.parametrize("name", ["bouc-wen 1", "dahl"])
def test_friction_builds_up_and_never_drives_the_tip_against_its_motor(name: str) -> None:
    q = 3.0 * np.sin(2 * np.pi * T / 10.0)
    c = hysteresis.PLANTS[name](q)
    way, tip = np.diff(q)[100:], np.diff(c)[100:]
    assert (tip * np.sign(way)).min() > -1e-3
    assert np.ptp(c[np.abs(q) < 0.01]) > 4.0  # deg: the loop is open
