"""What a model says the tip does under a recorded motor motion. It never looks at marker positions or angles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tautline import spread
from tautline.columns import read_columns, read_times
from tautline.core.chain import Chain, by_differences
from tautline.core.motor import MotorPath
from tautline.core.posterior import Posterior
from tautline.discrepancy import states
from tautline.encoder import between_counts
from tautline.errors import TautError
from tautline.folders import write_file
from tautline.geometry import px_per_deg, tracked_deg
from tautline.model import Model, allowed_width
from tautline.recording import Motor, Recording
from tautline.rig import ANGLE, MARKER, Sensor
from tautline.simulators.source import path_of, paths_of
from tautline.value import Value

Array = npt.NDArray[np.float64]

MOST_ROWS = 10_000_000  # format: of a prediction's CSV
TRUTH_FILE = "truth.csv"  # beside a simulated recording
COLUMNS = "t_s,c_deg,u_px,v_px,c_sigma_deg,u_sigma_px,v_sigma_px"
_TO_SPARE = 1.1  # tolerance: times B, beside two counts: a way that has surely driven the tip through it
_ANYWHERE = 3.0**-0.5  # equation: standard deviation of what is anywhere from -1 to 1


@dataclass(frozen=True)
class Times:
    """When a prediction is asked for: arrival times, delay_s after the scene. `cells` is how the times are written."""

    cells: list[str]
    t_s: Array  # (n,)
    delay_s: float

    @property
    def scene_s(self) -> Array:
        """(n,) The scene times, s: when what arrives at t_s happened."""
        return self.t_s - self.delay_s


@dataclass(frozen=True, eq=False, repr=False)
class Prediction(Value):
    """What a model says the tip does, at n times."""

    c_deg: Array  # (n,)
    image_px: Array | None  # (n, 2); None without a camera
    c_sigma_deg: Array | None = None  # (n,) one standard deviation of what the sensor would show, model error and noise
    image_sigma_px: Array | None = None  # (n, 2) included; NaN where the model does not know it, None where not asked


def predict(model: Model, motor: Motor, scene_s: npt.ArrayLike, start_deg: float | None = None) -> Prediction:
    """Predicts angle and, with a camera, marker at scene times scene_s (n,), s, on the motor's clock, in any order;
    without sigmas. The tip starts on the centre line, c = f_remain(q[0]), or at start_deg; q is held before the first
    and after the last motor sample."""
    scene = _scene_times(scene_s)
    seen = Chain(model).at(path_of(model, motor), scene, start_deg)
    return Prediction(seen.c_deg, seen.image_px)


def predict_with_sigma(
    model: Model, motor: Motor, scene_s: npt.ArrayLike, start_deg: float | None = None
) -> Prediction:
    """As `predict`, with one standard deviation of what the sensor would show. It combines the sensor's noise with the
    uncertainty of B, f_remain, the delay, the motor's path and, unless start_deg is given, the start within the
    backlash, propagated by differences through the chain. For a corrected simulator it adds the uncertainty of all of
    its unknowns together, and more where the motion is unlike those that it was fitted to."""
    scene = _scene_times(scene_s)
    path = path_of(model, motor)
    told = Chain(model).at(path, scene, start_deg)
    model_sigma = _model_sigma(model, path, scene, start_deg)
    if (apart := _deviations_sigma(model, motor, scene, start_deg)) is not None:
        model_sigma = np.hypot(model_sigma, apart)
    # In the sensor's unit: px, or deg of an angle.
    noise = np.hypot(_noise_at(model, told.c_deg), _discrepancy_sigma(model, path, motor, scene))
    if told.image_px is None:
        return Prediction(told.c_deg, image_px=None, c_sigma_deg=np.hypot(model_sigma[:, 0], noise))
    steepness = px_per_deg(model.rig, told.c_deg, *path.others_at(scene))
    noise_px, noise_deg = (noise, noise / steepness) if model.sensor == MARKER else (noise * steepness, noise)
    unseen_deg = _unseen_deg(model, told.c_deg, *path.others_at(scene))
    return Prediction(
        told.c_deg,
        told.image_px,
        c_sigma_deg=np.sqrt(model_sigma[:, 0] ** 2 + noise_deg**2 + unseen_deg**2),
        image_sigma_px=np.hypot(model_sigma[:, 1:], noise_px[:, None]),
    )


def _model_sigma(model: Model, path: MotorPath, scene: Array, start_deg: float | None) -> Array:
    """(n, 1 or 3) One standard deviation of the predicted rows, deg and px, at scene times (n,), s, by the uncertainty
    of B, f_remain, the delay, the motor's path and, without start_deg, the start, by differences through the chain. The
    part of f_remain's that shows in no image (`_unseen_deg`) is left out."""
    inputs = _input_uncertainty(model, path, start_deg)
    delay_sigma_s = float(inputs.sigma[2])
    unseen_deg = _unseen_deg(model, model.c_deg)
    with_delay = width_by_delay(model, delay_sigma_s)  # the part of B's sigma that is due to the delay's error
    by_delay = with_delay / delay_sigma_s if delay_sigma_s > 0.0 else with_delay
    without_delay = np.sqrt(np.maximum(model.width_sigma**2 - with_delay**2, 0.0))
    # Where all unknowns of a corrected simulator are off together, the law is among them.
    c_sigma = None if model.uncertainty.deviations else model.c_sigma
    fitted_deg = None if c_sigma is None else np.sqrt(np.maximum(c_sigma**2 - unseen_deg**2, 0.0))

    def rows(off: Array) -> Array:
        """The prediction (n, 1 or 3) with the five deviations `off`, those of `_input_uncertainty`: B and f_remain in
        their sigmas; the delay, s; the start, in half widths; the motor, unit of q."""
        width, remaining, delay_s, start, q = off
        moved = replace(
            model,
            width=allowed_width(model.q, model.width + width * without_delay + delay_s * by_delay),
            c_deg=model.c_deg if fitted_deg is None or not remaining else model.c_deg + remaining * fitted_deg,
        )
        lines = replace(path.lines, q=path.lines.q + q)
        begins = start_deg
        if start:
            begins = float(moved.remaining(lines.q[0] + start * 0.5 * float(model.width.max())))
        return Chain(moved).at(replace(path, lines=lines), scene - delay_s, begins).rows

    slopes = by_differences(rows, inputs.mean, inputs.sigma)
    # The motor's sigma, in `inputs` one number, differs from time to time.
    slopes[..., -1] *= path.sigma_at(scene)[:, None] / max(path.sigma, 1e-300)
    return inputs.spread(slopes)


