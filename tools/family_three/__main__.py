"""`python -m tools.family_three make --seed S --cases N --out DIR`: cases; `seal`, `--list`, `--describe`.

`python -m tools.family score` scores them.
"""

import argparse
import sys
from collections import Counter
from pathlib import Path

from tools.family import seal
from tools.family_three import cases, ranges, work
from tools.family_three.causes import LISTED, NOMINAL, UNLISTED

HERE = Path(__file__).parent


def listing() -> str:
    lines = ["mechanisms:"]
    lines += [f"  {name:10s} {(m.__doc__ or '').splitlines()[0]}" for name, m in cases.MECHANISMS.items()]
    lines += ["effects of formats.md:"]
    lines += [f"  {i:38s} {c.says}" for i, c in LISTED.items()]
    lines += ["causes that no list holds:"]
    lines += [f"  {i:38s} {c.says}" for i, c in UNLISTED.items()]
    every = [(n, r) for n, r in vars(ranges).items() if isinstance(r, ranges.Range)]
    lines += [f"only moved: {', '.join(NOMINAL)}", "ranges:"]
    lines += [f"  {n:16s} {r.lo:g} to {r.hi:g} {r.unit}  [{r.source}]" for n, r in every]
    return "\n".join(lines)


def describe(name: str) -> str:
    if name in cases.MECHANISMS:
        return cases.MECHANISMS[name].__doc__ or ""
    kinds = LISTED | UNLISTED
    if name not in kinds:
        sys.exit(f"no mechanism or cause is called {name}: `python -m tools.family_three --list` has them all")
    kind = kinds[name]
    notes = [
        f"{name}: {kind.says}",
        f"strength {kind.limits.lo:g} to {kind.limits.hi:g} {kind.limits.unit}",
        f"source: {kind.limits.source}",
        f"may be there while calibrating: {'yes' if kind.may_start else 'no'}",
        f"binned by the gap {'before (recalibration closes it)' if kind.moves else 'that a refit leaves'}",
    ]
    return "\n".join(notes)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tools.family_three", description=__doc__)
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
        print(listing())
    elif args.describe:
        print(describe(args.describe))
    elif args.verb == "make":
        work.make(args.seed, args.cases, args.out, args.truth or args.out / "truth", args.processes, args.first)
        kinds = Counter(kind for kind, _ in cases.plan(args.seed, args.cases)[: args.first])
        print(f"{args.out}: " + ", ".join(f"{n} {k}" for k, n in kinds.items()))
    elif args.verb == "seal":
        print(f"sources {seal.sources(HERE)}\nplan    {seal.planned(args.seed, args.cases, cases.plan)}")
        if args.truth:
            print(f"truths  {seal.truths(args.truth, args.first)}")
    else:
        parser.error("say make, seal, --list or --describe ID")


if __name__ == "__main__":
    main()
