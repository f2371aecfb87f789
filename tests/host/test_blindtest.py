"""taut blindtest: labels stay sealed until all diagnoses are written, nothing changes unseen, scores are right."""

import functools
import json
import os
import signal
import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from slices import some

from tautline.calibration.calibrate import calibrate
from tautline.errors import TautError
from tautline.pool import pool
from tautline.recording import load_all
from tautline.rig import Rig
from tests.host.test_diagnose import true_model
from tools.blindtest import baselines, campaign, compare, page, scores, sealed, work
from tools.blindtest.campaign import Order
from tools.blindtest.cases import Label, make
from tools.blindtest.generators import SECOND
from tools.blindtest.scores import Answer, Share

LAG, CREEP, DRIFT = "transmission.lag", "transmission.creep", "transmission.drift"


def label(kind: str, *effects: str, left: float = 1.0) -> Label:
    return Label(kind, effects, 5, True, {}, 0.05, (left,) * len(effects))


def said(verdict: str, *named: str, p: float = 0.8, **others) -> Answer:
    return Answer(named, verdict, 2.0, frozenset(named), {verdict: p}, **others)


def test_shares_have_exact_binomial_intervals():
    # Clopper and Pearson's for 8 of 10, and the closed form where none or all are right: 1 - 0.025^(1/n).
    assert Share(8, 10).interval == pytest.approx((0.4439, 0.9748), abs=1e-4)
    assert Share(0, 30).interval == pytest.approx((0.0, 1 - 0.025 ** (1 / 30)))
    assert Share(30, 30).interval == pytest.approx((0.025 ** (1 / 30), 1.0))
    assert Share(0, 0).value is None and Share(0, 0).interval == (0.0, 1.0)


def test_a_small_campaign_is_scored_as_counted_by_hand():
    gap = {"before": 1.0, "after": 0.1, "floor": 0.05}
    ambiguous = Answer(
        (CREEP,), CREEP, 4.0, frozenset({CREEP, LAG}), {CREEP: 0.6, LAG: 0.4}, "transmission", 0.8, (0.7, 0.95), gap
    )
    cases = [
        (label("single", LAG), said(LAG, LAG, stage="transmission", claimed=0.95, interval=(0.8, 0.89), realised=gap)),
        (label("single", LAG), ambiguous),  # wrong name, right set, right stage
        (label("single", LAG, left=0.01), said("none")),  # too weak to be seen: not scored
        (label("single", CREEP), said("unknown", stage="camera")),
        (label("unknown", "zoom"), said("unknown")),
        (label("unknown", "zoom"), said(LAG, LAG)),
        (label("none"), said("none")),
        (label("pair", LAG, CREEP), said(CREEP, CREEP, LAG)),
        (label("pair", LAG, CREEP), said(CREEP, CREEP)),
        (label("left out", LAG), said("unknown")),
        (label("triple", LAG, CREEP, DRIFT), said(LAG, LAG, CREEP, brought=frozenset({DRIFT}))),
        (label("triple", LAG, CREEP, DRIFT), said(LAG, LAG, CREEP, DRIFT)),
    ]
    found = scores.score(cases)
    assert (found.triples, found.triples_covered) == (Share(1, 2), Share(2, 2))
    assert (found.top1, found.in_set, found.stage) == (Share(1, 3), Share(2, 3), Share(2, 3))
    assert found.per_effect == {LAG: Share(1, 2), CREEP: Share(0, 1)}
    assert found.set_size == pytest.approx(1.5)
    assert (found.unknown, found.false_known) == (Share(1, 2), Share(1, 2))
    assert (found.none, found.false_alarm) == (Share(1, 1), Share(0, 1))
    assert (found.pairs, found.pairs_one, found.left_out) == (Share(1, 2), Share(2, 2), Share(1, 1))
    assert found.overall == Share(3, 6)
    assert found.probability == pytest.approx((0.8 + 0.4 + 0.0 + 0.8 + 0.0 + 0.8) / 6)
    # Realised 90 %, of what could be closed (1 - 0.01 + 0.0025 - 0.0025) / (1 - 0.0025).
    assert found.claim == pytest.approx((5.0 - 10.0) / 2) and found.claim_size == pytest.approx(7.5)
    assert found.closed == pytest.approx((1 - 0.01) / (1 - 0.0025))
    assert found.closed_90 == Share(2, 2)
    assert found.covered == Share(1, 2) and found.worse == Share(0, 2) and found.several == Share(0, 2)
    assert found.core_s == pytest.approx((10 * 2.0 + 4.0) / 11)
    assert found.by_strength == {"above 20 times the noise": Share(1, 3)}  # left 1.0 at a noise of 0.05
    least = np.log(1e-4)  # the unlikeliest that is told apart
    logs = [np.log(0.8), np.log(0.4), least, np.log(0.8), least, np.log(0.8)]
    assert found.log_score == pytest.approx(np.mean(logs))
    rows, columns, counts = scores.confusion(cases)
    assert rows == [LAG, CREEP, "zoom", "none"]
    assert counts[0, columns.index(LAG)] == 1 and counts[0, columns.index(CREEP)] == 1
    assert counts[2, columns.index("unknown")] == 1 and counts.sum() == 6
    rows, columns, counts = scores.confusion([*cases, (label("unknown", "heartbeat"), said("unknown"))])
    assert rows == [LAG, CREEP, "zoom", "heartbeat", "none"]  # a generator's own
    assert counts[3, columns.index("unknown")] == 1 and counts.sum() == 7
    slip = "transmission.slip"  # no case is made of it, and a campaign ended in an internal error where it was named
    _, columns, counts = scores.confusion([*cases, (label("single", LAG), said(slip, slip))])
    assert counts[0, columns.index(slip)] == 1 and counts.sum() == 7


