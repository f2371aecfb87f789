"""taut diagnose: what the recordings say, and nothing that they do not."""

import json
import pickle
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from slices import some

from tautline import effects, trajectory
from tautline.calibration.calibrate import calibrate
from tautline.diagnosis import narration
from tautline.diagnosis.candidates import Search
from tautline.diagnosis.diagnose import _corrected_model, diagnose
from tautline.diagnosis.fit import Fitter
from tautline.diagnosis.fitted import Fit, Hypothesis
from tautline.diagnosis.segment import prepare
from tautline.effects import LIBRARY, STAGES
from tautline.errors import TautError
from tautline.model import Model
from tautline.prediction import foretold, predict
from tautline.recording import Marker, Recording, save
from tautline.simulated import simulate
from tautline.simulated.instrument import preset, reference_rig
from tools.blindtest import cases
from tools.blindtest.generators import GENERATORS

NOISE = 0.05
RIG = reference_rig()
GRID = np.linspace(-5.0, 5.0, 401)


def rms(values) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def true_model() -> Model:
    instrument = preset("reference", RIG)
    return Model(RIG, GRID, instrument.backlash(GRID), np.full(401, 0.003), instrument.bend(GRID), 0.08, (-4.0, 4.0))


def recordings(parameters=None, seed=3, loads_mNm=None) -> list[Recording]:
    """A calibration, a test and a further motion; the effect holds after the calibration, but a load's throughout."""
    rng = np.random.default_rng(seed)
    model = true_model()
    actuator = RIG.actuator
    motions = [
        trajectory.back_and_forth(actuator, [0.8], 2.0, 12, 6.0),
        trajectory.trapezoids(actuator, 0.9, 2.6, 5, 8.0, 0.8).with_sway(2.0, 20.0, 20.0),
        trajectory.sines(actuator, 1.5, 30.0).with_sway(1.5, 15.0, 13.0),
    ]
    made, clock = [], 0.0
    for i, motion in enumerate(motions):
        recording = simulate.simulate(RIG, preset("reference", RIG), motion, seed=seed + i)
        t = recording.marker.t_s
        values = parameters if parameters and i else {}
        reference = 0.0
        if loads_mNm:
            load = np.full_like(recording.motor.t_s, loads_mNm[i])
            recording, reference = replace(recording, motor=replace(recording.motor, load_mNm=load)), loads_mNm[0]
        path = effects.simulate(model, recording.motor, t - 0.08, values, None, reference, clock_offset_s=clock)
        seen = path.image_px + rng.normal(0.0, NOISE, (len(t), 2))
        made.append(replace(recording, marker=Marker(t, seen[:, 0], seen[:, 1], np.ones(len(t), bool)), rig=RIG))
        clock += recording.motor.t_s[-1]
    return made


def diagnosed(parameters=None):
    """Once for each effect: nothing of it is changed by who reads it."""
    return _diagnosed(tuple((parameters or {}).items()))


@cache
def _diagnosed(parameters):
    made = recordings(dict(parameters))
    return diagnose(true_model(), made[0], made[1:2]), made


def test_nothing_is_called_nothing():
    found, _ = diagnosed()
    document = found.document
    assert document["verdict"] == "none" and document["effects"] == []
    assert document["probability_none"] > 0.8
    assert document["noise_floor"] == pytest.approx(NOISE, rel=0.1)
    assert document["gap"]["before"] == pytest.approx(NOISE, rel=0.1)
    assert document["gap"]["after_ci"] == document["gap"]["before_ci"]
    assert document["gap"]["after"] == document["gap"]["before"] and document["gap"]["shrink"] == 0.0


