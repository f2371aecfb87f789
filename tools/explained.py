"""The pictures of docs/calibration.md and docs/diagnosis.md, each with the sentence that stands beside it.

Both are drawn from simulated recordings, which the package calibrates and diagnoses as it would any other.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import tautline as tl
from tautline.calibration.onset import Onset
from tautline.calibration.result import Calibration
from tautline.diagnosis.diagnose import Diagnosis
from tautline.model import Effect
from tautline.recording import Recording
from tautline.reports import figures
from tautline.simulated.instrument import of_name, preset
from tautline.simulated.simulate import simulate
from tautline.trajectory import back_and_forth, random_smooth, trapezoids

AROUND_S = (-0.45, 0.55)  # of the turn that is shown
LAG_S = 0.06  # of the robot that is diagnosed


def _recording(amplitude: float, reversals: int) -> Recording:
    instrument = preset("reference")
    actuator = instrument.rig.actuator
    motion = back_and_forth(actuator, (3.0, 5.0), amplitude, reversals, 5.0, 0.2)
    return simulate(instrument.rig, instrument, motion, name="calibration")


def _moved(calibration: Calibration, onset: Onset) -> tuple[np.ndarray, np.ndarray]:
    """(n,) scene time and how far the image is from where it stood still before the onset, along its way after it."""
    seen = calibration.predicted[onset.track]
    level = seen.seen[(seen.scene_s > onset.turn_s) & (seen.scene_s < onset.t_s)].mean(axis=0)
    after = (seen.scene_s > onset.t_s) & (seen.scene_s < onset.t_s + AROUND_S[1])
    way = seen.seen[after].mean(axis=0) - level
    return seen.scene_s, (seen.seen - level) @ (way / np.linalg.norm(way))


def _draw_when(axes: Axes, recording: Recording, calibration: Calibration, onset: Onset) -> None:
    scene_s, moved = _moved(calibration, onset)
    delay_ms = 1e3 * calibration.model.delay_s
    arrival, motor = scene_s + calibration.model.delay_s - onset.turn_s, recording.motor
    near = (arrival > AROUND_S[0]) & (arrival < AROUND_S[1])
    axes.axvspan(0.0, delay_ms, color=figures.PALE, lw=0)
    axes.plot(1e3 * arrival[near], moved[near], ".", color=figures.INK, ms=4, label="image, as frames arrive")
    axes.legend(loc="center right")
    axes.set(xlabel="time since the motor turned (ms)", ylabel="image (px)", title="1  The image stops one delay late")
    at = motor.t_s - onset.turn_s
    near = (at > AROUND_S[0]) & (at < AROUND_S[1])
    right = axes.twinx()
    right.grid(visible=False)
    right.plot(1e3 * at[near], motor.q[near], color=figures.DOWN, lw=1.2)
    right.set_ylabel("motor q (mm)", color=figures.DOWN)
    right.tick_params(colors=figures.DOWN)
    axes.text(delay_ms, axes.get_ylim()[1], f" {delay_ms:.0f} ms", va="top", color=figures.GREY)


def _draw_where(axes: Axes, recording: Recording, calibration: Calibration, onset: Onset) -> None:
    scene_s, moved = _moved(calibration, onset)
    way = onset.direction * (np.interp(scene_s, recording.motor.t_s, recording.motor.q) - onset.q1)
    near = (scene_s > onset.turn_s) & (way < 2.2 * onset.width) & (scene_s < onset.t_s + AROUND_S[1])
    way, moved = way[near], moved[near]
    after = way > onset.width
    path = np.polynomial.Polynomial.fit(way[after] - onset.width, moved[after] / (way[after] - onset.width), 1)
    reach = np.linspace(0.0, float(way.max()) - onset.width)
    axes.axvspan(0.0, onset.width, color=figures.PALE, lw=0)
    axes.plot(way, moved, ".", color=figures.INK, ms=4)
    axes.plot([0.0, *(onset.width + reach)], [0.0, *(reach * path(reach))], color=figures.MODEL, lw=1.4)
    axes.text(
        onset.width / 2, axes.get_ylim()[1], f"B = {onset.width:.3f} mm", va="top", ha="center", color=figures.MODEL
    )
    title = "2  The width at one turn"
    axes.set(xlabel="way of the motor since it turned (mm)", ylabel="image (px)", title=title)


def _draw_together(axes: Axes, calibration: Calibration) -> tuple[float, float]:
    """Typical sigma (µm) of an onset and of B(q)."""
    model = calibration.model
    used = [o for o in calibration.onsets if o.used and np.isfinite(o.t_s)]
    at, sigma = np.array([o.q_mean for o in used]), 1e3 * np.array([o.sigma for o in used])
    off = 1e3 * (np.array([o.width for o in used]) - np.interp(at, model.q, model.width))
    inside = (model.q >= model.measured[0]) & (model.q <= model.measured[1])
    band = 2e3 * model.width_sigma
    axes.fill_between(model.q[inside], -band[inside], band[inside], color=figures.BAND, lw=0, label="B(q), ± 2 sigma")
    axes.axhline(0.0, color=figures.MODEL, lw=1.4)
    axes.errorbar(
        at, off, yerr=2 * sigma, fmt=".", color=figures.UP, elinewidth=0.8, lw=0, label="one onset, ± 2 sigma"
    )
    axes.set(xlabel="q (mm)", ylabel="off B(q) (µm)", title="3  All frames together are sharper")
    axes.legend(loc="upper left", ncols=2)
    axes.set_ylim(-1.6 * np.max(np.abs(off) + 2 * sigma), 1.6 * np.max(np.abs(off) + 2 * sigma))
    return float(np.median(sigma)), float(np.median(band[inside]) / 2)


@mpl.rc_context(figures.STYLE)
def calibration() -> tuple[Figure, str]:
    recording = _recording(2.5, 12)
    measured = tl.calibrate(recording)
    used = [o for o in measured.onsets if o.used and np.isfinite(o.t_s)]
    shown = min(used, key=lambda o: abs(o.q_mean + 1.5))  # where the image goes well and B is not at its widest
    made, axes = figures.figure(11, 3.1, 1, 3)
    _draw_when(axes[0, 0], recording, measured, shown)
    _draw_where(axes[0, 1], recording, measured, shown)
    onset, all_of_it = _draw_together(axes[0, 2], measured)
    delay_ms = 1e3 * measured.model.delay_s
    says = (
        f"One turn at q = {shown.q_mean:.1f} mm: the image stops {delay_ms:.0f} ms after the motor turned, and starts "
        f"when the motor has gone {shown.width:.2f} mm. An onset knows B to {onset:.2f} µm, all frames together to "
        f"{all_of_it:.2f} µm."
    )
    return made, says


def _diagnosed() -> Diagnosis:
    """Of a robot whose tip lags, which its model does not know."""
    recording = _recording(2.5, 12)
    model = tl.calibrate(recording).model
    with tempfile.TemporaryDirectory() as folder:
        replace(model, effects=(Effect("transmission.lag", {"lag": LAG_S}),)).save(Path(folder) / "robot")
        robot = of_name(str(Path(folder) / "robot"))
    actuator = robot.rig.actuator
    motions = {
        "trapezoids": trapezoids(actuator, 2.0, 3.0, 4, 5.0, 0.5),
        "in use": random_smooth(actuator, 2.5, 40.0, 3),
    }
    tests = [simulate(robot.rig, robot, motion, name=name, seed=1) for name, motion in motions.items()]
    return tl.diagnose(recording, tests, rig=robot.rig)


def _draw_bars(axes: Axes, values: dict[str, float], title: str, unit: str) -> None:
    names = list(values)[::-1]
    bars = axes.barh(names, [values[name] for name in names], color=figures.UP, height=0.6)
    axes.bar_label(bars, [f"{values[name]:.3g}" for name in names], padding=3, fontsize=8)
    axes.grid(axis="y", visible=False)
    axes.margins(x=0.15)
    axes.set(title=title, xlabel=unit)


@mpl.rc_context(figures.STYLE)
def diagnosis() -> tuple[Figure, str]:
    found = _diagnosed()
    document = found.document
    gap, noise, unit = document["gap"], document["noise_floor"], document["unit"]
    made = Figure(figsize=(11, 3.1), layout="constrained")
    seen, left, sure = made.subplots(1, 3)
    for residual, colour, name in (
        (found.before, figures.GREY, "calibrated model"),
        (found.after, figures.MODEL, "+ lag"),
    ):
        size = np.concatenate([np.sqrt(np.mean(each**2, axis=1)) for each in residual])
        seen.semilogy(size, ".", ms=2, color=colour, label=name)
    seen.axhline(noise, color=figures.INK, lw=0.8, ls="--", label="noise")
    seen.set(xlabel="frame of both tests", ylabel=f"off by ({unit})", title="1  Is there a gap?")
    seen.legend(loc="lower right", ncols=3, bbox_to_anchor=(1.0, 0.0), markerscale=4, columnspacing=0.8)
    seen.set_ylim(bottom=noise / 300)
    tried = [c for c in document["candidates"] if c["shrink"] > 0.4][:5]
    rms = {_name(c["id"]): gap["before"] * (1.0 - c["shrink"]) for c in tried}
    _draw_bars(left, {"as calibrated": gap["before"], "recalibrated": document["gap_recalibrated"]["before"], **rms},
               "2  What is left on unseen blocks", f"rms ({unit})")  # fmt: skip
    left.axvline(noise, color=figures.INK, lw=0.8, ls="--")
    odds = {_name(c["id"]): 100.0 * c["probability"] for c in document["candidates"][:3]}
    _draw_bars(sure, {**odds, "unknown": 100.0 * document["probability_unknown"]}, "3  How likely is it?", "%")
    named = document["effects"][0]
    lag_ms, again = 1e3 * named["parameters"]["lag"], document["gap_recalibrated"]["before"]
    says = (
        f"A robot whose tip lags by {1e3 * LAG_S:.0f} ms: the calibrated model is off by {gap['before']:.2f} px, a new "
        f"calibration by {again:.2f} px, the model with a lag of {lag_ms:.0f} ms by {gap['after']:.3f} px. The noise "
        f"is {noise:.3f} px. A lag is {100 * named['probability']:.0f} % sure."
    )
    return made, says


def _name(identity: str) -> str:
    return identity.partition(".")[2].replace("_", " ")
