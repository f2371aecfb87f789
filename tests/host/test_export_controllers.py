"""Files for other motor controllers, read back as those systems' documentation says that they read them."""

from __future__ import annotations

import configparser
import re
from dataclasses import replace
from pathlib import Path

import exported
import numpy as np
import pytest
from cli_runner import Taut

from tautline.errors import TautError
from tautline.io.exporting import export
from tautline.io.exporting.constants import constant
from tautline.io.exporting.source import of_model
from tautline.model import Effect


class ScrewCompensation:
    """LinuxCNC's table of type 0: lines of nominal, forward and reverse until the first that is none, rising, 256 at
    most. The motor goes to nominal + (nominal - forward) while the joint rises, nominal + (nominal - reverse) while it
    falls, straight between the lines and held beyond them; a joint at rest keeps what it had."""

    def __init__(self, path: Path) -> None:
        rows = []
        for line in path.read_text(encoding="ascii").splitlines():
            try:
                triplet = [float(word) for word in line.split()[:3]]
            except ValueError:
                break
            if len(triplet) < 3:
                break
            rows.append(triplet)
        assert 2 <= len(rows) <= 256
        self.nominal, forward, reverse = np.array(rows).T
        assert (np.diff(self.nominal) > 0).all()
        self.rise, self.fall = self.nominal - forward, self.nominal - reverse
        self.correction = 0.0

    def step(self, joint: float, speed: float) -> float:
        if speed:
            self.correction = float(np.interp(joint, self.nominal, self.rise if speed > 0 else self.fall))
        return joint + self.correction


