"""The simulation of a model with effects: what moves the tip in C (host/native/effects.h), and so where the marker is
seen (projection.h)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from tautline import _native
from tautline.effects.kind import COLUMN, Kind
from tautline.effects.library import BY_ID, LIBRARY, SCATTERS
from tautline.errors import TautError
from tautline.geometry import projection_rig
from tautline.model import Effect, Model
from tautline.recording import Motor

Array = npt.NDArray[np.float64]

# Names of parameters: of effects that move the tip in C; that change where it is seen; that are simulated by tables.
NATIVE = frozenset(name for name, *_ in _native.effect_parameters)
PROJECTION = frozenset(name for name, *_ in _native.projection_parameters)
_TABLED = tuple(kind for kind in LIBRARY if kind.in_tables)  # effects that are simulated by tables
_AMPLITUDES_IN_TABLES = {kind.id: frozenset(p.name for form in kind.forms for p in form.amplitudes) for kind in _TABLED}
IN_TABLES = frozenset(p.name for kind in _TABLED for form in kind.forms for p in form.parameters)
_TRANSFORMED = tuple(kind for kind in LIBRARY if kind.transform)  # effects with a law in Python
_BY_SIDE = tuple(p.name for p in BY_ID["registration.direction_dependent"].amplitudes)
_MEANS = frozenset(kind.event.mean for kind in LIBRARY if kind.event)  # names of events' mean effects


@dataclass(frozen=True)
class Path:
    """The tip's simulated path at n scene times. All arrays are (n,)."""

    scene_s: Array
    translation_mm: Array | None  # of the instrument; None where it never moves
    rotation_deg: Array | None
    c_deg: Array  # bending angle
    p: Array  # the play's centre coordinate, unit of q
    tip: Array  # the same after lag, creep and stick-slip: c = f_remain(tip) but for the configuration's effects
    gain: Array  # dc / df_remain
    way: Array  # to which side the instrument lies in its channel, -1 to 1
    lean: Array  # -2 dp/dB where B is constant, in the mean of all plays: +1 on the rising envelope, -1 on the falling
    side: Array  # the envelope that last carried the tip: +1 rising q, -1 falling, 0 not yet


@dataclass(frozen=True)
class ImagePath(Path):
    """A path together with the image positions of its marker."""

    image_px: Array  # (n, 2), NaN without a camera


def of_this_version(model: Model) -> tuple[Effect, ...]:
    """Returns the model's effects after checking that this version's library knows each of them and each of their
    parameters; TautError where it does not."""
    for effect in model.effects:
        kind = BY_ID.get(effect.id)
        if kind is None:
            raise TautError(f"{effect.id} is no effect of this version: diagnose again")
        known = {COLUMN, *(parameter.name for form in kind.forms for parameter in form.parameters)}
        if unknown := [name for name in effect.parameters if name not in known]:
            raise TautError(f"{effect.id} has no {', '.join(unknown)} in this version: diagnose again")
    return model.effects


def of_model(model: Model, scatter: bool = False) -> dict[str, Any]:
    """The parameters, by name, that `simulate` needs for a corrected model: those of its effects that its tables, rig
    and delay do not hold already. scatter: of each event take its random course (its amount) and leave out its mean
    effect; by default the other way round. TautError as `of_this_version`."""
    return {
        name: value
        for effect in of_this_version(model)
        if BY_ID[effect.id].holds is None
        for name, value in effect.parameters.items()
        if name not in (_MEANS if scatter else SCATTERS)
    }


def simulate(
    model: Model,
    motor: Motor,
    scene_s: npt.ArrayLike,
    parameters: Mapping[str, Any],
    start_deg: float | None = None,
    load_reference: float = 0.0,
    clock_offset_s: float = 0.0,
) -> ImagePath:
    """Simulates a model with effects: its path and image at scene times (n,), s, in any order. parameters: of the
    effects, by the names in LIBRARY. motor: q is interpolated linearly between its samples (tautline.encoder takes an
    encoder's steps out before). start_deg: the bending angle at the first time; by default the play's centre starts at
    the motor. load_reference: mNm at which the model's tables hold. clock_offset_s: added to the times to get the
    session's, for effects that depend on it (drift, shift). Of the random effects stick-slip is simulated as one
    course, jitter is not."""
    path = follow(model, motor, scene_s, parameters, start_deg, load_reference, clock_offset_s)
    px = image(model, path, parameters, clock_offset_s) if model.rig.has_camera else np.full((len(path.p), 2), np.nan)
    return ImagePath(**{f.name: getattr(path, f.name) for f in fields(Path)}, image_px=px)


