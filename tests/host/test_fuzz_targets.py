"""tests/fuzz: every harness is run, from inputs that are kept; those of what the host reads can fail."""

import random
import subprocess
import sys
from pathlib import Path

import pytest

from tools.trust import CORPUS, READER, READERS, TARGETS

FUZZ = Path(__file__).parents[1] / "fuzz"
sys.path.insert(0, str(FUZZ))
import readers  # noqa: E402


def test_every_harness_is_a_target_with_inputs() -> None:
    assert {f"fuzz_{name}" for name in TARGETS} == {path.stem for path in FUZZ.glob("fuzz_*.c")}
    assert {path.name for path in CORPUS.iterdir()} == TARGETS.keys()
    assert readers.TARGETS.keys() == READERS.keys()
    for name, target in TARGETS.items():
        sizes = [path.stat().st_size for path in (CORPUS / name).iterdir()]
        assert 10 < len(sizes) < 1000 and max(sizes) <= target.longest
    assert sum(target.long for target in (TARGETS | READERS).values()) >= 10**8
    assert min(target.long for target in (TARGETS | READERS).values()) >= 10**6


@pytest.mark.parametrize("name", readers.TARGETS)
def test_what_the_host_reads_ends_in_a_result_or_an_error_with_words(name: str) -> None:
    for seed in range(30):
        readers.once(name, seed)


@pytest.mark.parametrize("name", readers.TARGETS)
def test_both_ends_are_met(name: str) -> None:
    """What is changed is not so much that nothing is ever read, nor so little that all is (bytes that are no message
    are skipped, and a server that says nothing of use is a time-out)."""
    good = bad = 0
    for seed in range(300):
        try:
            readers.TARGETS[name][0](random.Random(f"{name}:{seed}"))
            good += 1
        except Exception:
            bad += 1
    assert good > 0 and (bad > 0 or name in ("stream", "usbip"))


def test_what_breaks_is_told_with_the_line_that_does_it_again(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    spoilt = tmp_path / "readers.py"
    spoilt.write_text(READER.read_text("utf-8").replace("suppress(TautError)", "suppress(KeyError)"), "utf-8")
    done = subprocess.run([sys.executable, str(spoilt), "rig", "-runs=50", "-seed=1"], capture_output=True, text=True)
    line = done.stderr.splitlines()[-1]
    assert done.returncode == 1 and line.startswith("broken: TautError(") and " rig -runs=1 -seed=" in line
