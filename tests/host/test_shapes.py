"""A library of shapes: what tells them apart, what is recalled, and what an index may not hold."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tautline.errors import TautError
from tautline.model import Model
from tautline.recording import save
from tautline.shapes import INDEX, Library, Seen, Shape, offset_and_scale
from tautline.tracking import replay
from tools.tracking.sessions import Change, Instrument, ideal_model, session

INSTRUMENT = Instrument(4)
FIRST = ideal_model(INSTRUMENT)


def bent(offset: float, scale: float) -> Model:
    """What a calibration finds with the shaft bent: a motor that seems `offset` further, and `scale` of B."""
    q = FIRST.q
    width = scale * np.interp(q + offset, q, FIRST.width)
    return replace(FIRST, width=width, c_deg=INSTRUMENT.of_place(INSTRUMENT.law, q + offset))


def library(folder: Path) -> Library:
    made = Library(folder).add("straight", FIRST)
    made = made.add("looped", bent(0.4, 0.8), 150.0)
    return made.add("u-turn", bent(-0.2, 1.5))


def test_offset_and_scale_are_those_that_a_tracker_finds():
    offset, scale = offset_and_scale(FIRST, bent(0.4, 0.8))
    assert offset == pytest.approx(0.4, abs=0.005) and scale == pytest.approx(0.8, abs=0.02)
    made = session(INSTRUMENT, "offset", 4, 60.0, change=Change("offset", offset=0.4, scale=0.8), start_s=15.0)
    row = replay(FIRST, [made.recording]).rows[-1]
    assert (row.offset, row.scale) == (pytest.approx(offset, abs=0.01), pytest.approx(scale, abs=0.02))


def test_what_was_added_is_read_back(tmp_path):
    made = library(tmp_path)
    read = Library.load(tmp_path)
    assert read == made and [shape.name for shape in read.shapes] == ["straight", "looped", "u-turn"]
    assert read.of("looped").current_mA == 150.0 and read.of("u-turn").current_mA is None
    own = read.own(bent(0.4, 0.8))
    assert own is not None and own.name == "looped"
    assert read.own(bent(0.41, 0.8)) is None
    again = read.add("looped", bent(0.1, 1.1))
    assert len(again.shapes) == 3 and again.of("looped").offset == pytest.approx(0.1, abs=0.005)


@pytest.mark.parametrize(
    ("own", "offset", "scale", "current", "name"),
    [
        ("straight", 0.0, 1.0, None, "straight"),
        ("straight", 0.4, 0.8, None, "looped"),
        ("straight", 0.4, 0.8, 160.0, "looped"),
        ("straight", 0.4, 0.8, 300.0, None),  # the motor works harder than it did in that shape
        ("straight", 0.4, 1.5, None, None),
        ("straight", 0.2, 0.8, None, None),
        ("looped", -0.4, 1.25, None, "straight"),  # the same shapes, told by another's model
        ("looped", -0.6, 1.875, None, "u-turn"),
    ],
)
def test_a_shape_is_the_one_that_it_is_near_to(tmp_path, own, offset, scale, current, name):
    known = library(tmp_path)
    near = known.nearest(Seen(offset, 0.002, scale, 0.005, current), known.of(own), 0.4)
    assert (near.name if near else None) == name


def test_two_that_are_alike_are_not_told_apart():
    known = Library(Path("nowhere"), (Shape("a"), Shape("b", 0.01, 1.01)))
    assert known.nearest(Seen(0.0, 0.002, 1.0, 0.005), known.of("a"), 0.4) is None


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('format = "shapes/1"\n[[shape]]\nname = "../x"\noffset = 0.0\nscale = 1.0\n', "shape.name"),
        ('format = "shapes/1"\n[[shape]]\nname = "x"\noffset = 0.0\n', "shape.scale"),
        ('format = "shapes/1"\n[[shape]]\nname = "x"\noffset = 0.0\nscale = -1.0\n', "above 0"),
        ('format = "shapes/2"\n', "shapes/1"),
        ('format = "shapes/1"\nshape = ' + 100_000 * "[", "no TOML"),
        ('format = "shapes/1"\nscale = ' + 5000 * "1", "no TOML"),
        ('format = "shapes/1"\nshape = 3\n', "[[shape]]"),
        ("no toml", "no TOML"),
    ],
)
def test_a_damaged_index_is_named(tmp_path, text, says):
    (tmp_path / INDEX).write_text(text)
    with pytest.raises(TautError) as refused:
        Library.load(tmp_path)
    assert says in str(refused.value) and INDEX in str(refused.value)


def test_the_first_shape_stays(tmp_path):
    with pytest.raises(TautError, match="begin another library"):
        library(tmp_path).add("straight", bent(0.1, 1.0))


def test_the_commands_add_list_and_recall(taut, tmp_path):
    shapes = tmp_path / "shapes"
    for name, model in (("straight", FIRST), ("looped", bent(0.4, 0.8))):
        model.save(tmp_path / name)
        done = taut("shapes", "add", shapes, name, tmp_path / name)
        assert done.code == 0, done.err
    assert "looped" in taut("shapes", "list", shapes).out
    for change, name in ((Change("offset"), "straight"), (Change("offset", offset=0.4, scale=0.8), "looped")):
        made = session(INSTRUMENT, "offset", 7, 20.0, change=change, start_s=-10.0)
        save(made.recording, tmp_path / f"use-{name}")
        done = taut("shapes", "recall", shapes, tmp_path / f"use-{name}")
        assert done.code == 0, done.err
        assert done.out.startswith(name) and f"taut flash {shapes / name}" in done.out
    assert "no library" in taut.refuses("shapes", "list", tmp_path)


def test_what_could_not_be_read_back_is_not_added(tmp_path):
    library = Library(tmp_path).add("straight", FIRST)
    for name, current, says in (("..", None, "1 to 40 letters"), ("bent", np.nan, "shape.current_mA is nan")):
        with pytest.raises(TautError, match=says):
            library.add(name, FIRST, current)
    assert Library.load(tmp_path) == library and not (tmp_path / "bent").exists()
