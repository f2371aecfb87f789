"""One case of a seed, written: what the first family's loop over processes calls."""

from pathlib import Path

from tools.family import work
from tools.family_four import files
from tools.family_six import cases


def one(seed: int, index: int, kind: str, ids: tuple[str, ...], out: Path, truths: Path) -> str:
    return str(files.write(cases.draw(seed, index, kind, ids), seed, out, truths)["case"])


def make(seed: int, count: int, out: Path, truths: Path, processes: int, first: int | None = None) -> None:
    """Writes all cases of a seed, or the first of them. Each comes from the seed and its own number alone."""
    work.spread(one, seed, cases.plan(seed, count)[:first], out, truths, processes)
