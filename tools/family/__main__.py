"""`python -m tools.family make --seed S --cases N --out DIR`, `diagnose`, `score`, `seal`, `--list`, `--describe`."""

import argparse
import sys
from collections import Counter
from pathlib import Path

from tools.family import cases, record, score, seal, work
from tools.family.causes import LISTED, NOMINAL, UNLISTED
from tools.family.mechanisms import MECHANISMS


def listing() -> str:
    lines = ["mechanisms:"]
    lines += [f"  {name:10s} {(m.__doc__ or '').splitlines()[0]}" for name, m in MECHANISMS.items()]
    lines += ["effects of formats.md:"]
    lines += [f"  {i:38s} {c.says}" for i, c in LISTED.items()]
    lines += ["causes that no list holds:"]
    lines += [f"  {i:38s} {c.says}" for i, c in UNLISTED.items()]
    lines += [f"only moved: {', '.join(NOMINAL)}", "ranges:"]
    lines += [f"  {n:16s} {r.lo:g} to {r.hi:g} {r.unit}  [{r.source}]" for n, r in record.ranges_table()]
    return "\n".join(lines)


def describe(name: str) -> str:
    if name in MECHANISMS:
        return MECHANISMS[name].__doc__ or ""
    kinds = LISTED | UNLISTED
    if name not in kinds:
        sys.exit(f"no mechanism or cause is called {name}: `python -m tools.family --list` has them all")
    kind = kinds[name]
    limits = kind.limits
    notes = [
        f"{name}: {kind.says}",
        f"strength {limits.lo:g} to {limits.hi:g} {limits.unit}",
        f"source: {limits.source}",
        f"may be there while calibrating: {'yes' if kind.may_start else 'no'}",
        f"binned by the gap {'before (recalibration closes it)' if kind.moves else 'that a refit leaves'}",
    ]
    return "\n".join(notes)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tools.family", description=__doc__)
    parser.add_argument("--list", action="store_true", help="mechanisms, causes and ranges with their sources")
    parser.add_argument("--describe", metavar="ID", help="one mechanism or cause")
    verbs = parser.add_subparsers(dest="verb")
    maker = verbs.add_parser("make", help="write cases")
    maker.add_argument("--seed", type=int, required=True)
    maker.add_argument("--cases", type=int, default=300)
    maker.add_argument("--out", type=Path, required=True)
    maker.add_argument("--truth", type=Path, help="where the truths go (default OUT/truth)")
    maker.add_argument("--processes", type=int, default=1)
    user = verbs.add_parser(
        "diagnose", help="`taut diagnose` and both `taut predict` of every case that is not done yet"
    )
    user.add_argument("folder", type=Path)
    user.add_argument("--out", type=Path, required=True)
    user.add_argument("--processes", type=int, default=1)
    sealer = verbs.add_parser("seal", help="print the fingerprints of a seed")
    sealer.add_argument("--seed", type=int, required=True)
    sealer.add_argument("--cases", type=int, default=300)
    sealer.add_argument("--truth", type=Path, help="a folder of truths, to hash them as well")
    sealer.add_argument("--first", type=int, default=300, help="how many of the truths")
    scorer = verbs.add_parser("score", help="score diagnoses against truths")
    score.arguments(scorer)
    args = parser.parse_args()
    if args.list:
        print(listing())
    elif args.describe:
        print(describe(args.describe))
    elif args.verb == "make":
        truths = args.truth or args.out / "truth"
        work.make(args.seed, args.cases, args.out, truths, args.processes)
        kinds = Counter(kind for kind, _ in cases.plan(args.seed, args.cases))
        print(f"{args.out}: " + ", ".join(f"{n} {k}" for k, n in kinds.items()))
    elif args.verb == "seal":
        print(f"sources {seal.sources()}\nplan    {seal.planned(args.seed, args.cases)}")
        if args.truth:
            print(f"truths  {seal.truths(args.truth, args.first)}")
    elif args.verb == "diagnose":
        if complaints := work.diagnose(args.folder, args.out, args.processes):
            sys.exit("\n".join(complaints))
    elif args.verb == "score":
        score.command(args)
    else:
        parser.error("say make, diagnose, score, seal, --list or --describe ID")


if __name__ == "__main__":
    main()