def test_scores_by_how_much_a_recalibration_leaves():
    lefts = {"2 to 5 times the noise": (0.11, 0.24), "5 to 20 times the noise": (0.26, 0.9)}
    for name, ends in lefts.items():
        cases = [(label("single", LAG, left=left), said(LAG, LAG)) for left in ends]
        assert scores.score(cases).by_strength == {name: Share(2, 2)}


def test_a_cause_outside_of_the_library_may_be_stood_for():
    """By at most three names whose corrected model leaves 1.3 times the noise on a motion that it never saw."""

    def on_unseen(after: float) -> dict[str, float]:
        return {"before": 1.0, "after": after, "floor": 0.05}

    stands, not_close = said(CREEP, CREEP, realised=on_unseen(0.06)), said(CREEP, CREEP, realised=on_unseen(0.07))
    many = replace(stands, possible=frozenset({CREEP, "a", "b", "c"}))
    sure = said(CREEP, CREEP, p=0.95, realised=on_unseen(0.07))
    told = [said("unknown"), stands, not_close, many, sure, said("none", p=0.99)]
    found = scores.score([(label("left out", LAG), answer) for answer in told])
    assert found.left_out == Share(1, 6) and found.stood_for == Share(2, 6) and found.left_out_sure == Share(1, 6)


def test_claims_and_probabilities_of_all_that_is_named():
    gap = {"before": 1.0, "after": 0.1, "floor": 0.05}
    pair = said(LAG, LAG, CREEP, claimed=0.8, interval=(0.85, 0.95), realised=gap, present=(0.9, 0.7))
    wrong = said(LAG, LAG, CREEP, claimed=0.7, interval=(0.6, 0.8), realised=gap, present=(0.9, 0.7))
    found = scores.score([(label("pair", LAG, CREEP), pair), (label("unknown", "zoom"), wrong)])
    assert found.claim is None and found.claim_all == pytest.approx(15.0) and found.covered_all == Share(1, 2)
    assert found.further_error == pytest.approx(0.2)  # 70 % stated, one of two there
    again = scores.from_json(json.loads(json.dumps(scores.to_json(pair))))
    assert again == pair


def test_what_was_claimed_is_held_against_a_motion_that_shows_something():
    """An obstacle that the further motion never meets leaves nothing to close; noise is not worse than noise."""
    nothing, worse = {"before": 0.06, "after": 0.07, "floor": 0.05}, {"before": 0.06, "after": 0.2, "floor": 0.05}
    met = said(LAG, LAG, claimed=0.9, interval=(0.6, 0.95), realised={"before": 1.0, "after": 0.2, "floor": 0.05})
    told = [met, *(said(LAG, LAG, CREEP, claimed=0.9, interval=(0.6, 0.95), realised=r) for r in (nothing, worse))]
    found = scores.score([(label("single", LAG), answer) for answer in told])
    assert found.claim == pytest.approx(10.0) and found.covered == Share(1, 1)
    assert found.worse == Share(1, 3) and found.several == Share(2, 3)


