"""The keys of rig.toml that nothing has told yet, and values as somebody types them."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from typing import Any

from tautline.errors import TautError
from tautline.rig import ANGLE, MARKER, SECTIONS, Sensor
from tautline.schema import Key, Section

Document = dict[str, Any]
_OF: Mapping[Sensor, tuple[str, ...]] = {
    MARKER: ("actuator", "coarse", "kinematics", "camera", "hand_eye"),
    ANGLE: ("actuator", "coarse", "angle"),
}


def put(document: Document, section: Section, key: Key, text: str) -> None:
    """Sets a key of a rig.toml's document, in place, from text as somebody types it: TOML, a word without quotes, or
    numbers with commas. The section is added where it is missing. TautError where the text is not what the key
    expects."""
    bare = text.strip()
    if key.kind == "text" and not bare.startswith(('"', "'")):
        bare = f'"{bare}"'
    if key.kind == "numbers" and not bare.startswith("["):
        bare = f"[{bare}]"
    name = f"{section.name}.{key.name}"
    try:
        value = tomllib.loads(f"value = {bare}")["value"]
    except ValueError as error:  # no TOML, or a number of too many digits
        raise TautError(f"{name} is {text!r}, expected {key.expected}, as in {example(key)}") from error
    read = key.read(value, name, where="as given")  # where: what an error names instead of a file
    document.setdefault(section.name, {})[key.name] = _as_toml_value(read)


def find_key(name: str) -> tuple[Section, Key]:
    """The section and key that the name SECTION.KEY means. TautError where rig.toml has no such key."""
    section = SECTIONS.get(name.partition(".")[0])
    key = next((k for k in section.keys if k.name == name.partition(".")[2]), None) if section else None
    if section is None or key is None:
        raise TautError(f"rig.toml has no key {name}: 'taut explain rig' lists them")
    return section, key


def missing(document: Mapping[str, Any], sensor: Sensor) -> Iterator[tuple[Section, Key]]:
    """Yields the required keys, with their sections, that a rig.toml's document lacks for this sensor, in the order of
    the file."""
    for name in _OF[sensor]:
        for key in SECTIONS[name].keys:
            if key.needed and key.name not in document.get(name, {}):
                yield SECTIONS[name], key


def example(key: Key) -> str:
    """A key's example as text, as somebody would type it for `put`."""
    return ", ".join(f"{v:g}" for v in key.example) if isinstance(key.example, list) else str(key.example)


def _as_toml_value(value: Any) -> Any:
    """A value as a TOML document holds it: a tuple becomes a list."""
    return list(value) if isinstance(value, tuple) else value
