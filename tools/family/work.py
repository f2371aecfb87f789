"""Many cases, in processes, with a progress bar."""

import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed
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


def _taut(*words: str | Path) -> str:
    """Runs `taut`; returns its last line of complaint, empty where it succeeded."""
    done = subprocess.run([sys.executable, "-m", "tautline", *map(str, words)], capture_output=True, text=True)
    return "" if done.returncode == 0 else (done.stderr.strip() or f"status {done.returncode}").splitlines()[-1]


def diagnose_one(folder: Path, name: str, out: Path) -> str:
    """`taut diagnose` of a case and both models' predictions of its unseen motion. Returns a complaint."""
    case, unseen, said = folder / "cases" / name, folder / "unseen" / name, out / name
    if (said / "corrected.csv").exists():
        return ""
    tests = sorted(case.glob("test-*"))
    complaint = _taut("diagnose", case / "calibration", *tests, "--rig", case / "rig.toml", "--out", said)
    for model in ("nominal", "corrected"):
        complaint = complaint or _taut(
            "predict", said / model, unseen, "--times", unseen / "times.csv", "--csv", said / f"{model}.csv"
        )
    return complaint and f"{name}: {complaint}"


def diagnose(folder: Path, out: Path, processes: int) -> list[str]:
    """Diagnoses all cases of a folder that OUT lacks; returns the complaints. Each case fails alone."""
    names = sorted(p.name for p in (folder / "cases").iterdir())
    with Progress() as progress, ThreadPoolExecutor(processes) as pool:
        bar = progress.add_task("diagnoses", total=len(names))
        complaints = []
        for done in as_completed([pool.submit(diagnose_one, folder, name, out) for name in names]):
            progress.update(bar, advance=1)
            complaints += [done.result()] if done.result() else []
    return complaints
