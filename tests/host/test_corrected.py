"""A corrected model: the same effects in predictions, in the simulated instrument and before the board's tables."""

from dataclasses import replace

import numpy as np
import pytest

from tautline import effects, trajectory
from tautline.diagnosis.diagnose import _corrected_model
from tautline.diagnosis.fitted import Fit, Hypothesis, ParameterState
from tautline.diagnosis.segment import Segment
from tautline.effects import BY_ID, LIBRARY
from tautline.errors import TautError
from tautline.model import Effect, Model
from tautline.prediction import predict
from tautline.recording import Motor
from tautline.simulated import simulate
from tautline.simulated.instrument import Corrected, of_name, preset, reference_rig

RIG = reference_rig()
GRID = np.linspace(-5.0, 5.0, 401)
MODEL = Model(
    RIG,
    GRID,
    preset("reference").backlash(GRID),
    np.full(401, 0.003),
    preset("reference").bend(GRID),
    0.08,
    (-4.0, 4.0),
)
T = np.arange(0.0, 40.0, 0.004)
LAST = Motor(
    T,
    4.0 * np.sin(2 * np.pi * T / 11.0),
    None,
    1.5 * np.sin(2 * np.pi * T / 13.0),
    20.0 * np.cos(2 * np.pi * T / 17.0),
    25.0 + 8.0 * np.sin(2 * np.pi * T / 9.0),
    {"wrist_deg": 15.0 * np.sin(2 * np.pi * T / 7.0)},
)
OF_A_JOINT = BY_ID["configuration.axis_coupling"].of_joint("wrist_deg")
OFFSET, LOAD = 120.0, 25.0  # when the last test began in the session; the calibration's load
SHAPES = {"encoder_period": 0.7, "asymmetry_travel": 0.4, "creep_time": 1.0, "contact_c": 15.0, "shift_time": 140.0}
SHAPES |= {"slip_time_1": -1e3, "slip_time_4": 140.0}


def values(kind) -> dict[str, float]:
    """The effect at three times what a user would notice; an encoder's error so small that its reading still rises."""
    span = RIG.actuator.span
    times = 0.5 if kind.stage == "actuator" else 3.0
    sizes = {p.name: times * p.scale * (span if p.unit.startswith("unit") else 1.0) for p in kind.amplitudes}
    column = {"column": kind.column} if kind.column else {}
    return sizes | column | {p.name: SHAPES.get(p.name, p.shape[0] if p.shape else p.scale) for p in kind.shapes}


def corrected(kind) -> Model:
    state = ParameterState(MODEL, {}, values(kind))
    segment = Segment("last", LAST, T, np.zeros((len(T), 2)), T > 5.0, OFFSET, False)
    model = _corrected_model(Fit(Hypothesis((kind,), (True,)), state, []), segment)
    return replace(model, load_reference_mNm=LOAD)


@pytest.mark.parametrize("kind", (*LIBRARY, OF_A_JOINT), ids=lambda kind: kind.column or kind.id)
def test_predictions_carry_the_effect_as_it_is_at_the_end_of_the_last_test(kind, tmp_path):
    """Saved, loaded, predicted: what the library's simulation says of a motion that begins when the session ends. A
    drift has gone as far as it had by then, and a shift has happened."""
    corrected(kind).save(tmp_path)
    model = Model.load(tmp_path)
    scene = np.arange(8.0, 38.0, 0.04)
    expected = {name: value for name, value in values(kind).items() if name not in effects.SCATTERS}
    if kind.id == "transmission.drift":  # frozen where the session ended: compared within half a second of it
        now = np.arange(18.5, 19.5, 0.02)
        ended = OFFSET + float(T[-1])
        said = effects.simulate(MODEL, LAST, now, expected, clock_offset_s=ended - 19.0)
        plain = effects.simulate(MODEL, LAST, now, {})
        assert np.abs(said.image_px - plain.image_px).max() > 5.0
        assert predict(model, LAST, now).image_px == pytest.approx(said.image_px, abs=0.2)
        return
    said = effects.simulate(MODEL, LAST, scene, expected, load_reference=LOAD, clock_offset_s=OFFSET + 40.0)
    asked = scene - (model.delay_s - MODEL.delay_s)  # arrival minus the corrected delay
    told = predict(model, LAST, asked)
    assert told.image_px is not None
    assert told.image_px == pytest.approx(said.image_px, abs=0.03)  # the motor as straight lines
    if expected:
        plain = effects.simulate(MODEL, LAST, scene, {}, load_reference=LOAD)
        assert np.abs(told.image_px - plain.image_px).max() > 0.1


