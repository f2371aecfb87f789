"""tests/fuzz: every harness is run, from inputs that are kept; those of what the host reads can fail."""

import os
import random
import subprocess
import sys
from pathlib import Path

import pytest

from tools.trust import CORPUS, EVERY, READER, READERS, ROOT, TARGETS

FUZZ = Path(__file__).parents[1] / "fuzz"
sys.path.insert(0, str(FUZZ))
import readers  # noqa: E402


def test_every_harness_is_a_target_with_inputs() -> None:
    assert {f"fuzz_{name}" for name in TARGETS} == {path.stem for path in FUZZ.glob("fuzz_*.c")}
    assert {path.name for path in CORPUS.iterdir()} == EVERY.keys()
    assert readers.TARGETS.keys() == READERS.keys()
    for name, target in EVERY.items():
        sizes = [path.stat().st_size for path in (CORPUS / name).iterdir()]
        assert 10 < len(sizes) < 1000 and max(sizes) <= target.longest
    assert sum(target.long for target in EVERY.values()) >= 10**8
    assert min(target.long for target in EVERY.values()) >= 10**6


@pytest.mark.parametrize("name", readers.TARGETS)
def test_what_the_host_reads_ends_in_a_result_or_an_error_with_words(name: str) -> None:
    for seed in range(30):
        readers.once(name, random.Random(f"{name}:{seed}"))


@pytest.mark.parametrize("name", readers.TARGETS)
def test_both_ends_are_met(name: str) -> None:
    """What is changed is not so much that nothing is ever read, nor so little that all is (bytes that are no message
    are skipped, and a server that says nothing of use is a time-out)."""
    good = bad = 0
    for seed in range(300):
        try:
            readers.TARGETS[name](random.Random(f"{name}:{seed}"))
            good += 1
        except Exception:
            bad += 1
    assert good > 0 and (bad > 0 or name in ("stream", "usbip"))


def test_what_breaks_is_told_and_left_to_be_read_again(tmp_path: Path) -> None:
    pytest.importorskip("atheris", reason="Atheris has no wheel for this machine")
    spoilt = tmp_path / "guided.py"
    text = READER.read_text("utf-8").replace("parents[2]", f"parents[{len(tmp_path.parents)}]")
    spoilt.write_text(text.replace("readers.once(name, ", "readers.TARGETS[name]("), "utf-8")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(READER.parent), str(ROOT / "host")))}
    command = [sys.executable, str(spoilt), "rig"]

    def fuzz(*options: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run([*command, *options], capture_output=True, text=True, cwd=tmp_path, env=environment)

    found = fuzz("-runs=50", "-seed=1")
    said = next(line for line in found.stderr.splitlines() if line.startswith("broken: "))
    (left,) = tmp_path.glob("crash-*")
    again = fuzz(left.name)
    assert found.returncode != 0 and again.returncode != 0
    assert said.startswith("broken: TautError(")
    assert said.partition("rig.toml")[2] in again.stderr
