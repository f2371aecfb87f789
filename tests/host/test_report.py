"""Reports stand alone, say what was measured, and survive models that measured little."""

from __future__ import annotations

import base64
import html.parser
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from matplotlib.figure import Figure

from tautline import trajectory
from tautline.cli.compare import command as compare
from tautline.cli.report import command as rewrite
from tautline.errors import TautError
from tautline.model import Model, Uncertainty
from tautline.quality import Quality, Reason
from tautline.recording import Recording
from tautline.reports import evidence, figures, pages
from tautline.rig import Actuator, Coarse, Rig
from tautline.simulated import endoscope, instrument, simulate


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
        uncertainty=Uncertainty(delay_sigma_s=0.0004),
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
    model = true_model(plant, onsets, notes=notes, pass_width=[None] * 80 + [0.5] * 121)
    return model, recording


class Links(html.parser.HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.sources: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.sources += [value or "" for name, value in attrs if name in ("src", "href")]

    def handle_data(self, data: str) -> None:
        self.text += data.replace("\u00a0", " ")


def read(path: Path) -> Links:
    page = Links()
    page.feed(path.read_text(encoding="utf-8"))
    return page


def test_report_stands_alone_and_says_the_result(measured: tuple[Model, Recording], tmp_path: Path) -> None:
    model, recording = measured
    seen = evidence.collect(model, [recording])
    page = read(pages.write(model, tmp_path, seen))
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
        "delay of the sensor" not in read(pages.write(replace(model, sensor="angle", delay_s=0.0), tmp_path, seen)).text
    )


def test_a_model_that_measured_nothing_says_so(measured: tuple[Model, Recording], tmp_path: Path) -> None:
    model = replace(measured[0], measured=(0.0, -1.0), extra={})
    assert "No width could be measured" in read(pages.write(model, tmp_path, None)).text


def test_runs_beside_a_model_are_shown(measured: tuple[Model, Recording], tmp_path: Path) -> None:
    t = np.linspace(0, 10, 101)
    for name, size in (("off", 4.0), ("full", 0.2)):
        run = evidence.Run(t, np.sin(t), np.sin(t) + np.where(t > 1, size, 99.0), t > 1)
        run.save(tmp_path, name)
    assert evidence.Run.load_all(tmp_path)["full"].rms_deg == pytest.approx(0.2, rel=1e-4)
    text = read(pages.write(measured[0], tmp_path, None)).text
    assert "off by 4.0 deg without compensation and by 0.20 deg with it: 20 times less" in text


def test_a_new_model_keeps_what_is_not_the_old_ones(measured: tuple[Model, Recording], tmp_path: Path) -> None:
    model, recording = measured
    folder = tmp_path / "model"
    pages.save_model(model, [recording], folder)
    (folder / "notes.txt").write_text("mine")
    t = np.linspace(0, 1, 11)
    evidence.Run(t, t, t, t > 0).save(folder, "full")
    sentences = pages.save_model(model, [recording], folder)
    assert len(sentences) == 3 and (folder / "notes.txt").read_text() == "mine"
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
    assert rows[1]["remaining_rest_rms_deg"] == pytest.approx(0.0, abs=1e-9)
    assert rows[2]["width_mean"] is None
    text = read(page).text
    assert "tuesday: B changed by +100 µm" in text and "friday has measured no q" in text
    assert "f_remain by +3.0 deg throughout, and by 0 deg rms about that" in text
    assert "offset of f_remain (deg)" in text and "rest of its change (deg rms)" in text
    printed = CliRunner().invoke(compare, names)
    assert printed.exit_code == 0
    title, _, tuesday, _ = printed.output.splitlines()
    assert title.endswith("f_remain offset (deg)  rest (deg rms)") and tuesday.split()[-2:] == ["3", "0"]
    assert CliRunner().invoke(compare, names[:1]).exit_code == 2
    assert "twice" in str(CliRunner().invoke(compare, [names[0], names[0]]).exception)


def test_a_comparison_is_not_cut_on_a_small_screen(measured: tuple[Model, Recording], tmp_path: Path) -> None:
    browser = pytest.importorskip("tools.browser", reason="needs the extra `test`")
    if not browser.there():
        pytest.skip("no chromium with its driver: tools/setup browser")
    model, _ = measured
    models = {name: replace(model, width=model.width + 1e-3 * k) for k, name in enumerate(("monday", "friday-evening"))}
    pages.write_comparison(models, tmp_path / "compare.html")
    with browser.browser(1000) as seen:
        seen.get((tmp_path / "compare.html").as_uri())
        cut = "return [...document.querySelectorAll('.scroll, body')].filter(e => e.scrollWidth > e.clientWidth).length"
        assert seen.execute_script(cut) == 0


