"""What was there from the first recording on is fitted beside B, path and delay: the model that is handed out carries
it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from slices import some

from tautline.calibration import calibrate as room
from tautline.calibration import naming
from tautline.calibration.beside import FITTED, FittedEffects
from tautline.calibration.calibrate import calibrate
from tautline.calibration.observations import observe
from tautline.calibration.playfit import Curves, PlayFit
from tautline.calibration.result import Calibration
from tautline.calibration.simulated_track import PreparedTrack
from tautline.calibration.wandering import allowing_for_wander
from tautline.calibration.worth import PREDICTS
from tautline.diagnosis.hyperparameters import learnt
from tautline.effects import BY_ID, LIBRARY
from tautline.elements import SINGLE
from tautline.geometry import project
from tautline.model import Effect, Model
from tautline.prediction import foretold
from tautline.quality import Quality, Reason
from tautline.recording import Recording
from tautline.simulated.instrument import Corrected, reference_rig
from tautline.simulated.simulate import run
from tautline.splines import Basis
from tautline.trajectory import Trajectory, back_and_forth, random_smooth

RIG, NOISE_PX = reference_rig(), 0.05
Q = np.linspace(*RIG.actuator.range, 257)
SOUND = Model(
    RIG, Q, 0.5 + 0.05 * np.sin(Q), 0.0 * Q, 11.0 * Q + 2.0 * np.sin(0.4 * Q), RIG.delay_s, RIG.actuator.range
)  # fmt: skip
LAG = Effect("transmission.lag", {"lag": 0.15, "lag_second": 0.2})
ONE_SIDED = Effect(
    "transmission.asymmetric_backlash", {"asymmetry": 0.2, "asymmetry_travel": 0.4, "asymmetry_form": 1.0}
)  # fmt: skip
COUPLING = Effect("configuration.axis_coupling", {"c_per_translation": 0.4, "c_per_rotation": 0.0})
SWING = Effect(
    "configuration.swing", {"swing_share": 0.4, "swing_period": 0.6, "swing_damping": 0.2, "swing_carried": 0.5}
)  # fmt: skip
LOAD = Effect(
    "transmission.load_dependence", {"width_per_load": 0.01, "gain_per_load": 0.004, "offset_per_load": 0.002}
)  # fmt: skip


@dataclass(frozen=True)
class _Found:
    model: Model
    evidence: dict[str, float]


def recorded(
    there: Sequence[Effect], seed: int, moves: Trajectory | None = None, seconds: float = 60.0, sways: bool = False
) -> Recording:
    moves = moves or random_smooth(RIG.actuator, 3.0, seconds, seed)
    if sways:
        moves = moves.with_sway(3.0, 0.0, 13.0)
    instrument = Corrected(replace(SOUND, effects=tuple(there)), "own")
    return run(RIG, instrument, moves, noise_px=NOISE_PX, seed=seed).recording


def told(names: Sequence[Effect], of: Model) -> Any:
    """As a diagnosis would tell it: a fifth too weak, on the nominal model that was found without it."""

    def weaker(effect: Effect) -> Effect:
        first, value = next(iter(effect.parameters.items()))
        return replace(effect, parameters={**effect.parameters, first: 0.8 * value})

    state = SimpleNamespace(model=of)
    own = SimpleNamespace(state=state)
    return SimpleNamespace(
        effects=tuple(map(weaker, names)),
        named=tuple(each.id for each in names),
        fit=own,
        fitter=SimpleNamespace(model=of, load_reference=0.0),
    )


def calibrated(
    monkeypatch: pytest.MonkeyPatch, there: Sequence[Effect], names: Sequence[Effect], seed: int = 3
) -> tuple[Calibration, Calibration]:
    """Without the effects that are named, and with them."""
    made = [recorded(there, seed)]
    alone = calibrate(made, RIG, naming=False)
    monkeypatch.setattr(naming, "effects_of_diagnosis", lambda model, *rest: told(names, model))
    monkeypatch.setattr(room.start, "concerns", lambda model: True)
    return alone, calibrate(made, RIG)


def off(found: Calibration) -> np.ndarray:
    """B's error where it was measured, as a share."""
    model = found.model
    inside = (model.q > model.measured[0]) & (model.q < model.measured[1])
    return (model.width - np.interp(model.q, SOUND.q, SOUND.width))[inside] / 0.5


