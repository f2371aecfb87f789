"""One source to one format."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tautline.errors import TautError
from tautline.io.exporting import constants, csv_files, linuxcnc, log
from tautline.io.exporting.formats import BY_NAME, EXTRA, Format
from tautline.io.exporting.source import Source

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Mount:
    """Where a model goes into an MJCF."""

    into: Path  # the user's MJCF
    actuator: str  # its name there: its control is q
    tip: str  # joint:NAME or site:NAME
    scale: float | None = None  # of the control, per unit of q; None: 0.001 for mm, pi / 180 for deg


@dataclass(frozen=True)
class Exported:
    """What an export wrote, and what it lost."""

    files: tuple[Path, ...]
    lost: tuple[str, ...]  # what the format does not hold, a line each
    report: dict[str, Any] = field(default_factory=dict)  # of mjcf: export.json


# Of each controller's format: the function that writes it, and the one that says what it loses of a model.
_CONTROLLERS: dict[str, tuple[Callable[..., list[Path]], Callable[..., list[str]]]] = {
    "linuxcnc": (linuxcnc.write, linuxcnc.loses),
    "marlin": (constants.write_marlin, constants.loses),
    "fluidnc": (constants.write_fluidnc, constants.loses),
    "klipper": (constants.write_klipper, constants.loses),
}


def export(
    source: Source,
    to: str,
    out: Path,
    *,
    mount: Mount | None = None,
    axis: str | None = None,
    progress: Progress = lambda share, what: None,
) -> Exported:
    """Writes a source to `out`, a file or a folder, whole or not at all, in the format named `to` (of FORMATS), and
    returns what was written and what the format lost. mount: for mjcf, where the model goes; axis: for controllers,
    None takes the format's usual one; progress: gets the share done, 0 to 1, and a word. TautError where format,
    source, options or place do not fit."""
    form = BY_NAME.get(to)
    if form is None:
        raise TautError(f"--to {to}: no such format: choose one of {', '.join(BY_NAME)}")
    _check(form, source, mount, axis)
    if to == "mjcf":
        from tautline.io.exporting import mjcf

        assert mount is not None  # _check has asked for it
        return mjcf.write(source.model, out, mount, progress)
    if form.axis:
        write, loses = _CONTROLLERS[to]
        files = write(source.model, out, form.axis if axis is None else axis)
        return Exported(tuple(files), tuple(loses(source.model)))
    what = log.of_source(source)
    if to == "csv":
        files = csv_files.write(what, out)
    elif to == "mcap":
        from tautline.io.exporting import mcap_file

        files = mcap_file.write(what, out, progress)
    else:
        from tautline.io.exporting import rerun_file

        files = rerun_file.write(what, out, progress)
    return Exported(tuple(files), (form.loses,) if what.video is not None else ())


def _check(form: Format, source: Source, mount: Mount | None, axis: str | None) -> None:
    """Raises TautError where the format does not take this source or these options, or needs a package that is not
    installed."""
    if source.kind not in form.takes:
        raise TautError(f"{source.name}: is {source.kind}: --to {form.name} takes {' or '.join(form.takes)}")
    if source.models and (form.axis or form.name == "mjcf") and source.model.simulator is not None:
        raise TautError(
            f"{source.name}: begins with a simulator, its B is over that one's tip and not the motor: calibrate, and "
            "export that model"
        )
    for module, package in form.needs:
        if importlib.util.find_spec(module) is None:
            raise TautError(
                f"--to {form.name} needs the package {package}: pip install 'tautline-robotics[{EXTRA}]', "
                f"or pip install {package}"
            )
    if form.name == "mjcf" and mount is None:
        raise TautError("--to mjcf needs --into MODEL.xml, --actuator A and --tip joint:J or site:S")
    if form.name != "mjcf" and mount is not None:
        raise TautError(f"--into, --actuator and --tip go with --to mjcf, not with {form.name}")
    if axis is not None and not form.axis:
        raise TautError(f"--axis goes with {', '.join(f.name for f in BY_NAME.values() if f.axis)}, not {form.name}")
