"""tests/proof: what is proven, on what, and that what Frama-C left is read from its report and explained."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from tools import proof

ROOT = Path(__file__).parents[2]
REPORT = "\n".join(
    (
        "directory\tfile\tline\tfunction\tproperty kind\tstatus\tproperty",
        '/x\ta.c\t1\tdivides\tdivision_by_zero\tUnknown\tb != 0 "',
        "/x\ta.c\t2\treads\tmem_access\tInvalid\t\\valid_read(a)",
        "/x\ta.c\t3\treads\tmem_access\tValid\t\\valid_read(b)",
        "/x\ta.c\t5\tadds\tsigned_overflow\tInvalid or unreachable\ta + b",
        "/x\tdriver.c\t4\tgranted\tpostcondition\tUnknown\t\\result == 0",
        "FRAMAC_SHARE/libc\tstring.h\t95\tmemcpy\tprecondition\tUnknown\tvalid_dest",
    )
)


def test_every_proof_says_what_it_is_of() -> None:
    found = proof.proofs()
    assert {each.name for each in found} == {path.name for path in proof.PROOFS.iterdir() if path.is_dir()}
    page = proof.EXPLAINED.read_text()
    for each in found:
        driver = (proof.PROOFS / each.name / "driver.c").read_text()
        for other in re.findall(r'#include "(\.\./\w+/driver\.c)"', driver):
            driver += (proof.PROOFS / each.name / other).read_text()
        included = [part.split('"')[0] for part in driver.split('#include "../../../')[1:]]
        sources = "\n".join((ROOT / path).read_text() for path in (*each.sources, *included))
        sources += (ROOT / "common/include/tautline/tl_fixed.h").read_text()
        sources += (ROOT / "common/src/tl_sections.h").read_text()
        assert each.functions and all(f"{name}(" in sources for name in each.functions), each.name
        assert each.preconditions and all(len(where) > 10 for _, where in each.preconditions), each.name
        assert f"| `{each.name}` |" in page, each.name


def test_alarms_are_what_is_not_proven() -> None:
    assert proof.left(REPORT) == [
        ("divides", "division_by_zero", 'b != 0 "'),
        ("reads", "mem_access", "\\valid_read(a)"),
        ("adds", "signed_overflow", "a + b"),
    ]


def test_an_alarm_that_nobody_explained_fails_and_so_does_an_explanation_of_none(
    capsys: pytest.CaptureFixture[str],
) -> None:
    (one,) = [each for each in proof.proofs() if each.name == "history"]
    known = proof.explained()
    mine = {alarm for alarm in known if alarm[0] == "history"}
    assert mine and all(len(why) > 30 for why in known.values())
    assert {name for name, _, _ in known} <= {each.name for each in proof.proofs()}
    (alarm,) = mine
    all_of_it = frozenset(one.functions)
    left = proof.Result(9, 9, ((alarm[1], alarm[2], "d != 0"),), all_of_it, 1.0)
    assert proof.report(one, left, known) == []
    assert "left: interpolate" in capsys.readouterr().out
    assert "not explained" in proof.report(one, left, {})[0]
    assert "no longer there" in proof.report(one, proof.Result(9, 9, (), all_of_it, 1.0), known)[0]


SAID = """\
[eva] done for function main
[eva] ====== VALUES COMPUTED ======
[eva:final-states] Values at end of function adds:
  sum ∈ [--..--]
[eva:final-states] Values at end of function spins:
  NON TERMINATING FUNCTION
[eva:final-states] Values at end of function main:
  __retres ∈ {0}
[eva:summary] ====== ANALYSIS SUMMARY ======
"""


def test_a_listed_function_that_is_never_reached_fails() -> None:
    """A driver without its call leaves no alarm of it, as a proof does."""
    assert proof.followed(SAID) == {"adds", "main"}
    one = proof.Proof("sum", "sums", ("adds", "divides", "spins"), (), (), (), False)
    wrong = proof.report(one, proof.Result(9, 9, (), proof.followed(SAID), 1.0), {})
    assert [each.split(": ")[:3] for each in wrong] == [
        ["sum", "divides", "listed, and never reached to its end"],
        ["sum", "spins", "listed, and never reached to its end"],
    ]


@pytest.mark.long
@pytest.mark.skipif(shutil.which("frama-c") is None, reason="tools/setup proof")
def test_frama_c_sees_what_is_wrong(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A checksum that reads one byte too many is an alarm, as it is none as it is."""
    (one,) = [each for each in proof.proofs() if each.name == "checksum"]
    assert proof.proven(one).alarms == ()
    wrong = tmp_path / "common/src/tl_crc.c"
    wrong.parent.mkdir(parents=True)
    wrong.write_text((ROOT / "common/src/tl_crc.c").read_text().replace("i < size", "i <= size"))
    (tmp_path / "common/include").symlink_to(ROOT / "common/include")
    monkeypatch.setattr(proof, "ROOT", tmp_path)
    assert ("tl_crc32", "mem_access") in {alarm[:2] for alarm in proof.proven(one).alarms}


@pytest.mark.long
@pytest.mark.skipif(shutil.which("frama-c") is None, reason="tools/setup proof")
def test_frama_c_says_which_functions_it_reached() -> None:
    """`tl_crc32` is reached, and a function of no proof is not."""
    (one,) = [each for each in proof.proofs() if each.name == "checksum"]
    assert proof.report(one, proof.proven(one), {}) == []
    more = replace(one, functions=(*one.functions, "tl_wire_parse"))
    assert "tl_wire_parse: listed, and never reached" in proof.report(more, proof.proven(more), {})[0]
