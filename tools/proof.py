"""What Frama-C's Eva proves of the C that reads what a host sends: no overflow of a sign, no division by zero, nothing
read or written out of bounds, nothing read that was not written, for every input of each proof's driver.

    ./run trust proofs [NAME...] [--quick]

A proof is a folder of tests/proof: driver.c calls the functions with any input that their preconditions allow,
proof.toml says which functions, sources, options and preconditions, and where each of those is established. What Eva
cannot exclude is an alarm; docs/proofs.md explains each that is left, in a table that is read here: an alarm that it
does not name fails, and so does a row whose alarm is gone. So does a listed function that the driver never reaches: it
has no alarms either. Integers are those of the boards: 32-bit pointers.
"""

from __future__ import annotations

import argparse
import csv
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
from tools.kept import keep  # noqa: E402

PROOFS = ROOT / "tests" / "proof"
EXPLAINED = ROOT / "docs" / "proofs.md"
INCLUDED = ("common/include", "firmware/estimator/include", "firmware/estimator/src", "common/src")
LONGEST_S = 3600.0
# Of what a proof takes for granted. Frama-C's own library is not ours either.
GRANTED = ("postcondition", "assigns clause", "from clause")

Alarm = tuple[str, str, str]  # proof, function, kind


@dataclass(frozen=True)
class Proof:
    name: str
    proves: str
    functions: tuple[str, ...]
    sources: tuple[str, ...]
    options: tuple[str, ...]
    preconditions: tuple[tuple[str, str], ...]
    quick: bool


@dataclass(frozen=True)
class Result:
    reached: int  # statements of the functions that were analysed
    of: int
    alarms: tuple[tuple[str, str, str], ...]  # function, kind, what is not excluded
    followed: frozenset[str]  # names of functions that Eva went through to an end
    seconds: float


def proofs() -> list[Proof]:
    found = []
    for file in sorted(PROOFS.glob("*/proof.toml")):
        said = tomllib.loads(file.read_text("utf-8"))
        lists = {key: tuple(said[key]) for key in ("functions", "sources", "options")}
        known = tuple((what, where) for what, where in said["preconditions"])
        found.append(
            Proof(file.parent.name, said["proves"], **lists, preconditions=known, quick=said.get("quick", False))
        )
    return found


def explained() -> dict[Alarm, str]:
    """The rows of docs/proofs.md's last table: proof, function, alarm, why it cannot come."""
    rows = re.findall(r"^\| (\w+) \| `(\w+)` \| ([^|]+?) \| ([^|]+?) \|$", EXPLAINED.read_text("utf-8"), re.MULTILINE)
    return {(proof, function, kind): why for proof, function, kind, why in rows}


def left(report: str) -> list[tuple[str, str, str]]:
    """The alarms in Frama-C's report, a table with tabs."""
    rows = csv.DictReader(report.splitlines(), delimiter="\t", quoting=csv.QUOTE_NONE)
    return [
        (row["function"], row["property kind"], row["property"])
        for row in rows
        if row["status"].startswith(("Unknown", "Invalid"))  # 'Invalid or unreachable': nothing behind it was followed
        and row["property kind"] not in GRANTED
        and not row["directory"].startswith("FRAMAC_SHARE")
    ]


def followed(said: str) -> frozenset[str]:
    """The functions that Eva went through to an end, by its output. Of one that was never called, or from which it saw
    no way back, it has no values there: what stands in it, or behind its calls, is not proven."""
    ends = r"^\[eva:final-states\] Values at end of function (\w+):(?!\s*NON TERMINATING)"
    return frozenset(re.findall(ends, said, re.MULTILINE))


def proven(proof: Proof) -> Result:
    """Errors: Frama-C's words where it does not understand the sources."""
    began = time.monotonic()
    driver, share = PROOFS / proof.name / "driver.c", _said(["frama-c", "-print-share-path"]).strip()
    included = " ".join(f"-I{ROOT / each}" for each in INCLUDED)
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.csv"
        command = [
            "frama-c",
            "-c11",
            "-machdep",
            "gcc_x86_32",
            f"-cpp-extra-args={included} -I{share}/libc",
            str(driver),
        ]
        command += [str(ROOT / each) for each in proof.sources]
        command += ["-eva", *proof.options, "-then", "-report", "-report-csv", str(report), "-report-no-proven"]
        said = _said(command)
        alarms = left(report.read_text("utf-8"))
    reached = re.search(r"(\d+) statements reached \(out of (\d+)\)", said)
    if reached is None:
        raise SystemExit(f"proofs: {proof.name}: Frama-C analysed nothing:\n{said[-2000:]}")
    seconds = time.monotonic() - began
    return Result(int(reached[1]), int(reached[2]), tuple(sorted(set(alarms))), followed(said), seconds)


def _said(command: list[str]) -> str:
    done = subprocess.run(command, capture_output=True, text=True, timeout=LONGEST_S, check=False)
    if done.returncode != 0:
        raise SystemExit(
            f"proofs: {' '.join(command[:1])} ended with {done.returncode}:\n{(done.stdout + done.stderr)[-2000:]}"
        )
    return done.stdout


def report(proof: Proof, result: Result, known: dict[Alarm, str]) -> list[str]:
    """Prints what came of it; returns what is wrong."""
    found = {(proof.name, function, kind) for function, kind, _ in result.alarms}
    verdict = "proven" if not found else f"{len(result.alarms)} alarms left, explained in docs/proofs.md"
    print(
        f"{proof.name}: {verdict}: {proof.proves} ({result.reached} of {result.of} statements, {result.seconds:.0f} s)"
    )
    print(f"    {', '.join(proof.functions)}")
    for function, kind, what in result.alarms:
        print(f"    left: {function}: {kind}: {what}")
    unknown = [f"{name}: {function}: {kind}: not explained" for name, function, kind in sorted(found - known.keys())]
    mine = {alarm for alarm in known if alarm[0] == proof.name}
    gone = [
        f"{name}: {function}: {kind}: explained, and no longer there" for name, function, kind in sorted(mine - found)
    ]
    missed = [
        f"{proof.name}: {function}: listed, and never reached to its end: nothing is proven of it"
        for function in proof.functions
        if function not in result.followed
    ]
    return unknown + gone + missed


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="folders of tests/proof; all of them")
    parser.add_argument("--quick", action="store_true", help="those that take some seconds; nothing without Frama-C")
    options = parser.parse_args()
    if shutil.which("frama-c") is None:
        if options.quick:
            print("proofs: Frama-C is not installed ('tools/setup proof'): none tried")
            return 0
        raise SystemExit("proofs: Frama-C is needed: tools/setup proof")
    every = proofs()
    if unknown := set(options.names) - {proof.name for proof in every}:
        raise SystemExit(f"proofs: no {', '.join(sorted(unknown))} in tests/proof")
    known, wrong, kept = explained(), [], []
    for proof in every:
        if proof.name in options.names or (not options.names and (proof.quick or not options.quick)):
            result = proven(proof)
            wrong += report(proof, result, known)
            left_of = f"{len(result.alarms)} alarms left" if result.alarms else "proven"
            kept.append((proof.name, left_of, proof.proves, ", ".join(proof.functions)))
            sys.stdout.flush()
    if kept:
        keep("proofs", ("proof", "result", "what", "functions"), kept)
    for each in wrong:
        print(f"proofs: {each}", file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
