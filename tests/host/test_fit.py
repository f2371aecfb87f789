"""The diagnosis' fits: derivatives against differences, few knots against all samples, starts that lead home."""

from dataclasses import replace

import numpy as np
import pytest

from tautline import effects, trajectory
from tautline.core.session import SessionClock
from tautline.diagnosis.candidates import Search, applicable
from tautline.diagnosis.diagnose import _corrected_model
from tautline.diagnosis.fit import Fitter
from tautline.diagnosis.fitted import STATIC_NAMES, Fit, Hypothesis, Scope
from tautline.diagnosis.huber import huber_weight
from tautline.diagnosis.moments import moments_are_seen, refine_moments
from tautline.diagnosis.screen import _HeldFromEdges, _Scan, screen
from tautline.diagnosis.segment import prepare
from tautline.effects import BY_ID
from tautline.encoder import between_counts, straight_lines
from tautline.model import Model
from tautline.recording import Angle, Marker, Motor, Recording
from tautline.rig import ANGLE
from tautline.simulated import simulate
from tautline.simulated.instrument import preset, reference_rig

RIG = reference_rig()
GRID = np.linspace(-5.0, 5.0, 401)
INSTRUMENT = preset("reference", RIG)
MODEL = Model(RIG, GRID, INSTRUMENT.backlash(GRID), np.full(401, 0.003), INSTRUMENT.bend(GRID), 0.08, (-4.0, 4.0))
NOISE = 0.03


@pytest.mark.parametrize("limit", [1.0, 0.0])
def test_what_is_foretold_to_the_last_digit_counts_in_full(limit):
    assert huber_weight(np.array([0.0, 1.0, 2.0]), limit) == pytest.approx([1.0, limit, 0.5 * limit], abs=1e-11)


def recordings(parameters, throughout=False, turned_deg=20.0) -> list[Recording]:
    """A calibration and a test, in which the other axes move; the effect in the test, or in both."""
    rng = np.random.default_rng(5)
    actuator = RIG.actuator
    motions = [
        trajectory.back_and_forth(actuator, [0.8, 1.6], 2.0, 12, 8.0, 0.3),
        trajectory.trapezoids(actuator, 2.4, 3.0, 6, 20.0, 1.0).with_sway(2.0, turned_deg, 17.0),
    ]
    made = []
    for i, motion in enumerate(motions):
        recording = simulate.simulate(RIG, INSTRUMENT, motion, seed=i)
        t = recording.marker.t_s
        values = parameters if i or throughout else {}
        clock = SessionClock.of([*made, recording]).offset_s[i]
        motor = Motor(motion.t_s, motion.q, None, motion.translation_mm, motion.rotation_deg)
        path = effects.simulate(MODEL, motor, t - 0.08, values, clock_offset_s=clock)
        seen = path.image_px + rng.normal(0.0, NOISE, (len(t), 2))
        made.append(replace(recording, marker=Marker(t, seen[:, 0], seen[:, 1], np.ones(len(t), bool)), rig=RIG))
    return made


def fitter_of(made) -> Fitter:
    fitter = Fitter(MODEL, prepare(MODEL, made[0], made[1:]))
    fitter.floor = NOISE
    return fitter


def rms(parts) -> float:
    return float(np.sqrt(np.mean(np.concatenate([p.ravel() for p in parts]) ** 2)))


def test_few_knots_predict_what_all_samples_do():
    made = recordings({})
    for segment, recording in zip(prepare(MODEL, made[0], made[1:]), made, strict=True):
        assert len(segment.motor.t_s) < 0.05 * len(recording.motor.t_s)
        motor = between_counts(recording.motor, RIG.actuator.encoder_resolution)
        for values in ({}, {"lag": 0.05}, {"onset_spread": 0.5}, {"creep_share": 0.1}):
            few = segment.predict(MODEL, values, 0.0)[1]
            many = effects.simulate(MODEL, motor, segment.arrival_s - MODEL.delay_s, values).image_px
            assert rms([(few - many)[segment.scored]]) < 0.6 * NOISE
        # Where the motor rests it rests in both.
        assert np.sum(np.diff(segment.motor.q) == 0) >= 5


