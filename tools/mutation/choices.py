"""Mutants that only choose otherwise between what is the same: found by their choice's text."""

from __future__ import annotations

import re
from operator import add, eq, ge, gt, le, lt, mul, ne, sub

from tree_sitter import Node

from tools.mutation.sites import COMPARISONS, Mutant, tree_of

MEANINGS = {"+": add, "-": sub, "*": mul, "<": lt, "<=": le, ">": gt, ">=": ge, "==": eq, "!=": ne}
WIDE_CASTS = ("int32_t", "uint32_t")
ORDERED = ("<", "<=", ">", ">=")


def _text(node: Node | None) -> str:
    return (node.text or b"").decode() if node is not None else ""


def _bare(node: Node | None) -> str:
    """Without parentheses, and without a cast to 32 bits, which hold every limit that is chosen here."""
    while node is not None and (
        node.type == "parenthesized_expression"
        or (node.type == "cast_expression" and _text(node.child_by_field_name("type")) in WIDE_CASTS)
    ):
        node = node.named_children[-1]
    return _text(node)


def _symbol(node: Node) -> str:
    sign = node.child_by_field_name("operator")
    return sign.type if sign is not None else ""


def _outward(node: Node | None, kind: str) -> Node | None:
    """The next node around it of this kind."""
    while node is not None and node.type != kind:
        node = node.parent
    return node


def _choice(node: Node | None) -> tuple[Node, Node] | None:
    """The comparison around a place, and the choice that it decides alone."""
    compared = _outward(node, "binary_expression")
    while compared is not None and _symbol(compared) not in COMPARISONS:
        compared = _outward(compared.parent, "binary_expression")
    chosen = compared.parent if compared is not None else None
    while chosen is not None and chosen.type == "parenthesized_expression":
        chosen = chosen.parent
    if compared is None or chosen is None or chosen.type != "conditional_expression":
        return None
    return compared, chosen


def _number(node: Node | None, values: dict[str, int]) -> int | None:
    """What an expression of `values`, numbers, sums and choices comes to; None for any other."""
    if node is None or _text(node) in values:
        return values.get(_text(node))
    if node.type == "number_literal":
        digits = _text(node).rstrip("uUlL")
        return int(digits, 0) if re.fullmatch(r"0|[1-9]\d*|0[xX][0-9a-fA-F]+", digits) else None
    parts = [_number(child, values) for child in node.named_children]
    if node.type == "cast_expression":
        return parts[-1]
    if not parts or parts[0] is None:
        return None
    if node.type == "parenthesized_expression":
        return parts[0]
    if node.type == "conditional_expression":
        return parts[1] if parts[0] else parts[2]
    if node.type == "unary_expression":
        return -parts[0] if _symbol(node) == "-" else None
    meaning = MEANINGS.get(_symbol(node)) if node.type == "binary_expression" and parts[1] is not None else None
    return int(meaning(*parts)) if meaning is not None else None


def _is_signed(name: Node) -> bool:
    function = _outward(name, "function_definition")
    kinds = r"\b(int\d+_t|tl_\w+_q\d+_t|tl_real_t)\b"
    return re.search(rf"{kinds}[^;(){{]*\b{re.escape(_text(name))} = ", _text(function)) is not None or (
        re.search(rf"{kinds} {re.escape(_text(name))}[,)]", _text(function)) is not None
    )


def _where_it_differs(mutant: Mutant, compared: Node, signed: bool = False) -> int | None:
    """The one whole number x at which `x < 3` is otherwise once its sign or its number is mutated. `signed`: x may be
    below 0, whether that is seen or not."""
    name, limit = (compared.child_by_field_name(side) for side in ("left", "right"))
    least = _number(limit, {})
    if name is None or limit is None or least is None or limit.type != "number_literal":
        return None
    if mutant.operator == "comparison":
        return least
    if mutant.operator != "constant" or mutant.start != limit.start_byte:
        return None
    up = mutant.after.endswith("+ 1)")
    if not up and least == 0 and not signed and not _is_signed(name):
        return None  # no number is below 0
    return (
        least
        + (1 if up and _symbol(compared) in ("<=", ">") else 0)
        - (1 if not up and _symbol(compared) in ("<", ">=") else 0)
    )


def same_either_way(mutant: Mutant, source: bytes) -> bool:
    """Whether it tells apart what gives the same: the smaller or the larger of equal ones, a size, an excess; or the
    one whole number for which it chooses otherwise, where either way gives the same.
    """
    found = _choice(tree_of(source).root_node.descendant_for_byte_range(mutant.start, mutant.end))
    if found is None or _symbol(found[0]) not in ORDERED:
        return False
    compared, chosen = found
    ways = [chosen.child_by_field_name(name) for name in ("consequence", "alternative")]
    at = _where_it_differs(mutant, compared)
    if at is not None:
        values = [_number(way, {_text(compared.child_by_field_name("left")): at}) for way in ways]
        if values[0] is not None and values[0] == values[1]:
            return True
    left, right = (_bare(compared.child_by_field_name(name)) for name in ("left", "right"))
    then, otherwise = map(_bare, ways)
    return mutant.operator == "comparison" and (
        {then, otherwise} == {left, right}
        or (then, otherwise) == (f"{left} - {right}", "0")
        or (right == "0" and {then, otherwise} == {left, f"-{left}"})
    )


def told_apart(mutant: Mutant, source: bytes) -> tuple[str, int] | None:
    """Of a comparison with a number what it compares, and the one whole number for which the mutant says otherwise."""
    compared = tree_of(source).root_node.descendant_for_byte_range(mutant.start, mutant.end)
    while compared is not None and (compared.type != "binary_expression" or _symbol(compared) not in ORDERED):
        compared = compared.parent
    at = _where_it_differs(mutant, compared, signed=True) if compared is not None else None
    return (_text(compared.child_by_field_name("left")), at) if compared is not None and at is not None else None


def starts_what_is_never_read(mutant: Mutant, source: bytes) -> bool:
    """Whether it changes the first value of a variable that others are given to write into, and nobody reads."""
    node = tree_of(source).root_node.descendant_for_byte_range(mutant.start, mutant.end)
    begun = node.parent if node is not None else None
    if mutant.operator != "constant" or begun is None or begun.type != "init_declarator":
        return False
    name, left = _text(begun.child_by_field_name("declarator")), [_outward(begun, "function_definition")]
    uses = []
    while left:
        each = left.pop()
        if each is not None:
            left += each.children
            uses += [each] if each.type == "identifier" and _text(each) == name else []
    others = [use for use in uses if use.parent is not None and use.parent.type != "init_declarator"]
    return all(_is_given_away(use) for use in others)


def _is_given_away(use: Node) -> bool:
    pointer = use.parent
    given = pointer.parent if pointer is not None else None
    return (
        pointer is not None and _text(pointer).startswith("&") and given is not None and given.type == "argument_list"
    )
