"""Many cases, in processes, with a progress bar."""

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

from rich.progress import Progress
from tools.family import cases, record

One = Callable[[int, int, str, tuple[str, ...], Path, Path], str]


def one(seed: int, index: int, kind: str, ids: tuple[str, ...], out: Path, truths: Path) -> str:
    case = cases.draw(seed, index, kind, ids)
    record.write(case, seed, out, truths)
    return case.name


def make(seed: int, count: int, out: Path, truths: Path, processes: int) -> None:
    """Writes all cases of a seed. Each comes from the seed and its own number alone: order does not matter."""
    spread(one, seed, cases.plan(seed, count), out, truths, processes)


def spread(
    one: One, seed: int, plan: list[tuple[str, tuple[str, ...]]], out: Path, truths: Path, processes: int
) -> None:
    """Cases of any family, each by `one`."""
    jobs = [(seed, i, kind, ids, out, truths) for i, (kind, ids) in enumerate(plan)]
    with Progress() as progress, ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        bar = progress.add_task("cases", total=len(jobs))
        for done in as_completed([pool.submit(one, *job) for job in jobs]):
            progress.update(bar, advance=1, description=done.result())
