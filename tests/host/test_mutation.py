"""Mutants of C sources by fixed operators: which there are, which are drawn, what is kept of them."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import pytest

from tools.mutation import __main__ as program
from tools.mutation import hosted
from tools.mutation.choices import same_either_way, starts_what_is_never_read, told_apart
from tools.mutation.coverage import Reached, asked
from tools.mutation.equivalent import equivalents
from tools.mutation.sites import ROOMS, Mutant, all_mutants, drawn, mutants_of, name_of_function
from tools.mutation.trial import Outcome, digest

ROOT = Path(__file__).parents[2]


def changes(body: str) -> set[tuple[str, str]]:
    """(operator, body as it becomes) of a function's body in one line."""
    source = f"void f(int a, int b) {{\n{body}\n}}\n".encode()
    return {(each.operator, each.change(source)[1]) for each in mutants_of("f.c", source)}


@pytest.mark.parametrize(
    ("body", "operator", "becomes"),
    [
        ("return a < b;", "comparison", ["return a <= b;"]),
        ("return a >= b;", "comparison", ["return a > b;"]),
        ("return a == b;", "comparison", ["return a != b;"]),
        ("return 12U;", "constant", ["return (12U + 1);", "return (12U - 1);"]),
        ("g(a);", "dropped", [";"]),
        ("return;", "dropped", [";"]),
        ("a -= b;", "sign", ["a += b;"]),
        ("return -a;", "sign", ["return a;"]),
        ("a++;", "sign", ["a--;"]),
        ("if (a) b = a;", "condition", ["if (!((a))) b = a;"]),
        ("return a ? b : a;", "condition", ["return (!(a)) ? b : a;"]),
    ],
)
def test_each_operator_changes_one_place(body: str, operator: str, becomes: list[str]) -> None:
    assert {text for kind, text in changes(body) if kind == operator} == set(becomes)


def test_only_what_functions_do_is_changed() -> None:
    assert mutants_of("f.h", b"#define LIMIT (3 + 4)\nenum { A = 1 };\nstatic const int B = 2; // a < 5\n") == []
    assert changes("(void)a;") == set()
    assert changes("int c[sizeof(int[3])];") == set()


@pytest.mark.parametrize(
    ("chosen", "same"),
    [
        ("a < b ? a : b", True),
        ("(a > b) ? a : b", True),
        ("a > b ? a - b : 0", True),
        ("a < 0 ? -a : a", True),
        ("a < b ? b - a : 0", False),
        ("a < b ? 1 : 2", False),
        ("a == b ? a : b", False),
        ("a < b + 1 ? a : b", False),
        ("a < b ? (int32_t)a : b", True),
        ("a > (uint32_t)b ? b : (a)", True),
        ("a < b ? (uint8_t)a : b", False),
        ("a < b ? (int32_t)b + a : b", False),
    ],
)
def test_a_comparison_that_only_chooses_between_equals_is_equivalent(chosen: str, same: bool) -> None:
    source = f"int f(int a, int b) {{ return {chosen}; }}\n".encode()
    compared = [each for each in mutants_of("f.c", source) if each.operator == "comparison"]
    assert [same_either_way(each, source) for each in compared] == [same]


@pytest.mark.parametrize(
    ("chosen", "becomes"),
    [
        ("a > 0 ? a : 0", {"a >= 0 ? a : 0", "a > (0 - 1) ? a : 0"}),  # otherwise at 0 alone
        ("a > 0 ? a - 1 : 0", {"a > (0 + 1) ? a - 1 : 0"}),  # at 1
        (
            "a < 1 ? 1 : (a > 64 ? 64 : a)",
            {
                "a <= 1 ? 1 : (a > 64 ? 64 : a)",
                "a < (1 + 1) ? 1 : (a > 64 ? 64 : a)",
                "a < 1 ? 1 : (a >= 64 ? 64 : a)",
                "a < 1 ? 1 : (a > (64 - 1) ? 64 : a)",
            },
        ),
        ("a > 0xFF ? 255 : a", {"a >= 0xFF ? 255 : a", "a > (0xFF - 1) ? 255 : a"}),
        ("a > 0 ? b : 0", set()),
        ("a >= 0 ? a : 1", set()),
        ("u > 0 ? u : 0", {"u >= 0 ? u : 0"}),  # below no number of those that have no sign
    ],
)
def test_a_choice_that_differs_at_one_number_and_is_the_same_there_is_equivalent(
    chosen: str, becomes: set[str]
) -> None:
    source = f"int f(int32_t a, int32_t b, uint32_t u) {{ return {chosen}; }}\n".encode()
    found = {each.change(source)[1] for each in mutants_of("f.c", source) if same_either_way(each, source)}
    assert {text.split("return ")[1].split(";")[0] for text in found} == becomes


