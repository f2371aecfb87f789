"""The command `taut`. Each subcommand is a module of its own, imported only when it is asked for."""

from __future__ import annotations

import importlib
import os
import sys

import click

from tautline import __version__
from tautline.errors import TautError, of_system

# Name, and the line that `taut --help` shows. Module tautline.cli.NAME holds a click command called `command`.
COMMANDS = {
    "boards": "list the boards that are attached, with their firmware and protocol",
    "commission": "put a motor into service: polarity, scale, current, ends and servo gains, stored on the board",
    "home": "find an axis' mechanical end at low drive, so that the board knows its position",
    "clear": "clear a board's faults, and say which they were and what mends them",
    "calibrate": "measure B(q) and f_remain from a recording, or live from a board and a camera",
    "predict": "what a model says the tip does under a recorded motor motion",
    "track": "how a model would have been kept calibrated while the instrument was used",
    "compensate": "motor set-points that lead the tip along a trajectory, for any motor",
    "diagnose": "where model and instrument part, which effect is the cause, how far the gap shrinks",
    "flash": "load a model's tables into a board and read them back",
    "follow": "follow a trajectory of the tip, with or without compensation",
    "stream": "send tip set-points at 200 Hz or more, for teleoperation",
    "rig": "make a rig.toml: the camera from a board, its place from known angles, the rest by asking",
    "import": "recordings out of a ROS bag, an MCAP file, a LeRobot data set or a CSV",
    "record": "record motor, marker and video from a board and a camera",
    "monitor": "watch a board's axes live",
    "watch": "keep a model calibrated while the instrument is used, live",
    "shapes": "remember a model for each shape of the shaft, and recall it",
    "marker": "pick the marker's colour, once",
    "simulate": "make a recording with a simulated instrument and endoscope",
    "compare": "how B and f_remain changed between models",
    "report": "write a model's report again",
    "export": "write a recording, model or diagnosis for a log viewer, a simulator or a motor controller",
    "explain": "what a message means: an effect, a reason, a fault, a key of rig.toml, a term",
    "blindtest": "diagnose instruments whose effect is withheld, then open the labels and score",
    "inject": "let a fault happen on a simulated board, and see what is said of it",
    "demo": "the whole job on a simulated instrument, without hardware",
}


class _Commands(click.Group):
    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"tautline.cli.{cmd_name}")
        command: click.Command = module.command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="taut")
def taut() -> None:
    """Measures and undoes what a tendon-driven instrument loses between motor and tip."""


def main() -> None:
    """Exit status: 0 on success, 2 on a usage error, 3 on an unusable calibration, 1 otherwise, after one line that
    says what to do.
    TAUT_TRACEBACK=1 shows where an error that nobody foresaw comes from."""
    try:
        taut(standalone_mode=False)
    except click.ClickException as error:
        error.show()
        sys.exit(2 if isinstance(error, click.UsageError) else 1)
    except (click.Abort, KeyboardInterrupt):
        click.echo("taut: stopped", err=True)
        sys.exit(1)
    except TautError as error:
        click.echo(f"taut: {error}", err=True)
        sys.exit(error.status)
    except BrokenPipeError:
        sys.exit(1)
    except OSError as error:
        if error.filename is None and os.environ.get("TAUT_TRACEBACK"):
            raise
        click.echo(f"taut: {of_system(error)}", err=True)
        sys.exit(1)
    except Exception as error:
        if os.environ.get("TAUT_TRACEBACK"):
            raise
        what = " ".join(str(error).split())
        click.echo(f"taut: internal error, {type(error).__name__}: {what} (TAUT_TRACEBACK=1 shows where)", err=True)
        sys.exit(1)
