"""What a diagnosis says never contradicts itself."""

import itertools
import re
from pathlib import Path

import numpy as np
import pytest
from reference_instrument import PLANT, RIG

from tautline.diagnosis import narration, page
from tautline.model import Model
from tautline.reports import pages

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


def explained(shrink: float, above: float) -> dict[str, object]:
    effect = {
        "id": "transmission.backlash", "probability": 0.9, "since": "start", "shrink": shrink, "ambiguous_with": [],
        "parameters": {"width_scale": -0.367}, "loads_on_board": True, "swallowed_by_recalibration": False,
    }  # fmt: skip
    made = document("effect", shrink, 0.0, 1.0)
    after = {"after": 1.0 - shrink, "after_ci": [0.1, 0.2], "shrink": shrink, "shrink_ci": [0.6, 0.9]}
    return {**made, "effects": [effect], "gap": {**made["gap"], **after, "closable_shrink": above}}


def test_a_shrinkage_and_what_is_closed_above_the_noise_are_told_as_two_things():
    assert "shrinks by 88 %" in narration.sentence(explained(0.88, 1.0))
    assert "to 0.12, 100 % of its power above the noise; on another" in narration.sentence(explained(0.88, 1.0))
    assert "above the noise" not in narration.sentence(explained(0.97, 0.99))


def test_a_second_effect_may_be_one_of_several():
    made = explained(0.88, 1.0)
    others = ["acquisition.delay", "transmission.lag"]
    made["effects"].append({**made["effects"][0], "id": "transmission.creep", "probability": 0.4, "ambiguous_with": []})
    assert "or else" not in narration.sentence(made)
    made["effects"][1]["ambiguous_with"] = others
    assert "(transmission.creep, 40 % sure, or else acquisition.delay or transmission.lag)" in narration.sentence(made)


def test_a_width_is_told_in_the_motors_unit():
    q = np.linspace(-5.0, 5.0, 101)
    models = [Model(RIG, q, np.full(101, b), 0.01 + 0 * q, PLANT.bend(q), 0.08, (-4.0, 4.0)) for b in (0.4, 0.253)]
    width = page.width_now(*models)
    document = explained(0.88, 1.0)
    (row,) = page._parameter_rows(document, document["effects"][0], "mm", width)
    assert (row["name"], row["value"]) == ("B is now", "0.253 mm in the mean, it was 0.4")


def test_the_page_explains_what_it_names_and_is_not_contradicted_by_its_numbers():
    text = (Path(pages.__file__).parent / "templates" / "diagnosis.html").read_text()
    assert "nothing gets below" not in text and "<code>taut explain" not in text and "topic.mend" in text


def test_why_an_unknown_cause_is_not_what_it_resembles():
    made = document("unknown", 0.97, 0.0, 4.0)
    assert "comes nearest and would close 97 %, but leaves what it could not" in narration.sentence(made)
    made["resembles"] = [{"id": NAMES[0], "closes": 0.97, "says": "30 ms when slow, 80 ms when fast"}]
    said = narration.sentence(made)
    assert "would close 97 %, but would be another law elsewhere (30 ms when slow, 80 ms when fast)" in said


@pytest.mark.parametrize(
    ("value", "said"), [(1234.4, "1234"), (999.6, "1000"), (-45.678, "-45.7"), (0.0, "0"), (4.2e-4, "0.000420")]
)
def test_a_number_has_no_exponent(value: float, said: str) -> None:
    assert narration.digits(value) == said


def test_a_gap_that_is_gone_is_said_to_close():
    assert "with it in the model the gap closes, from 1 deg rms to 0.001" in narration.sentence(explained(0.999, 1.0))


def test_a_command_takes_a_folder_with_a_space():
    commands = [step.command for step in narration.steps(explained(0.88, 1.0), "my robot")]
    assert "taut flash 'my robot'/corrected" in commands and not any(" my robot/" in c for c in commands)


def board_of(*effects: tuple[str, bool]) -> narration.NextStep:
    """Of effects (id, whether a board loads it)."""
    return narration.board([{"id": name, "loads_on_board": loads} for name, loads in effects], "out")


def test_of_what_no_table_undoes_a_rest_is_told_only_if_there_is_one():
    contact, lag = ("configuration.contact", False), ("transmission.lag", True)
    assert "the rest of what was named they do" in board_of(lag, contact).says
    assert "rest of what was named" not in board_of(contact).says
    assert board_of(contact).command == "taut flash out/corrected --without-effects"


def test_an_axis_that_couples_in_is_asked_for_beside_what_no_table_undoes():
    said = board_of(("configuration.axis_coupling", True), ("configuration.contact", False))
    assert said.command == "taut flash out/corrected --joint COLUMN=AXIS:RESOLUTION --without-effects"


def test_no_share_is_less_than_nothing():
    assert narration.percent(-0.001) == "0 %" and narration.percent(0.125) == "12 %"
    made = explained(0.88, 1.0)
    made["gap"]["shrink_ci"] = [-0.002, 0.9]
    assert "expect 0 to 90 %" in narration.sentence(made)


def test_of_a_simulator_nothing_is_another_since_its_calibration():
    made = explained(0.88, 1.0)
    made["effects"][0]["since"] = "calibration"
    simulated = {**made, "simulator": {"parameters": []}}
    assert "since the calibration" in narration.sentence(made)
    assert "since the calibration" not in narration.sentence(simulated)
    assert page._parameter_rows(simulated, made["effects"][0], "mm", "")[0]["since"] == ""
