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


def said_of(cases, mechanism):
    """(label, answer) of those that count."""
    said = []
    for seed, kind, chosen in cases:
        visible, opened = work.make_case(seed, kind, chosen, "salt", mechanism)
        record = work.score_case(visible, opened, work.diagnose_case(visible))
        assert record["document"]["verdict"] != scores.FAILED, record["document"]
        label, answer = Label.from_json(record["label"]), scores.answer_of(record)
        if scores.counts(label):
            said.append((label, answer))
    return said


def wrong_of(said):
    return [(label.effects, answer.verdict) for label, answer in said if answer.verdict != scores.truth(label)]


@pytest.mark.long
@pytest.mark.parametrize("mechanism", MECHANISMS)
def test_what_a_mechanism_has_is_named(mechanism):
    """Of four cases one may be wrong; nothing that is named makes an unseen motion worse."""
    pytest.importorskip("mujoco", reason="the package mujoco is not installed")
    said = said_of(slice_of(mechanism), mechanism)
    found = scores.score(said)
    assert len(said) >= 3 and len(wrong_of(said)) <= 1, wrong_of(said)
    assert found.worse.hits == 0, json.dumps(found.to_json())


def test_a_mechanisms_first_effect_and_what_no_library_holds_are_told():
    """Of the arm; the others, and all four of its cases, by ./run test long."""
    pytest.importorskip("mujoco", reason="the package mujoco is not installed")
    first, *_, other = slice_of("mujoco.arm")
    said = said_of([first, other], "mujoco.arm")
    assert len(said) == 2 and wrong_of(said) == []
    assert scores.score(said).worse.hits == 0