def test_probabilities_that_are_right_as_often_as_they_say_have_no_calibration_error():
    rng = np.random.default_rng(1)

    def campaign_of(bias: float):
        for p in rng.uniform(0.5, 0.99, 4000):
            right = rng.random() < p - bias
            yield label("none"), said("none" if right else "unknown", p=p)

    honest, boastful = (scores.score(list(campaign_of(bias))) for bias in (0.0, 0.2))
    assert honest.calibration_error < 0.03
    assert boastful.calibration_error == pytest.approx(0.2, abs=0.03)


def test_a_pair_is_covered_by_what_is_named_brought_or_one_of_three():
    pair = label("pair", LAG, CREEP)
    others = {"transmission.offset", "configuration.swing"}

    def one_of(*alternatives: str) -> Answer:
        return replace(said(LAG, LAG), possible=frozenset({LAG, *alternatives}))

    assert scores.covers(pair, said(LAG, LAG, CREEP)) and scores.covers(pair, replace(said(LAG, LAG), brought={CREEP}))
    assert scores.covers(pair, one_of(CREEP, DRIFT)) and not scores.covers(pair, one_of(DRIFT, *others))
    assert not scores.covers(pair, one_of(CREEP, *others))  # of four one is there: that says little


def test_an_order_lists_its_cases_and_names_their_seeds():
    order = Order(seed=50, single=2, unknown=3, none=1, pairs=1, triples=1)
    cases = order.cases()
    assert len(cases) == 25 * 2 + 3 + 1 + 1 + 1 and (50, "triple", (), SECOND) in cases
    assert (51, "single", (LAG,), SECOND) in cases and (50, "none", (), SECOND) in cases
    assert Order(seed=9, single=1, only=(LAG, "zoom")).cases() == [
        (9, "single", (LAG,), SECOND),
        (9, "unknown", ("zoom",), SECOND),
    ]


@given(
    st.lists(st.sampled_from([("single", (LAG,)), ("single", (CREEP,)), ("none", ()), ("pair", ())]), max_size=80),
    st.integers(0, 1000),
)
def test_every_beginning_of_a_campaign_has_its_share_of_each_sort(sorts, seed):
    cases = [(i, *sort) for i, sort in enumerate(sorts)]
    mixed = campaign.interleaved(cases, np.random.default_rng(seed))
    assert sorted(mixed) == sorted(cases)
    for sort in set(sorts):
        mine = [case for case in mixed if case[1:] == sort]
        assert mine == sorted(mine)
        for length in range(len(mixed) + 1):
            # Within one of its share, as is each other sort: that many cases may lie between.
            expected = len(mine) * length / len(mixed)
            there = sum(case[1:] == sort for case in mixed[:length])
            assert abs(there - expected) <= 1 + len(set(sorts)) * len(mine) / len(mixed)


def test_baselines_answer_every_so_manyth_scored_case_of_each_sort():
    labels = [label("single", LAG)] * 5 + [label("single", LAG, left=0.01)] + [label("single", CREEP)] * 2
    labels += [label("pair", LAG, CREEP), label("pair", CREEP, LAG), label("none")]
    records = [{"name": str(i), "label": each.to_json()} for i, each in enumerate(labels)]
    assert compare.subset(records, 2) == ["0", "2", "4", "6", "8", "10"]
    assert compare.subset(records, 1) == [str(i) for i in range(11) if i != 5]


def test_methods_are_compared_case_by_case():
    gap = {"before": 1.0, "after": 0.1, "floor": 0.05}
    shrunk = Answer((), "failed", 1.0, claimed=0.5, realised={**gap, "after": 0.5}, names=False)
    right, wrong = said(LAG, LAG, realised=gap), said(CREEP, CREEP, realised={**gap, "after": 0.05})
    cases = [(label("single", LAG), right, wrong)] * 6 + [(label("single", LAG), wrong, right)]
    cases += [(label("none"), said("none"), said("none")), (label("none"), said("none"), said("unknown"))]
    cases += [(label("pair", LAG, CREEP), right, wrong), (label("single", LAG, left=0.01), right, wrong)]
    found = scores.paired(cases)
    assert (found["verdicts"].ours, found["verdicts"].theirs) == (7, 1)
    assert found["verdicts"].p == pytest.approx(2 * (1 + 8) / 2**8)  # both tails of eight fair coins
    assert (found["closed"].ours, found["closed"].theirs) == (1, 6)
    only_shrinks = scores.paired([(label("single", LAG), right, shrunk), (label("none"), said("none"), shrunk)])
    assert set(only_shrinks) == {"closed"} and only_shrinks["closed"].ours == 1
    assert scores.Paired(0, 0).p == 1.0


