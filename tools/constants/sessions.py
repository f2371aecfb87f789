"""Recordings to calibrate, made by tools/honesty: of as many sound set-ups, and of as many with one fault each."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from tools.honesty.conditions import CONDITIONS, build
from tools.honesty.conditions.registry import BENIGN
from tools.honesty.record import make

FIRST_SEED = 61000  # nothing is tuned on what follows it
LIST = "sessions.json"
_SLOW = frozenset({"video", "video_trouble"})  # families whose frames are drawn and tracked, minutes each


@dataclass(frozen=True)
class Session:
    name: str
    sound: bool
    recordings: tuple[str, ...]
    rig: str


def sessions(folder: Path, count: int) -> list[Session]:
    """`count` with nothing wrong and `count` with something, one of each family in turn; made once."""
    told = folder / LIST
    kept = {row["name"]: _read(row) for row in json.loads(told.read_text())} if told.is_file() else {}
    wanted = [*_in_turn(True, count), *_in_turn(False, count)]
    for name, seed in wanted:
        if (key := f"{name}-{seed}") not in kept:
            made = make(build(name, seed), folder / key)
            sound = CONDITIONS[name].family == BENIGN
            kept[key] = Session(key, sound, tuple(map(str, made.recordings)), str(made.rig))
            told.write_text(json.dumps([asdict(each) for each in kept.values()]))
    return [kept[f"{name}-{seed}"] for name, seed in wanted]


def _in_turn(sound: bool, count: int) -> list[tuple[str, int]]:
    families: dict[str, list[str]] = {}
    for each in CONDITIONS.values():
        if (each.family == BENIGN) is sound and each.family not in _SLOW:
            families.setdefault(each.name if sound else each.family, []).append(each.name)
    taken = []
    for i in range(count):
        members = list(families.values())[i % len(families)]
        turn = i // len(families)
        taken.append((members[turn % len(members)], FIRST_SEED + turn // len(members)))
    return taken


def _read(row: dict[str, object]) -> Session:
    recordings = row["recordings"]
    assert isinstance(recordings, list)
    return Session(str(row["name"]), bool(row["sound"]), tuple(map(str, recordings)), str(row["rig"]))