def test_every_axis_has_a_unit(measured: tuple[Model, Recording]) -> None:
    model, recording = measured
    seen = evidence.collect(model, [recording])
    onsets = figures.onsets_of(model)
    passes = np.array(model.extra["pass_width"], dtype=float)
    run = evidence.Run(seen.t_s, seen.c_deg, seen.c_deg, np.ones(len(seen.t_s), dtype=bool))
    drawn = [
        figures.hero(model, onsets, seen),
        figures.stage_errors(seen),
        figures.recorded_motion(seen, onsets, "mm"),
        figures.residuals(seen, "mm"),
        figures.cross_check(model, passes),
        figures.followed_runs({"off": run}),
        figures.compared({"one": model, "other": model}),
    ]
    for made in drawn:
        labels = [text for axes in made.axes for text in (axes.get_xlabel(), axes.get_ylabel()) if text]
        assert labels and all(re.search(r"\((mm|µm|deg|px|s|ms|counts)\)", text) for text in labels), labels
        assert all(axes.get_xlabel() for axes in made.axes if axes.get_subplotspec().is_last_row())


def test_no_width_lies_outside_its_axes(measured: tuple[Model, Recording]) -> None:
    model, _ = measured
    plant = instrument.preset("reference", model.rig)
    wide = an_onset(plant, 3.0, 5.3, 1) | {"width": 0.9, "q2": 6.1, "sigma": 0.1}  # the motor went beyond the range
    made = figures.hero(model, figures.onsets_of(replace(model, extra={"onsets": [wide]})), None)
    axes = made.axes[0]
    low, high = axes.get_xlim()
    assert low <= figures.q_mean(wide) <= high and axes.get_ylim()[1] >= 0.9 + 2 * 0.1


def test_a_width_that_nothing_is_known_of_has_no_bar(measured: tuple[Model, Recording]) -> None:
    model, _ = measured
    vague = dict(figures.onsets_of(model)[0]) | {"sigma": 40.0}
    axes = figures.hero(model, figures.onsets_of(replace(model, extra={"onsets": [vague]})), None).axes[0]
    bars = [
        path.vertices
        for drawn in axes.collections
        if type(drawn).__name__ == "LineCollection"
        for path in drawn.get_paths()
    ]
    assert all(np.ptp(bar[:, 1]) < axes.get_ylim()[1] for bar in bars)
    assert any(vague["width"] in np.asarray(line.get_ydata()) for line in axes.lines)


def test_equal_models_show_their_difference(measured: tuple[Model, Recording]) -> None:
    model, _ = measured
    made = figures.compared({"one": model, "same": model, "wider": replace(model, width=model.width + 0.1)})
    change = made.axes[2]
    lines = {line.get_label(): line.get_ydata() for line in change.lines}
    assert np.allclose(lines["same"], 0.0) and np.allclose(lines["wider"], 100.0)  # um
    band = change.collections[0].get_paths()[0].get_extents()
    assert band.height == pytest.approx(4 * np.sqrt(2) * 4.0)  # 2 sigma of a difference, both ways
    styles = {line.get_label(): (line.get_linestyle(), line.get_linewidth()) for line in made.axes[0].lines}
    assert len(set(styles.values())) == 3


def test_nothing_is_gained_over_an_f_coarse_that_is_wrong(measured: tuple[Model, Recording], tmp_path: Path) -> None:
    model, recording = measured
    turned = replace(model, rig=replace(model.rig, coarse=Coarse(-model.rig.coarse.gain, 0.0)))
    seen = evidence.collect(turned, [recording])
    assert "wrong" not in pages.sentences(turned, seen)[1]
    doubted = replace(turned, quality=Quality((Reason("coarse", "the tip bends the other way", "turn the sign"),)))
    said = pages.sentences(doubted, seen)[1]
    assert "something in the rig is wrong" in said
    page = read(pages.write(doubted, tmp_path, seen))
    assert "taut explain coarse" in page.text and "the encoder's direction" in page.text


