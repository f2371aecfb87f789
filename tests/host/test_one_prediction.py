"""One model says one thing: calibration's residuals, predict, diagnosis, the simulations and an instrument of it.

Not by a tolerance that a camera does not see, but to a millionth of a pixel: there is one play, one motion of the motor
and one clock, whoever asks.
"""

from dataclasses import replace

import numpy as np
import pytest

from tautline import effects, trajectory
from tautline.calibration.observations import observe
from tautline.calibration.simulated_track import PreparedTrack
from tautline.core.motor import MotorPath
from tautline.diagnosis.fit import Fitter
from tautline.diagnosis.segment import prepare
from tautline.elements import SINGLE, Elements
from tautline.encoder import cut, straight_lines
from tautline.friction import Friction
from tautline.geometry import project
from tautline.model import Model
from tautline.prediction import predict, times_of, write_csv
from tautline.recording import Angle, Marker, Motor, Recording
from tautline.reports import evidence
from tautline.rig import ANGLE, MARKER
from tautline.simulated.instrument import Corrected, preset, reference_rig

RIG = reference_rig()
GRID = np.linspace(-5.0, 5.0, 1025)
INSTRUMENT = preset("reference", RIG)
DELAY_S = 0.0871
GRADUAL = Elements((0.4, 0.8, 1.2, 1.6), (0.25, 0.25, 0.25, 0.25))
BOUC_WEN = Friction("bouc-wen", 0.1, 0.6, 1.5, 0.6)
SAME_PX, SAME_DEG = 1e-6, 1e-7  # some 20 px a deg


def model(elements=SINGLE, sensor=MARKER) -> Model:
    return Model(
        RIG, GRID, INSTRUMENT.backlash(GRID), np.full(len(GRID), 0.003), INSTRUMENT.bend(GRID), DELAY_S, (-4.0, 4.0),
        sensor=sensor, elements=SINGLE if isinstance(elements, Friction) else elements,
        friction=elements if isinstance(elements, Friction) else None,
    )  # fmt: skip


def readings(kind: str) -> Motor:
    """What an encoder, or none, reads of strokes while the other axes sway."""
    strokes = trajectory.trapezoids(RIG.actuator, 2.4, 3.0, 6, 20.0, 1.0).with_sway(2.0, 20.0, 17.0)
    every = slice(None, None, 4)
    t, q = strokes.t_s[every], strokes.q[every]
    count = RIG.actuator.encoder_resolution
    noise = np.random.default_rng(3).normal(0.0, 4 * count, len(q)) if kind in ("noise", "float") else 0.0
    count = {"coarse": 15 * count, "float": 1e-9}.get(kind, count)  # a servo has 4096 counts a turn
    q = q if kind == "exact" else np.round((q + noise) / count) * count
    assert strokes.translation_mm is not None and strokes.rotation_deg is not None
    return Motor(t, q, None, strokes.translation_mm[every], strokes.rotation_deg[every])


def recorded(motor: Motor) -> Recording:
    """Frames at times that are no motor sample's, with a marker and an angle somewhere."""
    rng = np.random.default_rng(4)
    t = np.arange(motor.t_s[0] + 0.31, motor.t_s[-1] - 0.2, 1 / 60) + 0.00123
    seen = project(RIG, np.interp(t, motor.t_s, INSTRUMENT.bend(motor.q)), 0.0, 0.0) + rng.normal(
        0.0, 0.05, (len(t), 2)
    )
    marker = Marker(t, seen[:, 0], seen[:, 1], np.ones(len(t), bool))
    angle = Angle(t, rng.normal(0.0, 5.0, len(t)))
    return Recording("one", motor, marker, angle, None, RIG)


