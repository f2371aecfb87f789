"""taut simulate --out FOLDER"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np

from tautline.cli._common import SEED, Number, NumberRange, emit, json_option, progress_bar, read_rig, warn
from tautline.cli._outputs import folder_option
from tautline.errors import TautError
from tautline.rig import Actuator, Rig
from tautline.simulated.endoscope import Endoscope, load_background
from tautline.simulated.instrument import PRESETS, Instrument, of_name
from tautline.simulated.simulate import TRUTH, Simulation, run
from tautline.trajectory import Trajectory, back_and_forth, random_smooth, sines, trapezoids
from tautline.vision.timing import FrameTiming

_WAY_BACK = 0.105  # prior: least stroke back, as a share of the range: longer than any backlash


@dataclass(frozen=True)
class _MotionOptions:
    """The command's options that shape the motion."""

    speeds: tuple[float, ...]  # the rig's unit per second; (): a share of the range per second
    amplitude: float | None  # the rig's unit; None: a share of the range
    reversals: int
    dwell_s: float  # rest at each reversal
    duration_s: float  # of sines and random motions
    seed: int  # of random motions


def _calibration_motion(actuator: Actuator, wanted: _MotionOptions) -> Trajectory:
    """The paper's calibration motion, back and forth over the range; by default one pass at 5 % and one at 10 % of the
    range a second, with the stroke of `usual_stroke`. The acceleration is half the range per s^2."""
    span = actuator.span
    speeds = wanted.speeds or (0.05 * span, 0.1 * span)
    stroke = wanted.amplitude or usual_stroke(span, wanted.reversals)
    return back_and_forth(
        actuator, speeds, stroke, wanted.reversals, acceleration=0.5 * span, dwell_s=wanted.dwell_s
    )  # fmt: skip


