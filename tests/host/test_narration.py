"""What a diagnosis says never contradicts itself."""

import itertools
import re

import pytest

from tautline.diagnosis import narration, page

NAMES = ("transmission.lag", "acquisition.delay", "configuration.contact")
UNEXPLAINED = "no known effect explains"
CLOSES = re.compile(r"(?:close[sd]?|shrinks by) (\d+) %")


def document(verdict, shrink, recalibrated, before, flexible=0.98):
    """Of a gap in deg with a noise of 0.1; `shrink` of the best candidate."""
    candidates = [
        {"id": name, "probability": 0.02, "shrink": shrink / (i + 1), "identifiable": True}
        for i, name in enumerate(NAMES)
    ]
    return {
        "verdict": verdict,
        "unit": "deg",
        "noise_floor": 0.1,
        "gap": {"before": before, "after": before, "after_ci": [before, before], "shrink": 0.0},
        "gap_recalibrated": {"before": before * (1.0 - recalibrated)},
        "flexible": {"closable_shrink": flexible, "before": before, "after": 0.1, "swing_s": None},
        "effects": [],
        "moved": [],
        "candidates": candidates,
        "probability_none": 0.9 if verdict == "none" else 0.0,
        "probability_unknown": 0.9 if verdict == "unknown" else 0.0,
        "where": {"stage": "transmission", "conditions": [{"axis": "speed", "says": "when fast"}]},
        "signature": "largest when fast" if verdict == "unknown" else None,
        "next_motion": None,
    }


CASES = list(itertools.product(("unknown", "none"), (0.0, 0.06, 0.3, 0.98), (0.0, 0.06, 0.3, 0.98), (0.15, 0.25, 4.0)))


@pytest.mark.parametrize("case", CASES, ids=str)
def test_nothing_closes_what_no_effect_explains(case):
    made = document(*case)
    said = narration.text(made, "out")
    stages = " ".join(stage["says"] for stage in page._chain(made))
    shares = [int(share) for share in CLOSES.findall(f"{said} {stages}")]
    if UNEXPLAINED in said or made["verdict"] == "none":
        assert not shares, (said, stages)
    elif max(case[1:3]) > 0.9:
        assert 98 in shares and "leaves what" in said


def test_every_case_of_the_contradiction_is_met():
    said = [narration.text(document(*case), "out") for case in CASES]
    assert any(UNEXPLAINED in text for text in said) and any("comes nearest" in text for text in said)
    assert any("refitting B" in text for text in said) and any("Nothing large" in text for text in said)