def stub(files, left_out=()):
    """A diagnosis that finds nothing, at once."""
    document = {
        "verdict": "unknown" if left_out else "none",
        "effects": [],
        "candidates": [{"id": LAG, "probability": 0.1}],
        "probability_none": 0.9,
        "probability_unknown": 0.0,
        "noise_floor": 0.05,
        "where": {"stage": None},
        "gap": {"before": 0.05, "after": 0.05, "shrink": 0.0, "shrink_ci": [0.0, 0.0]},
    }
    cost = {"core_s": 0.1, "calibration_core_s": 0.0}
    return {work.DOCUMENT: sealed.canonical(document), work.COST: sealed.canonical(cost), **MODELS}


MODELS: dict[str, bytes] = {}
made_once = functools.cache(make)


@pytest.fixture
def stubbed(monkeypatch, tmp_path):
    for name in ("nominal", "corrected"):
        true_model().save(tmp_path / "models" / name)
    MODELS.update(sealed.read(tmp_path / "models"))
    monkeypatch.setattr(work, "diagnose_case", stub)
    monkeypatch.setattr(work, "make", made_once)


ORDER = Order(seed=40, single=1, none=1, leave_one_out=1, only=(LAG, "none"))


def conduct(folder, order=ORDER, progress=lambda fraction, text: None):
    with pool(1, None) as here:
        records = campaign.run(order, folder, here, progress)
        return records + campaign.left_out(order, folder, records, here, progress)


def test_what_a_diagnosis_sees_does_not_tell_the_label(tmp_path, stubbed):
    records = conduct(tmp_path / "out")
    assert [r["label"]["kind"] for r in records].count("left out") == 1
    assert {r["label"]["kind"] for r in records} == {"single", "none", "left out"}
    for case in (tmp_path / "out" / "cases").iterdir():
        files = sealed.read(case)
        assert set(files) == {"rig.toml"} | {
            f"{folder}/{name}.csv" for folder in ("calibration", "test-1", "test-2") for name in ("motor", "marker")
        }
        for content in files.values():
            assert b"lag" not in content and b"dashpot" not in content and b"seed" not in content
        paths = [case / name for name in ("calibration", "test-1", "test-2")]
        recordings = load_all(paths, Rig.load(case / "rig.toml"))
        assert all(r.warnings == () for r in recordings)


@pytest.mark.parametrize(
    "what",
    some(
        ["sealed/case-0000/label.json", "diagnoses/case-0001/diagnosis.json", "sealed/case-0000/further/marker.csv"], 1
    ),
)
def test_what_was_changed_after_sealing_is_an_error(tmp_path, stubbed, what):
    conduct(tmp_path / "out")
    path = tmp_path / "out" / what
    text = path.read_text()
    path.write_text(text.replace("0", "1", 1))
    assert path.read_text() != text
    with pytest.raises(TautError, match="was changed after it was"):
        conduct(tmp_path / "out")
    path.write_text(text)
    assert len(conduct(tmp_path / "out")) == 3
    if what.startswith("diagnoses"):  # its list of hashes changed along with it
        path.write_text(text.replace("0", "1", 1))
        files = {name: data for name, data in sealed.read(path.parent).items() if name != sealed.LIST}
        sealed.Campaign(tmp_path / "out").write_diagnosis("case-0001", files)
        with pytest.raises(TautError, match="was changed after it was"):
            conduct(tmp_path / "out")


