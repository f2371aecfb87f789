"""What of a user's simulator is to change, in words, out of the content of a diagnosis.json (`document`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tautline.effects import BY_ID, simulator_id

# format of all: units in words


def says(document: Mapping[str, Any], name: str) -> str:
    """What the effect with the id `name` does, in words; for a named parameter of the simulator its values in the
    simulator and on the robot."""
    for parameter in _named_parameters(document):
        if simulator_id(parameter["name"]) == name:
            return (
                f"the simulator has {parameter['name']} {parameter['nominal']:.3g}, "
                f"the robot {_value_in_words(parameter)}"
            )
    return BY_ID[name].says


def values(document: Mapping[str, Any], name: str) -> tuple[str, str] | None:
    """(Name of the simulator's parameter, its values on the robot and in the simulator in words); None where the effect
    with the id `name` is no named parameter of the simulator."""
    for parameter in _named_parameters(document):
        if simulator_id(parameter["name"]) == name:
            return parameter["name"], f"{_value_in_words(parameter)}, in the simulator {parameter['nominal']:.3g}"
    return None


def step(document: Mapping[str, Any]) -> str:
    """Two sentences on how much the simulator errs by its own step of time; "" where that is not known to matter."""
    told = document.get("simulator", {}).get("step")
    if told is None:
        return ""
    size = f"{told['error']:.2g} {told['unit']} rms, {told['error'] / told['noise']:.2g} times the noise"
    return (
        f"At its own step of {1e3 * told['own_s']:.3g} ms the simulator errs by {size}. That is no fault of the robot, "
        "and not in the gap."
    )


def steps(document: Mapping[str, Any]) -> list[str]:
    """Sentences on what to change in the simulator: its step, its parameters, and effects that it does not have."""
    todo = []
    if told := document.get("simulator", {}).get("step"):
        todo.append(f"Step the simulator at {1e3 * told['enough_s']:.2g} ms or less.")
    if named := [f"{parameter['name']} {_value_in_words(parameter)}" for parameter in _named_parameters(document)]:
        todo.append(f"Put into the simulator what the robot has: {', '.join(named)}.")
    of_simulator = {simulator_id(parameter["name"]) for parameter in _named_parameters(document)}
    if rest := [effect["id"] for effect in document["effects"] if effect["id"] not in of_simulator]:
        todo.append(f"Give the simulator what it has not: {', '.join(rest)}, or put the corrected model behind it.")
    return todo


def _named_parameters(document: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    """The simulator's parameters that are named, each with `name`, `unit`, `nominal` and `value`; () without a
    simulator."""
    return document.get("simulator", {}).get("parameters", ())  # type: ignore[no-any-return]


def _value_in_words(parameter: Mapping[str, Any]) -> str:
    """A parameter's value on the robot, with its unit."""
    return f"{parameter['value']:.3g} {parameter['unit']}".strip()
