"""A topic: one thing that a message names, and all that is known of it."""

from __future__ import annotations

from dataclasses import dataclass, field

KINDS = {
    "effect": "Effects: what may stand between model and instrument",
    "reason": "Reasons of a verdict",
    "fault": "Faults of an axis",
    "refusal": "What a board refuses",
    "rig": "rig.toml, key by key",
    "shapes": "shapes.toml, the index of a library of shapes, key by key",
    "file": "Files of a recording",
    "format": "Formats of taut export",
    "term": "Terms",
}


@dataclass(frozen=True)
class Topic:
    """`code` is what messages name. The texts are sentences; an empty one is left out."""

    code: str
    kind: str  # one of KINDS
    what: str  # what it is, or does
    tell: str = ""  # how to tell it
    mend: str = ""  # what to do about it
    rows: tuple[tuple[str, str], ...] = ()  # name and meaning: parameters, keys, columns
    see: tuple[str, ...] = ()  # codes of other topics
    aliases: tuple[str, ...] = field(default=())  # other names that lead here

    @property
    def file(self) -> str:
        """The file name of the topic's HTML page, made of its kind and code."""
        return f"{self.kind}-{self.code.lower().replace(' ', '-').replace('.', '-').replace('_', '-')}.html"
