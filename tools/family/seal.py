"""Fingerprints: of a generator's sources, of a seed's plan and of its truths; another family gives folder and plan."""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path

from tools.family.cases import plan

HERE = Path(__file__).parent
NOT_GENERATOR = ("score.py", "__main__.py", "seal.py", "work.py")  # they make no case
Plan = Callable[[int, int], list[tuple[str, tuple[str, ...]]]]


def sources(folder: Path = HERE) -> str:
    """sha256 over every source that makes a case, by name and content."""
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py"), key=lambda p: p.relative_to(folder).as_posix()):
        name = path.relative_to(folder).as_posix()
        if name not in NOT_GENERATOR:
            digest.update(name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def planned(seed: int, cases: int, planner: Plan = plan) -> str:
    """sha256 of the kinds and ids of all cases: integers and names only, the same on every machine."""
    return hashlib.sha256(json.dumps(planner(seed, cases)).encode()).hexdigest()


def truths(folder: Path, first: int) -> str:
    """sha256 over the truths of the first cases of a folder, the unseen motions' values included."""
    digest = hashlib.sha256()
    for number in range(first):
        for path in (folder / f"case-{number:03d}.json", folder / f"case-{number:03d}-unseen.csv"):
            digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()
