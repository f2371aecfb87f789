"""The campaign that asks whether what was there from the first recording on has one name."""

import pytest

from tools.naming.cases import LIBRARY, SECOND, make
from tools.naming.score import first, same, table

SPEED = "transmission.rate_dependent_backlash"


@pytest.mark.parametrize("generator", [SECOND, LIBRARY])
def test_a_case_is_as_strong_as_asked_for(generator: str) -> None:
    case = make(generator, "transmission.asymmetric_backlash", 1)
    assert 1.5 < case.left_px / case.noise_px < 25.0  # 2 to 20 times the noise, to what a step of the strength tells


def test_the_table_counts_names_and_what_the_model_holds() -> None:
    said = {"calibration": {"ids": [SPEED]}, "session": {"ids": [SPEED]}}
    rows = [
        {"effect": SPEED, "recalibrated": 3.0, **said, "diagnosis": {"verdict": "effect", "ids": [SPEED]}},
        {"effect": SPEED, "recalibrated": 9.0, **said, "diagnosis": {"verdict": "unknown", "ids": []}},
        {"effect": SPEED, "recalibrated": 1.0, **said, "diagnosis": {"verdict": "none", "ids": []}},
    ]
    assert [same(row) for row in rows] == [True, False, False]
    assert [first(row, "diagnosis") for row in rows] == [SPEED, "unknown", ""]
    assert table(rows).splitlines()[2:] == [
        f"| {SPEED} | 2 to 5 | 1 | 1 | 1 | 1 | 1 | 1 |",
        f"| {SPEED} | over 5 | 1 | 1 | 1 | 0 | 0 | 1 |",
    ]
