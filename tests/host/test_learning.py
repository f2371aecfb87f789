"""Learning how hypotheses behave: from evidence alone, in the direction that the evidence says."""

import json
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
import pytest

from tautline.diagnosis import gap
from tautline.diagnosis.decide import Decision, decide
from tautline.diagnosis.hyperparameters import NAMES, Hyperparameters, Learnt, learnt
from tautline.diagnosis.hypotheses import Beyond, CaseEvidence, Weighed
from tautline.diagnosis.repeated import HELD
from tautline.diagnosis.stacked import Stacked
from tautline.plain import plain
from tools import learning
from tools.blindtest.cases import Label

BLOCKS = 20
LAG, CREEP = "transmission.lag", "transmission.creep"


def case(generator: str, truth: str, seed: int, left: float = 0.01, excess: float = 0.0) -> learning.Case:
    """Lag leaves this share of a gap, creep nearly all; with nothing wrong the calibration leaves `excess`."""
    rng = np.random.default_rng(seed)
    gap = 0.0 if truth == "none" else 100.0
    unlike = np.exp(0.1 * rng.normal(size=BLOCKS))
    none = np.zeros(BLOCKS)

    def power(share: float) -> np.ndarray:
        return (1.0 + excess + share * gap) * unlike

    hypotheses = [Weighed((), power(1.0), none, none, 0)]
    hypotheses += [Weighed((name,), power(s), none, none, 2) for name, s in ((LAG, left), (CREEP, 0.8))]
    return learning.Case(generator, truth, CaseEvidence(1.0, power(1.0), tuple(hypotheses), 18))


def loss(cases: list[learning.Case], by: Learnt) -> float:
    said = [learning.probability(c, decide(c.evidence, by)) for c in cases]
    return float(-np.mean(np.log(np.array(said) + 1e-3)))


def test_a_generator_whose_right_effects_leave_more_teaches_so():
    """Right effects that leave 25 % are unknown to what it starts from."""
    cases = [case("a", LAG, i, left=0.25) for i in range(6)] + [case("a", "none", 10 + i, excess=0.5) for i in range(6)]
    before = Learnt(learning.START, 0.95)
    found = learning.learn(cases)
    assert found.center.unexplained > learning.START.unexplained
    assert found.center.calibration_excess > learning.START.calibration_excess
    assert loss(cases, found) < 0.8 * loss(cases, before)


def test_each_sort_of_case_weighs_the_same_however_many_there_are():
    cases = [case("a", "none", i) for i in range(9)] + [case("a", LAG, i) for i in range(3)]
    weight = learning.weights_of(cases)
    assert weight.sum() == pytest.approx(len(cases))
    assert weight[:9].sum() / weight.sum() == pytest.approx(0.25 / 0.75)


def test_a_set_holds_what_it_must_to_be_right_in_95_of_100():
    """Where the truth is now and then behind others with 0.6 of the probability, so much and no more is held."""
    rare, usual = ({LAG: 0.4, CREEP: 0.6}, {LAG: 0.9, CREEP: 0.1})
    said = []
    for i in range(100):
        leading = rare if i < 8 else usual
        said.append((case("a", LAG, 0), Decision(0.0, 0.0, leading, np.zeros(3), (LAG,), (1.0,), 1)))
    covers = learning.conformal(said)
    assert 0.6 < covers < 0.7
    held = [truth.truth in verdict.ambiguous(covers) for truth, verdict in said]
    assert np.mean(held) >= 0.95
    assert learning.conformal(said[8:]) < 0.1
    unknown = Decision(0.0, 0.9, {LAG: 0.02, CREEP: 0.08}, np.zeros(3), (CREEP,), (0.8,), 1)
    assert learning.conformal([*said[8:], *[(case("a", LAG, 0), unknown)] * 50]) < 0.1  # no set is told


def test_an_interval_learnt_on_others_covers_what_a_further_motion_leaves():
    """Generators weigh the same, however many cases they have."""
    rng = np.random.default_rng(4)

    def drawn(generator: str, many: int, wide: float) -> list[learning.Claim]:
        left = rng.uniform(0.01, 0.3, many)
        realised = left + (left + 0.05) * (1.0 - left) * wide * rng.standard_normal(many)
        return [learning.Claim(generator, gap.normalised_excess(a, b)) for a, b in zip(left, realised, strict=True)]

    low, high = learning.elsewhere([*drawn("a", 900, 0.1), *drawn("b", 300, 0.5)])
    fresh = [*drawn("a", 500, 0.1), *drawn("b", 500, 0.5)]
    assert 0.87 < np.mean([low <= claim.apart <= high for claim in fresh]) < 0.93
    few = learning.elsewhere(drawn("a", 10, 0.1))
    left = 0.1
    shrinks = gap.shrink_interval_elsewhere(left, few)
    assert shrinks[0] < 1.0 - left < shrinks[1] <= 1.0
    assert gap.normalised_excess(left, 1.0 - shrinks[0]) == pytest.approx(few[1])


