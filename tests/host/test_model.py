"""A model is a folder, and a simulation."""

import numpy as np
import pytest

from tautline.errors import TautError
from tautline.model import Effect, Model
from tautline.recording import Motor
from tautline.rig import Actuator, Coarse, Rig


def make(falling: bool = False) -> Model:
    q = np.linspace(-1.0, 11.0, 25)
    width = 1.0 + 0.2 * np.sin(q)
    gain = -2.0 if falling else 2.0
    rig = Rig(Actuator("deg", (-1.0, 11.0), 0.01), Coarse(gain, 0.0))
    return Model(
        rig, q, width, 0.01 * np.ones(25), gain * q, 0.08, (0.0, 10.0), (Effect("transmission.lag", {"tau_s": 0.1}),)
    )


@pytest.mark.parametrize("falling", [False, True])
def test_saved_and_loaded_it_is_the_same(tmp_path, falling):
    model = make(falling)
    model.save(tmp_path / "m")
    again = Model.load(tmp_path / "m")
    for name in ("q", "width", "width_sigma", "c_deg"):
        assert np.array_equal(getattr(again, name), getattr(model, name))
    assert (again.rig, again.delay_s, again.measured) == (model.rig, model.delay_s, model.measured)
    assert (again.effects, again.extra) == (model.effects, model.extra)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (None, "make it with taut calibrate"),
        ("{", "not valid JSON"),
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