def test_a_probe_that_takes_the_marker_behind_the_camera_leaves_slopes_finite():
    fitter = fitter_of(recordings({}))
    hypothesis = Hypothesis().plus(BY_ID["registration.static"], True)
    in_front, behind = 0.0, -100.0  # static_z, mm
    for _ in range(60):
        middle = 0.5 * (in_front + behind)
        state = replace(fitter.start(), values={**fitter.start().static, "static_z": middle})
        seen = all(np.isfinite(r).all() for r in fitter.residuals(state, hypothesis))
        in_front, behind = (middle, behind) if seen else (in_front, middle)
    state = replace(fitter.start(), values={**fitter.start().static, "static_z": in_front})
    columns = fitter.effect_columns(state, hypothesis, fitter.rows(state, hypothesis))
    assert all(np.isfinite(c).all() for c in columns)
    assert any((c[:, 0, :] == 0.0).any() for c in columns[1:])  # that observation, which a turn takes there


WIDTH = BY_ID["transmission.backlash"]
CURVE = {name: 0.02 + 0.01 * np.cos(i) for i, name in enumerate(WIDTH.curve)}
LAW = {name: 0.3 * np.sin(i / 2.0) for i, name in enumerate(BY_ID["configuration.remaining"].curve)}


@pytest.mark.parametrize(
    ("kinds", "values"),
    [
        ([BY_ID["transmission.lag"]], {"lag": 0.03, "lag_second": 0.2}),
        ([WIDTH], {"width_scale": 0.0, **CURVE, "width_at_motor": 0.0}),
        ([WIDTH.simple, BY_ID["configuration.remaining"]], {"width_everywhere": 0.05, **LAW}),
    ],
    ids=["lag", "width", "width and law"],
)
def test_the_gradient_is_the_cost_s(kinds, values):
    fitter = fitter_of(recordings({"c_per_translation": 0.2}))
    hypothesis = Hypothesis()
    for kind in kinds:
        hypothesis = hypothesis.plus(kind, Scope.TESTS)
    state = replace(fitter.start(), values=values)
    rows = fitter.rows(state, hypothesis)
    columns = fitter.effect_columns(state, hypothesis, rows)
    parts = [fitter.normal(row, extra) for row, extra in zip(rows, columns, strict=True)]
    gradient, matrix = sum(p.gradient for p in parts), sum(p.matrix for p in parts)
    assert len(gradient) == len(fitter.spread(hypothesis))

    def cost(step):
        return 0.5 * sum(
            float(np.sum(r**2)) for r in fitter.residuals(fitter.stepped(state, hypothesis, step), hypothesis)
        )

    size = np.sqrt(sum(float(np.sum(row.residual**2)) for row in rows))
    for j in range(len(gradient)):
        reach = 1e-3 * size / np.sqrt(matrix[j, j]) if matrix[j, j] > 0 else 0.0
        if reach == 0.0:
            continue
        step = np.zeros(len(gradient))
        step[j] = reach
        slope = (cost(-step) - cost(step)) / (2 * reach)
        assert slope == pytest.approx(gradient[j], abs=0.02 * size * np.sqrt(matrix[j, j])), j