@pytest.mark.parametrize(("calibration_px", "tests_px"), [(0.0, 0.12), (0.0, 0.4), (0.4, 0.0)])
@pytest.mark.parametrize("parameters", [None, {"lag": 0.1}])
def test_another_light_is_no_cause_and_hides_none(calibration_px, tests_px, parameters):
    """The sensor's noise is another one in the tests than while calibrating."""
    rng = np.random.default_rng(9)

    def noisier(recording: Recording, px: float) -> Recording:
        marker = recording.marker
        u_px, v_px = (at + rng.normal(0.0, px, len(at)) for at in (marker.u_px, marker.v_px))
        return replace(recording, marker=replace(marker, u_px=u_px, v_px=v_px))

    calibration, *tests = recordings(parameters)
    first, later = noisier(calibration, calibration_px), [noisier(test, tests_px) for test in tests]
    found = diagnose(true_model(), first, later[:1]).document
    assert [effect["id"] for effect in found["effects"]] == (["transmission.lag"] if parameters else []), found
    assert found["verdict"] == ("effect" if parameters else "none")
    assert parameters or ("times that of the calibration" in narration.sentence(found)) == (tests_px > 0.1)


def shifted(recording: Recording, later_s: float) -> Recording:
    """The same recording, begun later on its clock."""
    motor, marker = recording.motor, recording.marker
    return replace(
        recording,
        motor=replace(motor, t_s=motor.t_s + later_s),
        marker=replace(marker, t_s=marker.t_s + later_s),
    )


def test_what_differs_by_recording_is_told_of_the_latest_in_whatever_order_they_are_given():
    calibration, first = recordings({"offset": 0.15})[:2]
    second = recordings({"offset": -0.25})[2]
    first = shifted(first, calibration.motor.t_s[-1] + 1.0)
    second = shifted(second, first.motor.t_s[-1] + 1.0)
    found = diagnose(true_model(), calibration, [second, first])
    assert [(f.id, f.since) for f in found.findings] == [("transmission.offset", "recording")]
    assert found.findings[0].parameters["offset"] == pytest.approx(-0.25, abs=0.02)
    assert np.mean(found.corrected.q - GRID) == pytest.approx(0.25, abs=0.02)  # in the model that is handed out too


def test_another_blob_that_is_followed_for_a_while_says_nothing_of_the_tip():
    """Two reflections and the law of the whole: without them left out it is unknown."""
    calibration, test = recordings({"lag": 0.08})[:2]
    px = np.column_stack([test.marker.u_px, test.marker.v_px])
    for begin, frames, away in ((150, 30, (60.0, -35.0)), (len(px) - 150, 12, (-25.0, -70.0))):
        here = slice(begin, begin + frames)
        px[here] = 0.6 * px[here] + 0.4 * px.mean(axis=0) + away
    marker = replace(test.marker, u_px=px[:, 0], v_px=px[:, 1])
    found = diagnose(true_model(), calibration, [replace(test, marker=marker)])
    assert [finding.id for finding in found.findings] == ["transmission.lag"]
    assert found.gap.after < 1.2 * NOISE


@pytest.mark.parametrize(
    "parameters",
    some(
        [
            {"lag": 0.08},
            {"k1": 0.15, "p1": 0.01},
            {"c_per_translation": 0.4, "c_per_rotation": 0.03},
            {"creep_share": 0.12, "creep_time": 1.5},
        ],
        2,
    ),
    ids=lambda p: next(iter(p)),
)
def test_a_known_effect_is_named_and_sized(parameters):
    found, made = diagnosed(parameters)
    document = found.document
    kind = next(k for k in LIBRARY if next(iter(parameters)) in {p.name for p in k.amplitudes})
    assert document["verdict"] == "effect"
    assert document["effects"][0]["id"] == kind.id, document["candidates"][:3]
    assert document["where"]["stage"] == kind.stage
    assert document["gap"]["closable_shrink"] > 0.9
    assert document["gap"]["shrink_ci"][0] <= document["gap"]["shrink"] <= document["gap"]["shrink_ci"][1]
    typed, gap = found.findings[0], found.gap
    assert found.verdict == "effect" and (typed.id, typed.stage, typed.since) == (kind.id, kind.stage, "calibration")
    assert pickle.loads(pickle.dumps(typed)) == typed != found.findings[1:] and len(repr(typed)) < 400
    assert gap.after < gap.before and gap.unit == "px" and gap.before_ci[0] <= gap.before <= gap.before_ci[1]
    likely = found.probabilities
    assert next(iter(likely)) == kind.id and sum(likely.values()) == pytest.approx(1.0)
    named = document["effects"][0]["parameters"]
    for name, value in parameters.items():
        assert named[name] == pytest.approx(value, rel=0.3, abs=0.01), name
    # On a motion that the diagnosis never saw, most of the gap is gone too.
    further = made[2]
    scene = further.marker.t_s - found.nominal.delay_s
    late = scene > 8.0
    seen = np.column_stack([further.marker.u_px, further.marker.v_px])[late]
    before = rms(seen - predict(found.nominal, further.motor, scene[late]).image_px)
    scene = further.marker.t_s - found.corrected.delay_s
    after = rms(seen - predict(found.corrected, further.motor, scene[late]).image_px)
    assert after < 0.5 * before, (before, after)


