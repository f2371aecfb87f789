"""The chain with parts from outside: a model's own stages written in Python say what the library says."""

from dataclasses import replace

import numpy as np
import pytest

from tautline import effects, trajectory
from tautline.core.chain import Chain, OutsideBlock, Stage, by_differences
from tautline.core.motor import MotorPath
from tautline.encoder import cut
from tautline.errors import TautError
from tautline.model import Effect, Model
from tautline.prediction import predict
from tautline.recording import Motor
from tautline.simulated.instrument import preset, reference_rig

RIG = reference_rig()
COUNT = RIG.actuator.encoder_resolution
GRID = np.linspace(-5.0, 5.0, 1025)
INSTRUMENT = preset("reference", RIG)
MODEL = Model(
    RIG, GRID, INSTRUMENT.backlash(GRID), np.full(1025, 0.003), INSTRUMENT.bend(GRID), 0.08, (-4.0, 4.0)
)  # fmt: skip
STROKES = trajectory.trapezoids(RIG.actuator, 2.4, 3.0, 4, 20.0, 1.0).with_sway(2.0, 20.0, 17.0)
EVERY = slice(None, None, 4)
MOTOR = Motor(
    STROKES.t_s[EVERY], np.round(STROKES.q[EVERY] / COUNT) * COUNT, None, STROKES.translation_mm[EVERY],
    STROKES.rotation_deg[EVERY],
)  # fmt: skip
PATH = MotorPath.of(MOTOR, COUNT)
SCENE = np.random.default_rng(1).uniform(MOTOR.t_s[0], MOTOR.t_s[-1], 400)


def test_without_blocks_it_is_the_prediction():
    seen, told = Chain(MODEL).at(PATH, SCENE), predict(MODEL, MOTOR, SCENE)
    assert np.array_equal(seen.c_deg, told.c_deg) and np.array_equal(seen.image_px, told.image_px)
    blind = replace(MODEL, rig=replace(RIG, camera=None, hand_eye=None, kinematics=None))
    assert Chain(blind).at(PATH, SCENE).image_px is None


BLOCKS = [
    OutsideBlock("shifted", Stage.INPUT, lambda t, q, x: q + x[0], (0.0,), (1e-3,)),
    OutsideBlock("play", Stage.PLANT, lambda t, q, x: MODEL.play.forward(q)),
    OutsideBlock("gained", Stage.STATE, lambda t, p, x: p * x[0], (1.0,), (1e-3,)),
    OutsideBlock("turned", Stage.OUTPUT, lambda t, c, x: c + x[0] + x[1] * t, (0.0, 0.0), (1e-2, 1e-4)),
]


@pytest.mark.parametrize("outside", [[block] for block in BLOCKS] + [BLOCKS], ids=lambda blocks: blocks[-1].name)
def test_a_stage_that_does_nothing_new_changes_nothing(outside):
    seen, told = Chain(MODEL, outside).at(PATH, SCENE), Chain(MODEL).at(PATH, SCENE)
    np.testing.assert_allclose(seen.c_deg, told.c_deg, atol=1e-7)
    np.testing.assert_allclose(seen.image_px, told.image_px, atol=1e-6)


def test_a_sensors_clock_begins_with_the_motor_whatever_stands_in_the_chain():
    """Its rate counts from the motor's first sample, with scene times before that too."""
    model = replace(MODEL, effects=(Effect("acquisition.clock_rate", {"clock_rate": 1e-3}),))
    same = OutsideBlock("same", Stage.OUTPUT, lambda t, c, x: c)
    scene = np.append(SCENE, MOTOR.t_s[0] - 100.0)
    np.testing.assert_allclose(
        Chain(model, [same]).at(PATH, scene).c_deg, Chain(model).at(PATH, scene).c_deg, atol=1e-7
    )


