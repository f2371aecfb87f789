"""The list of `taut`'s commands, in groups: the name of each, its line in `taut --help`, and an example."""

from __future__ import annotations

import importlib
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

_SOURCES = Path(__file__).resolve().parents[3]  # the root of the clone, if the package is used from one


@dataclass(frozen=True)
class Command:
    """One command of `taut`. Its module holds a click command called `command`."""

    name: str
    says: str  # its line in `taut --help`
    example: str
    of_a_clone: str = ""  # dotted module in a clone's tools, for a command that the wheel lacks; "": in this package

    @property
    def module(self) -> str:
        """The dotted name of the module that holds the command."""
        return self.of_a_clone or f"tautline.cli.{self.name}"

    @property
    def there(self) -> bool:
        """Whether the command's module exists: a wheel lacks those that are in a clone's tools."""
        return not self.of_a_clone or (_SOURCES / self.of_a_clone.replace(".", "/")).with_suffix(".py").is_file()


_ALL: dict[str, tuple[Command, ...]] = {
    "Begin": (
        Command("demo", "the whole job on a simulated instrument, without hardware", "taut demo --out tautline-demo"),
        Command(
            "simulate",
            "make a recording with a simulated instrument and endoscope",
            "taut simulate --out session --reversals 12 --amplitude 2.5 --speed 4",
        ),
        Command(
            "explain",
            "what a message means: an effect, a reason, a fault, a key of rig.toml, a term",
            "taut explain transmission.creep",
        ),
    ),
    "Measure and use": (
        Command(
            "calibrate",
            "measure B(q) and f_remain from a recording, or live from a board and a camera",
            "taut calibrate session --rig rig.toml --out monday",
        ),
        Command(
            "live",
            "calibrate or diagnose in a browser on this machine, or watch a recording again",
            "taut live --simulate --out monday",
        ),
        Command(
            "predict",
            "what a model says the tip does under a recorded motor motion",
            "taut predict monday session --csv predicted.csv",
        ),
        Command(
            "compensate",
            "motor set-points that lead the tip along a trajectory, for any motor",
            "taut compensate monday --trajectory path.csv --csv q.csv",
        ),
        Command(
            "diagnose",
            "where model and instrument part, which effect is the cause, how far the gap shrinks",
            "taut diagnose session tuesday --rig rig.toml --out diagnosis",
        ),
        Command(
            "track",
            "how a model would have been kept calibrated while the instrument was used",
            "taut track monday session --csv rows.csv",
        ),
        Command(
            "fleet",
            "calibrate every session of many robots: who drifts, which batch is worn, what is unlike",
            "taut fleet robots --out fleet",
        ),
        Command("compare", "how B and f_remain changed between models", "taut compare monday friday"),
        Command("report", "write a model's report again", "taut report monday"),
        Command(
            "shapes",
            "remember a model for each shape of the shaft, and recall it",
            "taut shapes list shapes",
        ),
    ),
    "In and out": (
        Command(
            "import",
            "recordings out of a ROS bag, an MCAP file, a LeRobot data set or a CSV",
            "taut import log.mcap --rig rig.toml --out session",
        ),
        Command(
            "export",
            "write a recording, model or diagnosis for a log viewer, a simulator or a motor controller",
            "taut export session --to mcap --out session.mcap",
        ),
        Command(
            "rig",
            "make a rig.toml: the camera from a board, its place from known angles, the rest by asking",
            "taut rig --board board.avi --squares 8x6 --square-mm 4 --marker-mm 3 --motion known",
        ),
        Command("marker", "pick the marker's colour, once", "taut marker 0"),
    ),
    "With a board": (
        Command("boards", "list the boards that are attached, with their firmware and protocol", "taut boards"),
        Command(
            "commission",
            "put a motor into service: polarity, scale, current, ends and servo gains, stored on the board",
            "taut commission --rig rig.toml",
        ),
        Command(
            "home",
            "find an axis' mechanical end at low drive, so that the board knows its position",
            "taut home --rig rig.toml",
        ),
        Command("clear", "clear a board's faults, and say which they were and what mends them", "taut clear"),
        Command(
            "update",
            "give a board new firmware over USB: checked by hash and signature, the old one kept",
            "taut update build/rp2040/tautline.update",
        ),
        Command("flash", "load a model's tables into a board and read them back", "taut flash monday"),
        Command(
            "follow",
            "follow a trajectory of the tip, with or without compensation",
            "taut follow monday --camera 0 --trajectory path.csv",
        ),
        Command("stream", "send tip set-points at 200 Hz or more, for teleoperation", "taut stream monday"),
        Command(
            "ros",
            "a ROS 2 node: compensated set-points, joint states, the tracked tip, the calibration's state",
            "taut ros monday --camera 0 --ros-args -r __ns:=/left",
        ),
        Command(
            "record",
            "record motor, marker and video from a board and a camera",
            "taut record --camera 0 --rig rig.toml --out session",
        ),
        Command("monitor", "watch a board's axes live", "taut monitor"),
        Command(
            "watch",
            "keep a model calibrated while the instrument is used, live",
            "taut watch monday --camera 0 --rig rig.toml",
        ),
    ),
    "Try it out": (
        Command(
            "blindtest",
            "diagnose instruments whose effect is withheld, then open the labels and score",
            "taut blindtest --out campaign --quick",
            of_a_clone="tools.blindtest.command",
        ),
        Command(
            "inject",
            "let a fault happen on a simulated board, and see what is said of it",
            "taut inject blocked",
        ),
    ),
}
GROUPS = {title: tuple(each for each in group if each.there) for title, group in _ALL.items()}
COMMANDS = {command.name: command for group in GROUPS.values() for command in group}


def import_module_of(command: Command) -> ModuleType:
    """Imports the command's module and returns it. For a command that only a clone has, the clone's root is appended to
    Python's path (sys.path) first."""
    if command.of_a_clone and str(_SOURCES) not in sys.path:
        sys.path.append(str(_SOURCES))
    return importlib.import_module(command.module)


@dataclass
class Said:
    """What the running command has printed already. One instance is click's context object (`obj`)."""

    result: bool = False  # whether the result was printed on stdout


# What the exit statuses of every command mean.
EXIT_STATUS = {
    0: "done",
    1: "an error: one line on stderr says what is wrong and what to do",
    2: "a command line that cannot be understood",
    3: "a calibration that is unusable; what can be looked at is written",
    130: "stopped by Ctrl-C; what was recorded so far is kept",
}