@pytest.mark.parametrize("falling", [False, True])
def test_linuxcnc_leads_the_tip_where_it_is_asked_to(tmp_path: Path, falling: bool) -> None:
    model = exported.model(falling=falling, camera=False)
    out = tmp_path / "joint.comp"
    export(of_model(model), "linuxcnc", out)
    table, coarse = ScrewCompensation(out), model.rig.coarse
    t = np.arange(0.0, 20.0, 2e-3)
    c_deg = 25.0 * np.sin(0.9 * t) + 8.0 * np.sin(2.3 * t)  # turns back in the middle of the range, too
    joint = (c_deg - coarse.offset) / coarse.gain
    motor = np.array([table.step(x, dx) for x, dx in zip(joint, np.gradient(joint, t), strict=True)])
    sign = -1.0 if falling else 1.0
    tip = sign * exported.law(exported.play(motor))
    bare = sign * exported.law(exported.play(joint))
    later = slice(len(t) // 4, None)
    off, before = (np.abs(each - c_deg)[later] for each in (tip, bare))
    # 256 points of 39 um, straight between them: B'' and f'' leave less than 1 um, 0.02 deg. A tick moves by 0.1 deg.
    assert np.median(off) < 0.02 and np.quantile(off, 0.98) < 0.1 < 1.0 < np.sqrt(np.mean(before**2))


def test_linuxcncs_files_may_be_called_anything(tmp_path: Path) -> None:
    out = tmp_path / "Drehgelenk_ü.comp"
    table, section = export(of_model(exported.model()), "linuxcnc", out).files
    assert len(ScrewCompensation(table).nominal) > 2
    assert "COMP_FILE = Drehgelenk_ü.comp\n" in section.read_text(encoding="utf-8")


def test_linuxcnc_says_what_it_loses_where_it_is_not_read(tmp_path: Path, taut: Taut) -> None:
    folder, out = tmp_path / "model", tmp_path / "x.comp"
    creep = Effect("transmission.creep", {"creep_share": 0.05, "creep_time": 1.0, "creep_slow": 0.0})
    exported.model(effects=(creep,)).save(folder)
    done = taut("export", folder, "--to", "linuxcnc", "--out", out, "--axis", "2")
    assert done.code == 0 and "transmission.creep is not undone" in done.err
    lines = out.read_text().splitlines()
    first = next(i for i, line in enumerate(lines) if not re.match(r"-?\d", line))
    assert first == len(ScrewCompensation(out).nominal) and any("transmission.creep" in line for line in lines[first:])
    section = configparser.ConfigParser(delimiters="=", comment_prefixes="#")
    section.read_string(Path(f"{out}.ini").read_text())
    assert section["JOINT_2"]["COMP_FILE"] == "x.comp" and section["JOINT_2"]["COMP_FILE_TYPE"] == "0"


def marlin(text: str) -> list[float]:
    """BACKLASH_DISTANCE_MM, as the preprocessor has it: comments go, one value for each of X, Y and Z."""
    code = re.sub(r"//[^\n]*", "", text)
    defines = dict(re.findall(r"^\s*#define\s+(\w+)[ \t]*(.*)$", code, re.M))
    assert {"BACKLASH_COMPENSATION", "BACKLASH_GCODE"} <= defines.keys()
    assert 0.0 <= float(defines["BACKLASH_CORRECTION"]) <= 1.0
    values = re.fullmatch(r"\{(.*)\}\s*", defines["BACKLASH_DISTANCE_MM"])
    assert values is not None
    return [float(value) for value in values[1].split(",")]


def klipper(text: str) -> dict[str, float]:
    """[backlash_compensation] of printer.cfg: a full width for each axis, and smooth_time."""
    config = configparser.ConfigParser(comment_prefixes=("#", ";"), inline_comment_prefixes=("#", ";"))
    config.read_string(text)
    assert config.sections() == ["backlash_compensation"]
    return {key: float(value) for key, value in config["backlash_compensation"].items()}


def fluidnc(text: str) -> dict[str, float]:
    """axes / LETTER / backlash of config.yaml, by its indents."""
    found, path = {}, []
    for line in text.splitlines():
        if line.strip() and not line.lstrip().startswith("#"):
            key, _, value = line.strip().partition(":")
            path[(len(line) - len(line.lstrip())) // 2 :] = [key]
            if value:
                found["/".join(path)] = float(value)
    return found


def test_one_number_is_read_back_alike_by_three_systems(tmp_path: Path) -> None:
    source = of_model(exported.model())
    number = constant(source.model).width
    paths = {name: tmp_path / name for name in ("marlin", "klipper", "fluidnc")}
    for name, path in paths.items():
        done = export(source, name, path, axis="y")
        said = path.read_text()
        assert all(what in said for what in done.lost)
    assert marlin(paths["marlin"].read_text()) == pytest.approx([0.0, number, 0.0], abs=1e-6)
    read = klipper(paths["klipper"].read_text())
    assert read == {"smooth_time": 0.005, "y_backlash": pytest.approx(number, abs=1e-6)}
    assert fluidnc(paths["fluidnc"].read_text()) == {"axes/y/backlash": pytest.approx(number, abs=1e-6)}


def test_the_number_costs_least_where_too_much_costs_ten_times_too_little() -> None:
    """Against the loss itself, by brute force: 10 per mm beyond B, 1 per mm short of it."""
    model = exported.model()
    q = model.q[(model.q >= -4.0) & (model.q <= 4.0)]
    scatter = np.random.default_rng(1).normal(0.0, 0.004, (200, len(q)))
    b = exported.width(q) + scatter
    tried = np.linspace(0.3, 0.7, 801)
    loss = [np.mean(np.where(b < x, 10.0 * (x - b), b - x)) for x in tried]
    best = tried[int(np.argmin(loss))]
    assert constant(model).width == pytest.approx(best, abs=2e-3)
    flat = replace(model, width=np.full_like(model.q, 0.4), width_sigma=np.full_like(model.q, 1e-6))
    assert constant(flat).width == pytest.approx(0.4, abs=1e-5)


def test_bad_input_is_one_line_and_writes_nothing(tmp_path: Path, taut: Taut) -> None:
    folder, out = tmp_path / "model", tmp_path / "out"
    exported.model().save(folder)
    exported.model().rig.save(tmp_path / "rig.toml")
    for words, said in (
        (("--to", "siemens"), "no such format"),
        (("--to", "marlin", "--axis", "a"), "x, y and z"),
        (("--to", "klipper", "--axis", "first"), "name one of"),
        (("--to", "linuxcnc", "--axis", "x"), "numbers its joints"),
        (("--to", "csv", "--axis", "x"), "--axis goes with"),
        (
            (
                "--to",
                "mjcf",
            ),
            "--into",
        ),
        (("--to", "csv", "--into", "a.xml", "--actuator", "a", "--tip", "joint:j"), "go with --to mjcf"),
        (("--to", "csv", "--model", folder), "is no recording"),
        (("--to", "csv", "--rig", tmp_path / "rig.toml"), "--rig goes with a recording"),
        (("--to", "marlin", "--axis", ""), "name one of"),
        (("--to", "linuxcnc", "--axis", "²"), "numbers its joints"),
    ):
        assert said in taut.refuses("export", folder, *words, "--out", out)
        assert not out.exists()
    assert taut("export", folder, "--to", "mjcf", "--into", "a.xml", "--out", out).code == 2
    assert "no such folder" in taut.refuses("export", tmp_path / "nowhere", "--to", "csv", "--out", out)
    assert "holds no motor.csv" in taut.refuses("export", tmp_path, "--to", "csv", "--out", out)
    assert "is a file" in taut.refuses("export", folder / "model.json", "--to", "csv", "--out", out)
    assert "is a folder" in taut.refuses("export", folder, "--to", "marlin", "--out", folder)
    (tmp_path / "damaged").mkdir()
    (tmp_path / "damaged" / "diagnosis.json").write_text('{"format": 1')
    assert "is damaged" in taut.refuses("export", tmp_path / "damaged", "--to", "csv", "--out", out)


def test_a_model_that_was_measured_nowhere_has_no_number(tmp_path: Path) -> None:
    nowhere = replace(exported.model(), measured=(6.0, 7.0))
    with pytest.raises(TautError, match="measured nowhere"):
        export(of_model(nowhere), "marlin", tmp_path / "x.h")
    assert not list(tmp_path.iterdir())
