"""taut export RECORDING | MODEL | DIAGNOSIS --to FORMAT --out PATH"""

from __future__ import annotations

from pathlib import Path

import click

from tautline.cli._common import Number, emit, json_option, log, progress_bar, read_rig, rig_option, warn, warn_unusable
from tautline.cli._outputs import Output, check_no_input
from tautline.io.exporting import FORMATS, Mount, export
from tautline.io.exporting.source import read


@click.command("export", epilog="Formats: " + "; ".join(f"{form.name}: {form.says}" for form in FORMATS) + ".")
@click.argument("source_path", metavar="RECORDING|MODEL|DIAGNOSIS", type=click.Path(path_type=Path))
@click.option("--to", required=True, metavar="FORMAT", help=", ".join(form.name for form in FORMATS))
@click.option("--out", "out", type=Output(), required=True, help="The file or folder to write.")
@click.option(
    "--model",
    "beside",
    type=click.Path(path_type=Path),
    help="With a recording: a MODEL or DIAGNOSIS that foretells it.",
)
@rig_option
@click.option("--into", type=click.Path(path_type=Path), help="mjcf: the MJCF that the model goes into.")
@click.option("--actuator", help="mjcf: its actuator whose control is q.")
@click.option("--tip", help="mjcf: what bends, joint:NAME or site:NAME.")
@click.option(
    "--scale", type=Number(), help="mjcf: of the control, per unit of q; default 0.001 for mm, pi/180 for deg."
)
@click.option("--axis", help="linuxcnc: the joint's number; marlin, fluidnc, klipper: the axis' letter.")
@json_option
def command(
    source_path: Path,
    to: str,
    out: Path,
    beside: Path | None,
    rig_path: Path | None,
    into: Path | None,
    actuator: str | None,
    tip: str | None,
    scale: float | None,
    axis: str | None,
    as_json: bool,
) -> None:
    """Write a recording, a model or a diagnosis for another program: a log viewer, a simulator, a motor controller.

    What the format cannot hold is said on stderr and in the file. Of a diagnosis the corrected model is exported.
    """
    check_no_input(out, source_path)
    source = read(source_path, read_rig(rig_path) if rig_path else None, beside)
    for warning in source.recording.warnings if source.recording else ():
        warn(warning)
    for _, model in source.models[-1:]:
        warn_unusable(model, source_path)
    named = {"--into": into, "--actuator": actuator, "--tip": tip}
    missing = [name for name, value in named.items() if value is None]
    if 0 < len(missing) < len(named):
        raise click.UsageError(f"{', '.join(missing)} missing: --into, --actuator and --tip go together")
    if scale is not None and into is None:
        raise click.UsageError("--scale goes with --into, --actuator and --tip")
    mount = None
    if into is not None and actuator is not None and tip is not None:
        mount = Mount(into, actuator, tip, scale)
    with progress_bar(f"exporting to {to}") as progress:
        done = export(source, to, out, mount=mount, axis=axis, progress=progress)
    for what in done.lost:
        log(f"taut: lost: {what}")
    result = {"format": to, "files": list(done.files), "lost": list(done.lost), **done.report}
    emit(result, as_json, "\n".join(str(file) for file in done.files))