def test_columns_that_are_missing_count_as_at_rest():
    """Without a load column the load is the calibration's; without the other axes they stand at 0."""
    bare = replace(LAST, translation_mm=None, rotation_deg=None, load_mNm=None)
    scene = np.arange(8.0, 38.0, 0.04)
    plain = predict(MODEL, bare, scene).image_px
    for name in ("transmission.load_dependence", "configuration.axis_coupling"):
        assert predict(corrected(BY_ID[name]), bare, scene).image_px == pytest.approx(plain, abs=0.03)


@pytest.mark.parametrize("kind", LIBRARY, ids=lambda kind: kind.id)
def test_the_simulated_instrument_does_what_the_corrected_model_predicts(kind, tmp_path):
    model = corrected(kind)
    model.save(tmp_path)
    instrument = of_name(str(tmp_path))
    assert isinstance(instrument, Corrected)
    motion = trajectory.trapezoids(RIG.actuator, 0.9, 2.6, 2, 8.0, 0.8).with_sway(2.0, 20.0, 20.0)
    made = simulate.run(instrument.rig, instrument, motion, noise_px=0.0)
    assert instrument.rig.camera.delay_s == pytest.approx(model.delay_s)
    exact = replace(made.recording.motor, q=motion.q)
    marker = made.recording.marker
    late = made.scene_s > 4.0
    seen = np.column_stack([marker.u_px, marker.v_px])[late]
    own_camera = kind.id in ("acquisition.clock_rate", "acquisition.held_samples")
    told = predict(replace(model, effects=()) if own_camera else model, exact, made.scene_s[late]).image_px
    if not kind.event or own_camera:
        assert seen == pytest.approx(told, abs=0.05)
    elif kind.id == "transmission.stick_slip":
        assert 0.1 < np.sqrt(np.mean((seen - told) ** 2)) < 20.0
    else:
        assert instrument.jitter_s == pytest.approx(0.015)


def test_a_call_for_every_step_is_one_call_for_all():
    """The live set-up asks piece by piece; what is past is kept as corners only."""
    rng = np.random.default_rng(5)
    for name in ("transmission.lag", "transmission.smooth_onset", "transmission.stick_slip", "transmission.creep"):
        instrument = Corrected(corrected(BY_ID[name]), name)
        whole = instrument.move(T, LAST.q)
        instrument.reset()
        parts = np.split(np.arange(len(T)), np.sort(rng.choice(len(T), 60, replace=False)))
        pieces = np.concatenate([instrument.move(T[at], LAST.q[at]) for at in parts])
        assert pieces == pytest.approx(whole, abs=0.02), name


def test_a_name_that_is_neither_preset_nor_model_is_refused(tmp_path):
    with pytest.raises(TautError, match="or a model's folder"):
        of_name(str(tmp_path / "nothing"))


def test_what_the_tables_carry_and_what_they_cannot():
    carried = {kind.id for kind in LIBRARY if kind.on_board}
    assert "transmission.drift" in carried and "registration.static" in carried
    assert {"transmission.lag", "transmission.load_dependence", "transmission.smooth_onset"} <= carried
    left = {"configuration.contact", "configuration.swing", "transmission.stick_slip"}
    assert not carried & (left | {"acquisition.jitter", "acquisition.held_samples"})


def test_flash_wants_to_be_told_before_it_leaves_an_effect_out(tmp_path, taut):

    contact = Effect("configuration.contact", {"contact_hold": 0.5, "contact_c": 20.0})
    replace(MODEL, effects=(contact,)).save(tmp_path / "model")
    done = taut("flash", tmp_path / "model", "--board", "usbip:127.0.0.1:1")
    assert done.code == 1 and done.err.count("\n") == 1
    assert "no table can undo configuration.contact" in done.err and "--without-effects" in done.err


