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
    """Whether the argument of --simulator has the form MODULE:NAME, which `of_python` takes. Only the form is checked:
    a file whose name has this form must be given with its folder, ./MODULE:NAME."""
    return _NAME.fullmatch(name) is not None


def of_python(name: str) -> Simulator:
    """Imports the Simulator with the name MODULE:NAME; puts the working directory on sys.path, so that the module may
    be there. TautError where it cannot be imported, or is not a Simulator."""
    module, _, attribute = name.partition(":")
    if (folder := str(Path.cwd())) not in sys.path:
        sys.path.insert(0, folder)  # as `python -m` has it
    try:
        found = getattr(importlib.import_module(module), attribute)
    except Exception as error:  # of somebody else's module: anything
        says = " ".join(f"{type(error).__name__}: {error}".split())
        raise TautError(f"--simulator {name}: {says}: expected MODULE:NAME, which Python can import") from error
    if not isinstance(found, Simulator):
        raise TautError(f"--simulator {name}: is no tautline.simulators.Simulator, but {type(found).__name__}")
    return replace(found, source={"kind": _PYTHON, "name": name})


def open_simulator(model: Model) -> Simulator:
    """Opens the simulator that a model was made with, from the source that the model keeps. If the source has a step of
    time (STEP), the extrapolation from that step is opened (`stepless`). TautError where the model keeps no such
    source, or the simulator is missing or has changed since."""
    source = model.simulator or {}
    simulator = _open_source(source, model)
    return stepless(simulator, _number(source, STEP)) if STEP in source else simulator


def _open_source(source: Mapping[str, Any], model: Model) -> Simulator:
    """Opens the user's simulator by its source (Simulator.source; `stepless`'s key in it is ignored). TautError where
    it is missing or has changed."""
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
    """The text under a key of a simulator's source, which comes from a model's file. TautError where there is something
    else."""
    value = source.get(key)
    if not isinstance(value, str):
        raise _damaged_error(key, value, "a text")
    return value


def _number(source: Mapping[str, Any], key: str) -> float:
    """The number under a key of a simulator's source, finite and not 0. TautError where there is something else."""
    value = source.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not value or not math.isfinite(value):
        raise _damaged_error(key, value, "a number")
    return float(value)


def _damaged_error(key: str, value: object, expected: str) -> TautError:
    """The error to raise for a wrong value under a key of a simulator's source. expected: what should be there, in
    words."""
    return TautError(f"the model's simulator is damaged, its {key} is {value!r}, expected {expected}: diagnose again")


def path_of(model: Model, motor: Motor) -> MotorPath:
    """The path of the coordinate that a model's tables are over, for a motor's log. That is the motor's own path; for a
    model that was diagnosed against a simulator it is the simulated tip's coordinate. TautError as of
    `open_simulator`."""
    return next(paths_of([model], motor))


def paths_of(models: Sequence[Model], motor: Motor) -> Iterator[MotorPath]:
    """Yields `path_of` each of several models, which are of one simulator (or all without) and of one rig. The
    simulator is opened once, and models with the same values of its parameters share one simulation."""
    if models[0].simulator is None:
        path = MotorPath.of(motor, models[0].rig.actuator.encoder_resolution)
        yield from (path for _ in models)
        return
    drive = Drive(open_simulator(models[0]), motor, models[0].rig)
    for model in models:
        values = {name: value for effect in model.effects for name, value in effect.parameters.items()}
        driven = drive.motor(values)
        yield MotorPath(driven, driven)