def test_labels_cannot_be_opened_before_every_diagnosis_is_written(tmp_path, stubbed):
    def stop(fraction, text):
        if text.startswith("diagnosed 1"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        conduct(tmp_path / "out", progress=stop)
    folder = sealed.Campaign(tmp_path / "out")
    assert folder.diagnosed("case-0000") and not folder.diagnosed("case-0001")
    with pytest.raises(TautError, match="stays sealed until every diagnosis is written"):
        folder.open("case-0000", folder.plan()["cases"]["case-0000"])


@pytest.mark.parametrize("stage", some(["diagnosed 1", "making cases", "opening"], 1))
def test_an_interrupted_campaign_goes_on_where_it_was(tmp_path, stubbed, monkeypatch, stage):
    whole = conduct(tmp_path / "whole")
    done = []
    for name in ("make_case", "diagnose_case"):
        function = getattr(work, name)
        monkeypatch.setattr(work, name, lambda *a, f=function, n=name, **k: (done.append(n), f(*a, **k))[1])

    def stop(fraction, text):
        if text.startswith(stage):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        conduct(tmp_path / "out", progress=stop)
    resumed = conduct(tmp_path / "out")
    assert sorted(done) == ["diagnose_case"] * 3 + ["make_case"] * 2  # nothing twice
    assert page.result(resumed)["methods"] == page.result(whole)["methods"]
    with pytest.raises(TautError, match="another campaign"):
        conduct(tmp_path / "out", replace(ORDER, seed=41))


def test_a_campaign_that_is_stopped_is_scored_as_far_as_it_came(tmp_path, stubbed, monkeypatch):
    order = replace(ORDER, none=3, single=0, leave_one_out=0)

    def stop(fraction, text):
        if text.startswith("diagnosed 2"):
            raise KeyboardInterrupt

    with pytest.raises(TautError, match="no campaign"):
        campaign.order_of(tmp_path / "out")
    with pytest.raises(KeyboardInterrupt):
        conduct(tmp_path / "out", order, stop)
    assert campaign.order_of(tmp_path / "out") == order
    # A third that came out of turn would be one that was quick: it is not scored.
    folder = sealed.Campaign(tmp_path / "out")
    (folder.root / "diagnoses" / "case-0001").rename(folder.root / "diagnoses" / "case-0002")
    with pool(1, None) as here:
        stopped = campaign.run(order, tmp_path / "out", here, lambda fraction, text: None, stopped=True)
    assert [record["name"] for record in stopped] == ["case-0000"]
    monkeypatch.setattr(work, "diagnose_case", None)  # closed: nothing is diagnosed any more
    assert [record["name"] for record in conduct(tmp_path / "out", order)] == ["case-0000"]


def test_the_command_makes_diagnoses_and_scores(tmp_path, taut):
    arguments = ["blindtest", "--out", tmp_path / "out", "--seed", 3, "--only", "registration.shift"]
    done = taut(*arguments, "--cases", 1, "--jobs", 1, "--json")
    assert done.code == 0, done.err
    document = json.loads(done.out)
    assert document == json.loads((tmp_path / "out" / "result.json").read_text())
    assert document["cases"] == 1 and document["tuning"]
    assert document["methods"]["tautline"]["overall"]["of"] == 1
    assert np.sum(document["confusion"]["counts"]) == 1
    (shift,) = document["each"]
    assert shift["realised"]["before"] > 2 * shift["realised"]["floor"]
    html = (tmp_path / "out" / "report.html").read_text()
    assert "registration.shift" not in html.split("<h2>")[0] and "single identifiable effect" in html


def test_a_baseline_that_is_left_out_for_want_of_its_package_is_told(tmp_path, stubbed, monkeypatch, taut):
    monkeypatch.setattr(compare, "find_spec", lambda package: None)
    arguments = ["blindtest", "--out", tmp_path / "out", "--jobs", 1]
    made = taut(*arguments, "--cases", 0, "--unknown", 0, "--none", 1, "--pairs", 0, "--baselines", "none")
    assert made.code == 0 and "narx" not in made.err
    scored = taut(*arguments, "--score")
    assert scored.code == 0 and "without the baseline 'narx'" in scored.err


def calibrated(files, left_out=()):
    with work.unpacked_folder(files) as folder:
        rig, recordings = work.recordings_of(folder)
        model = calibrate(recordings[:1], rig).model
        for name in ("nominal", "corrected"):
            model.save(folder / "out" / name)
        return {**stub(files), **sealed.read(folder / "out")}


@pytest.mark.long
def test_baselines_answer_on_the_same_cases(tmp_path, stubbed, monkeypatch):
    monkeypatch.setattr(work, "diagnose_case", calibrated)
    records = conduct(tmp_path / "out", replace(ORDER, leave_one_out=0))
    methods = ["majority", "joint", "bic"]
    with pool(1, None) as here:
        answered = compare.answers(methods, records, tmp_path / "out", here, lambda fraction, text: None)
    without = [{**record, "label": {**record["label"], "kind": "left out"}} for record in records[:1]]
    result = page.result([*answered, *without])
    assert list(result["methods"]) == ["tautline", page.HERE, *methods]
    assert [result["methods"][method]["left_out"]["of"] for method in ("tautline", page.HERE, "bic")] == [1, 0, 0]
    with pool(1, None) as here:
        broken = ["joint", "process"]
        for method in broken:
            monkeypatch.setitem(baselines.ON_CASES, method, lambda evidence: 1 / 0)
        methods = [*methods, "process"]
        again = compare.answers(methods, records, tmp_path / "out", here, lambda fraction, text: None)
        stopped = compare.answers(methods, records, tmp_path / "out", here, lambda f, t: None, stopped=True)
    assert stopped == again
    for before, after in zip(answered, again, strict=True):  # what is there stays, what fails costs its own answer
        assert after["answers"].pop("process")["verdict"] == "failed"
        assert after["answers"] == before["answers"]
    text = page.text(page.result(again))
    assert "Baselines answered 2 of the 2 cases" in text and "ZeroDivisionError" in text
    single = next(r for r in answered if r["label"]["kind"] == "single")
    nothing = next(r for r in answered if r["label"]["kind"] == "none")
    assert single["answers"]["majority"] == nothing["answers"]["majority"]
    for method in ("joint", "bic"):
        assert nothing["answers"][method]["verdict"] == "none"
        assert single["answers"][method]["realised"]["before"] > 2 * single["label"]["noise_px"]
        assert result["methods"][method]["overall"]["of"] == 2


@pytest.mark.parametrize("method", some(["narx", "process"], 1))
def test_what_only_shrinks_the_gap_is_not_scored_on_names(method):
    pytest.importorskip(baselines.NEEDS.get(method, "tautline"))
    case = made_once(3, "single", ("configuration.axis_coupling",))
    model = calibrate([case.calibration], case.rig).model
    evidence = baselines.Comparison(model, [case.calibration, *case.tests], case.further)
    answer = baselines.ON_CASES[method](evidence)
    assert answer.realised["after"] < 0.6 * answer.realised["before"]  # it follows the other axes
    assert scores.from_json(json.loads(json.dumps(scores.to_json(answer)))) == answer
    found = scores.score([(case.label, answer)])
    assert found.top1.of == 0 and found.closed > 0.5


def test_a_forest_knows_what_it_was_trained_on():
    rng = np.random.default_rng(4)
    centres = {LAG: 0.0, "unknown": 4.0, "none": 8.0}
    verdicts = tuple(np.repeat(list(centres), 30))
    seen = np.array([centres[v] for v in verdicts])[:, None] + rng.normal(0.0, 0.5, (90, 3))
    forest = baselines.Forest(seen, verdicts)
    answer = forest.answer(np.full(3, 4.1), 1.0)
    assert answer.verdict == "unknown" and answer.named == () and sum(answer.probabilities.values()) == pytest.approx(1)
    assert forest.answer(np.zeros(3), 1.0).named == (LAG,)


def test_workers_on_this_machine_give_what_this_process_gives():
    tasks = [(str(i), ({"a": bytes([i])},)) for i in range(5)]
    with pool(1, None) as here, pool(2, None) as others:
        assert dict(here(sealed.commitment, iter(tasks))) == dict(others(sealed.commitment, iter(tasks)))


def test_a_campaign_is_stopped_by_timeout_as_by_ctrl_c():
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt), pool(2, None):
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(1.0)
    assert signal.getsignal(signal.SIGTERM) is before


