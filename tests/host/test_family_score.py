"""The sealed family's score, on diagnoses written by hand, with figures worked out by hand."""

import json
import math

import pytest

from tools.family import score


def truth_of(name, kind, ids, strength=10.0, verdict="effect", listed=True):
    return {
        "case": name, "kind": kind, "verdict": verdict, "unseen_valid_from_s": 1.0,
        "causes": [{"id": i, "listed": listed, "strength": strength} for i in ids],
    }  # fmt: skip


def diagnosis_of(verdict, candidates=(), named=(), none=0.0, unknown=0.0, shrink=None, ci=None, ambiguous=(), moved=()):
    return {
        "verdict": verdict,
        "candidates": [{"id": i, "probability": p} for i, p in candidates],
        "effects": [{"id": i, "ambiguous_with": list(ambiguous)} for i in named],
        "moved": [{"id": i} for i in moved],
        "probability_none": none,
        "probability_unknown": unknown,
        "gap": {"shrink": shrink, "shrink_ci": ci},
    }


@pytest.fixture
def graded(tmp_path):
    truths = [
        truth_of("a", "single", ["x.one"], 3.0),  # right, sure
        truth_of("b", "single", ["x.two"], 10.0),  # wrong, but in the set
        truth_of("c", "single", ["x.three"], 50.0),  # no diagnosis
        truth_of("d", "unknown", ["odd"], 8.0, "unknown", False),  # right
        truth_of("e", "none", [], verdict="none"),  # called an effect
        truth_of("f", "pair", ["x.one", "x.two"]),  # one named, one not, one too many
        truth_of("g", "nominal", ["transmission.offset"]),  # in `moved`
    ]
    said = {
        "a": diagnosis_of("effect", [("x.one", 0.8), ("x.two", 0.1)], ["x.one"], none=0.1, shrink=0.9, ci=[0.45, 0.95]),
        "b": diagnosis_of(
            "effect", [("x.one", 0.6), ("x.two", 0.4)], ["x.one"], shrink=0.5, ci=[0.4, 0.6], ambiguous=["x.two"]
        ),
        "d": diagnosis_of("unknown", [("x.one", 0.25)], unknown=0.75),
        "e": diagnosis_of("effect", [("x.one", 0.5)], ["x.one"], none=0.5),
        "f": diagnosis_of("effect", [("x.one", 0.9), ("x.three", 0.1)], ["x.one", "x.three"]),
        "g": diagnosis_of("effect", [], [], none=0.0, moved=["transmission.offset"]),
    }
    for name, d in said.items():
        (tmp_path / "said" / name).mkdir(parents=True)
        (tmp_path / "said" / name / "diagnosis.json").write_text(json.dumps(d))
    (tmp_path / "truth").mkdir()
    for t in truths:
        (tmp_path / "truth" / f"{t['case']}.json").write_text(json.dumps(t))
    # unseen: two rows count (t >= 1). nominal is off by 2 px in u (rms 2 / sqrt 2), corrected by 1 (a) and by 3 (b)
    for name, off in (("a", 1.0), ("b", 3.0)):
        (tmp_path / "truth" / f"{name}-unseen.csv").write_text("t_s,u_px,v_px\n0,0,0\n1,10,20\n2,11,20\n")
        (tmp_path / "said" / name / "nominal.csv").write_text("t_s,c_deg,u_px,v_px\n0,0,99,0\n1,0,12,20\n2,0,13,20\n")
        (tmp_path / "said" / name / "corrected.csv").write_text(
            f"t_s,c_deg,u_px,v_px\n0,0,99,0\n1,0,{10 + off},20\n2,0,{11 + off},20\n"
        )
    return score.collect(tmp_path / "said", tmp_path / "truth", tmp_path / "said")


def test_leads(graded):
    assert graded["missing"] == 1
    assert (graded["single leads"]["right"], graded["single leads"]["of"]) == (1, 3)
    assert graded["single in set"]["right"] == 2 and graded["single in first three"]["right"] == 2
    assert [graded[f"single leads, {b} times the noise"]["right"] for b in ("2 to 5", "5 to 20", "20 to inf")] == [
        1,
        0,
        0,
    ]
    assert graded["unknown called unknown"]["right"] == 1 and graded["none called none"]["right"] == 0
    assert graded["nominal: what moved leads"]["right"] == 1
    assert graded["by id"]["x.one"]["right"] == 1 and graded["by id"]["x.three"]["right"] == 0


def test_pairs(graded):
    assert graded["pair: one of them leads"]["right"] == 1 and graded["pair: all named"]["right"] == 0
    assert graded["pair: effects covered"]["right"] == 1 and graded["pair: effects covered"]["of"] == 2
    assert graded["pair: named and not there"] == 1 and graded["triple: all named"]["of"] == 0


def test_probabilities(graded):
    # likeliest labels: a 0.8 right, b 0.6 wrong, d 0.75 right, e 0.5 (x.one comes first) wrong, f 0.9 right; g none
    # bins: [0.8: 0.2] [0.6: 0.6] [0.7: 0.25] [0.5: 0.5] [0.9: 0.1], each one case of five
    assert graded["calibration error of probabilities"] == pytest.approx((0.2 + 0.6 + 0.25 + 0.5 + 0.1) / 5)
    # of the right label: a 0.8, b 0.4, c and g the floor, d 0.75, e 0.5, f 0.9 + 0
    logs = [0.8, 0.4, 1e-4, 0.75, 0.5, 0.9, 1e-4]
    assert graded["log score"] == pytest.approx(sum(map(math.log, logs)) / 7)


def test_claims(graded):
    # realised: a 1 - 1/2 = 0.5 (claimed 0.9, inside 0.45..0.95), b 1 - 3/2 = -0.5 (claimed 0.5, outside)
    assert graded["claim error, mean"] == pytest.approx((0.4 + 1.0) / 2) and graded["claims"] == 2
    assert (graded["shrink_ci covers"]["right"], graded["shrink_ci covers"]["of"]) == (1, 2)
    assert (graded["corrected worse than nominal"]["right"], graded["corrected worse than nominal"]["of"]) == (1, 2)
    assert "single leads" in score.text(graded)


def test_wilson():
    # 8 of 10 at 95 %: 0.490 to 0.943 (Wilson 1927, as Newcombe 1998 tabulates the method)
    found = score.share([True] * 8 + [False] * 2)
    assert found["low"] == pytest.approx(0.490, abs=5e-4) and found["high"] == pytest.approx(0.943, abs=5e-4)
    assert score.share([])["share"] is None


def test_predictions_at_other_times_are_refused(tmp_path):
    (tmp_path / "seen.csv").write_text("t_s,c_deg\n0,1\n1,2\n")
    (tmp_path / "off.csv").write_text("t_s,c_deg,u_px,v_px\n0,1,,\n1.5,2,,\n")
    with pytest.raises(ValueError, match=r"t_s 1\.5"):
        score.rms(tmp_path / "off.csv", tmp_path / "seen.csv", 0.0)
    (tmp_path / "good.csv").write_text("t_s,c_deg,u_px,v_px\n0,1,,\n1,5,,\n")
    assert score.rms(tmp_path / "good.csv", tmp_path / "seen.csv", 0.5) == pytest.approx(3.0)