def test_what_is_learnt_survives_its_file():
    import tomllib

    drawn = replace(learnt(), elsewhere=(-0.2, 1.5), later=(0.1, 3.0))
    read = Learnt.of_toml(tomllib.loads(drawn.to_toml({"a": 3})))
    assert (read.elsewhere, read.later) == (drawn.elsewhere, drawn.later)
    assert read.center == drawn.center and read.covers == drawn.covers


def test_a_share_stays_one_however_far_learning_goes():
    assert Hyperparameters.of_logarithms(learnt().center.logarithms() + 50.0).mimics < 1.0


@pytest.mark.parametrize(("truth", "stands_in"), [(LAG, ""), ("unknown", ""), ("unknown", CREEP)])
def test_slopes_are_those_of_what_is_decided_afresh(truth, stands_in):
    """What is remembered from one setting of hyperparameters must not answer for another."""
    one = replace(case("a", truth, 3, left=0.2), stands_in=stands_in)
    beyond = Beyond(1.4 * one.evidence.hypotheses[0].power / 101.0, np.full(BLOCKS, 50.0))
    weighed = tuple(replace(h, beyond=beyond if h.ids else None) for h in one.evidence.hypotheses)
    one = replace(one, evidence=replace(one.evidence, hypotheses=weighed))
    at = learning.START.logarithms() + 0.2
    stacked = Stacked(one.evidence)
    told = learning._slopes(one, stacked, at)
    learning._slopes(one, stacked, at - 0.4)
    np.testing.assert_array_equal(learning._slopes(one, stacked, at), told)

    def afresh(logarithms: np.ndarray) -> float:
        known = Learnt(Hyperparameters.of_logarithms(logarithms), 0.95)
        said = learning.probability(one, decide(one.evidence, known))
        return -float(np.log(0.99 * said + 0.01))

    assert told[0] == pytest.approx(afresh(at), abs=1e-9)
    by_step = [(afresh(at + 0.02 * step) - afresh(at)) / 0.02 for step in np.eye(len(NAMES))]
    np.testing.assert_allclose(told[1:], by_step, atol=1e-9)
    assert np.count_nonzero(np.abs(told[1:]) > 1e-6) > 8


def test_several_processes_learn_what_one_does():
    cases = [case(name, LAG, i, left=0.2) for i in range(2) for name in "ab"]
    one, two = learning.learn(cases), learning.learn(cases, jobs=2)
    assert one.center == two.center


def test_what_a_recalibration_moved_is_the_answer_where_nothing_known_explains():
    unknown = replace(case("a", "transmission.backlash", 1), moved=(("transmission.backlash", 1.0),))
    worse = tuple(replace(h, power=unknown.evidence.hypotheses[0].power) for h in unknown.evidence.hypotheses)
    unknown = replace(unknown, evidence=replace(unknown.evidence, hypotheses=worse))
    started = Learnt(learning.START, 0.95)
    before = decide(unknown.evidence, started)
    assert before.name == "unknown"
    verdict = learning.verdict_of(unknown, started)
    assert verdict.named == ("transmission.backlash",)
    taken = before.leading.get("transmission.backlash", 0.0) + before.unknown * (1.0 - learning.START.mimics)
    assert learning.probability(unknown, verdict) == pytest.approx(taken, rel=1e-9)


def test_a_campaign_teaches_what_its_evidence_decided(tmp_path):
    """Not a pair, nor repeats that were counted: those are known without any."""
    held = {"id": HELD, "probability": 0.98, "parameters": {"held_share": 0.3}}
    given = {"a": ("single", (LAG,), []), "b": ("pair", (LAG, CREEP), []), "c": ("single", (HELD,), [held])}
    for name, (kind, ids, effects) in given.items():
        label = Label(kind, ids, 7, False, {}, 1.0, (9.0,) * len(ids))
        document = {"gap": {"before": 10.0}, "gap_recalibrated": {"before": 9.0}, "noise_floor": 1.0}
        files = {
            f"sealed/{name}/label.json": {"label": label.to_json()},
            f"diagnoses/{name}/diagnosis.json": {**document, "effects": effects, "moved": []},
            f"diagnoses/{name}/evidence.json": case("second", LAG, 1).evidence.to_json(),
        }
        for path, content in files.items():
            (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / path).write_text(json.dumps(plain(content)))
    assert [(c.generator, c.truth) for c in learning.load([tmp_path])] == [("second", LAG)]
    scored = tmp_path / "sealed" / "a" / "label.json"
    scored.write_text(scored.read_text().replace('"seed": 7', '"seed": 1000000'))
    with pytest.raises(click.ClickException, match="scored"):
        learning.load([tmp_path])


