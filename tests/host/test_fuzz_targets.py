"""tests/fuzz: every harness is run, from inputs that are kept."""

from pathlib import Path

from tools.trust import CORPUS, TARGETS

FUZZ = Path(__file__).parents[1] / "fuzz"


def test_every_harness_is_a_target_with_inputs() -> None:
    assert {f"fuzz_{name}" for name in TARGETS} == {path.stem for path in FUZZ.glob("fuzz_*.c")}
    assert {path.name for path in CORPUS.iterdir()} == TARGETS.keys()
    for name, target in TARGETS.items():
        sizes = [path.stat().st_size for path in (CORPUS / name).iterdir()]
        assert 10 < len(sizes) < 1000 and max(sizes) <= target.longest
