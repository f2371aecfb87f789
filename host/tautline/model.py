"""A model: what calibration found, and the simulation that it is. Saved as a folder."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from tautline.discrepancy import Discrepancy
from tautline.elements import SINGLE, Elements, Play
from tautline.encoder import straight_lines
from tautline.errors import TautError, of_system
from tautline.friction import Friction
from tautline.quality import Quality
from tautline.recording import Motor
from tautline.rig import ANGLE, MARKER, RIG_FILE, Place, Rig, Sensor
from tautline.value import Value

Array = np.ndarray
FORMAT = "model/1"
MODEL_FILE = "model.json"
STEEPEST = 1.8  # limit: |B'| that tables may have: p_lo and p_hi are unique while it is below 2
_USUAL_NOISE = {MARKER: 0.05, ANGLE: 0.02}  # prior: px, deg
_DIGITS = 6  # format: decimals of a deviation's tables
_ARRAYS = ("q", "width", "width_sigma", "c_deg")


@dataclass(frozen=True)
class Effect:
    """One effect beside the play, that a diagnosis added or a calibration found; id as in `stage.name`, zero parameters
    meaning absent."""

    id: str
    parameters: Mapping[str, Any]  # numbers; `column`: the name of one of motor.csv

    def to_json(self) -> dict[str, Any]:
        """The fields as plain values, as model.json has them."""
        return {"id": self.id, "parameters": dict(self.parameters)}

    @classmethod
    def from_json(cls, told: Mapping[str, Any]) -> Self:
        """Reads what `to_json` gave. KeyError, TypeError or ValueError where it is something else."""
        found = cls(told["id"], dict(told["parameters"]))
        numbers = [value for value in found.parameters.values() if not isinstance(value, str)]
        texts = [name for name, value in found.parameters.items() if isinstance(value, str)]
        if not isinstance(found.id, str) or not set(texts) <= {"column"} or not np.isfinite(numbers).all():
            raise ValueError(f"effect {found.id!r} is no text, or a parameter of it no finite number")
        return found


@dataclass(frozen=True)
class Deviation:
    """Tables, delay and effects that a model would have if all of its unknowns were off together in one direction."""

    width: Array  # (n,) B on the model's grid, unit of q
    c_deg: Array  # (n,) f_remain
    delay_s: float
    effects: tuple[Effect, ...]

    @classmethod
    def of(cls, model: Model) -> Self:
        """The tables, delay and effects of `model`, which is one whose unknowns have been moved off its best ones."""
        return cls(model.width, model.c_deg, model.delay_s, model.effects)

    def to_json(self) -> dict[str, Any]:
        """The fields as plain values, as model.json has them."""
        return {
            "width": np.round(self.width, _DIGITS).tolist(),
            "c_deg": np.round(self.c_deg, _DIGITS).tolist(),
            "delay_s": self.delay_s,
            "effects": [effect.to_json() for effect in self.effects],
        }

    @classmethod
    def from_json(cls, told: Mapping[str, Any]) -> Self:
        """Reads what `to_json` gave. KeyError, TypeError or ValueError where it is something else."""
        width, c_deg = (np.array(told[name], dtype=float) for name in ("width", "c_deg"))
        effects = tuple(map(Effect.from_json, told["effects"]))
        return cls(width, c_deg, float(told["delay_s"]), effects)


@dataclass(frozen=True)
class Uncertainty:
    """What a model may be off by beside the sigmas of its tables, where a calibration or a diagnosis has found it."""

    noise: float | None = None  # one standard deviation of a reading about its prediction, px a coordinate or deg
    noise_times: Array | None = None  # (n,) of it, where the tip is at a node: noise that differs from place to place
    delay_sigma_s: float | None = None
    width_by_delay: Array | None = None  # (n,) unit of q per s: by what B changes where the delay is later
    tracked_px: float = 0.0  # rms of a tracker's constant error
    deviations: tuple[tuple[Deviation, Deviation], ...] = ()  # one standard deviation either way, independent
    discrepancy: Discrepancy | None = None  # of a corrected simulator

    def to_json(self) -> dict[str, Any]:
        """The fields as plain values, as model.json has them."""
        by_delay, times, apart = self.width_by_delay, self.noise_times, self.discrepancy
        return {
            "noise": self.noise,
            "noise_times": None if times is None else times.tolist(),
            "delay_sigma_s": self.delay_sigma_s,
            "width_by_delay": None if by_delay is None else by_delay.tolist(),
            "tracked_px": self.tracked_px,
            "deviations": [[each.to_json() for each in pair] for pair in self.deviations],
            "discrepancy": None if apart is None else apart.to_json(),
        }

    @classmethod
    def from_json(cls, told: Mapping[str, Any], nodes: int) -> Self:
        """Reads what `to_json` gave, for a model whose tables have `nodes` values. KeyError, TypeError or ValueError
        where it is something else."""
        by_delay, times = told.get("width_by_delay"), told.get("noise_times")
        pairs = tuple(
            (Deviation.from_json(below), Deviation.from_json(above)) for below, above in told.get("deviations", ())
        )
        found = cls(
            noise=None if told.get("noise") is None else float(told["noise"]),
            noise_times=None if times is None else np.array(times, dtype=float),
            delay_sigma_s=None if told.get("delay_sigma_s") is None else float(told["delay_sigma_s"]),
            width_by_delay=None if by_delay is None else np.array(by_delay, dtype=float),
            tracked_px=float(told.get("tracked_px", 0.0)),
            deviations=pairs,
            discrepancy=None if told.get("discrepancy") is None else Discrepancy.from_json(told["discrepancy"]),
        )
        tables = [table for pair in pairs for each in pair for table in (each.width, each.c_deg)]
        tables += [table for table in (found.width_by_delay, found.noise_times) if table is not None]
        if any(table.shape != (nodes,) or not np.isfinite(table).all() for table in tables):
            raise ValueError(f"tables of what is uncertain have other than {nodes} finite values")
        numbers = [v for v in (found.noise, found.delay_sigma_s, found.tracked_px) if v is not None]
        if not all(np.isfinite(v) and v >= 0.0 for v in numbers) or (
            found.noise_times is not None and (found.noise_times <= 0.0).any()
        ):
            raise ValueError("what is uncertain is negative or infinite")
        return found


@dataclass(frozen=True, eq=False, repr=False)
class Model(Value):
    """c = f_remain(p), p the play's centre coordinate, widths B(p) between its full strokes, shared by its elements.

    `q` is a grid over the actuator's range (rig.actuator.unit); width, width_sigma and c_deg are sampled on it and
    interpolated linearly between its points by everything that simulates (the board does the same with its tables).
    Beyond the grid the width is held and f_remain goes on with the slope of its last span.
    """

    rig: Rig
    q: Array  # (n,)
    width: Array  # (n,) B, >= 0, |B'| <= 1.8
    width_sigma: Array  # (n,) large where not measured
    c_deg: Array  # (n,) f_remain, strictly monotone
    delay_s: float
    measured: tuple[float, float]  # the q_mean that reversals reached
    effects: tuple[Effect, ...] = ()  # beside the play: simulated, and undone on the board where it can be
    elements: Elements = SINGLE  # of the play, in shares of B
    c_sigma: Array | None = None  # (n,) of c_deg, NaN where unknown; None: a model that was not calibrated
    quality: Quality = field(default_factory=Quality)
    extra: Mapping[str, Any] = field(default_factory=dict)  # onsets, notes, figures' data: what the report shows alone
    sensor: Sensor = MARKER  # that was calibrated with: delay_s is its own
    offset_s: float | None = None  # of the calibration: the sensor's clock less the motor's beyond delay_s
    friction: Friction | None = None  # instead of plays; `elements` are then those that come nearest to it
    uncertainty: Uncertainty = field(default_factory=Uncertainty)
    load_reference_mNm: float = 0.0  # at which the tables hold, where an effect follows the load
    simulator: Mapping[str, Any] | None = None  # the source of what stands in the motor's place (tautline.simulators)

    @property
    def is_measured(self) -> npt.NDArray[np.bool_]:
        """(n,) Whether B was measured at each node of the grid."""
        return np.asarray((self.q >= self.measured[0]) & (self.q <= self.measured[1]))

    @property
    def alone(self) -> Self:
        """The model itself if it has no effects, else a copy without them."""
        return replace(self, effects=()) if self.effects else self

    def delay_of(self, sensor: Sensor) -> float:
        """How old, s, a sensor's reading is when it arrives: as calibrated for the sensor that the model was calibrated
        with, the rig's nominal delay for another one."""
        return self.delay_s if sensor == self.sensor else self.rig.nominal_delay_s(sensor)

    def noise_of(self, sensor: Sensor) -> float:
        """One standard deviation of a sensor's noise, px a coordinate or deg: what the calibration left with this
        sensor, 0 too; a usual value for another sensor, or where that is not known."""
        known = self.uncertainty.noise if sensor == self.sensor else None
        return _USUAL_NOISE[sensor] if known is None else known

    @cached_property
    def play(self) -> Play:
        """The model's B with what follows the motor between its envelopes: friction's law, or else the play's
        elements."""
        return Play(self.q, self.width, self.friction or self.elements, self.rig.actuator.encoder_resolution)

    def remaining(self, p: npt.ArrayLike) -> Array:
        """f_remain: bending angles, deg, at centre coordinates p (n,), unit of q, or of any other shape; same shape."""
        return interpolate(p, self.q, self.c_deg)

    def remaining_inverse(self, c_deg: npt.ArrayLike) -> Array:
        """Centre coordinates, unit of q, at which f_remain is c_deg (n,), or of any other shape; same shape."""
        return interpolate_inverse(c_deg, self.q, self.c_deg)

    def simulate(self, motor: Motor, t_s: npt.ArrayLike, start_deg: float | None = None) -> Array:
        """Bending angles (n,), deg, at scene times t_s (n,), s, in any order, by the play and f_remain alone, without
        effects (for these see tautline.effects). Scene times are on the motor's clock: no delay is in them. The tip
        starts on the centre line, c = f_remain(q[0]), or at start_deg. q is held before and after the motor's
        samples."""
        p0 = np.nan if start_deg is None else float(self.remaining_inverse(start_deg))
        motor = straight_lines(motor, self.rig.actuator.encoder_resolution)
        return self.remaining(play_at(motor.t_s, motor.q, np.asarray(t_s, dtype=float), self.play, p0))

    def save(self, folder: str | Path) -> None:
        """Writes model.json and rig.toml into the folder, which is made if it is not there. TautError where it cannot
        be written."""
        folder = Path(folder)
        document: dict[str, Any] = {
            "format": FORMAT,
            "unit": self.rig.actuator.unit,
            **{name: getattr(self, name).tolist() for name in _ARRAYS},
            "sensor": self.sensor,
            "delay_s": self.delay_s,
            "offset_s": self.offset_s,
            "measured": list(self.measured),
            "elements": self.elements.to_json(),
            "friction": None if self.friction is None else self.friction.to_json(),
            "effects": [effect.to_json() for effect in self.effects],
            "c_sigma": None if self.c_sigma is None else [v if np.isfinite(v) else None for v in self.c_sigma.tolist()],
            "quality": self.quality.to_json(),
            "place": None if self.rig.place is None else asdict(self.rig.place),
            "uncertainty": self.uncertainty.to_json(),
            "load_reference_mNm": self.load_reference_mNm,
            "simulator": None if self.simulator is None else dict(self.simulator),
            "extra": dict(self.extra),
        }
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self.rig.save(folder / RIG_FILE)
            (folder / MODEL_FILE).write_text(json.dumps(document), encoding="utf-8")
        except OSError as error:
            raise TautError(f"{folder}: the model cannot be written ({error.strerror}): name another --out") from error

    @classmethod
    def load(cls, folder: str | Path) -> Self:
        """Reads what `save` wrote. TautError where a file is missing, damaged or no model's, or the two files are in
        different units."""
        folder = Path(folder)
        path, document = folder / MODEL_FILE, _document(folder)
        try:
            q, width, sigma, c_deg = arrays = [np.array(document[name], dtype=float) for name in _ARRAYS]
            effects = tuple(map(Effect.from_json, document["effects"]))
            delay_s = float(document["delay_s"])
            low, high = (float(value) for value in document["measured"])
            c_sigma = None if document.get("c_sigma") is None else np.array(document["c_sigma"], dtype=float)
            quality = Quality.from_json(document.get("quality", {"reasons": []}))
            extra: dict[str, Any] = dict(document["extra"])
            elements = Elements.from_json(document["elements"]) if "elements" in document else SINGLE
            offset_s = None if document.get("offset_s") is None else float(document["offset_s"])
            friction = None if document.get("friction") is None else Friction.from_json(document["friction"])
            sensor = document.get("sensor")
            place = None if document.get("place") is None else Place.from_json(document["place"])
            uncertainty = Uncertainty.from_json(document.get("uncertainty") or _uncertainty_of_old_model(extra), len(q))
            load_mNm = float(document.get("load_reference_mNm", extra.get("load_reference_mNm", 0.0)))
            source = document.get("simulator", extra.get("simulator"))
            simulator = None if source is None else dict(source)
            if not np.isfinite([delay_s, low, high, load_mNm, offset_s or 0.0]).all():
                raise ValueError("delay_s, offset_s, measured or load_reference_mNm is no finite number")
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            what = f"a key {error} is missing" if isinstance(error, KeyError) else f"a value is wrong ({error})"
            raise TautError(f"{path}: damaged, {what}: make the model again with taut calibrate") from error
        good = all(a.ndim == 1 and a.shape == q.shape and np.isfinite(a).all() for a in arrays) and len(q) >= 2
        good = good and (c_sigma is None or c_sigma.shape == q.shape)
        if not (good and is_backlash_table(q, width) and abs(np.sign(np.diff(c_deg)).sum()) == len(q) - 1):
            raise TautError(f"{path}: its tables are not a model's: make the model again with taut calibrate")
        rig = replace(Rig.load(folder / RIG_FILE), place=place)
        unit = document.get("unit", rig.actuator.unit)
        if unit != rig.actuator.unit:
            raise TautError(
                f"{folder}: {MODEL_FILE} is in {unit}, the {RIG_FILE} beside it in {rig.actuator.unit}: they are not "
                "of one calibration, so make the model again with taut calibrate"
            )
        if sensor not in (MARKER, ANGLE):
            sensor = MARKER if rig.has_camera else ANGLE
        return cls(
            rig=rig,
            q=q,
            width=width,
            width_sigma=sigma,
            c_deg=c_deg,
            delay_s=delay_s,
            measured=(low, high),
            effects=effects,
            elements=elements,
            c_sigma=c_sigma,
            quality=quality,
            extra=extra,
            sensor=sensor,
            offset_s=offset_s,
            friction=friction,
            uncertainty=uncertainty,
            load_reference_mNm=load_mNm,
            simulator=simulator,
        )


