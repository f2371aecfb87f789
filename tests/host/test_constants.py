"""Which numbers decide, and the package with others: `./run bench constants`."""

import json
import re
import subprocess
import sys

import pytest

from tautline.model import STEEPEST
from tools.constants.command import AS_IT_IS, changed, drawn, one_by_one
from tools.constants.find import PACKAGE, ROOT, UNSTATED, constants, of_source
from tools.constants.vary import other

SOURCE = """
A = 0.3  # loss: a third of what is gained
# a comment: 7.0
B = (4, 0.7)  # prior: of shafts
C = 9.81  # limit: gravity


def f(x, many=5):
    half = 0.5 * x[3] + 1e-12
    return half * 2.5 + many * -0.2
"""


def test_numbers_are_found_with_their_kinds():
    found = [(c.line, c.value, c.kind) for c in sorted(of_source(SOURCE, "a.py"), key=lambda c: (c.line, c.column))]
    named = [(2, 0.3, "loss"), (4, 4.0, "prior"), (4, 0.7, "prior"), (5, 9.81, "limit")]
    assert found == [*named, (10, 2.5, UNSTATED), (10, 0.2, UNSTATED)]
    assert [c.varied for c in of_source(SOURCE, "a.py")].count(False) == 1
    assert {c.kind for c in of_source("# format of all: of a file\nX = 0.25\n", "b.py")} == {"format"}


def test_what_decides_is_found_where_it_stands():
    for each in constants():
        rest = (PACKAGE / each.file).read_text().splitlines()[each.line - 1].encode()[each.column :].decode()
        written = re.match(r"[\d_.]+(e-?\d+)?", rest)
        assert written and float(written[0]) == each.value, each.key


@pytest.mark.parametrize(
    ("value", "factor", "expected"),
    [(4.0, 1.3, 5.2), (0.25, 0.7, 0.175), (0.9, 1.3, 0.87), (0.9, 0.7, 0.93), (-0.9, 1.3, -0.87), (10, 1.26, 13)],
)
def test_another_number_is_of_the_same_sort(value, factor, expected):
    assert other(value, factor) == pytest.approx(expected)
    assert type(other(value, factor)) is type(value)


def test_a_process_has_the_other_numbers():
    steepest = next(c for c in constants() if c.file == "model.py" and c.value == STEEPEST)
    code = (
        "import json, sys; from tools.constants.vary import install; install(json.load(sys.stdin));"
        "from tautline import model; print(model.STEEPEST, model.Model.__name__)"
    )
    run = subprocess.run(
        [sys.executable, "-c", code], input=json.dumps({steepest.key: 1.1}), capture_output=True, text=True, cwd=ROOT
    )
    assert run.stdout.split() == [str(STEEPEST * 1.1), "Model"], run.stderr


def test_draws_are_within_the_spread_and_a_change_is_seen():
    chosen = [c for c in constants() if c.varied][:50]
    orders = drawn(chosen, 3, 1)
    assert len({name for name, _, _ in orders}) == 3
    assert all(0.7 <= f <= 1.3 for _, factors, learnt in orders for f in [*factors.values(), learnt])
    assert [set(f.values()) for _, f, _ in one_by_one(chosen[:1])] == [{0.7}, {1.3}]
    rows = [
        {"draw": draw, "session": "s", "verdict": verdict}
        for draw, verdict in [(AS_IT_IS, "good"), ("a", "good"), ("b", "doubtful")]
    ]
    assert [row["draw"] for row in changed(rows)] == ["b"]