def test_a_report_shows_what_the_camera_saw(measured: tuple[Model, Recording], tmp_path: Path) -> None:
    model, recording = measured
    scope = endoscope.Endoscope(model.rig)
    kept = tmp_path / "kept.png"
    cv2.imwrite(str(kept), scope.frame(20.0))
    pages.save_model(model, [replace(recording, picture=kept)], tmp_path / "model")
    page = read(tmp_path / "model" / "report.html")
    (uri,) = [source for source in page.sources if source.startswith("data:image/jpeg")]
    shown = cv2.imdecode(np.frombuffer(base64.b64decode(uri.split(",")[1]), np.uint8), cv2.IMREAD_COLOR)
    assert shown.shape == (576, 720, 3)
    blue = np.array([178, 111, 31])  # the marker's way
    assert recording.marker is not None
    near = [
        shown[round(v), round(u)] for u, v in zip(recording.marker.u_px[::20], recording.marker.v_px[::20], strict=True)
    ]
    assert np.mean(np.abs(np.array(near, dtype=float) - blue).max(axis=1) < 60) > 0.9
    pages.save_model(model, [recording], tmp_path / "model")  # a recording without a picture
    assert not any(s.startswith("data:image/jpeg") for s in read(tmp_path / "model" / "report.html").sources)


def test_what_backlash_costs_is_told_apart_from_f_coarse(measured: tuple[Model, Recording]) -> None:
    model, recording = measured
    seen = evidence.collect(model, [recording])
    said = pages.sentences(model, seen)
    coarse, with_width, _ = seen.rms()
    assert f"off by {coarse:.2g} px, with B by {with_width:.2g} px" in said[1] and "times" not in " ".join(said)
    told = re.search(r"puts the tip ([\d.]+) deg off \(rms\), ([\d.]+) mm of the motor", said[2])
    assert told is not None
    without = replace(model, width=np.zeros_like(model.width))
    scene_s = seen.t_s[seen.settled]
    c_deg = model.simulate(recording.motor, scene_s)
    off_deg = without.simulate(recording.motor, scene_s) - c_deg
    off_mm = np.interp(scene_s, recording.motor.t_s, recording.motor.q) - model.remaining_inverse(c_deg)
    for value, off in zip(told.groups(), (off_deg, off_mm), strict=True):
        assert float(value) == pytest.approx(np.sqrt(np.mean(off**2)), rel=0.05)


def test_nothing_is_praised_where_the_verdict_is_unusable(measured: tuple[Model, Recording]) -> None:
    model, recording = measured
    fatal = Reason("clock", "the clocks contradict each other", "give the frames' times", fatal=True)
    said = pages.sentences(replace(model, quality=Quality((fatal,))), evidence.collect(model, [recording]))
    assert len(said) == 1 and "f_coarse" not in said[0] and "known to" not in said[0]


def test_the_page_of_what_is_unusable_shows_no_gain(measured: tuple[Model, Recording], tmp_path: Path) -> None:
    model, recording = measured
    seen = evidence.collect(model, [recording])
    good = read(pages.write(model, tmp_path, seen)).text
    fatal = Reason("clock", "the clocks contradict each other", "give the frames' times", fatal=True)
    bad = read(pages.write(replace(model, quality=Quality((fatal,))), tmp_path, seen)).text
    for boast in ("times better", "known to ±", "prediction", "What the model gains"):
        assert boast in good and boast not in bad
    assert "Nothing here holds" in bad


TEMPLATES = Path(pages.__file__).parent / "templates"
_COLOUR = r"#[0-9a-f]{3,8}\b"


def test_every_colour_of_a_page_has_one_for_the_dark() -> None:
    text = (TEMPLATES / "page.html").read_text()
    light, dark = re.findall(r":root \{(.*?)\}", text, re.DOTALL)
    assert "@media screen and (prefers-color-scheme: dark)" in text  # paper stays light
    names = [set(re.findall(r"--([\w-]+):", block)) for block in (light, dark)]
    assert names[0] == names[1] and "color-scheme: light dark" in light
    for path in TEMPLATES.glob("*.html"):
        elsewhere = re.sub(r":root \{.*?\}", "", path.read_text(), flags=re.DOTALL)
        assert re.findall(_COLOUR, elsewhere) == [], path.name


def test_a_phone_is_told_that_a_drawing_goes_on_and_a_photograph_fits(
    measured: tuple[Model, Recording], tmp_path: Path
) -> None:
    model, recording = measured
    kept = tmp_path / "kept.png"
    cv2.imwrite(str(kept), endoscope.Endoscope(model.rig).frame(20.0))
    pages.save_model(model, [replace(recording, picture=kept)], tmp_path / "model")
    text = (tmp_path / "model" / "report.html").read_text()
    figure = re.findall(r'<img src="data:image/(svg|jpeg)[^>]*?( class="photo")?><figcaption>(<span)?', text)
    assert {kind for kind, *_ in figure} == {"svg", "jpeg"}
    assert all((kind == "jpeg") == bool(photo) == (not hint) for kind, photo, hint in figure)