@pytest.mark.parametrize(
    ("parameters", "named"),
    [
        ({"offset": 0.08}, "transmission.offset"),
        ({"offset_per_load": 0.006}, "transmission.load_dependence"),
    ],
    ids=("offset", "load"),
)
def test_a_load_that_was_recorded_comes_first_only_where_it_explains(parameters, named):
    """Each recording has another load. What goes with it is the load's; an offset that does not is one."""
    made = recordings(parameters, loads_mNm=(12.0, 24.0, 17.0))
    document = diagnose(true_model(), made[0], made[1:]).document
    assert [effect["id"] for effect in document["effects"]] == [named], document["candidates"][:3]
    assert document["gap"]["closable_shrink"] > 0.9


def test_a_shift_that_takes_its_time_is_nothing_else_besides():
    """It slips within a fifth of a second: no image of that time is where it was before or is after."""
    before, after = recordings(), recordings({"shift_rx": 0.6, "shift_ry": -0.8, "shift_y": 0.4, "shift_time": -1e3})
    one, other = before[1].marker, after[1].marker
    share = 1.0 / (1.0 + np.exp(-(one.t_s - 0.08 - 17.3) / 0.05))
    marker = replace(
        one,
        u_px=one.u_px + share * (other.u_px - one.u_px),
        v_px=one.v_px + share * (other.v_px - one.v_px),
    )
    document = diagnose(true_model(), before[0], [replace(before[1], marker=marker)]).document
    assert [effect["id"] for effect in document["effects"]] == ["registration.shift"]


def test_counts_that_were_lost_are_a_slip_and_mended_by_it():
    """By what they are, and not by the library: the motor is elsewhere than the encoder says, twice in one recording.
    The further motion begins where that left it."""
    actuator = RIG.actuator
    plain = recordings()
    lost = np.array([11.3, 22.6]), np.array([0.06, -0.15])  # s, mm

    def with_lost(motion, calibrated, seed):
        gone = np.array([lost[1][lost[0] <= t].sum() for t in motion.t_s]) if calibrated is plain[1] else lost[1].sum()
        moved = simulate.simulate(
            RIG, preset("reference", RIG), replace(motion, q=motion.q + gone), noise_px=NOISE, seed=seed
        )
        return replace(moved, motor=calibrated.motor)

    test = with_lost(trajectory.trapezoids(actuator, 0.9, 2.6, 5, 8.0, 0.8).with_sway(2.0, 20.0, 20.0), plain[1], 4)
    further = with_lost(trajectory.sines(actuator, 1.5, 30.0).with_sway(1.5, 15.0, 13.0), plain[2], 5)
    found = diagnose(true_model(), plain[0], [test])
    assert [effect["id"] for effect in found.document["effects"]] == ["transmission.slip"], found.document["candidates"]
    told = found.document["effects"][0]["parameters"]
    slips = sorted((told[f"slip_time_{i}"], told[f"slip_{i}"]) for i in (1, 2))
    assert [size for _, size in slips] == pytest.approx([0.06, -0.15], abs=0.01)
    before, after = (foretold(model, further, found.nominal) for model in (found.nominal, found.corrected))
    assert after < 1.3 * NOISE < 0.2 * before


