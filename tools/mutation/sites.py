"""Every mutant that fixed operators make of a C source: places in function bodies, found in its syntax tree.

What is outside of functions (lists of fields, tables, macros) is not touched: those are compared with the host's copy.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import tree_sitter_c
from tree_sitter import Language, Node, Parser, Tree

ROOMS = ("common", "firmware/estimator", "firmware/app")
ELSEWHERE = {"tl_usb.c"}  # compiled by ports alone, against TinyUSB: no test of C has it
COMPARISONS = {"<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "=="}
SIGNS = {"+": "-", "-": "+", "+=": "-=", "-=": "+=", "++": "--", "--": "++"}
SIGNED = {"binary_expression", "assignment_expression", "update_expression"}
CONDITIONAL = {"if_statement", "while_statement", "do_statement", "for_statement", "conditional_expression"}
DROPPED = {"expression_statement", "break_statement", "continue_statement"}
PARSER = Parser(Language(tree_sitter_c.language()))


@cache
def tree_of(source: bytes) -> Tree:
    return PARSER.parse(source)


@dataclass(frozen=True, order=True)
class Mutant:
    """Bytes `start` to `end` of `file` (from the project's root) are `after`; `line` and `column` count from 1."""

    file: str
    start: int
    end: int
    after: str
    operator: str
    line: int
    column: int

    def applied(self, source: bytes) -> bytes:
        return source[: self.start] + self.after.encode() + source[self.end :]

    def change(self, source: bytes) -> tuple[str, str]:
        """The lines that it touches before and after, each as one line with single spaces."""
        first = source.rfind(b"\n", 0, self.start) + 1
        last = source.find(b"\n", self.end)
        before, rest = source[first : self.start], source[self.end : last]
        lines = (source[first:last], before + self.after.encode() + rest)
        was, becomes = (" ".join(text.decode().split()) for text in lines)
        return was, becomes


def _replacements(node: Node) -> Iterator[tuple[str, Node, str]]:
    """Operator, what is replaced, by what: of this node alone."""
    kind = node.type
    sign = node.child_by_field_name("operator")
    symbol = sign.type if sign is not None else ""
    if sign is not None and kind == "binary_expression" and symbol in COMPARISONS:
        yield "comparison", sign, COMPARISONS[symbol]
    if sign is not None and kind in SIGNED and symbol in SIGNS:
        yield "sign", sign, SIGNS[symbol]
    if sign is not None and kind == "unary_expression" and symbol == "-":
        yield "sign", sign, " "
    if kind == "number_literal":
        for step in ("+ 1", "- 1"):
            yield "constant", node, f"({_text(node)} {step})"
    condition = node.child_by_field_name("condition")
    if kind in CONDITIONAL and condition is not None:
        yield "condition", condition, f"(!({_text(condition)}))"
    if kind in DROPPED and not _text(node).startswith("(void)"):  # without effect as it is
        yield "dropped", node, ";"
    if kind == "return_statement" and node.named_child_count == 0:
        yield "dropped", node, ";"


def _text(node: Node) -> str:
    return (node.text or b"").decode()


def _nodes(node: Node, inside: bool) -> Iterator[Node]:
    """The nodes of function bodies, but for what the parser did not understand and for sizes of types."""
    if node.is_error or node.type in ("sizeof_expression", "preproc_def", "preproc_function_def"):
        return
    if inside:
        yield node
    body = node.child_by_field_name("body") if node.type == "function_definition" else None
    for child in node.children:
        yield from _nodes(child, inside or child == body)


def functions_of(source: bytes) -> list[tuple[int, int]]:
    """First and last line of each function."""
    functions, left = [], [tree_of(source).root_node]
    while left:
        node = left.pop()
        if node.type == "function_definition":
            functions.append((node.start_point[0] + 1, node.end_point[0] + 1))
        left += node.children
    return sorted(functions)


def name_of_function(mutant: Mutant, source: bytes) -> str:
    """Of the function that is changed; empty where it is told by none."""
    node = tree_of(source).root_node.descendant_for_byte_range(mutant.start, mutant.end)
    while node is not None and node.type != "function_definition":
        node = node.parent
    while node is not None and node.type != "identifier":
        node = node.child_by_field_name("declarator")
    return (node.text or b"").decode() if node is not None else ""


def mutants_of(file: str, source: bytes) -> list[Mutant]:
    """All mutants of one source, in its order."""
    found = []
    for node in _nodes(tree_of(source).root_node, False):
        for operator, place, after in _replacements(node):
            row, column = place.start_point
            found.append(Mutant(file, place.start_byte, place.end_byte, after, operator, row + 1, column + 1))
    return sorted(found)


def all_mutants(root: Path) -> list[Mutant]:
    found = []
    for room in ROOMS:
        for path in sorted((root / room).rglob("*.[ch]")):
            if path.name not in ELSEWHERE:
                found += mutants_of(path.relative_to(root).as_posix(), path.read_bytes())
    return found


def drawn(mutants: list[Mutant], count: int, seed: int) -> list[Mutant]:
    """`count` of them without replacement; with the same seed more of them begin with the same ones."""
    order = list(mutants)
    random.Random(seed).shuffle(order)
    return order[:count]