def _left_out_campaign(folder: Path, named: list[str], after: float) -> None:
    """One case, diagnosed by a library that lacks its effect; `after`: what is left of an unseen motion, noise 1."""
    label = Label("single", (CREEP,), 7, False, {}, 1.0, (9.0,))
    document = {"gap": {"before": 10.0}, "gap_recalibrated": {"before": 9.0}, "noise_floor": 1.0}
    line = {"name": "a", "kind": "left out", "named": named, "realised": {"before": 9.0, "after": after, "floor": 1.0}}
    files = {
        "sealed/a/label.json": {"label": label.to_json()},
        "without/a/diagnosis.json": {**document, "effects": [], "moved": []},
        "without/a/evidence.json": case("second", LAG, 1).evidence.to_json(),
        "result.json": {"each": [line]},
    }
    (folder / "diagnoses").mkdir()
    for path, content in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(json.dumps(plain(content)))


@pytest.mark.parametrize(
    ("named", "after", "right"), [([LAG], 1.2, {LAG, "unknown"}), ([LAG], 4.0, {"unknown"}), ([], 1.0, {"unknown"})]
)
def test_what_a_library_says_that_lacks_the_effect_is_learnt_from(tmp_path, named, after, right):
    """Unknown is right, and an effect that foretells an unseen motion to 1.3 times the noise is too."""
    _left_out_campaign(tmp_path, named, after)
    (one,) = learning.load([tmp_path])
    assert one.left_out and one.truth == "unknown"
    verdict = decide(one.evidence)
    assert verdict.name == "effect" and verdict.named == (LAG,)
    told = {LAG: verdict.leading[LAG], "unknown": verdict.unknown}
    assert learning.probability(one, verdict) == pytest.approx(sum(told[name] for name in right))
    *_, good, sure, _, _ = learning.row("all", [(one, verdict)], 0.95)
    assert good == ("100 % of 1" if LAG in right else "0 % of 1")
    assert sure == ("0 % of 1" if LAG in right or told[LAG] < 0.9 else "100 % of 1")


def family_case(
    family: Path, name: str, verdict: str, causes: list[str], one: learning.Case, **document: object
) -> None:
    """Files of a family's case and of what was said of it; the unseen motion's gap of 10 px shrinks to 1."""
    said = family / "diagnoses" / name
    said.mkdir(parents=True)
    (said / "evidence.json").write_text(json.dumps(plain(one.evidence.to_json())))
    of_all = {"verdict": verdict, "effects": [], "moved": [], "noise_floor": 1.0, "gap": {"before": 10.0, "after": 2.0}}
    of_all["gap_recalibrated"] = {"before": 10.0}
    (said / "diagnosis.json").write_text(json.dumps({**of_all, **document}))
    truth = {"verdict": verdict, "causes": [{"id": c} for c in causes], "mechanism": "m", "noise": 1.0}
    (family / "truth").mkdir(exist_ok=True)
    (family / "truth" / f"{name}.json").write_text(json.dumps({**truth, "unseen_valid_from_s": 0.5}))
    for path, value in (
        (family / "truth" / f"{name}-unseen.csv", 0.0),
        (said / "nominal.csv", 10.0),
        (said / "corrected.csv", 1.0),
    ):
        path.write_text(f"t_s,c_deg\n0,99\n1,{value}\n2,{value}\n")


def test_a_familys_cases_teach_what_a_campaigns_do(tmp_path):
    """Pairs do not, nor a cause that the calibrated model holds already."""
    family = tmp_path / "family_x"
    lag = [{"id": LAG}]
    family_case(family, "case-000", "effect", [LAG], case("a", LAG, 1), effects=lag)
    family_case(family, "case-001", "none", [], case("a", "none", 2))
    family_case(family, "case-002", "effect", [LAG, CREEP], case("a", LAG, 3), effects=lag)
    family_case(family, "case-003", "effect", [LAG], case("a", "none", 4))
    family_case(family, "case-004", "unknown", ["felt"], case("a", LAG, 5))
    cases = learning.load([family])
    assert [(c.generator, c.truth) for c in cases] == [
        ("family_x.m", LAG),
        ("family_x.m", "none"),
        ("family_x.m", "unknown"),
    ]
    (claim,) = learning.claims([family])
    assert claim == learning.Claim("family_x.m", gap.normalised_excess(0.2, 0.1), "elsewhere")
