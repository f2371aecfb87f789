"""Runs the harnesses of tests/fuzz with libFuzzer, those in C under ASan and UBSan, those of what the host reads
(readers.py) through Atheris, and prints executions and what they reached.

    python tools/trust.py [--long | --seconds S] [--keep] [TARGET...]

As it is each target has the executions of ./run test trust, always the same ones: its seed is fixed. With --long it has
those of ./run trust, a hundred million in sum and a million at least of each, with inputs that nobody has tried; with
--seconds as many as fit. --keep adds those that reach something new to tests/fuzz/corpus. What breaks a promise is left
in build/fuzz/found, with the line that replays it.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from rich.progress import Progress, TaskID

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
from tools.kept import keep  # noqa: E402

HARNESSES = ROOT / "build" / "fuzz" / "tests" / "fuzz"
FOUND = ROOT / "build" / "fuzz" / "found"
CORPUS = ROOT / "tests" / "fuzz" / "corpus"
AT_ONCE = 2
INTERRUPTED = 72  # libFuzzer's exit status after SIGINT: what it has done until then counts
MEMORY = "/dev/shm" if Path("/dev/shm").is_dir() else None  # a reader's files need no disk


@dataclass(frozen=True)
class Target:
    what: str
    runs: int  # of ./run test trust
    long: int  # of ./run trust
    longest: int = 512  # bytes of an input


MILLION = 1_000_000
TARGETS = {
    "wire": Target("bytes on the bus, message by message", 200_000, 56 * MILLION, 1024),
    "table": Target("table blobs with all sections, and look-ups in them", 200_000, 40 * MILLION, 4096),
    "changes": Target("a compensator while tables, modes and loads change", 4_000, MILLION, 1024),
    "onset": Target("the onset detector, any motor and camera", 4_000, MILLION, 512),
    "app": Target("the whole app on a fake clock: requests, tables, cut power, ills", 4_000, MILLION, 512),
    "usb": Target("TinyUSB with the whole app on the desktop bus", 4_000, MILLION, 512),
}
READER = ROOT / "tests" / "fuzz" / "guided.py"
READERS = {
    "recording": Target("a recording's folder, at the host", 300, MILLION),
    "model": Target("a model's folder", 1_000, MILLION),
    "rig": Target("a rig.toml", 1_000, MILLION),
    "replies": Target("what a board answers, as messages", 1_000, MILLION),
    "stream": Target("bytes of the bus, at the host", 2_000, MILLION),
    "dfu": Target("what a board answers to DFU requests", 2_000, MILLION),
    "usbip": Target("what a USB/IP server sends", 2_000, MILLION),
}
EVERY = TARGETS | READERS


@dataclass(frozen=True)
class Result:
    name: str
    executions: int
    reached: int  # edges of harness and library; of a reader: of the package's Python
    edges: int  # that there are, where it is known
    inputs: int  # that are kept
    broken: str  # what, and how to replay it; empty: nothing


def harness(name: str) -> list[str]:
    return [sys.executable, str(READER), name] if name in READERS else [str(HARNESSES / f"fuzz_{name}")]


def run(name: str, amount: list[str], keep: bool, progress: Progress, task: TaskID) -> Result:
    """One target. Its corpus grows in a folder of its own, so that a run with a fixed seed always does the same."""
    kept = CORPUS / name
    with tempfile.TemporaryDirectory() as grown, tempfile.TemporaryDirectory(dir=MEMORY) as scratch:
        command = [*harness(name), *amount, f"-max_len={EVERY[name].longest}", "-len_control=0"]
        command += ["-print_final_stats=1", f"-artifact_prefix={FOUND}/{name}-", grown, str(kept)]
        said: list[str] = []
        environment = os.environ | {"TMPDIR": scratch, "OPENBLAS_NUM_THREADS": "1"}
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, errors="replace", env=environment) as process:
            assert process.stderr is not None
            for line in process.stderr:
                said.append(line)
                if match := re.match(r"#(\d+)\t", line):
                    progress.update(task, completed=int(match[1]))
        result = _result(name, said, process.returncode)
        if keep and not result.broken:
            _merge(name, Path(grown), kept)
    progress.update(task, completed=result.executions, total=result.executions)
    return result


def _result(name: str, said: list[str], code: int) -> Result:
    text = "".join(said)
    executions = re.findall(r"number_of_executed_units: (\d+)", text) or re.findall(r"^#(\d+)\t", text, re.MULTILINE)
    reached = re.findall(r"cov: (\d+)", text)
    edges = re.search(r"Loaded \d+ modules\s+\((\d+) inline", text)
    broken = ""
    if code not in (0, INTERRUPTED):
        why = re.search(r"broken: .*|runtime error: .*|SUMMARY: .*", text)
        left = re.search(r"Test unit written to (\S+)", text)
        again = " ".join(
            str(part).removeprefix(f"{ROOT}/") for part in [*harness(name), *(left.groups() if left else ())]
        )
        replay = f"; again by {again}" if left else ""
        broken = (why[0] if why else f"ended with {code}") + replay
    return Result(
        name,
        int(executions[-1]) if executions else 0,
        int(reached[-1]) if reached else 0,
        int(edges[1]) if edges else 0,
        len(list((CORPUS / name).iterdir())),
        broken,
    )


def _merge(name: str, grown: Path, kept: Path) -> None:
    """Adds what reaches something that the kept inputs do not; they stay, as each was a case once.
    (Atheris cannot merge: of a reader all that reached something new when it was tried.)"""
    if name in READERS:
        for path in grown.iterdir():
            shutil.copy(path, kept)
        return
    command = [*harness(name), "-merge=1", "-use_counters=0", str(kept), str(grown)]
    subprocess.run(command, check=True, capture_output=True)


def amount(name: str, long: bool, seconds: int | None) -> tuple[list[str], int | None]:
    """libFuzzer's options, and how many executions that is, if they say."""
    if seconds is not None:
        return [f"-max_total_time={seconds}"], None
    target = EVERY[name]
    return ([f"-runs={target.long}"], target.long) if long else ([f"-runs={target.runs}", "-seed=1"], target.runs)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("targets", nargs="*", metavar="TARGET", help=f"of {', '.join(EVERY)}; all of them")
    many = parser.add_mutually_exclusive_group()
    many.add_argument("--long", action="store_true", help="a hundred million executions in sum: hours")
    many.add_argument("--seconds", type=int, help="for each target, instead of a fixed number of executions")
    parser.add_argument("--keep", action="store_true", help="adds what reaches something new to tests/fuzz/corpus")
    options = parser.parse_args()
    if unknown := set(options.targets) - EVERY.keys():
        parser.error(f"no target {', '.join(sorted(unknown))}: choose of {', '.join(EVERY)}")
    names = options.targets or list(EVERY)
    if find_spec("atheris") is None:
        says = f"without {', '.join(READERS)}: Atheris, which drives them, has no wheel for this machine"
        names = [name for name in names if name not in READERS]
        if not names:
            parser.error(says)
        print(says)
    FOUND.mkdir(parents=True, exist_ok=True)
    with Progress(transient=True) as progress, ThreadPoolExecutor(AT_ONCE) as pool:
        amounts = {name: amount(name, options.long, options.seconds) for name in names}
        tasks = {name: progress.add_task(name, total=amounts[name][1]) for name in names}
        results = list(pool.map(lambda name: run(name, amounts[name][0], options.keep, progress, tasks[name]), names))
    print(f"{'target':10s}{'executions':>12s}{'edges reached':>16s}{'kept inputs':>13s}")
    for each in results:
        edges = f"{each.reached} of {each.edges}" if each.edges else str(each.reached)
        print(f"{each.name:10s}{each.executions:12d}{edges:>16s}{each.inputs:13d}  {EVERY[each.name].what}")
    heads = ("target", "executions", "edges reached", "of", "kept inputs", "broken")
    kept = [(each.name, each.executions, each.reached, each.edges or "-", each.inputs, each.broken) for each in results]
    keep("fuzz" if options.long or options.seconds else "fuzz-short", heads, kept)
    for each in results:
        if each.broken:
            print(f"{each.name}: {each.broken}")
    return 1 if any(each.broken for each in results) else 0


if __name__ == "__main__":
    sys.exit(main())
