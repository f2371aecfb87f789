"""What of a user's simulator is to change, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tautline.effects import BY_ID, simulator_id


def says(document: Mapping[str, Any], name: str) -> str:
    """What an effect does, in words; of a simulator's parameter its value in the simulator and on the robot."""
    for parameter in _named(document):
        if simulator_id(parameter["name"]) == name:
            return f"the simulator has {parameter['name']} {parameter['nominal']:.3g}, the robot {_value(parameter)}"
    return BY_ID[name].says


def values(document: Mapping[str, Any], name: str) -> tuple[str, str] | None:
    """A parameter's name, and in words its values on the robot and in the simulator; None for an effect of the
    library."""
    for parameter in _named(document):
        if simulator_id(parameter["name"]) == name:
            return parameter["name"], f"{_value(parameter)}, in the simulator {parameter['nominal']:.3g}"
    return None


def steps(document: Mapping[str, Any]) -> list[str]:
    """What to change in the simulator, in sentences."""
    told = []
    if named := [f"{parameter['name']} {_value(parameter)}" for parameter in _named(document)]:
        told.append(f"Put into the simulator what the robot has: {', '.join(named)}.")
    own = {simulator_id(parameter["name"]) for parameter in _named(document)}
    if rest := [effect["id"] for effect in document["effects"] if effect["id"] not in own]:
        told.append(f"Give the simulator what it has not: {', '.join(rest)}, or put the corrected model behind it.")
    return told


def _named(document: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    """The simulator's parameters that are named, each with name, unit, nominal and value; () without a simulator."""
    return document.get("simulator", {}).get("parameters", ())  # type: ignore[no-any-return]


def _value(parameter: Mapping[str, Any]) -> str:
    """Its value on the robot, with its unit."""
    return f"{parameter['value']:.3g} {parameter['unit']}".strip()
