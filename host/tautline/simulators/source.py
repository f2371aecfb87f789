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
    """Whether it names what `of_python` takes, and no file."""
    return _NAME.fullmatch(name) is not None


def of_python(name: str) -> Simulator:
    """MODULE:NAME, a Simulator that some module of the user's holds, beside or below the working directory too.
    TautError where there is none."""
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


def opened(model: Model) -> Simulator:
    """The simulator that a model remembers. TautError where it remembers none, or that has gone or changed since."""
    source = model.simulator or {}
    simulator = _own(source, model)
    return stepless(simulator, _number(source, STEP)) if STEP in source else simulator


def _own(source: Mapping[str, Any], model: Model) -> Simulator:
    """The user's own simulator of a source."""
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
    """A text of a model's source, as its file has it. TautError where there is none."""
    value = source.get(key)
    if not isinstance(value, str):
        raise _damaged(key, value, "a text")
    return value


def _number(source: Mapping[str, Any], key: str) -> float:
    """A number of a model's source, above or below 0. TautError where there is none."""
    value = source.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not value or not math.isfinite(value):
        raise _damaged(key, value, "a number")
    return float(value)


def _damaged(key: str, value: object, expected: str) -> TautError:
    return TautError(f"the model's simulator is damaged, its {key} is {value!r}, expected {expected}: diagnose again")


def path_of(model: Model, motor: Motor) -> MotorPath:
    """The coordinate that a model's tables are over: the motor's path, or where the simulator that the model begins
    with puts the tip."""
    return next(paths_of([model], motor))


def paths_of(models: Sequence[Model], motor: Motor) -> Iterator[MotorPath]:
    """`path_of` for models that differ in their tables and effects alone: those whose simulator has the same values
    share one simulation."""
    if models[0].simulator is None:
        path = MotorPath.of(motor, models[0].rig.actuator.encoder_resolution)
        yield from (path for _ in models)
        return
    drive = Drive(opened(models[0]), motor, models[0].rig)
    for model in models:
        values = {name: value for effect in model.effects for name, value in effect.parameters.items()}
        driven = drive.motor(values)
        yield MotorPath(driven, driven)
