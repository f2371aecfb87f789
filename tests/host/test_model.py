"""A model is a folder, and a simulation."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tautline.discrepancy import Discrepancy
from tautline.errors import TautError
from tautline.model import Deviation, Effect, Model, Uncertainty
from tautline.recording import Motor
from tautline.rig import Actuator, Coarse, Rig
from tautline.value import same


def make(falling: bool = False) -> Model:
    q = np.linspace(-1.0, 11.0, 25)
    width = 1.0 + 0.2 * np.sin(q)
    gain = -2.0 if falling else 2.0
    rig = Rig(Actuator("deg", (-1.0, 11.0), 0.01), Coarse(gain, 0.0))
    return Model(
        rig, q, width, 0.01 * np.ones(25), gain * q, 0.08, (0.0, 10.0), (Effect("transmission.lag", {"tau_s": 0.1}),),
        uncertainty=uncertain(width, gain * q), load_reference_mNm=40.0,
    )  # fmt: skip


def uncertain(width: np.ndarray, c_deg: np.ndarray) -> Uncertainty:
    pair = [
        Deviation(np.round(width * by, 6), np.round(c_deg + by, 6), 0.08 * by, (Effect("joint.gain", {"gain": by}),))
        for by in (0.9, 1.1)
    ]
    apart = Discrepancy(0.3, np.array([[0.0, 1.0], [2.0, 3.0]]), np.array([0.5, 0.7]), 0.01)
    return Uncertainty(0.05, 1.0 + 0.1 * width, 0.001, -4.0 * width, 0.02, (tuple(pair),), apart)


@pytest.mark.parametrize("falling", [False, True])
def test_saved_and_loaded_it_is_the_same(tmp_path, falling):
    model = make(falling)
    model.save(tmp_path / "m")
    again = Model.load(tmp_path / "m")
    for name in ("q", "width", "width_sigma", "c_deg"):
        assert np.array_equal(getattr(again, name), getattr(model, name))
    assert (again.rig, again.delay_s, again.measured) == (model.rig, model.delay_s, model.measured)
    assert (again.effects, again.extra) == (model.effects, model.extra)
    assert again == model


def damaged(document: dict, key: str, value: object) -> dict:
    return document | {"uncertainty": document["uncertainty"] | {key: value}}


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("noise", "much"), ("noise", -1.0), ("tracked_px", float("inf")), ("noise_times", [0.0] * 25),
        ("noise_times", [1.0]), ("width_by_delay", [1.0]), ("deviations", [[{}]]), ("deviations", 3),
        ("discrepancy", {"sigma": 1.0, "white": 0.1, "inputs": [1.0], "lengths": [1.0]}),
        ("discrepancy", {"sigma": 1.0, "white": 0.1, "inputs": [[1.0]], "lengths": [0.0]}),
    ],
)  # fmt: skip
def test_a_wrong_uncertainty_is_damage(tmp_path, key, value):
    make().save(tmp_path)
    path = tmp_path / "model.json"
    path.write_text(json.dumps(damaged(json.loads(path.read_text()), key, value)))
    with pytest.raises(TautError, match=r"damaged, .*: make the model again"):
        Model.load(tmp_path)


def test_a_model_of_before_has_its_uncertainty(tmp_path):
    """It stood among what the report shows."""
    model = make()
    model.save(tmp_path)
    path = tmp_path / "model.json"
    document = json.loads(path.read_text())
    moved = {name: document.pop(name) for name in ("uncertainty", "load_reference_mNm", "simulator")}
    told = moved.pop("uncertainty")
    del told["noise_times"]  # it knew of none
    document["extra"] = moved | told | {"evidence": {"residual": 0.03, "error": told.pop("noise")}}
    path.write_text(json.dumps(document))
    again = Model.load(tmp_path)
    assert same(again.uncertainty, replace(model.uncertainty, noise_times=None))
    document["extra"]["width_by_delay"] = [None, *told["width_by_delay"][1:]]
    path.write_text(json.dumps(document))
    assert Model.load(tmp_path).uncertainty.width_by_delay is None
    assert again.load_reference_mNm == model.load_reference_mNm


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (None, "make it with taut calibrate"),
        ("{", "not valid JSON"),
        ('{"delay_s": ' + 5000 * "1" + "}", "not valid JSON"),
        ("[]", "format"),
        ('{"format": "model/1"}', "q, width, .* missing"),
        ('{"format":"model/1","q":[0,1],"width":[0,3],"width_sigma":[0,0],"c_deg":[0,1],"delay_s":0,'
         '"measured":[0,1],"effects":[],"extra":{}}', "not a model's"),
    ],
)  # fmt: skip
def test_a_folder_that_is_no_model_is_refused_in_one_line(tmp_path, text, says):
    if text is not None:
        (tmp_path / "model.json").write_text(text)
    with pytest.raises(TautError, match=says) as error:
        Model.load(tmp_path)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("delay_s", np.nan),
        ("measured", [0.0, np.inf]),
        ("offset_s", np.nan),
        ("load_reference_mNm", np.inf),
        ("effects", [{"id": 5, "parameters": {}}]),
        ("effects", [{"id": "transmission.lag", "parameters": {"lag": "long"}}]),
        ("effects", [{"id": "transmission.lag", "parameters": {"lag": np.nan}}]),
    ],
)
def test_a_value_that_is_no_finite_number_is_damage(tmp_path, key, value):
    make().save(tmp_path)
    document = json.loads((tmp_path / "model.json").read_text())
    (tmp_path / "model.json").write_text(json.dumps(document | {key: value}))
    with pytest.raises(TautError, match=r"damaged, a value is wrong .*no finite number"):
        Model.load(tmp_path)


@pytest.mark.parametrize("falling", [False, True])
def test_simulation_starts_on_the_centre_or_where_it_is_told(falling):
    model = make(falling)
    motor = Motor(np.array([0.0, 1.0]), np.array([3.0, 9.0]))
    gain = -2.0 if falling else 2.0
    assert model.simulate(motor, [0.0])[0] == pytest.approx(gain * 3.0)
    assert model.simulate(motor, [0.0], start_deg=gain * 3.2)[0] == pytest.approx(gain * 3.2)
    end = model.simulate(motor, [2.0, 1.0])
    assert end[0] == end[1]
    p = model.remaining_inverse(end[0])
    assert p + np.interp(p, model.q, model.width) / 2 == pytest.approx(9.0)


@pytest.mark.parametrize("falling", [False, True])
def test_the_inverse_of_the_law_leads_back_also_beyond_the_grid(falling):
    model = make(falling)
    p = np.linspace(-3.0, 13.0, 60).reshape(3, 20)
    np.testing.assert_allclose(model.remaining_inverse(model.remaining(p)), p, atol=1e-12)


def test_b_was_measured_at_the_nodes_that_reversals_reached():
    model = make()
    assert model.q[model.is_measured].tolist() == [q for q in model.q if 0.0 <= q <= 10.0]