def test_what_may_be_carried_moves_the_tip_at_all_times_alike() -> None:
    assert {"transmission.lag", "transmission.creep", "actuator.encoder_periodic"} <= FITTED
    assert {"transmission.smooth_onset", ONE_SIDED.id, "transmission.rate_dependent_backlash"} <= FITTED
    assert {COUPLING.id, SWING.id, LOAD.id} <= FITTED
    tables = {kind.id for kind in LIBRARY if kind.holds is not None or kind.nominal or kind.event}
    later = {kind.id for kind in LIBRARY if kind.course or kind.moments}
    seen = {kind.id for kind in LIBRARY if not kind.through_angle}
    assert not FITTED & (tables | later | seen)


def test_an_effect_is_read_and_written_as_a_model_has_it() -> None:
    beside, values = FittedEffects.of([LAG, Effect("transmission.drift", {"offset_drift": 0.3})], SOUND)
    assert beside.to_effects(values) == (LAG,)
    wrist = Effect(COUPLING.id, {"c_per_joint": 0.2, "joint_play": 2.0, "column": "wrist_deg"})
    beside, values = FittedEffects.of([COUPLING, LAG], SOUND, others_rest=True)
    assert values.tolist() == [0.15, 0.2] and beside.to_effects(values) == (COUPLING, LAG)
    beside, values = FittedEffects.of([wrist], SOUND)
    assert values.tolist() == [0.2, 2.0] and beside.to_effects(values) == (wrist,)
    by_speed = {"width_per_speed": 0.01, "speed_saturation": 1.0, "speed_time": 0.03, "width_held": 1.0}
    beside, values = FittedEffects.of([Effect("transmission.rate_dependent_backlash", by_speed)], SOUND)
    assert len(values) == 3 and beside.held == {"width_held": 1.0}
    assert beside.to_effects(values)[0].parameters == by_speed
    assert not beside.any_at_end(values)
    assert beside.any_at_end(values + np.array([0.0, 2.0, 0.0]))
    assert not beside.any_at_end(values * np.array([1.0, 0.0, 1.0]))  # saturates at no speed


def test_a_model_alone_has_no_effects_and_is_otherwise_the_same() -> None:
    carries = replace(SOUND, effects=(LAG,))
    assert carries.alone == SOUND and SOUND.alone is SOUND


@pytest.mark.parametrize("effect", [LAG, ONE_SIDED, COUPLING, SWING, LOAD])
def test_the_gradient_is_the_costs_slope(effect: Effect) -> None:
    made = recorded([effect], 1, seconds=20.0, sways=effect is COUPLING)
    if effect is LOAD:
        made = replace(made, motor=replace(made.motor, load_mNm=20.0 * np.sin(0.3 * made.motor.t_s)))
    prepared = [PreparedTrack.of(track) for track in observe([made], RIG)]
    beside, values = FittedEffects.of([effect], SOUND)
    fit = PlayFit(prepared, Basis(-5, 5, 10), Basis(-5, 5, 12), settled_only=False, effects=beside)
    width = np.linalg.lstsq(fit.backlash.design(Q).toarray(), SOUND.width, rcond=None)[0]
    curves = Curves(width, project(RIG, 11.0 * fit.follow.centres), RIG.delay_s + 0.01, 1.1 * values)
    rows, masks = fit.residuals(curves)
    weights = [mask.astype(float) for mask in masks]
    _, gradient = fit.normal(curves, rows, weights)

    def cost(there: Curves) -> float:
        left = fit.residuals(there)[0]
        return -0.5 * sum(float(np.sum(w[:, None] * r**2)) for r, w in zip(left, weights, strict=True))

    steps = 0.01 * beside.scales
    slopes = np.zeros(len(steps))
    for i, step in enumerate(steps):
        ahead, behind = (curves.effect_values + sign * step * np.eye(len(values))[i] for sign in (1, -1))
        slopes[i] = (cost(replace(curves, effect_values=ahead)) - cost(replace(curves, effect_values=behind))) / (
            2.0 * step
        )
    told, slopes = gradient[-1 - len(steps) : -1] * beside.scales, slopes * beside.scales
    assert told == pytest.approx(slopes, abs=0.05 * np.abs(slopes).max())
    cut = curves.follow.size
    wider = [cost(replace(curves, backlash=curves.backlash + each)) for each in (0.002, -0.002)]
    by_width = float(np.sum(gradient[cut : cut + fit.backlash.size]))
    assert by_width == pytest.approx((wider[0] - wider[1]) / 0.004, rel=0.1)
    later = [cost(replace(curves, delay_s=curves.delay_s + each)) for each in (0.002, -0.002)]
    assert gradient[-1] == pytest.approx((later[0] - later[1]) / 0.004, rel=0.1)