def usual_stroke(span: float, reversals: int) -> float:
    """The default stroke of the calibration motion over a range of length `span`, in the unit of `span`: 15 % of it, or
    more with few reversals. Then each stroke advances far, and yet the stroke back, which is the stroke minus the
    advance, has to be longer than any backlash: _WAY_BACK of the range."""
    # n advances a over the span S: stroke s + n a = S, and s - a = W S (W = _WAY_BACK), so s = (W n + 1) S / (n + 1).
    advances = max(1, reversals // 2)
    return max(0.15, (_WAY_BACK * advances + 1.0) / (advances + 1.0)) * span


def _test_motion(actuator: Actuator, wanted: _MotionOptions) -> Trajectory:
    """The paper's test motion, trapezoids, one for each two reversals; by default 30 % of the range from peak to peak.
    The acceleration is half the range per s^2."""
    span = actuator.span
    amplitude = wanted.amplitude or 0.3 * span
    cycles = max(1, wanted.reversals // 2)
    return trapezoids(
        actuator, _first_speed(actuator, wanted), amplitude, cycles, acceleration=0.5 * span, dwell_s=wanted.dwell_s
    )


def _sine_motion(actuator: Actuator, wanted: _MotionOptions) -> Trajectory:
    """A motion of sines over the range that lasts duration_s."""
    return sines(actuator, _first_speed(actuator, wanted), wanted.duration_s)


def _random_motion(actuator: Actuator, wanted: _MotionOptions) -> Trajectory:
    """A random smooth motion over the range that lasts duration_s."""
    return random_smooth(actuator, _first_speed(actuator, wanted), wanted.duration_s, wanted.seed)


def _first_speed(actuator: Actuator, wanted: _MotionOptions) -> float:
    """The first of the speeds, or 10 % of the range a second without any; unit of q per second."""
    return wanted.speeds[0] if wanted.speeds else 0.1 * actuator.span


def _count_short_strokes(trajectory: Trajectory, instrument: Instrument) -> int:
    """The number of the motor's strokes that are shorter than the instrument's backlash at their middle, so that the
    tip does not move. A stroke goes from one reversal to the next, or to the end; that before the first reversal does
    not count."""
    way = np.sign(np.diff(trajectory.q))
    moving = np.flatnonzero(way)  # steps in which the motor moves
    turns = moving[np.flatnonzero(np.diff(way[moving]))] + 1  # the last sample before each reversal
    q = trajectory.q[np.concatenate([turns, [len(trajectory.q) - 1]])]
    return int(np.sum(np.abs(np.diff(q)) < instrument.backlash(0.5 * (q[1:] + q[:-1]))))


def _warn_of_short_strokes(trajectory: Trajectory, instrument: Instrument) -> None:
    """Prints a warning if strokes of the motor are shorter than the instrument's backlash."""
    if short := _count_short_strokes(trajectory, instrument):
        warn(
            f"{short} of the motor's strokes are shorter than the instrument's backlash: nothing moves on them and no "
            "calibration can use them. Choose a larger --amplitude or more --reversals"
        )


_MOTIONS: dict[str, Callable[[Actuator, _MotionOptions], Trajectory]] = {
    "back-and-forth": _calibration_motion,
    "trapezoids": _test_motion,
    "sines": _sine_motion,
    "random": _random_motion,
}
MOTIONS = tuple(_MOTIONS)


@click.command("simulate")
@folder_option("--out", "Folder for the recording and the truth beside it.", key_file=TRUTH)
@click.option(
    "--rig",
    "rig_path",
    type=click.Path(path_type=Path),
    help="The rig file. Default: 10 mm of cable, 120 deg of bending, an endoscope of 720 x 576 at 25 Hz.",
)
@click.option(
    "--instrument",
    metavar="PRESET|MODEL",
    default="reference",
    show_default=True,
    help=f"{', '.join(PRESETS)}; or a model's folder: its instrument with the effects that a diagnosis added.",
)
@click.option(
    "--motion",
    type=click.Choice(MOTIONS),
    default="back-and-forth",
    show_default=True,
    help="back-and-forth: the paper's calibration motion; trapezoids: its test motion.",
)
@click.option(
    "--speed",
    "speeds",
    type=NumberRange(min=0, min_open=True),
    multiple=True,
    help="Top speed, rig unit/s; back-and-forth takes several. Default: 5 and 10 % of the range a second, else 10 %.",
)
@click.option(
    "--amplitude",
    type=NumberRange(min=0, min_open=True),
    help="Stroke of back-and-forth (default 15 % of the range, more below 40 reversals) and trapezoids (30 %).",
)
@click.option("--reversals", type=click.IntRange(2, 2000), default=40, show_default=True, help="On one way up or down.")
@click.option("--dwell", type=NumberRange(min=0), default=0.2, show_default=True, help="Rest at a reversal, s.")
@click.option(
    "--duration", type=NumberRange(0.1, 7200), default=60.0, show_default=True, help="Of sines and random, s."
)
@click.option(
    "--sway", type=(Number(), Number()), default=(0.0, 0.0), help="Translation (mm) and rotation (deg) that sway."
)
@click.option("--noise", type=NumberRange(min=0), default=0.05, show_default=True, help="Of marker.csv, px rms.")
@click.option("--delay", type=NumberRange(min=0), help="True delay of the frames, s. Default: the rig's nominal one.")
@click.option("--jitter", type=NumberRange(min=0), default=0.0, help="Of the frames' arrival, s rms.")
@click.option("--lost", type=NumberRange(0, 0.9), default=0.0, help="Share of the frames that never arrive.")
@click.option("--angle-noise", type=NumberRange(min=0), help="Record an external angle sensor too, deg rms.")
@click.option("--seed", type=SEED, default=0, show_default=True)
@click.option("--video", is_flag=True, help="Draw the frames (MJPEG) instead of writing marker.csv.")
@click.option("--lossless", is_flag=True, help="Draw them without loss, 0.6 MB a frame.")
@click.option("--background", type=click.Path(path_type=Path), help="A picture to draw the instrument over.")
@json_option
def command(
    out: Path,
    rig_path: Path | None,
    instrument: str,
    motion: str,
    speeds: tuple[float, ...],
    amplitude: float | None,
    reversals: int,
    dwell: float,
    duration: float,
    sway: tuple[float, float],
    noise: float,
    delay: float | None,
    jitter: float,
    lost: float,
    angle_noise: float | None,
    seed: int,
    video: bool,
    lossless: bool,
    background: Path | None,
    as_json: bool,
) -> None:
    """Make a recording with a simulated instrument, and beside it the truth to compare results with.

    truth.csv holds the bending angle c and the play's centre p at the motor's times, truth.json B(q) and f_remain(q).
    """
    rig = read_rig(rig_path) if rig_path else None
    made = of_name(instrument, rig, seed)
    rig = rig or made.rig
    video = video or lossless or background is not None
    if video and not rig.has_camera:
        raise TautError(f"{rig_path}: has no [camera] to draw a video with: add one, or leave --video out")
    if video and not made.drawn:
        raise TautError(f"{instrument}: its effects change what is seen, which no drawn video shows: leave --video out")
    wanted = _MotionOptions(speeds, amplitude, reversals, dwell_s=dwell, duration_s=duration, seed=seed)
    trajectory = _MOTIONS[motion](rig.actuator, wanted)
    _warn_of_short_strokes(trajectory, made)
    if any(sway):
        trajectory = trajectory.with_sway(*sway, period_s=20.0)
    delay_s = rig.delay_s if delay is None else delay
    timing = FrameTiming.of(rig, delay_s=delay_s, jitter_s=jitter or made.jitter_s, lost=lost, seed=seed)
    simulation = run(
        rig, made, trajectory, noise_px=noise, timing=timing, angle_noise_deg=angle_noise, seed=seed, name=out.name
    )
    endoscope = (
        Endoscope(rig, background=load_background(background) if background else None, seed=seed) if video else None
    )
    with progress_bar("simulating") as progress:
        simulation.save(out, endoscope, lossless, progress)
    result = {
        "recording": out,
        "instrument": made.name,
        "motion": motion,
        "duration_s": round(trajectory.duration_s, 3),
        "frames": len(simulation.scene_s) if rig.has_camera else 0,
        "video": video,
    }
    emit(
        result,
        as_json,
        f"{out}: {trajectory.duration_s:.1f} s of {motion} with the {made.name} instrument, "
        f"{_recorded_in_words(simulation, rig)}; truth.csv and truth.json say what was true",
    )


def _recorded_in_words(simulation: Simulation, rig: Rig) -> str:
    """A text on how many frames, and readings of an angle sensor, a simulation recorded."""
    counts = [f"{len(simulation.scene_s)} frames"] if rig.has_camera else []
    if (angle := simulation.recording.angle) is not None:
        counts.append(f"{len(angle.t_s)} readings of an angle sensor")
    return " and ".join(counts)