def _document(folder: Path) -> dict[str, Any]:
    """Reads a model's JSON as it is written, and checks that all keys which it must have are there. TautError as of
    `Model.load`."""
    path = folder / MODEL_FILE
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError) as error:
        if (folder / "motor.csv").exists():
            raise TautError(
                f"{folder}: is a recording, not a model: 'taut calibrate {folder} --out MODEL' makes one of it"
            ) from error
        what = f"holds no {MODEL_FILE}" if folder.is_dir() else "is a file" if folder.exists() else "is not there"
        raise TautError(f"{folder}: {what}, a model is a folder: make it with taut calibrate") from error
    except OSError as error:
        raise TautError(of_system(error)) from error
    except UnicodeDecodeError as error:
        raise TautError(f"{path}: damaged, it is no text: make the model again with taut calibrate") from error
    except (ValueError, RecursionError) as error:
        raise TautError(f"{path}: not valid JSON ({error}): make the model again with taut calibrate") from error
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise TautError(f'{path}: format is not "{FORMAT}": make the model again with taut calibrate')
    missing = [name for name in (*_ARRAYS, "effects", "delay_s", "measured", "extra") if name not in document]
    if missing:
        raise TautError(f"{path}: {', '.join(missing)} missing: make it again with taut calibrate")
    return document