@pytest.mark.long
def test_what_sticking_holds_back_is_predicted():
    """Of the second instrument, whose grip scatters: after the calibration the play is wider in the mean."""
    case = cases.make(20915, "single", ("transmission.stick_slip",))
    assert not case.label.throughout
    found = diagnose(calibrate([case.calibration], case.rig).model, case.calibration, case.tests)
    named = found.document["effects"][0]
    assert named["id"] == "transmission.stick_slip"
    assert 0.0 < named["parameters"]["mean_stick_lag"] < 3.0 * case.label.values["static_grip"]
    gap = found.document["gap"]
    assert gap["after_ci"][1] < 0.8 * gap["before_ci"][0] and gap["shrink_ci"][0] > 0.0
    shrinks = f"shrinks the gap by {narration.percent(gap['shrink'])}"
    assert shrinks in narration.sentence(found.document)
    assert any("predict" in step.command for step in narration.steps(found.document, "here"))


def test_the_command_writes_what_the_format_says(tmp_path, taut):

    moves = {"shift_rx": 0.5, "shift_x": 0.3, "shift_y": -0.2, "shift_time": 60.0}
    made = recordings(moves)
    for i, recording in enumerate(made):
        save(recording, tmp_path / f"r{i}")
    RIG.save(tmp_path / "rig.toml")
    out = tmp_path / "out"
    done = taut("diagnose", tmp_path / "r0", tmp_path / "r1", "--rig", tmp_path / "rig.toml", "--out", out, "--json")
    assert done.code == 0, done.err
    document = json.loads(done.out)
    assert document == json.loads((out / "diagnosis.json").read_text())
    assert document["format"] == "diagnosis/1" and document["unit"] == "px"
    assert document["verdict"] == "effect" and document["effects"][0]["id"] == "registration.shift"
    assert set(document["gap"]) == {
        *("before", "after", "before_ci", "after_ci", "shrink", "shrink_ci", "closable_shrink"),
    }
    assert document["gap_recalibrated"]["before"] > 0
    assert len(document["count"]) == 4 and sum(document["count"]) == pytest.approx(1.0)
    for effect in document["effects"]:
        assert set(effect) == {
            *("id", "probability", "since", "parameters", "shrink"),
            *("swallowed_by_recalibration", "loads_on_board", "ambiguous_with"),
        }
    assert document["moved"] == [] and document["effects"][0]["since"] == "calibration"
    applicable = {kind.id for kind in LIBRARY if kind.needs not in ("load", "simulator")}
    assert {c["id"] for c in document["candidates"]} == applicable
    assert all(set(c) == {"id", "probability", "shrink", "identifiable"} for c in document["candidates"])
    total = sum(c["probability"] for c in document["candidates"])
    assert total + document["probability_none"] + document["probability_unknown"] == pytest.approx(1.0)
    assert document["where"]["stage"] in STAGES
    assert all(set(c) == {"axis", "share", "range", "says"} for c in document["where"]["conditions"])
    assert document["next_motion"]["why"] and (out / document["next_motion"]["file"]).exists()
    page = (out / "report.html").read_text()
    assert "registration.shift" in page and f"taut predict {out}/corrected" in page
    for name in ("nominal", "corrected"):
        scored = taut("predict", out / name, tmp_path / "r2", "--csv", tmp_path / f"{name}.csv")
        assert scored.code == 0, scored.err
    errors = {}
    for name in ("nominal", "corrected"):
        said = np.loadtxt(tmp_path / f"{name}.csv", delimiter=",", skiprows=1)
        seen = np.column_stack([made[2].marker.u_px, made[2].marker.v_px])
        errors[name] = rms((said[:, 2:4] - seen)[said[:, 0] > 8.0])
    assert errors["corrected"] < 0.3 * errors["nominal"], errors


