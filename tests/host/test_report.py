"""Reports stand alone, say what was measured, and survive models that measured little."""

from __future__ import annotations

import html.parser
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from tautline import evidence, reports
from tautline.cli.compare import command as compare
from tautline.cli.report import command as rewrite
from tautline.errors import TautError
from tautline.model import Model
from tautline.recording import Recording
from tautline.rig import Actuator, Coarse, Rig
from tautline.simulated import instrument, simulate, trajectory


def true_model(plant: instrument.Instrument, onsets: list[dict[str, Any]], **extra: Any) -> Model:
    q = np.linspace(*plant.rig.actuator.range, 201)
    return Model(
        plant.rig,
        q,
        plant.backlash(q),
        np.full_like(q, 0.004),
        plant.bend(q),
        plant.rig.delay_s,
        (q[10], q[-10]),
        extra={"onsets": onsets, **extra},
    )


def an_onset(plant: instrument.Instrument, t_s: float, q1: float, direction: int, used: bool = True) -> dict[str, Any]:
    width = float(plant.backlash(np.array([q1]))[0])
    return {
        "recording": "simulated",
        "t_s": t_s,
        "direction": direction,
        "q1": q1,
        "q2": q1 + direction * width if used else None,
        "width": width,
        "sigma": 0.004,
        "used": used,
        "reason": "" if used else "its stroke <was> short",
    }


@pytest.fixture(scope="module")
def measured() -> tuple[Model, Recording]:
    rig = instrument.reference_rig()
    plant = instrument.preset("reference", rig)
    recording = simulate.simulate(rig, plant, trajectory.back_and_forth(rig.actuator, [2.0], 2.0, 10, 20.0))
    onsets = [an_onset(plant, 2.0, -3.0, 1), an_onset(plant, 4.0, 0.0, -1), an_onset(plant, 5.0, 2.0, 1, used=False)]
    notes = ["B was held at 0 & more"]
    model = true_model(plant, onsets, notes=notes, pass_width=[None] * 80 + [0.5] * 121, delay_sigma_s=0.0004)
    return model, recording


