"""What a right effect leaves stays within its stage, whatever its law; what a wrong one leaves does not."""

from dataclasses import replace

import numpy as np
import pytest

from tautline import effects
from tautline.diagnosis import confined
from tautline.diagnosis.fit import Fitter
from tautline.diagnosis.fitted import Fit, Hypothesis
from tautline.diagnosis.segment import prepare
from tautline.effects import BY_ID
from tests.host.test_diagnose import NOISE, RIG, recordings, true_model

LAG, JITTER, LENS = "transmission.lag", "acquisition.jitter", "camera.distortion"
CURVATURE, STATIC, TILT = "kinematics.nonconstant_curvature", "registration.static", "registration.direction_dependent"


def as_it_is(path, model):
    return path, model, np.zeros(len(path.c_deg)), 0.0


def angle_wanders(path, model):
    """0.4 deg by time: no law of a transmission that the library has."""
    return replace(path, c_deg=path.c_deg + 0.4 * np.sin(path.scene_s)), model, np.zeros(len(path.c_deg)), 0.0


def longer_tip(path, model):
    """In the bending plane, and no function of the angle that the library has."""
    kinematics = replace(RIG.kinematics, tip_length_mm=RIG.kinematics.tip_length_mm + 0.5)
    return path, replace(model, rig=replace(RIG, kinematics=kinematics)), np.zeros(len(path.c_deg)), 0.0


def unsteady_frames(path, model):
    late = np.random.default_rng(2).normal(0.0, 0.01, len(path.c_deg))
    return path, model, late, 0.0


def fourth_order_lens(path, model):
    return path, model, np.zeros(len(path.c_deg)), 1e-10


def rolls_in_its_channel(path, model):
    """The instrument's own turn lags behind the direction by a law that the library has not."""
    way = np.sign(np.gradient(path.p))
    lies = np.zeros(len(way))
    for i in range(1, len(way)):
        lies[i] = lies[i - 1] + (way[i] - lies[i - 1]) * min(1.0, abs(path.p[i] - path.p[i - 1]) / 0.08)
    turned = (0.0 if path.rotation_deg is None else path.rotation_deg) + 1.0 * lies
    return replace(path, rotation_deg=turned), model, np.zeros(len(path.c_deg)), 0.0


def wanders_sideways(path, model):
    """The instrument turns about its own axis by time."""
    turned = (0.0 if path.rotation_deg is None else path.rotation_deg) + 1.5 * np.sin(0.7 * path.scene_s)
    return replace(path, rotation_deg=turned), model, np.zeros(len(path.c_deg)), 0.0


def beyond(disturbed, *ids: str, off: float = 0.0) -> float:
    """Of the noise's power, in the test; the first effect's amplitudes are `off` by so many of their scales."""
    made, model = recordings(), true_model()
    rng = np.random.default_rng(8)
    segments = []
    for i, segment in enumerate(prepare(model, made[0], made[1:2])):
        path, seen_by, late, bulge = (disturbed if i else as_it_is)(segment.follow(model, {}, 0.0), model)
        seen = effects.image(seen_by, path, {})
        seen = seen + late[:, None] * np.gradient(seen, segment.arrival_s, axis=0)
        from_centre = seen - [RIG.camera.cx_px, RIG.camera.cy_px]
        seen = seen + bulge * np.sum(from_centre**2, axis=1, keepdims=True) ** 2 * from_centre / 100.0
        segments.append(replace(segment, observed=seen + rng.normal(0.0, NOISE, seen.shape)))
    fitter = Fitter(model, segments)
    fitter.floor = NOISE
    nominal = fitter.nominal()
    kinds = [BY_ID[name] for name in ids]
    values = {p.name: 0.0 for kind in kinds for p in kind.amplitudes}
    values |= {p.name: p.shape[0] for kind in kinds for p in kind.shapes}
    values |= {p.name: off * fitter.scale(p) for p in kinds[0].amplitudes}
    hypothesis = Hypothesis(tuple(kinds), (True,) * len(kinds))
    found = confined.residuals(fitter, Fit(hypothesis, replace(nominal.state, values=values), nominal.residuals))
    assert found is not None
    return float(np.mean(found[1] ** 2)) / NOISE**2


@pytest.mark.parametrize(
    ("disturbed", "kind"),
    [
        (angle_wanders, LAG),
        (longer_tip, CURVATURE),
        (unsteady_frames, JITTER),
        (fourth_order_lens, LENS),
        (rolls_in_its_channel, TILT),
    ],
)
def test_another_law_of_the_same_stage_leaves_noise(disturbed, kind):
    assert beyond(disturbed, kind) == pytest.approx(1.0, abs=0.12)


def test_parameters_that_an_inexact_law_has_biased_are_free():
    assert beyond(angle_wanders, STATIC, LAG, off=0.3) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("kind", [LAG, CURVATURE, JITTER, LENS, STATIC, TILT])
def test_what_no_law_of_the_stage_can_do_is_left(kind):
    assert beyond(wanders_sideways, kind) > 10.0


@pytest.mark.parametrize("disturbed", [angle_wanders, unsteady_frames])
def test_a_rigid_motion_has_one_law(disturbed):
    assert beyond(disturbed, STATIC) > 2.0


def test_an_angle_sensor_sees_no_stage():
    made = recordings()
    segments = [replace(s, observed=s.observed[:, :1]) for s in prepare(true_model(), made[0], made[1:2])]
    fitter = Fitter(true_model(), segments)
    assert confined.residuals(fitter, Fit(Hypothesis().plus(BY_ID[LAG], True), fitter.start(), [])) is None