def test_too_short_a_motion_is_refused_in_one_line():
    made = recordings()
    t = made[1].motor.t_s
    still = replace(made[1], motor=replace(made[1].motor, q=np.zeros(len(t))))
    with pytest.raises(Exception, match="full backlash both ways"):
        diagnose(true_model(), made[0], [still])


def test_a_sensor_that_counts_has_the_noise_of_its_step():
    from tautline.diagnosis import gap
    from tautline.diagnosis.segment import Segment
    from tautline.recording import Motor

    t = np.arange(0.0, 20.0, 0.01)
    q = 30.0 * np.sin(0.5 * np.minimum(t, 10.0))
    observed = np.round(q / 0.09)[:, None] * 0.09
    segment = Segment("s", Motor(t, q, None), t, observed, t >= 0.0, 0.0, False)
    assert gap.noise_floor([segment], [observed - q[:, None]]) == pytest.approx(0.09 / np.sqrt(12.0))


@pytest.mark.parametrize("period_s", [4.0, 20.0])
def test_every_other_block_holds_both_ways(period_s):
    """On a single way width and offset are one: a half of the blocks that never saw the other way predicts nothing."""
    from tautline.diagnosis import gap
    from tautline.diagnosis.segment import Segment
    from tautline.recording import Motor

    t = np.arange(0.0, 30.0, 0.01)
    q = 4.0 * np.sin(2 * np.pi * t / period_s)
    segment = Segment("s", Motor(t, q, None), t, q[:, None], t > 1.0, 0.0, False)
    number = gap.blocks(segment)
    rises = np.gradient(q)[t > 1.0] > 0
    for half in (0, 1):
        assert 0.2 < rises[number % 2 == half].mean() < 0.8


def test_a_direction_has_a_bin_of_its_own():
    from tautline.diagnosis.where import _condition_of_axis

    rng = np.random.default_rng(1)
    way = rng.choice([-1.0, 0.0, 1.0], 900)
    found = _condition_of_axis("direction", way, np.where(way < 0, 2.0, 0.1)[:, None])
    assert list(found.centres) == [-1.0, 0.0, 1.0]
    assert found.power == pytest.approx([4.0, 0.01, 0.01]) and found.says == "while the motor falls"


def test_the_report_says_it_all_and_shows_the_axes_that_tell_most(tmp_path):
    from tautline.diagnosis import narration, page

    found, _ = diagnosed({"lag": 0.08})
    text = page.write(found, tmp_path).read_text()
    assert narration.sentence(found.document) in text.replace("&#39;", "'")
    for stage in STAGES:
        assert f">{stage}<small>" in text
    assert 'class="named">transmission' in text
    for condition in found.conditions[:2]:
        assert page._TITLES[condition.axis] in text
    for step in narration.steps(found.document, str(tmp_path)):
        assert step.command in text
    assert text.count("<img") == 1 + 2 < 1 + len(found.conditions)
    said = narration.text(found.document, "out")
    assert said.startswith(narration.sentence(found.document)) and said.endswith("out/report.html")
    assert "taut flash out/corrected\n" in said and "--without-effects" not in said
    tip = found.document["tip"]
    assert tip["after_deg"] < 0.1 * tip["before_deg"] and narration.tip(found.document) in said


@pytest.mark.parametrize("frames", [1, 2, 7])
def test_of_a_few_frames_nothing_is_said(frames):
    calibration, test, _ = recordings()
    marker = Marker(
        *(column[-50 : -50 + frames] for column in (test.marker.t_s, test.marker.u_px, test.marker.v_px)),
        np.ones(frames, bool),
    )
    with pytest.raises(TautError, match=f"{test.name}: only {frames} new readings of the sensor"):
        prepare(true_model(), calibration, [replace(test, marker=marker)])