def test_no_heading_stands_alone_at_the_foot_of_a_printed_page() -> None:
    printed = (TEMPLATES / "page.html").read_text().partition("@media print")[2]
    assert re.search(r"h2[^{}]*\{ break-after: avoid; \}", printed)
    assert re.search(r"figure[^{}]*\{ break-inside: avoid; \}", printed)


def test_what_is_hollow_is_in_the_legend_and_what_was_not_measured_has_no_band(
    measured: tuple[Model, Recording],
) -> None:
    model, _ = measured
    low, high = model.q[20], model.q[-20]
    seen = replace(model, measured=(float(low), float(high)))
    common = {"t_s": 1.0, "q1": 0.0, "used": True, "reason": ""}
    onsets = [
        {**common, "q2": 0.5, "direction": 1, "width": 0.5, "sigma": 0.01},
        {**common, "q2": -0.5, "direction": -1, "width": 0.5, "sigma": 0.4},
    ]
    axes = Figure().subplots()
    figures.draw_backlash(axes, seen, onsets)
    assert {"onset, rising", "vague, falling"} <= {text.get_text() for text in axes.get_legend().get_texts()}
    band = axes.collections[0].get_paths()[0].get_extents()
    assert band.x0 >= low - 1e-9 and band.x1 <= high + 1e-9


def test_a_change_of_b_is_told_in_micrometres(measured: tuple[Model, Recording], tmp_path: Path) -> None:
    model, _ = measured
    models = {"monday": model, "friday": replace(model, width=model.width + 0.002)}
    pages.write_comparison(models, tmp_path / "c.html")
    text = read(tmp_path / "c.html").text
    assert "B changed by +2.0 µm on average" in text and "change of B (µm)" in text


def damaged(folder: Path, **columns: Any) -> None:
    """Puts other columns into the evidence that lies in a folder."""
    with np.load(folder / evidence.FILE) as data:
        whole = dict(data)
    np.savez_compressed(folder / evidence.FILE, **whole | columns)


@pytest.mark.parametrize("column", ["recording", "t_s", "q", "path", "seen", "c_deg", "error", "settled", "names"])
def test_evidence_of_which_a_part_is_short_is_refused(
    measured: tuple[Model, Recording], tmp_path: Path, column: str
) -> None:
    seen = evidence.collect(measured[0], [measured[1]])
    seen.save(tmp_path)
    assert evidence.Evidence.load(tmp_path) is not None
    damaged(tmp_path, **{column: getattr(seen, column)[:-1]})
    with pytest.raises(TautError, match="do not fit each other"):
        evidence.Evidence.load(tmp_path)


def test_the_times_of_a_board_that_is_on_for_days_are_kept(tmp_path: Path) -> None:
    t_s = 5e5 + np.arange(0.0, 1.0, 0.01)
    evidence.Run(t_s, t_s, t_s, t_s > 0).save(tmp_path, "full")
    assert np.abs(evidence.Run.load_all(tmp_path)["full"].t_s - t_s).max() < 1e-3


def test_a_run_in_which_nothing_is_scored_is_compared_with_none() -> None:
    t_s = np.arange(3.0)
    never, always = (evidence.Run(t_s, t_s, t_s + 1.0, np.full(3, counted)) for counted in (False, True))
    assert pages._run_sentences({"off": always, "full": never}) == []
    assert len(pages._run_sentences({"off": always, "full": always})) == 1


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("late_s", [0.0, 1000.0])
def test_a_recording_in_which_the_tip_is_hardly_seen_has_a_report(
    measured: tuple[Model, Recording], tmp_path: Path, late_s: float
) -> None:
    model, recording = measured
    marker = recording.marker
    assert marker is not None
    keep = np.arange(len(marker.t_s)) == 100  # one frame, within the motor's times or beyond them
    few = replace(
        recording,
        marker=replace(
            marker,
            t_s=marker.t_s[keep] + late_s,
            u_px=marker.u_px[keep],
            v_px=marker.v_px[keep],
            valid=marker.valid[keep],
            sigma_px=None if marker.sigma_px is None else marker.sigma_px[keep],
        ),
    )
    pages.save_model(model, [few], tmp_path / "model")
    assert (tmp_path / "model" / pages.FILE).exists()
    assert (tmp_path / "model" / evidence.FILE).exists() == (late_s == 0.0)


def test_models_of_two_units_or_of_none_are_not_compared(measured: tuple[Model, Recording]) -> None:
    model = measured[0]
    other = replace(model, rig=replace(model.rig, actuator=replace(model.rig.actuator, unit="deg")))
    with pytest.raises(TautError, match="different units"):
        figures.compared({"one": model, "other": other})
    with pytest.raises(TautError, match="no model"):
        figures.compared({})
