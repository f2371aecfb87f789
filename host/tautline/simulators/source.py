"""A simulator found again by what a model remembers of it."""

from __future__ import annotations

import importlib
import math
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from tautline.core.motor import MotorPath
from tautline.errors import TautError
from tautline.model import Model
from tautline.recording import Motor
from tautline.simulators import mjcf
from tautline.simulators.drive import Drive
from tautline.simulators.simulator import Simulator
from tautline.simulators.stepless import STEP, stepless

_PYTHON = "python"
_NAME = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")  # MODULE:NAME


def is_python(name: str) -> bool:
    """Whether a name of --simulator has the form MODULE:NAME, which `of_python` takes. Only the form is looked at: a
    file that is called so has to be named with its folder, ./MODULE:NAME."""
    return _NAME.fullmatch(name) is not None


def of_python(name: str) -> Simulator:
    """Imports the Simulator that the name MODULE:NAME means; the module may also be in the working directory. TautError
    where it cannot be imported, or is no Simulator."""
    module, _, attribute = name.partition(":")
    if (here := str(Path.cwd())) not in sys.path:
        sys.path.insert(0, here)  # as `python -m` has it
    try:
        found = getattr(importlib.import_module(module), attribute)
    except Exception as error:  # of somebody else's module: anything
        says = " ".join(f"{type(error).__name__}: {error}".split())
        raise TautError(f"--simulator {name}: {says}: expected MODULE:NAME, which Python can import") from error
    if not isinstance(found, Simulator):
        raise TautError(f"--simulator {name}: is no tautline.simulators.Simulator, but {type(found).__name__}")
    return replace(found, source={"kind": _PYTHON, "name": name})


def open_simulator(model: Model) -> Simulator:
    """Opens the simulator that a model was made with, by the source that it keeps; where that names a step of time
    (STEP), the limit for short steps that was used then (`stepless`). TautError where it has no such source, or the
    simulator is missing or has changed since."""
    source = model.simulator or {}
    simulator = _open_source(source, model)
    return stepless(simulator, _number(source, STEP)) if STEP in source else simulator


def _open_source(source: Mapping[str, Any], model: Model) -> Simulator:
    """Opens the user's simulator by its source (Simulator.source, without `stepless`'s addition). TautError where it is
    missing or has changed."""
    if source.get("kind") == _PYTHON:
        return of_python(_text(source, "name"))
    if source.get("kind") != mjcf.KIND:
        raise TautError("the model's simulator was a function of a session: give its Simulator a source to find it by")
    path = Path(_text(source, "path"))
    if mjcf.digest(path) != _text(source, "sha256"):
        raise TautError(f"{path}: is not the file that was diagnosed: diagnose again, or put that back")
    unit = model.rig.actuator.unit
    return mjcf.simulator(path, _text(source, "actuator"), _text(source, "tip"), unit, _number(source, "scale"))


def _text(source: Mapping[str, Any], key: str) -> str:
    """The text of a key in a simulator's source, which comes from a model's file. TautError where it is something
    else."""
    value = source.get(key)
    if not isinstance(value, str):
        raise _damaged_error(key, value, "a text")
    return value


def _number(source: Mapping[str, Any], key: str) -> float:
    """The number of a key in a simulator's source, finite and not 0. TautError where it is something else."""
    value = source.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not value or not math.isfinite(value):
        raise _damaged_error(key, value, "a number")
    return float(value)


def _damaged_error(key: str, value: object, expected: str) -> TautError:
    """The error to raise for a key of a simulator's source with a wrong value. expected: in words."""
    return TautError(f"the model's simulator is damaged, its {key} is {value!r}, expected {expected}: diagnose again")


def path_of(model: Model, motor: Motor) -> MotorPath:
    """The path of the coordinate that a model's tables are over, for a motor's log: the motor's own path, or for a
    model that was diagnosed against a simulator the simulated tip's coordinate. TautError as of `open_simulator`."""
    return next(paths_of([model], motor))


def paths_of(models: Sequence[Model], motor: Motor) -> Iterator[MotorPath]:
    """Yields `path_of` each of several models of one simulator, which differ in tables and effects alone. It is opened
    once, and models with the same values of its parameters share one simulation."""
    if models[0].simulator is None:
        path = MotorPath.of(motor, models[0].rig.actuator.encoder_resolution)
        yield from (path for _ in models)
        return
    drive = Drive(open_simulator(models[0]), motor, models[0].rig)
    for model in models:
        values = {name: value for effect in model.effects for name, value in effect.parameters.items()}
        driven = drive.motor(values)
        yield MotorPath(driven, driven)