def test_a_sensor_that_stands_still_is_told():
    calibration, test, _ = recordings()
    marker = replace(
        test.marker, u_px=np.full_like(test.marker.u_px, 200.0), v_px=np.full_like(test.marker.v_px, 300.0)
    )
    with pytest.raises(TautError, match="whether the sensor stands still"):
        prepare(true_model(), calibration, [replace(test, marker=marker)])


def test_a_drift_that_wears_off_is_folded_in_as_far_as_it_went():
    made = recordings()
    segments = prepare(true_model(), made[0], made[1:2])
    fitter = Fitter(true_model(), segments)
    drift = {"offset_drift": 8e-4, "width_drift": 1e-3, "drift_decay": 0.02}
    hypothesis = Hypothesis().plus(effects.BY_ID["transmission.drift"], False)
    state = replace(fitter.start(), values=drift)
    corrected = _corrected_model(Fit(hypothesis, state, []), segments[-1])
    end = segments[-1].motor.t_s[-1] + segments[-1].offset_s
    at = np.array([made[1].motor.t_s[-1]])
    with_drift = effects.simulate(true_model(), made[1].motor, at, drift, clock_offset_s=end - at[0])
    assert abs(with_drift.c_deg[0] - effects.simulate(true_model(), made[1].motor, at, {}).c_deg[0]) > 0.02
    assert predict(corrected, made[1].motor, at).c_deg[0] == pytest.approx(with_drift.c_deg[0], abs=0.05)


def test_a_fit_that_ends_behind_the_camera_is_no_hypothesis(monkeypatch):
    made = recordings({"lag": 0.08})
    fitter = Fitter(true_model(), prepare(true_model(), made[0], made[1:2]))
    base = fitter.nominal()
    search = Search(
        fitter, base, [effects.BY_ID["transmission.lag"], effects.BY_ID["camera.distortion"]], lambda text: None
    )
    whole = Fitter.finish

    def lost(self, begun):
        fit = whole(self, begun)
        if begun.hypothesis.kinds[-1].id == "camera.distortion":
            fit.residuals[0][3] = np.nan
        return fit

    monkeypatch.setattr(Fitter, "finish", lost)
    assert [found.ids for found in search.on_top_of(search.base, 2, 0)] == [("transmission.lag",)]


@pytest.mark.long
def test_what_has_no_path_and_shrinks_nothing_leaves_the_model_as_it_was():
    """Of the second instrument, whose tip sticks from the start: recalibrated on more jumps it is no better."""
    case = GENERATORS["second.setup"].make(5500008, "single", ("transmission.stick_slip",))
    found = diagnose(calibrate([case.calibration], case.rig).model, case.calibration, case.tests)
    document = found.document
    assert [e["id"] for e in document["effects"]] == ["transmission.stick_slip"]
    assert document["gap"]["shrink"] == 0.0 and document["gap"]["after_ci"] == document["gap"]["before_ci"]
    np.testing.assert_array_equal(found.corrected.c_deg, found.nominal.c_deg)
    assert found.corrected.effects and found.corrected.effects[0].id == "transmission.stick_slip"


def test_what_a_cause_outside_of_the_library_resembles():
    made = recordings({"creep_share": 0.12, "creep_time": 1.5})
    document = diagnose(true_model(), made[0], made[1:2], left_out=("transmission.creep",)).document
    assert document["verdict"] == "unknown" and 1 <= len(document["resembles"]) <= 3
    nearest = document["resembles"][0]
    assert nearest["closes"] == max(c["shrink"] for c in document["candidates"])
    assert (nearest["says"] or "leaves what it could not") in narration.sentence(document)


def test_what_a_cause_resembles_with_another_amplitude_here_than_there():
    """Without the tilt that turns over within most of the range, which is as steady."""
    made = recordings({"creep_share": 0.12, "creep_time": 1.5})
    left_out = "transmission.creep", "registration.direction_dependent"
    document = diagnose(true_model(), made[0], made[1:2], left_out=left_out).document
    assert document["verdict"] == "unknown" and any(each["says"] for each in document["resembles"])