def follow(
    model: Model,
    motor: Motor,
    scene_s: npt.ArrayLike,
    parameters: Mapping[str, Any],
    start_deg: float | None = None,
    load_reference: float = 0.0,
    clock_offset_s: float = 0.0,
    clock_begin_s: float | None = None,
) -> Path:
    """The path without the image; arguments as for `simulate`. The parameters "delay" (s) and "clock_rate" (s/s) move
    the scene times before anything else. clock_begin_s: the time at which the sensor's clock and the motor's agree, by
    default the motor's first sample. TautError where a law of another distribution gives no finite numbers."""
    model = tabled(model, parameters)
    outside = [kind for kind in _TRANSFORMED if any(parameters.get(p.name) for p in kind.amplitudes)]
    scene = np.asarray(scene_s, dtype=float) - parameters.get("delay", 0.0)
    if rate := parameters.get("clock_rate", 0.0):
        scene = scene - rate * (scene - (motor.t_s[0] if clock_begin_s is None else clock_begin_s))
    order = np.argsort(scene, kind="stable") if len(scene) > 1 and (np.diff(scene) < 0).any() else None
    rising = scene if order is None else scene[order]
    if outside:
        path = _path_with_python_laws(
            outside, model, motor, rising, parameters, start_deg, load_reference, clock_offset_s
        )
    else:
        path = _native_path(model, motor, rising, parameters, start_deg, load_reference, clock_offset_s)
    return path if order is None else _samples_of_path(path, np.argsort(order, kind="stable"))


def _samples_of_path(path: Path, which: npt.NDArray[np.int64]) -> Path:
    """The path's samples with these indices (m,), in their order."""
    return Path(*(None if values is None else values[which] for values in vars(path).values()))  # type: ignore[arg-type]


def _path_with_python_laws(
    outside: list[Kind],
    model: Model,
    motor: Motor,
    rising: Array,
    parameters: Mapping[str, Any],
    start_deg: float | None,
    load_reference: float,
    clock_offset_s: float,
) -> Path:
    """As `_native_path`, with the Python laws of the effects `outside` applied in their places (input, state, output).
    They are evaluated at every motor sample and scene time. `gain` does not contain their derivatives, so a fit's steps
    of the nominal model are less exact."""
    times = np.union1d(motor.t_s, rising)

    def through(place: str, values: Array) -> Array:
        """Values (n,) at `times` after applying, one after the other, all laws whose place is `place`. TautError where
        a law gives another shape or numbers that are not finite."""
        for kind in outside:
            if kind.transform and kind.transform.place == place:
                own = {p.name: float(parameters[p.name]) for p in kind.parameters if p.name in parameters}
                values = np.asarray(kind.transform.run(times + clock_offset_s, values, own), dtype=float)
                if values.shape != times.shape or not np.isfinite(values).all():
                    raise TautError(f"{kind.id}: its law gave no {len(times)} numbers: mend its distribution's run()")
        return values

    q = through("input", np.interp(times, motor.t_s, motor.q))
    driven = motor.resampled(times, q, motor.extra)
    path = _native_path(model, driven, times, parameters, start_deg, load_reference, clock_offset_s)
    tip = through("state", path.tip)
    # The library's effects behind f_remain are kept, to first order: c moves by dc/df_remain times f_remain's change.
    c_deg = path.c_deg + path.gain * (model.remaining(tip) - model.remaining(path.tip))
    path = replace(path, tip=tip, c_deg=through("output", c_deg))
    return _samples_of_path(path, np.searchsorted(times, rising))


def _native_path(
    model: Model,
    motor: Motor,
    rising: Array,
    parameters: Mapping[str, Any],
    start_deg: float | None,
    load_reference: float,
    clock_offset_s: float,
) -> Path:
    """The path at rising scene times (n,), s, by the library's own laws, in C; other arguments as in `simulate`."""
    moved = _native.simulate_effects(
        {name: value for name, value in parameters.items() if name in NATIVE},
        model.play.native,
        model.c_deg,
        motor.t_s,
        motor.q,
        rising,
        motor.translation_mm,
        motor.rotation_deg,
        None if motor.load_mNm is None else motor.load_mNm - load_reference,
        motor.extra.get(parameters.get(COLUMN, "")),  # a joint that is missing is at rest
        clock_offset_s,
        np.nan if start_deg is None else float(model.remaining_inverse(start_deg)),
    )
    return Path(rising, *moved)


