"""What a tracker makes of a recording's begin, and of what it saw before: another posture, a hand, another blob."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tautline.model import Model, Uncertainty
from tautline.recording import Angle, Motor, Recording
from tautline.rig import Actuator, Coarse, Rig
from tautline.tracking import Row, State, replay
from tools.tracking.sessions import Instrument, ideal_model, session

GRID = np.linspace(-5.0, 5.0, 201)
WIDTH, NOISE = 0.5, 0.01  # mm, deg
STEP_S = 0.005
MODEL = Model(
    Rig(Actuator("mm", (-5.0, 5.0), 0.001), Coarse(12.0, 0.0)),
    GRID,
    np.full(len(GRID), WIDTH),
    np.full(len(GRID), 0.001),
    12.0 * GRID,
    0.0,
    (-4.7, 4.7),
    sensor="angle",
    uncertainty=Uncertainty(noise=NOISE),
)


def used(q: np.ndarray, width: np.ndarray | float = WIDTH, offset: float = 0.0, moved=np.zeros_like) -> Recording:
    """A joint with this B and offset led along q (n,); moved(t): by how many deg something else moves its tip."""
    t_s, p, place = STEP_S * np.arange(len(q)), float(q[0] + offset), []
    for motor, half in zip((q + offset).tolist(), (0.5 * width * np.ones(len(q))).tolist(), strict=True):
        p = min(max(p, motor - half), motor + half)
        place.append(p)
    frames = slice(3, None, 8)
    scene = t_s[frames]
    c = 12.0 * np.array(place)[frames] + moved(scene) + NOISE * np.random.default_rng(0).normal(size=len(scene))
    return Recording("use", Motor(t_s, np.round(q, 3)), angle=Angle(scene, c), rig=MODEL.rig)


def there_and_back(seconds: float, period_s: float = 8.0) -> np.ndarray:
    """Straight strokes of 6 mm about 0, from 0 on."""
    phase = np.arange(0.0, seconds, STEP_S) / period_s + 0.25
    return 6.0 * np.abs(phase % 1.0 * 2.0 - 1.0) - 3.0


def off_deg(rows: list[Row], recording: Recording) -> np.ndarray:
    return np.abs(np.array([row.c_deg for row in rows]) - recording.angle.c_deg)


@pytest.mark.parametrize("offset", [0.9, -0.9])
def test_what_a_law_leaves_is_not_added_to_the_one_that_is_learnt(offset: float) -> None:
    """A posture that an offset of less than two B holds: learnt from one sweep."""
    recording = used(np.concatenate([np.zeros(200), there_and_back(20.0)]), offset=offset)
    rows = replay(MODEL, [recording]).rows
    adapting = next(i for i, row in enumerate(rows) if row.state is State.ADAPTING)
    assert rows[adapting].offset == pytest.approx(offset, abs=0.01)
    assert off_deg(rows, recording)[adapting:].max() < 6.0 * NOISE


@pytest.mark.parametrize("offset", [1.6, -1.6])
@pytest.mark.parametrize("at", [-2.0, 2.0])
def test_an_offset_of_more_than_two_widths_is_taken_from_five_frames(offset: float, at: float) -> None:
    recording = used(at + np.concatenate([np.zeros(200), 0.5 * there_and_back(20.0)]), offset=offset)
    rows = replay(MODEL, [recording]).rows
    assert [row.state for row in rows[:6]].count(State.ADAPTING) == 1
    assert (
        off_deg(rows, recording)[5:60].max() < 0.5 * WIDTH * 12.0 + 6.0 * NOISE
    )  # it may lie on either side of the play
    assert rows[-1].offset == pytest.approx(offset, abs=0.01)


def test_a_blob_that_is_off_the_markers_track_is_no_posture() -> None:
    instrument = Instrument(1)
    recording = session(instrument, "nothing", 1, 6.0).recording
    marker = recording.marker
    blob = replace(
        marker, u_px=marker.u_px[0] + 80.0 + 0.0 * marker.u_px, v_px=marker.v_px[0] + 60.0 + 0.0 * marker.v_px
    )
    rows = replay(ideal_model(instrument), [replace(recording, marker=blob)]).rows
    assert {row.offset for row in rows} == {0.0}


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize("seconds", [0.5, 4.0])
def test_after_another_blob_the_model_holds_as_soon_as_it_foretells_again(held: bool, seconds: float) -> None:
    """As far as one that moves along, or one that stays."""
    instrument = Instrument(4)
    recording = session(instrument, "nothing", 4, 20.0).recording
    marker = recording.marker
    blob = (marker.t_s > 10.0) & (marker.t_s < 10.0 + seconds)
    u_px, v_px = (np.where(blob, 300.0, of) if held else of + 50.0 * blob for of in (marker.u_px, marker.v_px))
    tracked = replay(ideal_model(instrument), [replace(recording, marker=replace(marker, u_px=u_px, v_px=v_px))])
    trusted = np.array([row.state is State.TRUSTED for row in tracked.rows])
    during = blob & (tracked.t_s > 10.3)
    assert not trusted[during].any()
    assert trusted[(tracked.t_s < 10.0) | (tracked.t_s > 11.5 + seconds)].all()
    assert {(row.offset, row.scale) for row in tracked.rows} == {(0.0, 1.0)}


@pytest.mark.parametrize("in_another_recording", [False, True])
def test_a_hand_on_a_resting_tip_is_over_once_the_motor_moved_for_long(in_another_recording: bool) -> None:
    """Then a narrower B is dialled down as soon as without."""
    rest, move = np.zeros(1000), there_and_back(64.0)
    before = np.zeros(len(rest) + len(move)) + STEP_S * np.arange(len(rest) + len(move))
    narrow = 45.0
    hand = used(
        np.concatenate([rest, move]),
        np.where(before < narrow, WIDTH, 0.6 * WIDTH),
        moved=lambda t: np.where(t < 5.0, 1.0 - np.cos(2.0 * t), 0.0),
    )
    if in_another_recording:
        cut = int(5.0 / STEP_S)
        motor, angle = hand.motor, hand.angle
        seen = angle.t_s < 5.0
        first = replace(
            hand,
            motor=Motor(motor.t_s[:cut], motor.q[:cut]),
            angle=Angle(angle.t_s[seen], angle.c_deg[seen]),
        )
        then = used(move, np.where(STEP_S * np.arange(len(move)) < narrow - 5.0, WIDTH, 0.6 * WIDTH))
        tracked = replay(MODEL, [first, then])
        began = tracked.t_s + 5.0 * tracked.recording
    else:
        tracked = replay(MODEL, [hand])
        began = tracked.t_s
    down = next(t for t, row in zip(began.tolist(), tracked.rows, strict=True) if row.scale < 0.9)
    assert narrow < down < narrow + 2.5


@pytest.mark.parametrize("seed", range(6))
def test_a_width_that_is_less_than_the_noise_makes_no_posture_of_noise(seed: int) -> None:
    recording = used(np.zeros(400), 0.002)
    noisy = 0.3 * np.random.default_rng(seed).normal(size=len(recording.angle.c_deg))  # deg: 0.025 mm
    recording = replace(recording, angle=replace(recording.angle, c_deg=recording.angle.c_deg + noisy))
    model = replace(MODEL, width=np.full(len(GRID), 0.002), uncertainty=Uncertainty(noise=0.3))
    assert {row.offset for row in replay(model, [recording]).rows} == {0.0}