def _uncertainty_of_old_model(extra: Mapping[str, Any]) -> dict[str, Any]:
    """The uncertainty, as Uncertainty.from_json takes it, of a model written before 2026-11-27, when its parts were in
    `extra` among what the report shows. The noise was the larger rms there, if any; B's change by the delay is left out
    unless it is known at all nodes."""
    evidence, by_delay = extra.get("evidence", {}), extra.get("width_by_delay")
    rms = [value for name in ("residual", "error") if (value := evidence.get(name)) is not None and value > 0.0]
    if by_delay is not None and None in by_delay:  # not known everywhere
        by_delay = None
    return {**extra, "noise": max(rms, default=None), "width_by_delay": by_delay}


def is_backlash_table(grid: Array, width: Array) -> bool:
    """Whether a table of B, width (n,) at grid (n,), makes the play unique: grid rising, width >= 0, |width'| < 2."""
    step = np.diff(grid)
    return bool((step > 0).all() and (width >= 0).all() and (np.abs(np.diff(width)) < 2 * step).all())


def allowed_width(grid: Array, width: Array, steepest: float = STEEPEST) -> Array:
    """(n,) The largest backlash table that is nowhere above width (n,), 0 at least, and nowhere steeper than
    `steepest`, |B'|. grid (n,): rising, in the unit of width."""
    step = steepest * np.diff(grid)
    lawful: Array = np.maximum(width, 0.0)
    if (np.abs(np.diff(lawful)) <= step).all():
        return lawful
    reach = np.concatenate([[0.0], np.cumsum(step)])  # what a width may change by from the first node on
    rising: Array = reach + np.minimum.accumulate(lawful - reach)
    both: Array = np.minimum.accumulate((rising + reach)[::-1])[::-1] - reach
    cut: Array = np.maximum(both, 0.0)
    return cut