@pytest.mark.long
def test_a_dask_cluster_does_the_same_work(tmp_path, taut):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        arguments = ["blindtest", "--seed", 3, "--only", "none", "--none", 2, "--json"]
        on_dask = taut(*arguments, "--out", tmp_path / "dask", "--dask", cluster.scheduler_address)
    assert on_dask.code == 0, on_dask.err
    here = taut(*arguments, "--out", tmp_path / "here", "--jobs", 1)
    verdicts = [[line["verdict"] for line in json.loads(done.out)["each"]] for done in (on_dask, here)]
    assert verdicts[0] == verdicts[1] == ["none", "none"]


def test_a_cluster_that_does_not_answer_is_one_line():
    pytest.importorskip("distributed")
    with pytest.raises(TautError, match="no Dask scheduler answers"), pool(None, "tcp://127.0.0.1:9"):
        pass


def test_a_diagnosis_that_fails_is_a_wrong_one_and_the_campaign_goes_on():
    files = work.diagnose_case({"rig.toml": b"format = 'rig/1'"})
    record = {"document": json.loads(files[work.DOCUMENT]), "core_s": 0.1, "realised": None}
    assert "rig.toml" in record["document"]["error"]
    answer = scores.answer_of(record)
    found = scores.score([(label("single", LAG), answer), (label("none"), answer)])
    assert answer.verdict == "failed" and found.overall == Share(0, 2) and found.false_alarm == Share(0, 1)