@pytest.mark.parametrize(
    ("body", "unread"),
    [
        ("int n = 0; g(&n); return h(1, &n);", 2),
        ("int n = 0; g(&n); return n;", 0),
        ("int n = 0; g(&n); if (n) {} return 0;", 0),
        ("int n = 0; g(n); return 0;", 0),
        ("int n = a ? 0 : 1; g(&n); return 0;", 0),
    ],
)
def test_what_begins_a_variable_that_nobody_reads_is_equivalent(body: str, unread: int) -> None:
    source = f"int f(int a) {{ {body} }}\n".encode()
    assert sum(starts_what_is_never_read(each, source) for each in mutants_of("f.c", source)) == unread


def test_each_host_test_of_fixed_point_is_there_and_of_files_that_are() -> None:
    stems = {path.stem for room in ROOMS for path in (ROOT / room).rglob("*.[ch]")}
    for test, of in hosted.OF.items():
        assert (ROOT / hosted.FOLDER / test).is_file()
        assert set(of) <= stems


def test_a_mutant_differs_from_its_source_in_its_bytes_alone() -> None:
    for mutant in drawn(all_mutants(ROOT), 200, 7):
        source = (ROOT / mutant.file).read_bytes()
        changed = mutant.applied(source)
        assert changed != source
        assert changed[: mutant.start] == source[: mutant.start]
        assert changed[mutant.start + len(mutant.after.encode()) :] == source[mutant.end :]
        assert source[: mutant.start].count(b"\n") == mutant.line - 1


def test_every_room_and_operator_has_mutants_and_no_two_are_the_same() -> None:
    mutants = all_mutants(ROOT)
    assert len(set(mutants)) == len(mutants)
    assert {mutant.operator for mutant in mutants} == set(program.OPERATORS)
    assert all(any(mutant.file.startswith(room) for mutant in mutants) for room in ROOMS)


def test_more_of_a_seed_begin_with_fewer_and_another_seed_has_others() -> None:
    mutants = mutants_of("f.c", b"int f(int a) {\n" + b"a = a + 1;\n" * 30 + b"return a;\n}\n")
    assert drawn(mutants, 40, 3)[:10] == drawn(mutants, 10, 3) != drawn(mutants, 10, 4)
    assert sorted(drawn(mutants, len(mutants), 3)) == mutants


def kept_rows(file: Path, *rows: tuple[Mutant, Outcome, dict[str, str]]) -> None:
    lines = [
        json.dumps({"of": of, "mutant": asdict(mutant), "outcome": {"how": outcome.how, "test": outcome.test}})
        for mutant, outcome, of in rows
    ]
    file.write_text("\n".join(lines), "utf-8")


def test_an_outcome_of_other_sources_and_a_line_cut_off_are_no_outcomes(tmp_path: Path) -> None:
    mutant, other = (Mutant("f.c", at, at + 1, "+", "sign", 1, at + 1) for at in (1, 2))
    file = tmp_path / "outcomes.jsonl"
    kept_rows(
        file,
        (mutant, Outcome("killed", "test_f"), {"test_f": "today's"}),
        (other, Outcome("killed", "test_f"), {"test_f": "another"}),
        (other, Outcome("build", ""), {"": "cut off"}),
    )
    file.write_text(file.read_text("utf-8")[:-9], "utf-8")
    assert program.known(file, {"": "cut off", "test_f": "today's"}) == ({mutant: Outcome("killed", "test_f")}, {})
    assert program.known(file, {"": "cut off", "test_f": "new"}) == ({}, {})
    assert program.known(tmp_path / "none.jsonl", {}) == ({}, {})