def _scene_times(scene_s: npt.ArrayLike) -> Array:
    """The scene times as an array (n,), s. TautError where they have another shape or one is no finite number."""
    scene = np.asarray(scene_s, dtype=float)
    if scene.ndim != 1 or not np.isfinite(scene).all():
        raise TautError(f"scene_s, of shape {scene.shape}, is no row of finite times, s")
    return scene


def _noise_at(model: Model, c_deg: Array) -> Array:
    """(n,) One standard deviation of the calibrated sensor's noise, px or deg, where the tip is at angles c_deg (n,):
    that of `noise_of`, times `noise_times` at its place if the model has these."""
    usual, times = model.noise_of(model.sensor), model.uncertainty.noise_times
    if times is None:
        return np.full(len(c_deg), usual)
    return np.asarray(usual * np.interp(model.remaining_inverse(c_deg), model.q, times))


def _deviations_sigma(model: Model, motor: Motor, scene_s: Array, start_deg: float | None) -> Array | None:
    """(n, 1 or 3) One standard deviation of the prediction at scene times (n,), s, by all of a corrected simulator's
    unknowns together. Each pair of `uncertainty.deviations` holds two models, one sigma either way in an independent
    direction: half the difference of their predictions, summed as squares over the pairs. None where the model has no
    pairs."""
    pairs = model.uncertainty.deviations
    if not pairs:
        return None
    models = [replace(model, **vars(each)) for pair in pairs for each in pair]
    rows = [
        Chain(moved).at(path, scene_s - (moved.delay_s - model.delay_s), start_deg).rows
        for moved, path in zip(models, paths_of(models, motor), strict=True)
    ]
    halves = [0.5 * (above - below) for below, above in zip(rows[::2], rows[1::2], strict=True)]
    return np.asarray(np.sqrt(np.sum(np.square(halves), axis=0)))