def test_sides_that_begin_anew_after_rests_are_left_out_by_no_command(tmp_path, taut):
    law = {"asymmetry": 0.1, "asymmetry_travel": 0.3, "asymmetry_form": 1.0, "asymmetry_renewed": 1.0}
    replace(MODEL, effects=(Effect("transmission.asymmetric_backlash", law),)).save(tmp_path / "model")
    done = taut("flash", tmp_path / "model", "--board", "usbip:127.0.0.1:1")
    assert done.code == 1 and "127.0.0.1:1" in done.err and "undo" not in done.err  # it comes as far as the board
    (tmp_path / "c.csv").write_text("t_s,c_deg\n0,0\n1,10\n")
    done = taut("compensate", tmp_path / "model", "--trajectory", tmp_path / "c.csv", "--csv", tmp_path / "o.csv")
    assert done.code == 0 and "undo" not in done.err
    told = taut("explain", "transmission.asymmetric_backlash")
    assert "The board's tables can carry it." in " ".join(told.out.split())


@pytest.mark.parametrize(
    ("effect", "said"),
    [
        (Effect("transmission.rate_dependent_backlash", {"speed_exponent": 0.5}), "speed_exponent"),
        (Effect("transmission.gremlins", {"many": 3.0}), "gremlins"),
    ],
)
def test_an_effect_of_another_version_is_refused_not_ignored(tmp_path, effect, said, taut):

    replace(MODEL, effects=(effect,)).save(tmp_path / "model")
    (tmp_path / "motor.csv").write_text("t_s,q_mm\n" + "".join(f"{0.1 * i},{0.01 * i}\n" for i in range(50)))
    for rest in (("predict", tmp_path, "--csv", tmp_path / "out.csv"), ("flash", "--board", "usbip:127.0.0.1:1")):
        done = taut(rest[0], tmp_path / "model", *rest[1:])
        assert done.code == 1 and done.err.count("\n") == 1
        assert said in done.err and "diagnose again" in done.err


def test_flash_wants_to_know_which_axis_couples_in(tmp_path, taut):

    coupling = Effect("configuration.axis_coupling", {"c_per_translation": 0.5, "c_per_rotation": 0.0})
    replace(MODEL, effects=(coupling,)).save(tmp_path / "model")
    done = taut("flash", tmp_path / "model", "--board", "usbip:127.0.0.1:1")
    assert done.code == 1 and "without --joint" in done.err
    done = taut("flash", tmp_path / "model", "--board", "usbip:127.0.0.1:1", "--joint", "translation_mm=1")
    assert done.code == 2 and "translation_mm=1:0.001" in done.err


def test_the_next_motion_stays_within_the_rig_and_asks_for_no_axis_that_never_moved():
    from tautline.diagnosis import motion
    from tautline.diagnosis.fit import Fitter
    from tautline.diagnosis.information import Rivals

    for others in (True, False):
        made = LAST if others else replace(LAST, translation_mm=None, rotation_deg=None)
        segment = Segment("last", made, T[::10], np.zeros((len(T[::10]), 2)), T[::10] > 12.0, 0.0, False)
        fitter = Fitter(MODEL, [segment, segment])
        start = fitter.start()
        fits = [
            Fit(Hypothesis((BY_ID[name],), (True,)), replace(start, values=values(BY_ID[name])), [])
            for name in ("transmission.lag", "kinematics.nonconstant_curvature")
        ]
        rivals = Rivals.of([Fit(fitter.no_effect, start, []), *fits], [0.0, 0.5, 0.5, 0.0])
        found = motion.plan_best_motion(fitter, rivals)
        table = motion.table(found.motion, "mm")
        low, high = RIG.actuator.range
        assert table["q_mm"].between(low, high).all()
        assert np.abs(np.diff(table["q_mm"]) / np.diff(table["t_s"])).max() <= 1.05 * max(
            np.abs(np.gradient(LAST.q, LAST.t_s)).max(), 0.02 * RIG.actuator.span
        )
        assert ("translation_mm" in table) <= others