def test_a_survivor_is_asked_only_what_it_was_not(tmp_path: Path) -> None:
    mutant, file = Mutant("f.c", 1, 2, "+", "sign", 1, 2), tmp_path / "outcomes.jsonl"
    kept_rows(file, (mutant, Outcome("survived", ""), {"test_f": "1", "test_g": "1"}))
    survived = {mutant: Outcome("survived", "", ("test_f", "test_g"))}
    assert program.known(file, {"": "0", "test_f": "1", "test_g": "1"}) == (survived, {})
    assert program.known(file, {"": "0", "test_f": "1", "test_g": "2"}) == ({}, {mutant: frozenset({"test_f"})})
    new = {"": "0", "test_f": "1", "test_g": "1", "test_h": "1"}
    assert program.known(file, new) == ({}, {mutant: frozenset({"test_f", "test_g"})})


def test_an_outcome_is_of_its_test_and_of_what_all_tests_read(tmp_path: Path) -> None:
    tests = tmp_path / "tests" / "c"
    tests.mkdir(parents=True)
    (tests / "test_f.c").write_text("old")
    before, sources = digest(tmp_path, "test_f"), digest(tmp_path, "")
    (tests / "test_g.c").write_text("new")
    assert digest(tmp_path, "test_f") == before
    (tests / "test_f.c").write_text("changed")
    assert digest(tmp_path, "test_f") != before
    (tests / "test_f.c").write_text("old")
    (tests / "used.h").write_text("by all")
    assert digest(tmp_path, "test_f") != before
    assert digest(tmp_path, "") == sources


def test_the_tests_that_run_its_line_come_first_and_others_of_its_function_after() -> None:
    mutant = Mutant("f.c", 1, 2, "+", "sign", 12, 1)
    line = Reached({"f.c": {11, 12}}, {"f.c": [(10, 20)]})
    function = Reached({"f.c": {11}}, {"f.c": [(10, 20)]})
    neither = Reached({"f.c": {31}, "g.c": {12}}, {"f.c": [(30, 40)], "g.c": [(10, 20)]})
    assert [each.line(mutant) for each in (line, function, neither)] == [True, False, False]
    assert [each.function(mutant) for each in (line, function, neither)] == [True, True, False]
    assert asked(mutant, {"a": function, "b": line, "c": neither, "d": line}, {"a": 0, "b": 2, "c": 0, "d": 1}) == [
        "d",
        "b",
        "a",
    ]


def test_the_share_is_of_what_counts(capsys: pytest.CaptureFixture[str]) -> None:
    mutants = drawn(all_mutants(ROOT), 6, 1)
    hows = ["killed", "time", "survived", "survived", "build", "same"]
    outcomes = {mutant: Outcome(how, "") for mutant, how in zip(mutants, hows, strict=True)}
    program.report(outcomes, {mutants[3]: "its reason"})
    said = capsys.readouterr().out
    assert "2 of 3 killed, 66.7%" in said
    assert f"survived {mutants[2].file}:{mutants[2].line}" in said
    assert said.count("survived ") == 1
    with pytest.raises(SystemExit, match="a test kills it"):
        program.report(outcomes, {mutants[0]: "its reason"})


def test_the_interval_is_that_of_clopper_and_pearson() -> None:
    # No failure in 20: the lower bound is 0.05^(1/20).
    assert f"(90 %: {0.05 ** (1 / 20):.1%} to 100.0%)" in program.share(20, 20)


@pytest.mark.parametrize(
    ("body", "told"),
    [
        ("if (a->b > 0) {}", {("a->b", 0), ("a->b", 1)}),
        ("return a < 3 ? 1 : 2;", {("a", 3), ("a", 2)}),
        ("return a == 0;", set()),
    ],
)
def test_a_comparison_is_otherwise_at_one_number(body: str, told: set[tuple[str, int]]) -> None:
    source = f"int32_t f(int32_t a) {{ {body} }}\n".encode()
    assert {found for each in mutants_of("f.c", source) if (found := told_apart(each, source))} == told


@pytest.mark.parametrize(
    ("source", "name"),
    [
        ("static const int *f(int a) { return a + 1; }", "f"),
        ("TL_FAST void tl_g(int a) { h(a + 1); }", "tl_g"),
    ],
)
def test_a_mutant_is_told_by_its_function(source: str, name: str) -> None:
    assert {name_of_function(each, source.encode()) for each in mutants_of("f.c", source.encode())} == {name}


def test_each_mutant_listed_as_equivalent_is_one_of_todays_with_a_reason() -> None:
    assert all(len(reason) > 20 for reason in equivalents(all_mutants(ROOT), ROOT).values())