def test_all_axes_come_late_with_the_delay():
    """Where others move as well its column is what the whole image does."""
    fitter = fitter_of(recordings({}))
    ahead = 2e-3
    later = replace(fitter.start(), model=replace(MODEL, delay_s=MODEL.delay_s + ahead))
    sooner = replace(later, model=replace(MODEL, delay_s=MODEL.delay_s - ahead))
    rows = fitter.rows(fitter.start(), fitter.no_effect)
    seen = [fitter.residuals(state, fitter.no_effect) for state in (sooner, later)]
    for row, before, after in zip(rows, *seen, strict=True):
        expected, column = (before - after) / (2.0 * ahead), row.columns[:, :, -1]
        off = np.abs(column - expected)  # differences reach across a turn now and then
        assert np.quantile(off, 0.9) < 0.02 * rms([expected])
    turned = fitter.segments[1]
    path = turned.follow(MODEL, {}, 0.0)
    by_c = np.gradient(path.c_deg, turned.arrival_s)[turned.scored, None] * rows[1].by_c
    assert rms([rows[1].columns[:, :, -1] + by_c]) > 0.1 * rms([by_c])  # so much is the other axes


FITTED = [
    {"encoder_sin": 0.03, "encoder_cos2": 0.005, "encoder_period": 0.47},
    {"onset_spread": 0.6, "onset_tail": 1.0},
    {"asymmetry": -0.15, "asymmetry_travel": 0.6, "asymmetry_form": 2.0},
    {"width_per_speed": 0.08, "speed_saturation": 0.7, "speed_time": 0.05, "width_held": 0.0},
    {"lag": 0.08},
    {"creep_share": 0.15, "creep_time": 2.0},
    {"offset_drift": 0.002, "drift_decay": 0.01},
    {"contact_hold": 0.7, "contact_c": 15.0, "contact_side": 1.0},
    {"contact_hold": 1.15, "contact_c": 12.0, "contact_side": -1.0},  # a section that bows behind it slides back
    {"curvature_gradient": 0.6},
    {"curvature_gradient": 0.2, "curvature_by_bend": 0.3},
    {"tilt_x": 0.4, "tilt_y": -0.3, "tilt_travel": 0.02},
    {"tilt_x": 0.4, "tilt_y": -0.3, "tilt_travel": 0.8},
    {"shift_rx": 0.6, "shift_y": 0.3, "shift_time": 104.03},
    {"slip_1": -0.06, "slip_time_1": 102.53},
    {"k1": -0.2, "p1": 0.01},
]
# What is in front of the tip while calibrating already is f_remain.
CASES = [(p, t) for p in FITTED for t in (False, True) if not (t and "contact_hold" in p)]


@pytest.mark.parametrize(
    ("parameters", "throughout"), CASES, ids=lambda p: next(iter(p)) if isinstance(p, dict) else str(p)
)
def test_the_right_effect_is_fitted_down_to_the_noise(parameters, throughout):
    fitter = fitter_of(recordings(parameters, throughout))
    base = fitter.nominal()
    kind = next(k for k in BY_ID.values() if next(iter(parameters)) in {p.name for p in k.amplitudes})
    limits = [10.0 * float(np.abs(r).max()) for r in base.residuals]
    entries = {entry.scope: entry for entry in screen(fitter, base, [kind], limits)}
    entry = entries.get(not throughout) or entries[False]
    found = fitter.fit(Hypothesis().plus(entry.kind, entry.scope), entry.values, base.state, entry.others)
    assert rms(found.residuals) < 1.1 * NOISE, (rms(base.residuals), found.state.values)
    for moment in entry.kind.moments:
        assert found.state.values[moment] == pytest.approx(parameters[moment], abs=0.05)


@pytest.mark.parametrize("name", ["transmission.slip", "registration.shift"])
def test_in_a_few_seconds_no_moment_is_looked_for(name):
    fitter = fitter_of(recordings({}))
    ends = [s.arrival_s[s.scored][0] + 3.9 for s in fitter.segments]
    fitter.segments = [
        replace(s, scored=s.scored & (s.arrival_s < e)) for s, e in zip(fitter.segments, ends, strict=True)
    ]
    base = fitter.nominal()
    assert screen(fitter, base, [BY_ID[name]], [1e3] * len(base.residuals)) == []


