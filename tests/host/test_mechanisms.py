"""A fixed slice of the blind campaign on mechanisms whose equations the library does not share: an effect in turn on
each of them, something outside of the library, and nothing. docs/blindtest.md has the campaign."""

import json

import pytest

from tools.blindtest import scores, work
from tools.blindtest.cases import Label
from tools.blindtest.generators import GENERATORS

MECHANISMS = [name for name in GENERATORS if name.startswith("mujoco.")]
SEED = 77  # for tuning, as all below 1 000 000
SINGLES = 3  # of each mechanism


def slice_of(mechanism: str) -> list[tuple[int, str, tuple[str, ...]]]:
    at, made = MECHANISMS.index(mechanism), GENERATORS[mechanism]
    singles = [(SEED, "single", (name,)) for name in made.known[at :: len(MECHANISMS)]][:SINGLES]
    other = (SEED, "none", ()) if at % 2 else (SEED, "unknown", (made.unknown[at // 2 % len(made.unknown)],))
    return [*singles, other]


def test_the_slice_has_most_effects_and_both_other_answers():
    cases = [case for name in MECHANISMS for case in slice_of(name)]
    assert len({case[2] for case in cases if case[1] == "single"}) >= 12
    assert {case[1] for case in cases} == {"single", "unknown", "none"}


SLICE = ("mujoco.arm",)  # the others by ./run test long


@pytest.mark.parametrize(
    "mechanism", [each if each in SLICE else pytest.param(each, marks=pytest.mark.long) for each in MECHANISMS]
)
def test_what_a_mechanism_has_is_named(mechanism):
    """Of four cases one may be wrong; nothing that is named makes an unseen motion worse."""
    pytest.importorskip("mujoco", reason="the package mujoco is not installed")
    said = []
    for seed, kind, chosen in slice_of(mechanism):
        visible, opened = work.make_case(seed, kind, chosen, "salt", mechanism)
        record = work.score_case(visible, opened, work.diagnose_case(visible))
        assert record["document"]["verdict"] != scores.FAILED, record["document"]
        label, answer = Label.from_json(record["label"]), scores.answer_of(record)
        if scores.counts(label):
            said.append((label, answer))
    found = scores.score(said)
    wrong = [(label.effects, answer.verdict) for label, answer in said if answer.verdict != scores.truth(label)]
    assert len(said) >= 3 and len(wrong) <= 1, wrong
    assert found.worse.hits == 0, json.dumps(found.to_json())
