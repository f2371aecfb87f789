"""taut explain: every code that a message may name has a page, made from its definition."""

from __future__ import annotations

import ast
import html
import json
import re
from pathlib import Path

import pytest
from cli_runner import Taut

from tautline import effects, explain, rig
from tautline.cli._topic_pages import picture, write_all
from tautline.device import wire
from tautline.errors import TautError
from tautline.explain.faults import LOOK
from tautline.layouts import LAYOUTS
from tautline.recording import Motor

PACKAGE = Path(explain.__file__).parents[1]


def codes_in_the_source() -> set[str]:
    """The first text of every Reason(...), doubt(...) and notice(...) in the package, and of the departures' table."""
    found = set()
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and node.args:
                name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
                if name in ("Reason", "doubt", "notice") and path.name != "quality.py":  # which reads them from a file
                    for part in ast.walk(node.args[0]):
                        if isinstance(part, ast.Constant) and isinstance(part.value, str):
                            found.add(part.value)
            if isinstance(node, ast.AnnAssign) and getattr(node.target, "id", "") == "_MEANS":
                assert isinstance(node.value, ast.Dict)
                found |= {
                    ast.literal_eval(value.elts[0]) for value in node.value.values if isinstance(value, ast.Tuple)
                }
    return found


def test_every_reason_of_a_verdict_has_a_page() -> None:
    codes = codes_in_the_source()
    assert {"coverage", "clock.offset", "registration.drift", "transmission.creep", "lost"} <= codes and len(codes) > 30
    assert codes - set(explain.topics()) == set()
    reasons = {topic.code for topic in explain.topics().values() if topic.kind == "reason"}
    assert reasons - codes == set()  # nor one that nothing gives


def test_every_effect_says_how_to_tell_and_mend_it() -> None:
    for kind in effects.LIBRARY:
        topic = explain.topics()[kind.id]
        assert kind.tell.endswith(".") and kind.mend.endswith(".") and len(topic.rows) == len(kind.parameters)


def test_every_fault_and_refusal_has_a_page() -> None:
    faults = {name for name, (number, _) in wire.wire.FAULTS.items() if number}
    assert faults == set(LOOK)
    assert faults <= set(explain.topics())
    assert {f"refused.{name}" for name in wire.wire.REASONS} <= set(explain.topics())


def test_every_key_and_column_has_a_page() -> None:
    example = dict(rig.SECTIONS)
    assert set(example) == {"actuator", "coarse", "kinematics", "camera", "angle", "hand_eye"}
    for section in rig.SECTIONS.values():
        for key in section.keys:
            assert key.name in explain.find(f"rig.{section.name}.{key.name}").rows[0][1]
    for layout in LAYOUTS:
        for name in layout.names("mm"):
            assert explain.find(f"{layout.file}:{name}").code == layout.file


def test_the_example_of_every_key_is_a_rig() -> None:
    """The pages' own examples, put together, are read; and each is in the file's documentation."""
    document = {s.name: {key.name: key.example for key in s.keys} for s in rig.SECTIONS.values()}
    assert rig.Rig.from_document({"format": rig.FORMAT, **document}, "the pages").has_camera
    page = (PACKAGE.parents[1] / "docs" / "files.md").read_text()
    block = page.split("```toml")[1].split("```")[0]
    for section in rig.SECTIONS.values():
        assert f"[{section.name}]" in block
        for key in section.keys:
            assert f"\n{key.name} = " in block, f"docs/files.md does not have {section.name}.{key.name}"


@pytest.mark.parametrize("section", list(rig.SECTIONS))
def test_a_wrong_value_leads_to_its_page(section: str) -> None:
    document = {s.name: {key.name: key.example for key in s.keys} for s in rig.SECTIONS.values()}
    for key in rig.SECTIONS[section].keys:
        for wrong in (["a"], {"a": 1}, float("nan")):
            broken = {name: dict(values) for name, values in document.items()}
            broken[section][key.name] = wrong
            with pytest.raises(TautError, match=rf"{section}\.{key.name} .*taut explain rig\.{section}\.{key.name}\)"):
                rig.Rig.from_document({"format": rig.FORMAT, **broken}, "rig.toml")


def test_the_motor_s_columns_are_what_is_read() -> None:
    from dataclasses import fields

    from tautline.layouts import MOTOR

    names = {name.removesuffix("_mm") if name.startswith("q") else name for name in MOTOR.names("mm")}
    assert names == {field.name for field in fields(Motor)} - {"extra"}


def test_what_topics_lead_to_is_there() -> None:
    known = explain.topics()
    for topic in known.values():
        assert set(topic.see) <= set(known), topic.code
        assert (topic.kind in explain.KINDS and topic.what.endswith(".")) or topic.kind == "file", topic.code
    files = [topic.file for topic in known.values()]
    assert len(set(files)) == len(files)


def test_names_are_found_and_near_ones_told(taut: Taut) -> None:
    names = {
        "lag": "transmission.lag",
        "stall": "STALL",
        "actuator.range": "rig.actuator.range",
        "[hand_eye]": "rig.hand_eye",
        "central fibre": "f_remain",
        "motor.csv:q_mm": "motor.csv",
    }
    for name, code in names.items():
        assert json.loads(taut("explain", name, "--json").out)["code"] == code
    assert "is it f_remain?" in taut.refuses("explain", "f_remian")
    assert "taut explain' lists" in taut.refuses("explain", "qqqqq")
    listed = taut("explain").out
    assert all(code in listed for code in explain.topics())


def test_the_index_is_searched_by_every_word_of_a_topic(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page's own script, on rows as the page has them."""
    monkeypatch.setattr("tautline.cli._topic_pages.picture", lambda topic: None)
    page = write_all(tmp_path).read_text()
    assert '<input type="search"' in page
    rows = {code: words for words, code in re.findall(r'<tr data-words="([^"]*)">.*?">([^<]+)</a>', page)}
    assert set(rows) == set(explain.topics())
    assert "words.every((word) => row.dataset.words.includes(word))" in page
    asked = ["gradually", "corner"]
    shown = [code for code, text in rows.items() if all(word in html.unescape(text) for word in asked)]
    assert "transmission.smooth_onset" in shown and len(shown) < 10


def test_the_pages_are_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tautline.cli._topic_pages.picture", lambda topic: None)
    index = write_all(tmp_path / "pages")
    written = {path.name for path in index.parent.iterdir()}
    assert written == {topic.file for topic in explain.topics().values()} | {"index.html"}
    for path in index.parent.iterdir():
        for target in re.findall(r'href="([^"#]+)"', path.read_text()):
            assert target in written, f"{path.name} leads to {target}"


@pytest.mark.parametrize(
    "code", ["transmission.lag", "camera.distortion", "registration.static", "configuration.contact"]
)
def test_an_effect_s_picture_shows_it(code: str) -> None:
    topic = explain.topics()[code]
    shown = picture(topic)
    assert shown is not None and shown.uri.startswith("data:image/svg")
    assert picture(explain.topics()["transmission.stick_slip"]) is None


def test_what_a_message_names_it_leads_to(capsys: pytest.CaptureFixture[str]) -> None:
    from tautline.cli._common import quality_lines
    from tautline.cli.diagnose import _log_topics
    from tautline.quality import Quality, Reason

    _log_topics({"effects": [{"id": "transmission.lag"}]})
    said = capsys.readouterr().err + "\n".join(
        quality_lines(Quality((Reason("clock.offset", "it is off", "mend it"),)))
    )
    assert "'taut explain transmission.lag'" in said and "'taut explain clock.offset'" in said