def test_what_slips_twice_is_found_twice():
    """One before which the tip was carried to a frame (0.04 s); of one that the play takes up nothing is seen until the
    tip is carried again."""
    truth = {"slip_1": -0.06, "slip_time_1": 102.53, "slip_2": 0.09, "slip_time_2": 110.01}
    fitter = fitter_of(recordings(truth))
    base = fitter.nominal()
    limits = [1e3] * len(base.residuals)
    once, *_ = screen(fitter, base, [BY_ID["transmission.slip"]], limits)
    twice = once.more[0]
    found = fitter.fit(Hypothesis().plus(twice.kind, twice.scope), twice.values, base.state)
    found = refine_moments(fitter, found, limits)
    assert rms(found.residuals) < 1.1 * NOISE
    slips = sorted((found.state.values[f"slip_time_{i}"], found.state.values[f"slip_{i}"]) for i in (1, 2))
    assert [size for _, size in slips] == pytest.approx([-0.06, 0.09], abs=2e-3)
    assert [at for at, _ in slips] == pytest.approx([102.53, 110.01], abs=0.2)


def test_moments_that_are_scored_at_once_have_the_gain_of_columns_that_begin_there():
    """Against the plain normal equations of columns that are zero before each moment."""
    fitter = fitter_of(recordings({"slip_1": -0.06, "slip_time_1": 102.53}))
    base = fitter.nominal()
    scan = _Scan(fitter.coarse, base, [1e3] * len(base.residuals), tuple(Scope))
    columns = scan._columns_if_always(BY_ID["transmission.slip"])
    times = [s.session_s[s.scored] for s in fitter.coarse.segments]
    edges = np.array([5.0, 30.0, 102.6, 104.0, 110.0])
    from_edges = _HeldFromEdges(scan, columns, edges)
    for chosen in ([], [3], [3, 0]):
        tried = [i for i in range(len(edges)) if i not in chosen]
        amplitudes, gains = from_edges.gains(chosen, tried)
        for i, found, gain in zip(tried, amplitudes, gains, strict=True):
            begins = edges[[*chosen, i]]
            parts = [
                scan.fitter.normal(row, np.concatenate([of * (t >= at)[:, None, None] for at in begins], axis=2))
                for row, of, t in zip(scan.rows, columns, times, strict=True)
            ]
            expected, share = scan.gain(parts)
            assert expected == pytest.approx(found, rel=1e-6, abs=1e-9) and share == pytest.approx(gain, rel=1e-6)


def test_a_first_fit_is_not_finished_only_where_another_leaves_far_less_of_many_blocks():
    names = ["transmission.lag", "camera.distortion", "kinematics.nonconstant_curvature"]
    for lag, hopeless in ((0.25, [False, True, True]), (0.0, [False, False, False])):
        fitter = fitter_of(recordings({"lag": lag}))
        search = Search(fitter, fitter.recalibrated(), [BY_ID[name] for name in names], lambda text: None)
        entries = screen(fitter, search.base.fit, search.kinds, search.limits)
        screened = {entry.kind.id: entry for entry in reversed(entries)}  # of each the best scope
        fits = [search._first_fit(search.base, screened[name]) for name in names]
        assert search._are_hopeless(fits) == hopeless
        gone = replace(fits[1], residuals=[np.full_like(r, np.nan) for r in fits[1].residuals])
        assert search._are_hopeless([fits[0], gone]) == [False, True]


def test_an_axis_that_never_moved_hides_no_other():
    fitter = fitter_of(recordings({"c_per_translation": 0.3}, turned_deg=0.0))
    base = fitter.nominal()
    limits = [10.0 * float(np.abs(r).max()) for r in base.residuals]
    best = max(screen(fitter, base, [BY_ID["configuration.axis_coupling"]], limits), key=lambda entry: entry.gain)
    assert best.gain > 0.0 and best.values["c_per_translation"] == pytest.approx(0.3, rel=0.1)
    found = fitter.fit(Hypothesis().plus(best.kind, best.scope), best.values, base.state)
    assert rms(found.residuals) < 1.1 * NOISE


