"""tools/soak.py: a slice of a long life, that it can fail, and that a failure's id lives it again."""

from __future__ import annotations

import contextlib
import re
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from tools import soak

SEED = 29  # its first mishap comes within two seconds


@pytest.fixture(autouse=True)
def desktop(request: pytest.FixtureRequest) -> None:
    if request.config.getoption("--board") != "desktop":
        pytest.skip("./run trust soak --board emulated is for that one")


def test_a_life_of_some_seconds_keeps_its_word() -> None:
    life, broken = soak.lived(SEED, None, 15.0, lambda _: None)
    assert broken == "" and life.step >= 2 and life.seen["following, s"] > 5


def test_a_life_that_broke_is_lived_again() -> None:
    """The cable is pulled 20 ms after the last count: the pulse that brakes was taken for what the axis held with, and
    what it really held with for a push, until it was a stall."""
    assert soak.lived(40, 16, 600.0, lambda _: None)[1] == ""


def test_what_breaks_is_told_with_an_id_that_lives_it_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody presses the stop button that this life is told to have been pressed."""
    monkeypatch.setattr(soak, "MISHAPS", {"stop": soak.Life.stop})
    asked = soak.SimLink.ask
    monkeypatch.setattr(soak.SimLink, "ask", lambda link, line: asked(link, line.replace("0 estop", "0 well")))
    said: list[list[str]] = [[], []]
    broken = [soak.lived(SEED, None, 60.0, said[0].append)[1]]
    found = re.fullmatch(rf"{SEED}:(\d+): axis 0 is driven though the stop button is pressed", broken[0])
    assert found is not None
    broken.append(soak.lived(SEED, int(found[1]), 60.0, said[1].append)[1])
    assert broken[0] == broken[1] and said[0] == said[1] and said[0]  # at the same moment


@pytest.mark.parametrize(
    ("axis", "says"),
    [
        ({"fault": "STALL"}, "has the fault STALL and is driven"),
        ({"fault": "STALL", "mode": soak.OFF}, "has the fault STALL for no reason"),
        ({"mode": soak.OFF, "duty_q15": 3}, "is off, at duty 3"),
        ({"duty_q15": -30000}, "is at duty -30000"),
        ({"q_q8": 256 * 30, "flags": soak.wire.code("FLAGS", "REFERENCED")}, "is 30.0 counts off"),
    ],
)
def test_what_has_to_hold_is_looked_at(axis: dict[str, int | str], says: str) -> None:
    life = object.__new__(soak.Life)
    life.allowed, life.seen, life.known, life.true, life.way = set(), soak.Counter(), [True], [0.0], [0.0]
    each = {"mode": soak.wire.code("MODES", "HOLD"), "fault": "NONE", "duty_q15": 0, "q_q8": 0, "flags": 0} | axis
    each["fault"] = soak.wire.code("FAULTS", str(each["fault"]))

    with pytest.raises(soak.Broken, match=re.escape(says)):
        life.look({"powered": True, "board_us": 0, "axes": [each]})


@pytest.mark.parametrize(("after", "breaks"), [(0, False), (3, True)])
def test_a_bridge_has_a_period_to_go_off(after: int, breaks: bool) -> None:
    """The real image is looked at between the fault and the end of the PWM's period, too."""
    life = object.__new__(soak.Life)
    life.allowed, life.seen, life.known = {"SUPPLY"}, soak.Counter(), [False]
    life.true, life.way, life.seconds = [0.0], [0.0], 0.0
    duties = iter((3, after))

    class Link:
        def ask_all(self, *_: str) -> list[dict[str, object]]:
            fault = soak.wire.code("FAULTS", "SUPPLY")
            axis = {"mode": soak.OFF, "fault": fault, "duty_q15": next(duties), "q_q8": 0}
            return [{"q": [[0]]}, {"powered": True, "board_us": 0, "axes": [axis]}]

    life.link = Link()  # type: ignore[assignment]
    with pytest.raises(soak.Broken, match="is off, at duty 3") if breaks else contextlib.nullcontext():
        life.pass_by(0.02)
