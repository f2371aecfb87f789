"""A slice of tools.tracking: sessions scored from the plant's truth, and the real tools where they are at hand."""

import json
import math

import numpy as np
import pytest
from click.testing import CliRunner

from tools.tracking import real
from tools.tracking.__main__ import main
from tools.tracking.cases import one
from tools.tracking.score import table, turns_of

SECONDS = 70.0


@pytest.mark.parametrize(("kind", "seed"), [("scale", 31), ("offset", 32), ("shape", 33)])
def test_a_change_is_doubted_soon_and_never_taken_up_too_much(kind, seed):
    scored = one((kind, seed, SECONDS, True))
    assert scored["cost"] >= 3.0 and scored["learnt"]
    assert scored["stale_after"] <= 3
    assert scored["over"] <= 2
    assert scored["rms"] < 0.5 * scored["untracked"]
    assert scored["rms"] < (1.3 if kind != "shape" else 2.0) * scored["reference"]


@pytest.mark.parametrize("seed", [35, 36])
def test_with_every_disturbance_at_once_nothing_is_learnt(seed):
    assert not one(("all", seed, SECONDS, True))["learnt"]


def test_turns_are_where_the_motor_goes_back_by_more():
    q = np.array([0.0, 1.0, 0.95, 2.0, 0.5, 0.55, 0.4, 3.0])
    assert turns_of(q, 0.1) == [3, 6]


def test_the_table_counts_only_what_costs_enough():
    base = {
        "kind": "scale",
        "stale_after": 1,
        "stale_before": 0.0,
        "over": -1,
        "rms": 0.06,
        "reference": 0.05,
        "untracked": 1.0,
    }
    base |= {"offset_z": 1.0, "scale_z": 1.0}
    late = {**base, "cost": 9.0, "stale_after": math.inf, "rms": 0.08}
    rows = table([{**base, "cost": 9.0}, {**base, "cost": 1.0}, late], 3.0)
    assert rows[0]["sessions"] == 2 and rows[0]["stale within 3"] == 0.5 and rows[0]["within"] == 0.5


def test_the_command_prints_its_table():
    done = CliRunner().invoke(
        main, ["run", "--kind", "nothing", "--sessions", "1", "--seconds", "20", "--ideal", "--jobs", "1", "--json"]
    )
    assert done.exit_code == 0, done.output
    assert json.loads(done.output)[0]["learnt"] == 0


@pytest.mark.long
def test_postures_of_a_real_tool_are_followed():
    data = real.find()
    if data is None or not (data / "davinci-posture").is_dir():
        pytest.skip("no shared/data beside the repository")
    row = real.table(data, ("roll, other postures",))[0]
    assert row["runs"] == 4 and row["untracked"] > 3.0
    assert row["tracked"] < 0.3


@pytest.mark.long
def test_every_run_of_the_real_tool():
    data = real.find()
    if data is None:
        pytest.skip("no shared/data beside the repository")
    rows = {row["set"]: row for row in real.table(data)}
    for j in range(4):
        assert rows[f"load {j}, other rates"]["tracked"] < 1.15 * rows[f"load {j}, other rates"]["untracked"]
    for name in ("0.3 Hz, other loads", "0.5 Hz, other loads", "pitch, other postures", "roll, other postures"):
        assert rows[name]["tracked"] < 0.3