def angles(late_s: tuple[float, float]) -> Fitter:
    """Of recordings by an angle sensor whose values come so much later than the model says."""
    rng = np.random.default_rng(6)
    model = replace(MODEL, sensor=ANGLE)
    made = []
    for recording, late in zip(recordings({}), late_s, strict=True):
        t = recording.marker.t_s
        lines = straight_lines(recording.motor, RIG.actuator.encoder_resolution)
        c_deg = effects.follow(model, lines, t - model.delay_s - late, {}).c_deg
        angle = Angle(t, c_deg + rng.normal(0.0, 0.02, len(t)))
        made.append(replace(recording, marker=None, angle=angle))
    fitter = Fitter(model, prepare(model, made[0], made[1:]))
    fitter.floor = 0.02
    return fitter


def test_an_angle_sensor_s_delay_is_found():
    everywhere = angles((0.02, 0.02))
    assert everywhere.nominal().state.model.delay_s == pytest.approx(MODEL.delay_s + 0.02, abs=5e-4)
    later = angles((0.0, 0.02))
    assert "acquisition.delay" in {kind.id for kind in applicable(later)}
    base = later.nominal()
    hypothesis = Hypothesis().plus(BY_ID["acquisition.delay"], True)
    found = later.fit(hypothesis, {"delay": 0.0}, base.state)
    assert rms(found.residuals) < 1.05 * 0.02 < rms(base.residuals)
    assert found.state.values["delay"] == pytest.approx(0.02, abs=5e-4)


def test_a_sensor_that_the_model_was_not_calibrated_with_has_no_delay_to_find():
    fitter = fitter_of(recordings({}))
    other = Fitter(replace(MODEL, sensor=ANGLE), fitter.segments)
    assert fitter.delayed and not other.delayed
    assert "acquisition.delay" not in {kind.id for kind in applicable(other)}
    rows = other.rows(other.start(), other.no_effect)
    assert all(np.all(row.columns[:, :, -1] == 0.0) for row in rows)


@pytest.mark.parametrize(("before_s", "after_s", "seen"), [(1.2, 1.2, True), (1.2, 0.9, False), (0.9, 1.2, False)])
def test_a_moment_is_seen_by_the_frames_that_show_it_however_late_they_arrive(before_s, after_s, seen):
    """A recording shows a moment if it has a second on either side of it, here of a sensor with 0.7 s of delay."""
    model, at_s = replace(MODEL, delay_s=0.7), 104.03
    made = recordings({"shift_rx": 0.3, "shift_y": 0.15, "shift_time": at_s})
    made = [replace(r, marker=replace(r.marker, t_s=r.marker.t_s + 0.62)) for r in made]
    calibration, test = prepare(model, made[0], made[1:])
    scene_s = test.session_s - 0.7
    fitter = Fitter(model, [calibration, test.part((scene_s > at_s - before_s) & (scene_s < at_s + after_s))])
    values = {p.name: 0.0 for p in BY_ID["registration.shift"].parameters}
    state = replace(fitter.start(), values=values | {"shift_rx": 0.3, "shift_y": 0.15, "shift_time": at_s})
    hypothesis = Hypothesis().plus(BY_ID["registration.shift"], Scope.START)
    fit = Fit(hypothesis, state, fitter.residuals(state, hypothesis))
    assert rms(fit.residuals) < 1.1 * NOISE
    assert moments_are_seen(fitter, fit, [1e3, 1e3]) == seen