def monotone(c_deg: Array) -> Array:
    """f_remain (n,), deg, made strictly rising or falling where it is level or goes back, as a model's must be: by a
    millionth of its mean slope at least."""
    sign = np.sign(c_deg[-1] - c_deg[0])
    ramp = 1e-6 * abs(c_deg[-1] - c_deg[0]) / len(c_deg) * np.arange(len(c_deg))  # what it rises by at least
    strict: Array = sign * (np.maximum.accumulate(sign * c_deg - ramp) + ramp)
    return strict


def interpolate(x: npt.ArrayLike, grid: Array, values: Array) -> Array:
    """values (n,) at a rising grid (n,), interpolated linearly at x of any shape; beyond the ends with the slope of the
    first or last span."""
    x = np.asarray(x, dtype=float)
    first = (values[1] - values[0]) / (grid[1] - grid[0])
    last = (values[-1] - values[-2]) / (grid[-1] - grid[-2])
    beyond = first * np.minimum(x - grid[0], 0.0) + last * np.maximum(x - grid[-1], 0.0)
    return np.asarray(np.interp(x, grid, values) + beyond)


def interpolate_inverse(y: npt.ArrayLike, grid: Array, values: Array) -> Array:
    """The x at which `interpolate` of strictly monotone values (n,), rising or falling, on a rising grid (n,) is y, of
    any shape; same shape."""
    rising = slice(None) if values[-1] > values[0] else slice(None, None, -1)
    return interpolate(y, values[rising], grid[rising])


def play_at(t_s: Array, q: Array, at_s: Array, play: Play, p0: float) -> Array:
    """(m,) The play's centre coordinate, unit of q, at times at_s (m,), s, in any order, driven by the motor's samples
    t_s, q (n,) with straight lines between them and q held before and after them. p0: the state before the first
    sample, NaN: the centre."""
    times = np.concatenate([t_s, at_s])
    positions = np.concatenate([q, np.interp(at_s, t_s, q)])
    order = np.argsort(times, kind="stable")
    p = np.empty(len(times))
    p[order] = play.forward(positions[order], p0)
    return p[len(t_s) :]