@pytest.mark.parametrize("effect", some([ONE_SIDED, LAG, SWING], 1))
def test_a_calibration_carries_what_it_names_and_predicts_with_it(
    effect: Effect, monkeypatch: pytest.MonkeyPatch
) -> None:
    alone, found = calibrated(monkeypatch, [effect], [effect])
    assert [each.id for each in found.model.effects] == [effect.id] and not alone.model.effects
    unseen = recorded([effect], 8)
    before, after = (foretold(each.model, unseen, settled_by=SOUND) / NOISE_PX for each in (alone, found))
    assert before > 2.0 and after < 1.15
    assert np.sqrt(np.mean(off(found) ** 2)) < 0.2 * np.sqrt(np.mean(off(alone) ** 2)) + 0.003
    assert found.model.quality.verdict == "good"
    assert [(reason.code, reason.mild) for reason in found.model.quality.reasons][:1] == [(effect.id, True)]
    for name, value in effect.parameters.items():
        if name in {p.name for p in BY_ID[effect.id].amplitudes}:
            assert found.model.effects[0].parameters[name] == pytest.approx(value, rel=0.05)


def test_what_other_axes_add_is_named_where_the_model_foretells_nothing_of_it() -> None:
    """They move in a recording of their own, and the fit of B sees the image at their rest alone."""
    made = [recorded([COUPLING], 3), replace(recorded([COUPLING], 4, sways=True), name="other axes")]
    alone, found = calibrate(made, RIG, naming=False), calibrate(made, RIG)
    assert alone.model.quality.verdict == "doubtful" and found.model.quality.verdict == "good"
    assert [each.id for each in found.model.effects] == [COUPLING.id]
    assert found.model.effects[0].parameters["c_per_translation"] == pytest.approx(0.4, rel=0.05)
    unseen = recorded([COUPLING], 8, sways=True)
    before, after = (foretold(each.model, unseen, settled_by=SOUND) / NOISE_PX for each in (alone, found))
    assert before > 20.0 and after < PREDICTS


def test_the_sigmas_of_b_and_delay_beside_an_effect_cover(monkeypatch: pytest.MonkeyPatch) -> None:
    _, found = calibrated(monkeypatch, [LAG], [LAG], seed=4)
    model = found.model
    inside = (model.q > model.measured[0]) & (model.q < model.measured[1])
    z = 0.5 * off(found) / model.width_sigma[inside]
    assert np.sqrt(np.mean(z**2)) < 2.0
    assert abs(model.delay_s - RIG.delay_s) < 3.0 * found.delay.sigma_s


def test_b_is_as_uncertain_as_its_fit_effects_another_amplitude_is_off() -> None:
    """By the share that a right effect may be another than its law makes of the frames."""
    prepared = [PreparedTrack.of(track) for track in observe([recorded([ONE_SIDED], 6, seconds=30.0)], RIG)]
    beside, values = FittedEffects.of([ONE_SIDED], SOUND)
    fit = PlayFit(prepared, Basis(-5, 5, 20), Basis(-5, 5, 40), settled_only=True, effects=beside)
    width = np.linalg.lstsq(fit.backlash.design(Q).toarray(), SOUND.width, rcond=None)[0]
    found = fit.solve(Curves(width, project(RIG, 11.0 * fit.follow.centres), RIG.delay_s, values))
    held = replace(fit, fit_effects=False, smoothing=dict(fit.smoothing))
    amplitudes = beside.amplitudes(found.curves.effect_values)
    other = found.curves.effect_values + learnt().center.wanders_material * amplitudes
    beside_it = held.solve(replace(found.curves, effect_values=other), adapt=False)
    at = Q[np.abs(Q) < 3.0]
    shift = np.abs(np.interp(at, fit.grid, fit.width(beside_it.curves) - fit.width(found.curves)))
    sigma = allowing_for_wander(found).width_sigma(at)
    assert np.median(shift) > 2.0 * np.median(found.width_sigma(at))
    assert np.all(sigma > 0.8 * shift) and np.median(sigma) < 2.0 * np.median(shift)