@pytest.mark.parametrize(
    ("name", "moved", "tests", "seen"),
    [
        ("registration.shift", {"shift_rx": 0.3, "shift_y": 0.15, "shift_time": 104.03}, 2, True),
        ("registration.shift", {"shift_rx": 0.3, "shift_y": 0.15, "shift_time": 104.03}, 1, False),
        ("transmission.slip", {"slip_1": -0.06, "slip_time_1": 104.03}, 2, False),
    ],
    ids=["shift", "since_the_tests", "slip"],
)
def test_a_registration_may_change_between_two_tests(name, moved, tests, seen):
    """Since the calibration it is another registration; and the tip's offset in each test is an effect of its own."""
    made = recordings(moved)
    calibration, test = prepare(MODEL, made[0], made[1:])
    parts = [test.part(test.session_s < 103.0), test.part(test.session_s > 105.0)]
    parts[0] = replace(parts[0], calibration=tests == 1)
    fitter = Fitter(MODEL, [calibration, *parts])
    kind = BY_ID[name].happening(1)
    state = replace(fitter.start(), values={p.name: 0.0 for p in kind.parameters} | moved)
    hypothesis = Hypothesis().plus(kind, Scope.START)
    fit = Fit(hypothesis, state, fitter.residuals(state, hypothesis))
    assert rms(fit.residuals) < 1.1 * NOISE
    assert moments_are_seen(fitter, fit, [1e3] * 3) == seen


@pytest.mark.parametrize(("tests", "seen"), [(2, True), (1, False)])
def test_a_slip_that_the_play_takes_up_is_shown_by_the_test_after_it(tests, seen):
    """Until its recording ends the tip hardly moves: as far as that shows it did not slip."""
    moved = {"slip_1": -0.06, "slip_time_1": 104.03}
    made = recordings(moved)
    calibration, test = prepare(MODEL, made[0], made[1:])
    parts = [test.part(test.session_s < 105.13), test.part(test.session_s > 106.0)]
    fitter = Fitter(MODEL, [calibration, *parts[:tests]])
    kind = BY_ID["transmission.slip"].happening(1)
    state = replace(fitter.start(), values={p.name: 0.0 for p in kind.parameters} | moved)
    hypothesis = Hypothesis().plus(kind, Scope.START)
    fit = Fit(hypothesis, state, fitter.residuals(state, hypothesis))
    assert moments_are_seen(fitter, fit, [1e3] * 3) == seen


def test_a_moment_is_found_by_a_sensor_that_the_model_was_not_calibrated_with():
    """Its delay is the nominal one, and not the calibrated sensor's 0.7 s."""
    truth = {"slip_1": -0.06, "slip_time_1": 102.53}
    model = replace(MODEL, delay_s=0.7)
    made = []
    for recording in recordings({}):
        values = truth if made else {}
        clock = SessionClock.of([*made, recording]).offset_s[len(made)]
        t = recording.motor.t_s[::20]
        seen = effects.simulate(MODEL, recording.motor, t, values, clock_offset_s=clock).c_deg
        made.append(
            replace(recording, marker=None, angle=Angle(t, seen + np.random.default_rng(1).normal(0, 0.03, len(t))))
        )
    fitter = Fitter(model, prepare(model, made[0], made[1:]))
    fitter.floor = NOISE
    once, *_ = screen(fitter, fitter.nominal(), [BY_ID["transmission.slip"]], [1e3, 1e3])
    assert once.values["slip_time_1"] == pytest.approx(102.53, abs=0.1)


def test_a_corrected_model_has_the_nominals_registration_and_the_effects_once():
    fitter = fitter_of(recordings({}))
    hypothesis = Hypothesis(tests=1).plus(BY_ID["registration.static"], Scope.TESTS)
    nominal = dict(zip(STATIC_NAMES, (1.5, -4.0, 0.8, 2.0, -0.5, 3.0), strict=True))
    effect = dict(zip(STATIC_NAMES, (0.4, 1.0, -0.3, 0.5, 0.2, -1.0), strict=True))
    state = replace(fitter.start(), static=nominal, values=effect)
    fit = Fit(hypothesis, state, fitter.residuals(state, hypothesis))
    test = fitter.segments[1]
    corrected = _corrected_model(fit, test)
    fitted = test.predict(state.model, state.at(test, hypothesis), 0.0)[1]
    np.testing.assert_allclose(test.predict(corrected, {}, 0.0)[1], fitted, atol=1e-6)
    assert corrected.effects[0].parameters == effect
