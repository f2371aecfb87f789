"""The verdict of a calibration: how reasons make it, that it is kept, that nothing unusable is driven with."""

from dataclasses import replace

import numpy as np
import pytest

from tautline.model import Model
from tautline.quality import Quality, Reason, Verdict
from tautline.simulated.instrument import preset, reference_rig

RIG = reference_rig()
DOUBT = Reason("transmission.lag", "the tip follows late", "mend it")
FATAL = Reason("frame_size", "the frames are half the rig's", "check camera.width_px", fatal=True)


def model(*reasons: Reason) -> Model:
    plant, q = preset("reference", RIG), np.linspace(*RIG.actuator.range, 201)
    made = Model(RIG, q, plant.backlash(q), 0.001 + 0 * q, plant.bend(q), 0.08, (-4.5, 4.5))
    return replace(made, quality=Quality.of(reasons))


def test_a_verdict_is_its_reasons_and_what_is_fatal_comes_first():
    assert Quality().verdict is Verdict.GOOD
    assert Quality.of([DOUBT]).verdict is Verdict.DOUBTFUL
    worst = Quality.of([DOUBT, FATAL, DOUBT])
    assert worst.verdict is Verdict.UNUSABLE and worst.reasons == (FATAL, DOUBT)


def test_a_model_keeps_its_verdict_and_the_sigma_of_f_remain(tmp_path):
    sigma = np.full(201, 0.02)
    sigma[:5] = np.nan
    replace(model(DOUBT), c_sigma=sigma).save(tmp_path / "m")
    again = Model.load(tmp_path / "m")
    assert again.quality == Quality((DOUBT,))
    assert np.array_equal(again.c_sigma, sigma, equal_nan=True)


@pytest.mark.parametrize(
    "command", [("flash",), ("stream", "--duration", "0.1"), ("follow", "--simulate"), ("flash", "--json")]
)
def test_nothing_is_driven_with_an_unusable_model(tmp_path, taut, command):
    model(DOUBT, FATAL).save(tmp_path / "m")
    result = taut(command[0], tmp_path / "m", *command[1:])
    assert result.code == 3
    assert "unusable" in result.err and "check camera.width_px" in result.err and "--force" in result.err
    assert result.err.count("\n") == 1


def test_force_goes_on_with_a_warning(tmp_path, taut):
    model(FATAL).save(tmp_path / "m")
    result = taut("flash", tmp_path / "m", "--board", "usbip:127.0.0.1:9", "--force")
    assert result.code == 1 and "warning" in result.err and "frame_size" not in result.err.split("\n")[-2]