def test_what_moves_one_recordings_stops_sets_no_clock_where_it_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """A width that grows with the speed, and relaxes: images of fast strokes stop later."""
    by_speed = {"width_per_speed": 0.05, "speed_saturation": 0.0, "speed_time": 0.2, "width_held": 0.0}
    there = Effect("transmission.rate_dependent_backlash", by_speed)
    made = [
        replace(recorded([there], seed, back_and_forth(RIG.actuator, [speed], 2.0, 16, 5.0, 0.1)), name=f"at {speed}")
        for seed, speed in ((5, 0.6), (6, 2.4))
    ]
    alone = calibrate(made, RIG, naming=False)
    assert alone.offsets
    monkeypatch.setattr(naming, "effects_of_diagnosis", lambda model, *rest: told([there], model))
    monkeypatch.setattr(room.start, "concerns", lambda model: True)
    found = calibrate(made, RIG)
    assert [each.id for each in found.model.effects] == [there.id] and not found.offsets
    assert abs(found.model.delay_s - RIG.delay_s) < 2e-3
    assert np.sqrt(np.mean(off(found) ** 2)) < 0.5 * np.sqrt(np.mean(off(alone) ** 2))


def test_a_name_that_does_not_help_is_a_name_alone() -> None:
    def of(error: float, effects: tuple[Effect, ...]) -> Calibration:
        evidence = {"error": error, "foretold_over_noise": 1.0}
        return cast(Calibration, _Found(replace(SOUND, effects=effects), evidence))

    found = of(0.05, ())
    named = room._with_effects(found, told([LAG], SOUND), of(0.06, (LAG,)))
    assert not named.model.effects and [each.code for each in named.model.quality.reasons] == [LAG.id]
    carries = room._with_effects(found, told([LAG], SOUND), of(0.04, (LAG,)))
    assert carries.model.effects == (LAG,)
    useless = Quality.of([Reason("clock.offset", "unknown", "one clock", fatal=True)])
    unusable = cast(Calibration, replace(cast(Any, of(0.04, (LAG,))), model=replace(SOUND, quality=useless)))
    assert room._with_effects(found, told([LAG], SOUND), unusable).model.quality.usable
    nothing = room._with_effects(found, told([LAG], SOUND), None)
    assert not nothing.model.effects


def test_beside_what_is_not_weighed_a_name_counts_only_where_it_leaves_no_more_than_all_that_departs() -> None:
    """Breathing, or an effect that looks like it."""
    breathes = Quality.of([Reason("registration.breathing", "sways", "hold it")])

    def of(left: float, *effects: Effect) -> Calibration:
        model = replace(SOUND, effects=effects, quality=breathes if not effects else Quality())
        own = {"residual_joint": left} if effects else {"residual_components": left}
        return cast(Calibration, _Found(model, {"error": 0.1 * left if effects else 1.0, **own}))

    breathing = of(1.0)
    assert room._with_effects(breathing, told([LAG], SOUND), of(2.0, LAG)) is breathing
    looks_like_it = of(6.0)
    carries = room._with_effects(looks_like_it, told([LAG], SOUND), of(2.0, LAG))
    assert carries.model.effects == (LAG,) and carries.model.quality.reasons[0].code == LAG.id


def test_what_the_carrying_model_still_misses_is_a_doubt() -> None:
    carries, other = replace(SOUND, effects=(LAG,)), Reason("coverage", "a hole", "move there")
    reasons = naming.reasons_with_carried([Reason(LAG.id, "late", "")], [other], carries, predicts=False)
    assert [(each.code, each.says, each.mild) for each in reasons] == [
        (LAG.id, "late", False),
        ("coverage", "a hole", False),
    ]


@pytest.mark.parametrize("width", [0.0, 1e-3, 0.5])
def test_a_tip_is_half_of_what_b_widens_behind_or_ahead_however_narrow_b_is(width: float) -> None:
    """By a tiny lag, so that an effect is there; of a constant B, dp/dB = -side / 2."""
    motor = recorded((), 5).motor
    beside, values = FittedEffects.of([Effect(LAG.id, {"lag": 1e-3, "lag_second": 0.0})], SOUND)
    at_s = np.linspace(motor.t_s[len(motor.t_s) // 2], motor.t_s[-1] - 0.1, 400)
    by_width, _, _ = beside.slopes(motor, at_s, Q, np.full(len(Q), width), SINGLE, values)
    far = np.abs(by_width)[np.abs(np.interp(at_s, motor.t_s, np.gradient(motor.q, motor.t_s))) > 0.5]
    assert np.median(far) == pytest.approx(0.5, abs=0.01)
