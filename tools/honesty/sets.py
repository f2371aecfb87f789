"""Which conditions may be looked at while something is tuned, and which are set aside: families.toml, drawn once."""

from __future__ import annotations

import tomllib
from pathlib import Path

from tools.honesty.conditions import CONDITIONS
from tools.honesty.conditions.registry import BENIGN

FILE = Path(__file__).with_name("families.toml")
SETS = ("tuning", "aside")


def of_each() -> dict[str, str]:
    """The set of every condition, in the order of families.toml."""
    drawn = tomllib.loads(FILE.read_text())
    families = {family: which for which in SETS for family in drawn[which]}
    benign = {name: which for which in SETS for name in drawn[BENIGN][which]}
    return {c.name: benign[c.name] if c.family == BENIGN else families[c.family] for c in CONDITIONS.values()}


# One or two of most families, quick ones: what a continuous integration can afford.
CI = (
    "strokes-that-wander",
    "twenty-seconds",
    "spindle-with-angle-sensor",
    "counts-of-20-um",
    "image-clock-off-by-2-s",
    "middle-crossed-one-way",
    "range-in-um",
    "mjpeg-on-a-plain-wall",
    "gradual-over-30-percent",
    "registration-shifts",
    "angle-80-ms-late",
    "width-grows-by-5-percent",
)
