"""The package's functions: what they say of themselves, and that they are the commands' own."""

from __future__ import annotations

import ast
import inspect
import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runner import Taut

import tautline as tl

SECTIONS = ("Shapes", "Units", "Errors", "Source")
FUNCTIONS = [name for name in tl.__all__ if inspect.isfunction(getattr(tl, name))]
TYPES = [name for name in tl.__all__ if inspect.isclass(getattr(tl, name))]


def lacks(function: Callable[..., Any]) -> list[str]:
    """What a public function does not say: a section, or one of its parameters."""
    text = inspect.getdoc(function) or ""
    missing = [each for each in SECTIONS if not re.search(rf"^{each}: \S.{{10}}", text, re.MULTILINE)]
    named = [name for name in inspect.signature(function).parameters if name != "progress"]
    return missing + [name for name in named if not re.search(rf"\b{name}\b", text)]


def silent_about(source: str) -> list[str]:
    """Public methods that raise a TautError themselves and do not say so, or that say nothing at all but have a body of
    more than one statement."""
    found = []
    for each in ast.walk(ast.parse(source)):
        if not isinstance(each, ast.FunctionDef) or each.name.startswith("_"):
            continue
        text = ast.get_docstring(each) or ""
        raises = any(
            isinstance(node, ast.Raise) and "Error" in ast.unparse(node.exc) for node in ast.walk(each) if node != each
            if isinstance(node, ast.Raise) and node.exc is not None
        )  # fmt: skip
        if raises and "Error" not in text:
            found.append(f"{each.name}: errors")
        if "Array" in ast.unparse(each.args) + ast.unparse(each.returns or ast.Constant(None)) and "(n" not in text:
            found.append(f"{each.name}: shapes")
    return found


def test_every_function_says_shapes_units_errors_and_source() -> None:
    assert {"load", "calibrate", "predict", "diagnose", "encode", "compensate", "track", "report"} <= set(FUNCTIONS)
    assert {name: missing for name in FUNCTIONS if (missing := lacks(getattr(tl, name)))} == {}


def test_a_function_that_says_too_little_is_found() -> None:
    def told(q: float, unsaid: float) -> None:
        """One.

        Shapes: q (n,) of anything.
        Units: s, and no more.
        Source: an equation, eq. 4.
        """

    assert lacks(told) == ["Errors", "unsaid"]


def test_the_types_methods_say_their_shapes_and_errors() -> None:
    silent = {}
    for name in TYPES:
        made = getattr(tl, name)
        if missing := silent_about(inspect.cleandoc("\n" + inspect.getsource(made))):
            silent[name] = missing
    assert silent == {}
    assert silent_about("def f(x: Array) -> None:\n    raise TautError('no')") == ["f: errors", "f: shapes"]


def test_what_is_public_has_a_room_and_comes_late() -> None:
    """`import tautline` and `taut --help` must not wait for scipy, pandas or OpenCV."""
    code = "import sys, tautline, tautline.cli; print(*{'numpy', 'scipy', 'pandas', 'cv2'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""
    assert all(getattr(tl, name) is not None for name in tl.__all__)
    assert (Path(tl.__file__).parent / "py.typed").is_file()
    with pytest.raises(AttributeError, match="no attribute 'calibrat'"):
        _ = tl.calibrat  # type: ignore[attr-defined]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording, made by the command."""
    made = tmp_path_factory.mktemp("api") / "recording"
    words = ["simulate", "--out", made, "--reversals", "12", "--amplitude", "2.5", "--speed", "4"]
    subprocess.run([sys.executable, "-m", "tautline", *map(str, words)], check=True, capture_output=True)
    return made


@pytest.fixture(scope="module")
def recording(folder: Path) -> tl.Recording:
    return tl.load(folder)


@pytest.fixture(scope="module")
def found(recording: tl.Recording) -> tl.Calibration:
    return tl.calibrate(recording)


def test_calibrate_is_the_commands(folder: Path, found: tl.Calibration, tmp_path: Path, taut: Taut) -> None:
    done = taut("calibrate", folder, "--out", tmp_path / "model", "--json")
    assert done.code == 0, done.err
    assert json.loads(done.out)["backlash"]["width"] == found.model.width.tolist()
    assert tl.Model.load(tmp_path / "model").c_deg.tolist() == found.model.c_deg.tolist()


def test_the_truth_is_found(folder: Path, found: tl.Calibration) -> None:
    truth = json.loads((folder / "truth.json").read_text())["backlash"]
    low, high = found.model.measured
    q = np.linspace(low, high, 50)
    off = np.interp(q, found.model.q, found.model.width) - np.interp(q, truth["q"], truth["width"])
    assert np.sqrt(np.mean(off**2)) < 0.005  # mm: the widths are 0.3 to 0.8