def _discrepancy_sigma(model: Model, path: MotorPath, motor: Motor, scene_s: Array) -> Array:
    """(n,) One standard deviation, in the sensor's unit, of a corrected simulator's further error, beside its noise,
    where the motion is unlike those that it was fitted to; 0 for any other model."""
    discrepancy = model.uncertainty.discrepancy
    if discrepancy is None:
        return np.zeros(len(scene_s))
    return discrepancy.sigma_at(states(path.lines, motor, scene_s, model.rig.actuator.span))


def width_by_delay(model: Model, delay_sigma_s: float) -> Array:
    """(grid,) By how much, unit of q, the fitted B grows at each node where the delay grows by delay_sigma_s, s, its
    standard deviation: if the motor had few speeds, the errors of B and the delay correlate. Clipped to +-width_sigma,
    of which it is a part; 0 where the model does not know it, or delay_sigma_s is 0 or infinite."""
    by_delay = model.uncertainty.width_by_delay
    if by_delay is None or not 0.0 < delay_sigma_s < np.inf:
        return np.zeros_like(model.width)
    return np.clip(by_delay * delay_sigma_s, -model.width_sigma, model.width_sigma)


def _unseen_deg(model: Model, c_deg: Array, *others: Array) -> Array:
    """(n,) The part of f_remain's sigma, deg, at angles c_deg (n,), that shifts the angle and leaves the image as it
    is: by what is not known of the place that is followed on a bare instrument, and by a tracker's constant error.
    others: translation, mm, and rotation, deg."""
    of_tracker = tracked_deg(model.uncertainty.tracked_px, model.rig, c_deg, *others)
    place = model.rig.place
    return of_tracker if place is None else np.hypot(place.sigma_at(c_deg), of_tracker)


def _input_uncertainty(model: Model, path: MotorPath, start_deg: float | None) -> Posterior:
    """The independent deviations that a prediction depends on, with mean 0: B and f_remain in their own sigmas (a row
    depends on one place of the curve); the delay, s; the start within the backlash, in half widths, uniform and none
    with start_deg; the motor, unit of q."""
    delay_s = model.uncertainty.delay_sigma_s or 0.0
    sigma = [1.0, 1.0, delay_s, 0.0 if start_deg is not None else _ANYWHERE, path.sigma]
    return Posterior(("width", "remaining", "delay", "start", "motor"), np.zeros(5), np.diag(np.square(sigma)))


def settled_from(model: Model, motor: Motor) -> float:
    """The scene time, s, from which the start inside the backlash no longer matters: the motor has been driven both
    ways by 1.1 times the widest B and two counts. Infinite where it never was."""
    widest = _TO_SPARE * float(model.width.max()) + 2 * model.rig.actuator.encoder_resolution
    motor = between_counts(motor, model.rig.actuator.encoder_resolution)  # at every sample
    return driven_both_ways_from(motor.t_s, motor.q, widest)


def driven_both_ways_from(t_s: Array, q: Array, width: float) -> float:
    """The time, s, from which a motor at q (n,) at times t_s (n,) has moved both up from its lowest place so far and
    down from its highest by more than `width`, unit of q; infinite where it never has."""
    up = np.flatnonzero(q - np.minimum.accumulate(q) > width)
    down = np.flatnonzero(np.maximum.accumulate(q) - q > width)
    if len(up) == 0 or len(down) == 0:
        return float("inf")
    return float(t_s[max(up[0], down[0])])


def residuals(model: Model, motor: Motor, scene_s: npt.ArrayLike, seen: Array) -> Array:
    """Seen less predicted at scene times (n,), s. seen: (n, 2) px, or (n,) or (n, 1) deg; the result has seen's
    shape."""
    told = predict(model, motor, scene_s)
    if seen.ndim == 2 and seen.shape[1] == 2:
        assert told.image_px is not None  # the model has a camera
        return np.asarray(seen - told.image_px)
    return np.asarray(seen - told.c_deg.reshape(seen.shape))