def test_a_lag_from_outside_is_the_librarys():
    tau_s = 0.08

    def lagging(t, p, x):
        """p behind itself in first order, straight between its times."""
        out = np.empty_like(p)
        behind = out[0] = p[0]
        for k in range(1, len(t)):
            step = t[k] - t[k - 1]
            rate, decay = (p[k] - p[k - 1]) / max(step, 1e-12), np.exp(-step / x[0])
            behind = p[k] - rate * x[0] + (behind - p[k - 1] + rate * x[0]) * decay
            out[k] = behind
        return out

    own = Chain(MODEL, [OutsideBlock("lag", Stage.STATE, lagging, (tau_s,), (1e-3,))])
    fine = np.arange(MOTOR.t_s[0], MOTOR.t_s[-1], 0.001)
    expected = effects.follow(MODEL, PATH.lines, fine, {"lag": tau_s}).c_deg
    assert np.abs(own.at(PATH, fine).c_deg - expected).max() < 0.02  # deg: it moves by 60 of them
    assert np.abs(Chain(MODEL).at(PATH, fine).c_deg - expected).max() > 1.0
    slope = own.slopes(PATH, fine)[:, 0, 0]
    ahead, behind = (effects.follow(MODEL, PATH.lines, fine, {"lag": tau_s + by}).c_deg for by in (1e-3, -1e-3))
    assert np.quantile(np.abs(slope - (ahead - behind) / 2e-3), 0.95) < 0.02 * np.abs(slope).max()


def test_slopes_stand_in_the_order_of_the_values():
    slopes = Chain(MODEL, BLOCKS).slopes(PATH, SCENE)
    assert slopes.shape == (400, 3, 4)
    np.testing.assert_allclose(slopes[:, 0, 2], 1.0, atol=1e-9)
    np.testing.assert_allclose(slopes[:, 0, 3], SCENE, atol=1e-6)
    p = MODEL.remaining_inverse(Chain(MODEL).at(PATH, SCENE).c_deg)
    expected = (MODEL.remaining(p * 1.001) - MODEL.remaining(p * 0.999)) / 0.002
    np.testing.assert_allclose(slopes[:, 0, 1], expected, atol=1e-4)
    assert Chain(MODEL).slopes(PATH, SCENE).shape == (400, 3, 0)
    bent = by_differences(lambda x: np.array([x[0] ** 2, x[1]]), np.array([3.0, 1.0]), np.array([1e-3, 0.0]))
    np.testing.assert_allclose(bent, [[6.0, 0.0], [0.0, 0.0]], atol=1e-9)


def test_what_cannot_stand_together_is_refused():
    plant = BLOCKS[1]
    with pytest.raises(TautError, match="one plant"):
        Chain(MODEL, [plant, plant])
    lagging = replace(MODEL, effects=(Effect("transmission.lag", {"lag": 0.05}),))
    with pytest.raises(TautError, match="the model's own effects"):
        Chain(lagging, [plant])
    with pytest.raises(TautError, match="gave"):
        Chain(MODEL, [OutsideBlock("short", Stage.OUTPUT, lambda t, c, x: c[:-1])]).at(PATH, SCENE)
    with pytest.raises(ValueError, match="a step above 0"):
        OutsideBlock("free", Stage.INPUT, lambda t, q, x: q, (1.0,), (0.0,))
    around = Chain(lagging, [BLOCKS[0], BLOCKS[3]]).at(PATH, SCENE)  # before and behind them is room
    np.testing.assert_allclose(around.c_deg, predict(lagging, MOTOR, SCENE).c_deg, atol=1e-5)


def test_a_path_up_to_a_horizon_is_that_of_a_motor_cut_there():
    until = 0.5 * (MOTOR.t_s[0] + MOTOR.t_s[-1])
    early, whole = MotorPath.of(MOTOR, COUNT, until), MotorPath.of(cut(MOTOR, until), COUNT)
    assert early.readings.t_s[-1] <= until and np.array_equal(early.lines.q, whole.lines.q)
    t = np.linspace(MOTOR.t_s[0], until - 1.0, 500)
    assert np.abs(early.at(t) - PATH.at(t)).max() < COUNT


@pytest.mark.parametrize("noise", [2.0, 5.0])
def test_a_paths_sigma_is_how_far_scattering_readings_leave_it_off(noise):
    rng = np.random.default_rng(7)
    read = STROKES.q + rng.normal(0.0, noise * COUNT, len(STROKES.q))
    path = MotorPath.of(Motor(STROKES.t_s, np.round(read / COUNT) * COUNT), COUNT)
    off = float(np.sqrt(np.mean((path.at(STROKES.t_s) - STROKES.q) ** 2)))
    assert off < 0.3 * noise * COUNT and 0.5 < path.sigma / off < 2.0
    assert MotorPath.of(Motor(STROKES.t_s, STROKES.q), 1e-6 * COUNT).sigma < 1e-3 * COUNT