def test_predict_encode_compensate_and_track(
    folder: Path, recording: tl.Recording, found: tl.Calibration, tmp_path: Path, taut: Taut
) -> None:
    model = found.model
    assert recording.marker is not None
    scene = recording.marker.t_s - model.delay_s
    predicted = tl.predict(model, recording.motor, scene)
    assert predicted.image_px is not None
    assert predicted.c_deg.shape == scene.shape and predicted.image_px.shape == (*scene.shape, 2)
    late = scene > 20.0  # after a full backlash both ways
    off = predicted.image_px[:, 0] - recording.marker.u_px
    assert np.sqrt(np.mean(off[late] ** 2)) < 0.1  # px; the marker's noise is 0.05

    points = tl.compensate(model, [0.0, 1.0, 2.0], [0.0, 10.0, 0.0], rate_hz=100)
    assert points.q.shape == points.clipped.shape == points.t_s.shape == (201,) and not points.clipped.any()
    for wrong in ([0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 1.0, np.nan]):
        with pytest.raises(tl.TautError, match="trajectory"):
            tl.compensate(model, wrong, [0.0, 1.0, 2.0])
    with pytest.raises(tl.TautError, match="choose one of off, backlash, full"):
        tl.compensate(model, [0.0, 1.0], [0.0, 1.0], mode="half")  # type: ignore[arg-type]

    blob = tl.encode(model, instrument="SN-7")
    assert isinstance(blob, bytes) and 1000 < len(blob) < 4096
    with pytest.raises(tl.TautError, match="axis 9"):
        tl.encode(model, axis=9)

    tracked = tl.track(model, recording)
    assert len(tracked.rows) == len(tracked.t_s) == len(scene)
    tl.report(found, tmp_path / "model", recording)
    assert taut("track", tmp_path / "model", folder, "--csv", tmp_path / "rows.csv").code == 0
    rows = np.genfromtxt(tmp_path / "rows.csv", delimiter=",", names=True, usecols=(1, 3))
    assert np.allclose(rows["c_deg"], tracked.column("c_deg"), atol=1e-6)


def test_report_of_a_calibration_of_a_model_and_what_it_refuses(
    recording: tl.Recording, found: tl.Calibration, tmp_path: Path
) -> None:
    page = tl.report(found, tmp_path / "model", recording)
    assert page == tmp_path / "model" / "report.html" and (tmp_path / "model" / "evidence.npz").is_file()
    whole = page.read_text()
    motion = tmp_path / "model" / "next_motion.csv"
    assert tl.recording.read_motor(motion, found.model.rig).t_s[-1] > 1.0 and found.gaps
    assert tl.report(found.model, tmp_path / "model").read_text() != whole
    assert not motion.exists()  # nothing is known of where this one came from
    assert not (tmp_path / "model" / "evidence.npz").exists()  # those frames were not behind this one
    with pytest.raises(tl.TautError, match="give them too"):
        tl.report(found, tmp_path / "other")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.txt").write_text("mine")
    with pytest.raises(tl.TautError, match="holds other files"):
        tl.report(found, tmp_path / "full", recording)


def test_recordings_of_different_rigs_are_refused(recording: tl.Recording, folder: Path, tmp_path: Path) -> None:
    other = tl.load(folder, recording.rig.with_camera(fx_px=500.0))  # type: ignore[union-attr]
    with pytest.raises(tl.TautError, match="differs"):
        tl.calibrate([recording, other])
    with pytest.raises(tl.TautError, match="rig"):
        tl.calibrate([])
    with pytest.raises(tl.TautError, match="no such folder"):
        tl.load(tmp_path / "nowhere")


def test_a_plot_is_a_figure_to_show_or_save(recording: tl.Recording, found: tl.Calibration, tmp_path: Path) -> None:
    seen, alone = tl.plot(found, recording), tl.plot(found.model)
    points = [sum(len(line.get_xdata()) for line in figure.axes[1].lines) for figure in (seen, alone)]
    assert points[0] > points[1]  # every frame's place behind the curve
    labels = [axes.get_ylabel() for axes in seen.axes[:2]]
    assert "backlash" in labels[0].lower() and "deg" in labels[1]
    both = tl.plot({"monday": found.model, "friday": found.model})
    assert {"monday", "friday"} <= {text.get_text() for text in both.axes[0].get_legend().get_texts()}
    both.savefig(tmp_path / "both.png")
    with pytest.raises(AttributeError):
        tl.plot("monday")  # type: ignore[arg-type]


def test_recordings_of_one_name_are_told_apart(recording: tl.Recording) -> None:
    """Two folders may have one name: as the commands do it, the second gets a number."""
    from tautline import api

    names = [each.name for each in api._several([recording, recording, recording])]
    assert names == [recording.name, f"{recording.name} (2)", f"{recording.name} (3)"]


def test_no_recording_is_refused_in_words(recording: tl.Recording, found: tl.Calibration) -> None:
    with pytest.raises(tl.TautError, match="a recording of use"):
        tl.track(found.model, [])
    with pytest.raises(tl.TautError, match="no test"):
        tl.diagnose(recording, [])
    with pytest.raises(tl.TautError, match="no model"):
        tl.plot({})