def foretold(model: Model, recording: Recording, settled_by: Model | None = None) -> float:
    """Rms of the model's error on a recording, px a coordinate, or deg without a marker, counted from when the motor
    was driven through the backlash both ways. settled_by: if given, the model whose backlash and delay say from when.
    TautError where it never was, or nothing was seen after that."""
    scored_by, motor = settled_by or model, recording.motor  # whose backlash and delay say which frames count
    begin_s = settled_from(scored_by, motor)
    if not np.isfinite(begin_s):
        raise TautError(
            f"{recording.name}: the motor does not go through the backlash both ways: record a longer motion"
        )
    sensor, arrival_s, valid, seen = _sensor_readings(model, recording)
    counted = valid & _frames_to_score(arrival_s - scored_by.delay_of(sensor), begin_s, motor)
    if not counted.any():
        raise TautError(f"{recording.name}: nothing was seen after the tip was driven both ways")
    return rms([residuals(model, motor, (arrival_s - model.delay_of(sensor))[counted], seen[counted])])


def _frames_to_score(scene_s: Array, begin_s: float, motor: Motor) -> npt.NDArray[np.bool_]:
    """(n,) Which scene times (n,), s, are from begin_s on and not after the motor's log, beyond which its motion is not
    known."""
    return np.asarray((scene_s >= begin_s) & (scene_s <= motor.t_s[-1]))


def _sensor_readings(model: Model, recording: Recording) -> tuple[Sensor, Array, npt.NDArray[np.bool_], Array]:
    """What a recording's sensor saw: the marker if there is one and the rig has a camera for it, else the angle.
    Returns the sensor, its arrival times (n,), s, which of them show the tip (n,), and the values: (n, 2) px or (n,)
    deg. TautError where the recording has neither."""
    marker, angle = recording.marker, recording.angle
    if marker is not None and model.rig.has_camera:
        return MARKER, marker.t_s, marker.valid, np.column_stack([marker.u_px, marker.v_px])
    if angle is not None:
        return ANGLE, angle.t_s, angle.seen, angle.c_deg
    raise TautError(f"{recording.name}: has neither marker.csv (or a video) nor angle.csv")


@dataclass(frozen=True)
class Score:
    """How far what was seen is from what was predicted, from when the tip was driven through the backlash both ways."""

    rows: int
    unit: str  # px a coordinate, or deg
    rms: float
    over_sigma: float  # rms, 1 where the stated sigmas are right
    within_90: float  # share within 1.645 sigma: 0.9 there


def score(model: Model, recording: Recording, start_deg: float | None = None) -> Score:
    """Scores the model's predictions, with their sigmas, on a recording, from when both directions were driven through
    the backlash; start_deg: as of `predict`. TautError where the tip was not seen, or not after that."""
    sensor, arrival_s, valid, seen = _sensor_readings(model, recording)
    scene = arrival_s - model.delay_of(sensor)
    counted = valid & _frames_to_score(scene, settled_from(model, recording.motor), recording.motor)
    if not counted.any():
        raise TautError(f"{recording.name}: nothing was seen after the tip was driven both ways: there is no score")
    told = predict_with_sigma(model, recording.motor, scene[counted], start_deg)
    by_image = sensor == MARKER
    predicted, sigma = (told.image_px, told.image_sigma_px) if by_image else (told.c_deg, told.c_sigma_deg)
    assert predicted is not None and sigma is not None  # a marker counts with a camera alone
    off = seen[counted] - predicted
    with np.errstate(invalid="ignore", divide="ignore"):
        z = off / sigma
    known = z[np.isfinite(z)]  # errors over sigma, where sigma is known and not 0
    return Score(
        rows=int(counted.sum()),
        unit="px" if by_image else "deg",
        rms=rms([off]),
        over_sigma=float(np.sqrt(np.mean(known**2))) if len(known) else float("nan"),
        within_90=float(np.mean(np.abs(known) < spread.NINE_OF_TEN)) if len(known) else float("nan"),
    )


