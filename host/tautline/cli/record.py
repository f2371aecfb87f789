"""taut record"""

from __future__ import annotations

from pathlib import Path

import click

from tautline.cli._common import NumberRange, emit, json_option, progress_bar, rig_option, warn
from tautline.cli._live import (
    LiveOptions,
    bus_text,
    live_options,
    motion_option,
    opened_setup,
    seed_option,
    speed_option,
)
from tautline.cli._outputs import folder_option


@click.command("record")
@folder_option("--out", "Folder for the recording.")
@live_options
@rig_option
@motion_option("off: move it yourself")
@speed_option
@click.option("--duration", type=NumberRange(min=0.1), default=60.0, show_default=True, help="s, where nothing moves.")
@click.option("--video/--no-video", default=False, help="Keep the frames too.")
@seed_option
@json_option
def command(
    out: Path,
    live: LiveOptions,
    rig_path: Path | None,
    motion: str,
    speed: float | None,
    duration: float,
    video: bool,
    seed: int,
    as_json: bool,
) -> None:
    """Record motor, marker and video from a board and a camera. Ctrl-C ends it early and keeps what there is."""
    from tautline.live.following import record
    from tautline.live.setup import CameraSource

    with opened_setup(live, rig_path, seed) as setup, progress_bar("record") as progress:
        result = record(setup, out, motion, speed=speed, duration_s=duration, video=video, seed=seed, progress=progress)
        camera = setup.marker_source.says if isinstance(setup.marker_source, CameraSource) else {}
    if result["other_axes"]:
        warn(f"{motion}: {' and '.join(result['other_axes'])} were not moved: the board's axis is the bending motor's")
    emit(
        {**result, "camera": camera},
        as_json,
        f"{out}: {result['seconds']:.1f} s, {result['motor_samples']} motor samples, {result['frames']} frames, "
        f"the marker lost in {result['lost_frames']}, {result['telemetry_dropped']} samples dropped"
        + bus_text(result["bus"])
        + (f"; its times are {camera['clock']}" if camera else ""),
    )