@pytest.mark.parametrize("elements", [SINGLE, GRADUAL, BOUC_WEN], ids=["single", "several", "friction"])
@pytest.mark.parametrize("kind", ["counts", "coarse", "exact", "noise", "float"])
def test_all_say_the_same_of_the_marker(elements, kind):
    own, motor = model(elements), readings(kind)
    recording = recorded(motor)
    scene = recording.marker.t_s - DELAY_S
    told = predict(own, motor, scene)
    assert told.image_px is not None

    def same(image, at=slice(None)):
        np.testing.assert_allclose(image, told.image_px[at], atol=SAME_PX, rtol=0)

    # What calibration says of its model: its residuals, and so the report's figures.
    shown = evidence.collect(own, [recording])
    at = np.searchsorted(scene, shown.t_s - 1e-9)
    same(shown.seen - shown.error[evidence.STAGES.index("f_remain + B")], at)
    # The diagnosis: frozen, and the nominal that it starts from.
    segments = prepare(own, recording, [recording])
    fitter = Fitter(own, segments)
    for segment in segments:
        same(segment.predict(own, {}, 0.0)[1])
    for segment, row in zip(segments, fitter.rows(fitter.start(), fitter.no_effect), strict=True):
        same((segment.observed[segment.scored] - row.residual), segment.scored)
    # The simulation with effects, all of them absent.
    lines = straight_lines(motor, RIG.actuator.encoder_resolution)
    none = {parameter.name: 0.0 for each in effects.LIBRARY for parameter in each.amplitudes}
    same(effects.simulate(own, lines, scene, none).image_px)
    same(project(RIG, own.simulate(motor, scene), *(np.interp(scene, lines.t_s, v) for v in others(lines))))
    if elements.single:
        # The instrument of a live session without hardware, and the play of the calibration's joint fit.
        course = np.union1d(lines.t_s, scene)
        q = np.interp(course, lines.t_s, lines.q)
        path = Corrected(own, "own").course(course, q, *(np.interp(course, lines.t_s, v) for v in others(lines)))
        at_scene = np.searchsorted(course, scene)
        moved = [np.interp(scene, lines.t_s, v) for v in others(lines)]
        same(Corrected(own, "own").see(path.c_deg[at_scene], path.way[at_scene], *moved))
    track = replace(observe([recording], RIG)[0], path=MotorPath.of(motor, RIG.actuator.encoder_resolution))
    fitted = PreparedTrack.of(track).simulate(GRID, own.width, DELAY_S, elements)
    c = own.remaining(fitted.p)
    image = project(RIG, c, *track.others_at(track.scene_s(DELAY_S)))
    kept = np.searchsorted(scene, track.scene_s(DELAY_S) - 1e-9)
    known = fitted.known
    if isinstance(elements, Friction):  # it forgets where it started by and by: to a hundredth of the noise at first
        np.testing.assert_allclose(image[known], told.image_px[kept][known], atol=5e-3, rtol=0)
        known = known & (np.cumsum(known) > len(known) // 3)
    np.testing.assert_allclose(image[known], told.image_px[kept][known], atol=SAME_PX, rtol=0)


def others(motor: Motor):
    return motor.translation_mm, motor.rotation_deg


def test_all_say_the_same_of_an_angle():
    own, motor = model(sensor=ANGLE), readings("counts")
    recording = replace(recorded(motor), marker=None)
    scene = recording.angle.t_s - DELAY_S
    told = predict(own, motor, scene).c_deg
    (segment, _) = prepare(own, recording, [recording])
    stride = round(len(scene) / len(segment.arrival_s))
    np.testing.assert_allclose(segment.predict(own, {}, 0.0)[1][:, 0], told[::stride], atol=SAME_DEG, rtol=0)
    np.testing.assert_allclose(own.simulate(motor, scene), told, atol=SAME_DEG, rtol=0)


def test_the_file_that_predict_writes_is_what_it_says(tmp_path):
    own, motor = model(), readings("counts")
    times = times_of(own, tmp_path, motor)
    told = predict(own, motor, times.scene_s)
    write_csv(tmp_path / "told.csv", times, told)
    written = np.genfromtxt(tmp_path / "told.csv", delimiter=",", names=True)
    assert np.abs(written["c_deg"] - told.c_deg).max() <= 0.5e-6 + 1e-12
    assert told.image_px is not None
    assert np.abs(written["u_px"] - told.image_px[:, 0]).max() <= 0.5e-4 + 1e-9


def test_a_diagnosis_of_what_the_model_says_finds_nothing_to_correct():
    """Frames made by `predict` leave the diagnosis' nominal nothing: its recalibration stays where it starts."""
    own, motor = model(), readings("counts")
    recording = recorded(motor)
    told = predict(own, motor, recording.marker.t_s - DELAY_S).image_px
    assert told is not None
    seen = replace(recording, marker=replace(recording.marker, u_px=told[:, 0], v_px=told[:, 1]))
    fitter = Fitter(own, prepare(own, seen, [seen]))
    fitter.floor = 1e-3
    base = fitter.nominal()
    assert max(float(np.abs(r).max()) for r in base.residuals) < SAME_PX
    assert abs(base.state.model.delay_s - DELAY_S) < 1e-9
    assert np.abs(base.state.model.width - own.width).max() < 1e-7


@pytest.mark.parametrize("kind", ["counts", "coarse", "exact", "noise", "float"])
def test_another_horizon_is_the_same_within_what_is_known(kind):
    """What was read by then decides, bit for bit; later readings move the path by no more than its sigma says."""
    motor = readings(kind)
    until = 0.7 * motor.t_s[-1]
    early, whole = (MotorPath.of(motor, RIG.actuator.encoder_resolution, until_s) for until_s in (until, np.inf))
    again = MotorPath.of(cut(motor, until), RIG.actuator.encoder_resolution)
    assert np.array_equal(early.lines.t_s, again.lines.t_s) and np.array_equal(early.lines.q, again.lines.q)
    at = np.linspace(motor.t_s[0], early.readings.t_s[-1], 5000)
    away = np.abs(early.at(at) - whole.at(at))
    sigma = np.hypot(early.sigma_at(at), whole.sigma_at(at))
    print(f"{kind}: {1e3 * np.quantile(away, 0.99):.3f} um away, sigma {1e3 * np.median(sigma):.3f}")
    assert (away <= 2.0 * sigma + 1e-9).mean() > 0.99
