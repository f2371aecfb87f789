"""`python -m tools.family_two make --seed S --cases N --out DIR`: cases; `seal`, `--list`, `--describe`.

`python -m tools.family score` scores them.
"""

import argparse
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from tools.family import seal
from tools.family_two import cases, causes, ranges, work


@dataclass(frozen=True)
class Family:
    """A family's modules, as this command asks for them; a later family's command is this one with its own."""

    name: str  # of its package
    cases: ModuleType
    causes: ModuleType
    ranges: ModuleType
    work: ModuleType

    @property
    def folder(self) -> Path:
        return Path(str(self.cases.__file__)).parent


def listing(family: Family) -> str:
    lines = ["mechanisms:"]
    lines += [f"  {name:10s} {(m.__doc__ or '').splitlines()[0]}" for name, m in family.cases.MECHANISMS.items()]
    lines += ["effects of formats.md:"]
    lines += [f"  {i:38s} {c.says}" for i, c in family.causes.LISTED.items()]
    lines += ["causes that no list holds:"]
    lines += [f"  {i:38s} {c.says}" for i, c in family.causes.UNLISTED.items()]
    every = [(n, r) for n, r in vars(family.ranges).items() if isinstance(r, family.ranges.Range)]
    lines += [f"only moved: {', '.join(family.causes.NOMINAL)}", "ranges:"]
    lines += [f"  {n:16s} {r.lo:g} to {r.hi:g} {r.unit}  [{r.source}]" for n, r in every]
    return "\n".join(lines)


def describe(family: Family, name: str) -> str:
    if name in family.cases.MECHANISMS:
        return family.cases.MECHANISMS[name].__doc__ or ""
    kinds = family.causes.LISTED | family.causes.UNLISTED
    if name not in kinds:
        sys.exit(f"no mechanism or cause is called {name}: `python -m tools.{family.name} --list` has them all")
    kind = kinds[name]
    notes = [
        f"{name}: {kind.says}",
        f"strength {kind.limits.lo:g} to {kind.limits.hi:g} {kind.limits.unit}",
        f"source: {kind.limits.source}",
        f"may be there while calibrating: {'yes' if kind.may_start else 'no'}",
        f"binned by the gap {'before (recalibration closes it)' if kind.moves else 'that a refit leaves'}",
    ]
    return "\n".join(notes)


def main(family: Family, says: str | None) -> None:
    """The command of a family. says: what its help begins with."""
    parser = argparse.ArgumentParser(prog=f"python -m tools.{family.name}", description=says)
    parser.add_argument("--list", action="store_true", help="mechanisms, causes and ranges with their sources")
    parser.add_argument("--describe", metavar="ID", help="one mechanism or cause")
    verbs = parser.add_subparsers(dest="verb")
    maker = verbs.add_parser("make", help="write cases")
    maker.add_argument("--seed", type=int, required=True)
    maker.add_argument("--cases", type=int, default=300)
    maker.add_argument("--first", type=int, help="only the first so many of them")
    maker.add_argument("--out", type=Path, required=True)
    maker.add_argument("--truth", type=Path, help="where the truths go (default OUT/truth)")
    maker.add_argument("--processes", type=int, default=1)
    sealer = verbs.add_parser("seal", help="print the fingerprints of a seed")
    sealer.add_argument("--seed", type=int, required=True)
    sealer.add_argument("--cases", type=int, default=300)
    sealer.add_argument("--truth", type=Path, help="a folder of truths, to hash them as well")
    sealer.add_argument("--first", type=int, default=300, help="how many of the truths")
    args = parser.parse_args()
    if args.list:
        print(listing(family))
    elif args.describe:
        print(describe(family, args.describe))
    elif args.verb == "make":
        family.work.make(args.seed, args.cases, args.out, args.truth or args.out / "truth", args.processes, args.first)
        kinds = Counter(kind for kind, _ in family.cases.plan(args.seed, args.cases)[: args.first])
        print(f"{args.out}: " + ", ".join(f"{n} {k}" for k, n in kinds.items()))
    elif args.verb == "seal":
        print(
            f"sources {seal.sources(family.folder)}\nplan    {seal.planned(args.seed, args.cases, family.cases.plan)}"
        )
        if args.truth:
            print(f"truths  {seal.truths(args.truth, args.first)}")
    else:
        parser.error("say make, seal, --list or --describe ID")


if __name__ == "__main__":
    main(Family("family_two", cases, causes, ranges, work), __doc__)
