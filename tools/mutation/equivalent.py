"""Mutants that behave as the program does for every input, each with its reason: by hand (equivalent.toml), and by
rule those that only choose otherwise between what is the same, at a 0 that is listed as none, or begin what is never
read.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

from tools.mutation.choices import same_either_way, starts_what_is_never_read, told_apart
from tools.mutation.sites import Mutant, name_of_function

LIST = Path(__file__).with_name("equivalent.toml")


def listed(mutants: list[Mutant], root: Path) -> dict[Mutant, str]:
    """The reason of each that is listed; an entry that is not one mutant of today's sources ends the program."""
    by_change: dict[tuple[str, str, str], list[Mutant]] = {}
    for mutant in mutants:
        by_change.setdefault((mutant.file, *mutant.change((root / mutant.file).read_bytes())), []).append(mutant)
    found = {}
    for entry in tomllib.loads(LIST.read_text("utf-8"))["mutant"]:
        same = by_change.get((entry["file"], entry["was"], entry["becomes"]), [])
        if "function" in entry:
            same = [
                mutant
                for mutant in same
                if name_of_function(mutant, (root / mutant.file).read_bytes()) == entry["function"]
            ]
        if len(same) != 1:
            raise SystemExit(f"mutation: {len(same)} mutants of {entry['file']} are '{entry['becomes']}': mend {LIST}")
        found[same[0]] = entry["reason"]
    return found


def at_what_never_is_0(mutants: list[Mutant], root: Path) -> dict[Mutant, str]:
    """The reason of each that says otherwise for 0 alone of what is listed as never 0 in a function."""
    listed_as = {
        (entry["file"], function, entry["name"]): str(entry["reason"])
        for entry in tomllib.loads(LIST.read_text("utf-8"))["never_0"]
        for function in entry["functions"]
    }
    files = {file for file, _, _ in listed_as}
    found = {}
    for mutant in mutants:
        if mutant.file in files:
            source = (root / mutant.file).read_bytes()
            name, at = told_apart(mutant, source) or ("", 1)
            reason = listed_as.get((mutant.file, name_of_function(mutant, source), name))
            if reason is not None and at == 0:
                found[mutant] = reason
    return found


def equivalents(mutants: list[Mutant], root: Path) -> dict[Mutant, str]:
    """The reason of each that is listed, only chooses between equals, differs at a 0 that never is, or begins what is
    never read."""
    chooses = {
        mutant: "It differs where two are the same, and either gives the same there."
        for mutant in mutants
        if same_either_way(mutant, (root / mutant.file).read_bytes())
    }
    unread = {
        mutant: "It begins what others write into and nobody reads."
        for mutant in mutants
        if starts_what_is_never_read(mutant, (root / mutant.file).read_bytes())
    }
    return chooses | unread | at_what_never_is_0(mutants, root) | listed(mutants, root)