def rms(off: Sequence[Array]) -> float:
    """Root mean square of all elements of these arrays, seen less predicted; infinite where one is NaN, as for a
    predicted place that cannot be in the image."""
    value = float(np.sqrt(np.mean(np.concatenate(off) ** 2)))
    return value if np.isfinite(value) else float("inf")


def times_of(
    model: Model, folder: Path, motor: Motor, file: Path | None = None, warnings: list[str] | None = None
) -> Times:
    """The times at which to predict: column t_s of `file` if given; else those of marker.csv, else angle.csv, else a
    video's frames.csv, else one for each frame period, from the motor's first time plus the delay on (without a camera
    one for each motor sample). A camera on the tip counts as the angle sensor. warnings: if given, gets a line where
    the file's last line was cut. TautError for more than MOST_ROWS frames."""
    rig = model.rig
    for path, delay_s in (
        (file, model.delay_s),
        (folder / "marker.csv", model.delay_of(MARKER)),
        (folder / "angle.csv", model.delay_of(ANGLE)),
        (folder / "frames.csv" if rig.camera else None, model.delay_of(MARKER if rig.has_camera else ANGLE)),
    ):
        if path is not None and (path == file or path.exists()):
            cells, arrival_s = read_times(path, warnings)
            return Times(cells, arrival_s, delay_s)
    if rig.camera is None:
        t_s = motor.t_s + model.delay_s
    else:
        frames = (motor.t_s[-1] - motor.t_s[0]) * rig.camera.frame_rate_hz * (1 + 1e-12)
        if frames > MOST_ROWS:
            raise TautError(f"{folder}: lasts for more than {MOST_ROWS} frames: name the times with --times")
        t_s = motor.t_s[0] + model.delay_s + np.arange(int(frames) + 1) / rig.camera.frame_rate_hz
    return Times([f"{t:.6f}" for t in t_s], t_s, model.delay_s)


def rms_to_truth(model: Model, folder: Path, motor: Motor, times: Times, prediction: Prediction) -> float | None:
    """Rms of the predicted angle less that of the folder's truth.csv (t_s, c_deg at scene times), deg, counted once
    both directions were driven through the backlash; None without that file, or where no time counts."""
    if not (folder / TRUTH_FILE).exists():
        return None
    truth = read_columns(folder / TRUTH_FILE, ["t_s", "c_deg"], "t_s,c_deg")
    t_s, c_deg = truth.rising_times(), truth.finite("c_deg")
    scene_s = times.scene_s
    counted = (scene_s >= max(settled_from(model, motor), t_s[0])) & (scene_s <= t_s[-1])
    if not counted.any():
        return None
    return rms([prediction.c_deg[counted] - np.interp(scene_s[counted], t_s, c_deg)])


def write_csv(path: Path, times: Times, prediction: Prediction) -> None:
    """Writes a CSV with COLUMNS, t_s as it was read. u_px, v_px and their sigmas are empty where the marker cannot be
    seen or there is no camera, and a sigma where the model does not know it."""
    nothing = np.full(len(times.cells), np.nan)
    absent = np.column_stack([nothing, nothing])
    image = absent if prediction.image_px is None else prediction.image_px
    c_sigma = nothing if prediction.c_sigma_deg is None else prediction.c_sigma_deg
    image_sigma = absent if prediction.image_sigma_px is None else prediction.image_sigma_px
    lines = [COLUMNS]
    numbers = np.column_stack([prediction.c_deg, image, c_sigma, image_sigma])
    for cell, (c, u, v, *sigmas) in zip(times.cells, numbers.tolist(), strict=True):
        of_c, *of_image = (f"{sigma:.4g}" if np.isfinite(sigma) else "" for sigma in sigmas)
        lines.append(f"{cell},{c:.6f},{_text(u)},{_text(v)},{of_c},{','.join(of_image)}")
    write_file(path, "\n".join(lines) + "\n")


def _text(value: float) -> str:
    """A position, px, as a cell of `write_csv`; empty for NaN, where the marker cannot be seen."""
    return f"{value:.4f}" if np.isfinite(value) else ""