_RECENT = 8  # tolerance: tabled models that are kept: a session's recordings need the same ones in turn
_recent: tuple[tuple[Model, dict[str, Any], Model], ...] = ()


def tabled(model: Model, parameters: Mapping[str, Any]) -> Model:
    """Puts the effects that are simulated by tables (IN_TABLES) into the model's B and f_remain; returns the model
    itself where there are none. parameters: of all effects, by name. The last _RECENT results are cached, by the
    model's identity."""
    present = [kind for kind in _TABLED if not _AMPLITUDES_IN_TABLES[kind.id].isdisjoint(parameters)]
    if not present:
        return model
    values = {name: parameters[name] for name in IN_TABLES if name in parameters}
    global _recent
    for nominal, known, result in _recent:
        if nominal is model and known == values:
            return result
    result = model
    for kind in present:
        assert kind.holds
        result = kind.holds(result, parameters, 0.0)
    _recent = ((model, values, result), *_recent[: _RECENT - 1])  # a new tuple: another thread may read the old one
    return result


def image(model: Model, path: Path, parameters: Mapping[str, Any], clock_offset_s: float = 0.0) -> Array:
    """(n, 2) px: the image positions of a path's marker, with the effects of kinematics, registration and camera.
    clock_offset_s: added to the path's times to get the session's, for a shift."""
    return _see(model, path, parameters, clock_offset_s, False)  # type: ignore[no-any-return]


def bends_alone(before: Path, after: Path, parameters: Mapping[str, Any]) -> bool:
    """Whether the images of two paths can differ only through the bending angle: they are at the same times, and where
    the registration depends on the direction also to the same sides of the channel."""
    same_side = not any(parameters.get(name) for name in _BY_SIDE) or np.array_equal(before.way, after.way)
    return same_side and np.array_equal(before.scene_s, after.scene_s)


def see(
    model: Model,
    c_deg: Array,
    way: Array,
    translation_mm: npt.ArrayLike,
    rotation_deg: npt.ArrayLike,
    parameters: Mapping[str, Any],
) -> Array:
    """(n, 2) px: the marker's image positions at bending angles c_deg (n,), with the effects as in `image`, except that
    a shift of the registration is left out, as it would need times. way (n,): the side of the channel on which the
    instrument lies, -1 to 1; translation_mm, rotation_deg: of the instrument, (n,) or one number each."""
    each = np.ones(len(c_deg))
    translation, rotation = each * np.asarray(translation_mm), each * np.asarray(rotation_deg)
    known, rig = _of_projection(parameters), projection_rig(model.rig)
    return _native.see(known, rig, c_deg, translation, rotation, way, None, False)  # type: ignore[no-any-return]


def image_with_slopes(
    model: Model, path: Path, parameters: Mapping[str, Any], clock_offset_s: float = 0.0
) -> tuple[Array, Array, Array]:
    """(The image (n, 2), px; its derivative by the bending angle c (n, 2), px per deg; its derivatives by a further
    static registration (n, 2, 6), px per deg of its turn about x, y, z, then px per mm of its move along them)."""
    return _see(model, path, parameters, clock_offset_s, True)  # type: ignore[no-any-return]


def _of_projection(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """The parameters, by name, that change how the tip is seen (those in PROJECTION)."""
    return {name: value for name, value in parameters.items() if name in PROJECTION}


def _see(model: Model, path: Path, parameters: Mapping[str, Any], clock_offset_s: float, slopes: bool) -> Any:
    """Calls the projection in C: returns what `image` returns, or with `slopes` what `image_with_slopes` returns.
    Frames at or after "shift_time" are seen with the shifted registration."""
    shifted = None
    if "shift_time" in parameters:
        shifted = (path.scene_s + clock_offset_s >= parameters["shift_time"]).view(np.uint8)
    return _native.see(
        _of_projection(parameters),
        projection_rig(model.rig),
        path.c_deg,
        path.translation_mm,
        path.rotation_deg,
        path.way,
        shifted,
        slopes,
    )
