"""The formats of `taut export`: one table, of which command, errors and pages are made."""

from __future__ import annotations

from dataclasses import dataclass

from tautline.io.exporting.source import DIAGNOSIS, MODEL, RECORDING

EXTRA = "export"


@dataclass(frozen=True)
class Format:
    """A format of `taut export`."""

    name: str  # of --to
    says: str  # what comes out
    takes: tuple[str, ...]  # RECORDING, MODEL, DIAGNOSIS
    loses: str  # what it cannot hold
    needs: tuple[tuple[str, str], ...] = ()  # further libraries that write it: module, distribution
    suffix: str = ""  # of --out; "": a folder
    axis: str = ""  # --axis where it is not named; "": it has none


_ALL, _LAW = (RECORDING, MODEL, DIAGNOSIS), (MODEL, DIAGNOSIS)
_ONE = "all but one width: B(q), f_remain, a gradual onset, effects"

FORMATS = (
    Format(
        "mcap",
        "an MCAP of JSON messages with their schemas, and a Foxglove layout beside it",
        _ALL,
        "frames become JPEG; times are nanoseconds from 0 on",
        (("mcap", "mcap"),),
        ".mcap",
    ),
    Format(
        "rerun",
        "a rerun recording: every column over time, the marker on the picture, B and f_remain over q",
        _ALL,
        "frames become JPEG; q of a curve is in millionths",
        (("rerun", "rerun-sdk"),),
        ".rrd",
    ),
    Format("csv", "a folder of CSV files, and columns.json that says what they are", _ALL, "the video's frames"),
    Format(
        "mjcf",
        "a folder with the MJCF of --into and what was found in it: what MuJoCo has in XML, the rest as a callback",
        _LAW,
        "in XML what polynomials leave of B and f_remain, and most effects; export.json has each",
        (("mujoco", "mujoco"),),
    ),
    Format(
        "linuxcnc",
        "a table of screw and backlash compensation, both directions, and its lines of the INI file",
        _LAW,
        "a gradual onset, effects that tables do not hold; 256 points",
        suffix=".comp",
        axis="0",
    ),
    Format("marlin", "lines of Configuration_adv.h", _LAW, _ONE, suffix=".h", axis="x"),
    Format("fluidnc", "config.yaml of FluidNC's backlash proposal", _LAW, _ONE, suffix=".yaml", axis="x"),
    Format("klipper", "printer.cfg of Klipper's backlash draft", _LAW, _ONE, suffix=".cfg", axis="x"),
)
BY_NAME = {each.name: each for each in FORMATS}