class Links(html.parser.HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.sources: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.sources += [value or "" for name, value in attrs if name in ("src", "href")]

    def handle_data(self, data: str) -> None:
        self.text += data


def read(path: Path) -> Links:
    page = Links()
    page.feed(path.read_text(encoding="utf-8"))
    return page


def test_report_stands_alone_and_says_the_result(measured: tuple[Model, Recording], tmp_path: Path) -> None:
    model, recording = measured
    seen = evidence.collect(model, [recording])
    page = read(reports.write(model, tmp_path, seen))
    assert len(page.sources) == 6 and all(source.startswith("data:image/svg+xml;base64,") for source in page.sources)
    assert re.search(r"turns 0\.3\d+ to 0\.80\d mm", page.text) and "B was held at 0 & more" in page.text
    assert "its stroke <was> short" in page.text and "80.0 ms" in page.text
    gain = re.search(r"within ([\d.]+) px; f_coarse alone is off by ([\d.]+) px", page.text)
    assert gain and float(gain[1]) == pytest.approx(0.05, rel=0.1) and float(gain[2]) > 10


def test_evidence_scores_only_the_settled(measured: tuple[Model, Recording], tmp_path: Path) -> None:
    model, _ = measured
    plant = instrument.preset("reference", model.rig)
    half = 0.5 * float(plant.backlash(np.array([-5.0]))[0])
    # the tip starts at one end of its backlash, the model on the centre: wrong until it is driven through
    path = trajectory.through([-4.0, -3.95, -4.1, -2.0, -4.0], 1.0, 10.0)
    off = simulate.simulate(model.rig, plant, path, start_p=-4.0 - half)
    seen = evidence.collect(model, [off])
    assert not seen.settled[0] and seen.settled[-1]
    assert np.abs(seen.error[2][~seen.settled]).max() > 1.0 and np.abs(seen.error[2][seen.settled]).max() < 0.4
    assert seen.rms()[2] == pytest.approx(0.05, rel=0.2)
    seen.save(tmp_path)
    back = evidence.Evidence.load(tmp_path)
    assert back is not None and back.rms() == seen.rms()
    (tmp_path / evidence.FILE).write_bytes(b"PK")
    with pytest.raises(TautError, match="evidence"):
        evidence.Evidence.load(tmp_path)


def test_recordings_are_put_on_one_clock(measured: tuple[Model, Recording]) -> None:
    model, recording = measured
    seen = evidence.collect(model, [recording, recording])
    assert list(np.unique(seen.recording)) == [0, 1] and np.all(np.diff(seen.t_s) > 0)
    assert seen.error.shape == (3, len(seen.t_s), 2)


def test_a_sensor_without_camera(tmp_path: Path) -> None:
    rig = Rig(Actuator("deg", (0.0, 60.0), 0.044), Coarse(-0.9, 77.0))
    plant = instrument.preset("davinci", rig)
    path = trajectory.through([5, 50, 20, 55, 5], 40.0, 400.0)
    recording = simulate.simulate(rig, plant, path, angle_noise_deg=0.02)
    model = true_model(plant, [an_onset(plant, 1.5, 50.0, -1)])
    seen = evidence.collect(model, [recording])
    assert seen.unit == "deg" and seen.rms()[2] == pytest.approx(0.02, rel=0.2)
    assert (
        "delay of the sensor"
        not in read(reports.write(replace(model, sensor="angle", delay_s=0.0), tmp_path, seen)).text
    )


def test_a_model_that_measured_nothing_says_so(measured: tuple[Model, Recording], tmp_path: Path) -> None:
    model = replace(measured[0], measured=(0.0, -1.0), extra={})
    assert "No width could be measured" in read(reports.write(model, tmp_path, None)).text


def test_runs_beside_a_model_are_shown(measured: tuple[Model, Recording], tmp_path: Path) -> None:
    t = np.linspace(0, 10, 101)
    for name, size in (("off", 4.0), ("full", 0.2)):
        run = evidence.Run(t, np.sin(t), np.sin(t) + np.where(t > 1, size, 99.0), t > 1)
        run.save(tmp_path, name)
    assert evidence.Run.load_all(tmp_path)["full"].rms_deg == pytest.approx(0.2, rel=1e-4)
    text = read(reports.write(measured[0], tmp_path, None)).text
    assert "off by 4.0 deg without compensation and by 0.20 deg with it: 20 times less" in text


def test_a_new_model_keeps_what_is_not_the_old_ones(measured: tuple[Model, Recording], tmp_path: Path) -> None:
    model, recording = measured
    folder = tmp_path / "model"
    reports.save_model(model, [recording], folder)
    (folder / "notes.txt").write_text("mine")
    t = np.linspace(0, 1, 11)
    evidence.Run(t, t, t, t > 0).save(folder, "full")
    sentences = reports.save_model(model, [recording], folder)
    assert len(sentences) == 2 and (folder / "notes.txt").read_text() == "mine"
    assert not evidence.Run.load_all(folder) and Model.load(folder).rig == model.rig


def test_report_is_written_again(measured: tuple[Model, Recording], tmp_path: Path) -> None:
    model, recording = measured
    model.save(tmp_path)
    evidence.collect(model, [recording]).save(tmp_path)
    result = CliRunner().invoke(rewrite, [str(tmp_path), "--json"])
    assert result.exit_code == 0 and json.loads(result.stdout) == {"report": str(tmp_path / "report.html")}
    assert (tmp_path / "report.html").exists()


def test_compare(measured: tuple[Model, Recording], tmp_path: Path) -> None:
    model, _ = measured
    wider = replace(model, width=model.width + 0.1, c_deg=model.c_deg + 3.0, measured=(-2.0, 9.0))
    elsewhere = replace(model, measured=(100.0, 101.0))
    for name, one in (("monday", model), ("tuesday", wider), ("friday", elsewhere)):
        one.save(tmp_path / name)
    page = tmp_path / "compare.html"
    names = [str(tmp_path / name) for name in ("monday", "tuesday", "friday")]
    result = CliRunner().invoke(compare, [*names, "--json", "--html", str(page)])
    assert result.exit_code == 0, result.output
    rows = json.loads(result.stdout)["models"]
    assert [row["model"] for row in rows] == ["monday", "tuesday", "friday"]
    assert rows[1]["width_change_mean"] == pytest.approx(0.1) and rows[1]["q_from"] == -2.0
    assert rows[1]["width_change_sigmas"] == pytest.approx(0.1 / (0.004 * np.sqrt(2)))
    assert rows[1]["remaining_change_mean_deg"] == pytest.approx(3.0)
    assert rows[1]["remaining_change_rms_deg"] == pytest.approx(0.0, abs=1e-9)
    assert rows[2]["width_mean"] is None
    text = read(page).text
    assert "tuesday: B changed by +0.100 mm" in text and "friday has measured no q" in text
    assert CliRunner().invoke(compare, names).exit_code == 0
    assert CliRunner().invoke(compare, names[:1]).exit_code == 2
    assert "twice" in str(CliRunner().invoke(compare, [names[0], names[0]]).exception)
