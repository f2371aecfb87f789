"""taut watch: the tracker on a board and its camera, while the motor moves."""

import json
from dataclasses import replace

import pytest
from click.testing import CliRunner

from tautline.cli import taut
from tautline.errors import TautError
from tautline.live.following import follow_run
from tautline.live.recalling import recall
from tautline.live.setup import open_live
from tautline.live.tracking import watch
from tautline.model import Model, Uncertainty
from tautline.shapes import Library
from tautline.simulated.instrument import preset, reference_rig


def model_of_the_reference() -> Model:
    """What a calibration of the simulated instrument finds, without the wait."""
    rig = reference_rig()
    instrument = preset("reference", rig)
    width = instrument.backlash(instrument.grid)
    own = rig.actuator.range
    errs = Uncertainty(noise=0.05)
    return Model(
        rig, instrument.grid, width, 0.001 + 0 * width, instrument.c_deg, rig.delay_s, own, uncertainty=errs
    )  # fmt: skip


@pytest.mark.minutes
@pytest.mark.parametrize("scale", [1.0, 0.7])
def test_watch_tells_whether_the_model_still_holds(tmp_path, scale):
    model = model_of_the_reference()
    replace(model, width=scale * model.width).save(tmp_path / "instrument")
    with open_live(simulate=str(tmp_path / "instrument"), pictures=False) as live:
        result = watch(live, model, "smooth", speed=4.0, duration_s=25.0)
        assert not live.board._listeners["batch"]  # what comes is no longer gathered
    assert result["frames"] > 500
    if scale == 1.0:
        assert result["state"] == "trusted" and not result["changes"]
        assert (result["offset"], result["scale"]) == (0.0, 1.0)
        assert result["rms_px"] < 0.08
    else:
        assert "stale" in [change["state"] for change in result["changes"]]
        assert result["scale"] == pytest.approx(0.7, abs=0.02)
        assert result["offset"] == pytest.approx(0.0, abs=0.005)
        assert "transmission.backlash" in result["reason"]


@pytest.mark.minutes
def test_watch_proposes_the_shape_that_the_shaft_has(tmp_path):
    """The instrument is that of another model of the library; `taut watch` with the first one says so."""
    model = model_of_the_reference()
    other = replace(model, width=0.7 * model.width)
    library = Library(tmp_path / "shapes").add("straight", model).add("looped", other)
    for name, mine in (("looped", model), ("straight", other)):
        with open_live(simulate=str(library.folder / name), pictures=False) as live:
            result = watch(live, mine, "smooth", speed=4.0, duration_s=20.0, library=library)
        assert result["shape"] == name
    with open_live(simulate=str(library.folder / "looped"), pictures=False) as live:
        result = watch(live, other, "smooth", speed=4.0, duration_s=10.0, library=library)
    assert result["shape"] is None and result["state"] == "trusted"


@pytest.mark.minutes
def test_a_short_motion_tells_which_shape_the_shaft_has_and_follow_names_another(tmp_path):
    model = model_of_the_reference()
    library = Library(tmp_path / "shapes").add("straight", model)
    library = library.add("looped", replace(model, width=0.7 * model.width))
    with open_live(simulate=str(library.folder / "looped"), pictures=False, at=3.5) as live:
        shape, rms = recall(live, library)
        assert shape.name == "looped" and rms["looped"] < 0.1 < 1.0 < rms["straight"]
        followed = follow_run(live, "smooth", model=library.model("looped"), track=True, library=library)
        assert followed.tracking is not None and followed.tracking["shape"] is None
    with open_live(simulate=str(library.folder / "looped"), pictures=False) as live:
        followed = follow_run(live, "smooth", model=model, track=True, library=library)
        assert followed.tracking is not None and followed.tracking["shape"] == "looped"
    with open_live(simulate=str(library.folder / "looped"), pictures=False) as live:
        live.marker_source = None
        with pytest.raises(TautError, match="--camera"):
            recall(live, library)


@pytest.mark.minutes
def test_follow_without_a_model_recalls_the_shape_first(tmp_path):
    model = model_of_the_reference()
    library = Library(tmp_path / "shapes").add("straight", model)
    folder = str(library.add("looped", replace(model, width=0.7 * model.width)).folder)
    ran = CliRunner().invoke(taut, ["follow", "--shapes", folder, "--simulate", f"{folder}/looped"])
    assert ran.exit_code == 0, ran.stderr
    assert "the shaft has the shape 'looped'" in ran.stderr and "model trusted" in ran.stdout
    told = CliRunner().invoke(taut, ["shapes", "recall", folder, "--simulate", f"{folder}/straight", "--json"])
    assert told.exit_code == 0 and json.loads(told.stdout)["name"] == "straight"
    blind = CliRunner().invoke(taut, ["follow", f"{folder}/looped", "--shapes", folder])
    assert blind.exit_code == 2 and "--camera" in blind.stderr
