"""A model that carries an effect, tracked: the effect moves the tip as it was found, the tracker keeps the rest."""

from dataclasses import replace

import numpy as np

from tautline.model import Effect, Model, Uncertainty
from tautline.recording import Recording
from tautline.simulated.instrument import Corrected, reference_rig
from tautline.simulated.simulate import run
from tautline.tracking import replay
from tautline.tracking.replay import residuals
from tautline.trajectory import random_smooth

RIG, NOISE_PX = reference_rig(), 0.05
Q = np.linspace(*RIG.actuator.range, 257)
LAG = Effect("transmission.lag", {"lag": 0.15, "lag_second": 0.2})
MODEL = Model(
    RIG, Q, 0.5 + 0.05 * np.sin(Q), 0.01 + 0.0 * Q, 11.0 * Q, RIG.delay_s, RIG.actuator.range, (LAG,),
    c_sigma=0.05 + 0.0 * Q, uncertainty=Uncertainty(noise=NOISE_PX),
)  # fmt: skip


def recorded(seconds: float) -> Recording:
    moves = random_smooth(RIG.actuator, 3.0, seconds, 5)
    return run(RIG, Corrected(MODEL, "own"), moves, noise_px=NOISE_PX, seed=5).recording


def test_what_a_model_carries_is_in_what_is_predicted_while_tracking() -> None:
    made = recorded(40.0)
    carried, alone = (residuals(replay(each, [made]), [made])[0] for each in (MODEL, MODEL.alone))
    assert carried is not None and alone is not None
    assert alone > 10.0 * NOISE_PX and carried < 3.0 * NOISE_PX


def test_a_recording_cut_short_gives_the_same_rows() -> None:
    made = recorded(12.0)
    marker = made.marker
    assert marker is not None and marker.valid is not None
    kept = made.motor.t_s <= 8.0
    motor = replace(made.motor, t_s=made.motor.t_s[kept], q=made.motor.q[kept], q_cmd=None)
    frames = marker.t_s - RIG.delay_s < 7.9
    few = {name: getattr(marker, name)[frames] for name in ("t_s", "u_px", "v_px", "valid")}
    short = replace(made, motor=motor, marker=replace(marker, **few))
    whole, part = (replay(MODEL, [each]) for each in (made, short))
    assert part.rows == whole.rows[: len(part.rows)] and len(part.rows) > 100
