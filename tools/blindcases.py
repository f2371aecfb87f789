"""python -m tools.blindcases SEED WHAT...: diagnoses cases of the second instrument and prints label beside verdict.

WHAT: none, known (every known effect), unknown (every effect outside the library), or one effect's name.
"""

from __future__ import annotations

import time

import click

from tautline.blindtest.cases import make
from tautline.blindtest.reality import KNOWN, UNKNOWN
from tautline.calibration.calibrate import calibrate
from tautline.diagnose.diagnosis import diagnose


@click.command()
@click.argument("seed", type=int)
@click.argument("what", nargs=-1, required=True, type=click.Choice(["none", "known", "unknown", *KNOWN, *UNKNOWN]))
def main(seed: int, what: tuple[str, ...]) -> None:
    for name in what:
        for effect in {"none": [""], "known": list(KNOWN), "unknown": list(UNKNOWN)}.get(name, [name]):
            click.echo(_line(seed, effect))


def _line(seed: int, effect: str) -> str:
    kind = "none" if not effect else "single" if effect in KNOWN else "unknown"
    case = make(seed, kind, (effect,) if effect else ())
    began = time.process_time()
    model = calibrate([case.calibration], case.rig).model
    found = diagnose(model, case.calibration, case.tests).document
    named = ", ".join(f"{e['id']} ({e['probability']:.2f})" for e in found["effects"]) or found["verdict"]
    since = "throughout" if case.label.throughout else "after the calibration"
    gap = found["gap"]
    return (
        f"{effect or 'nothing'}, {since}: {named}; gap {gap['before']:.3f} -> {gap['after']:.3f} px, "
        f"noise {found['noise_floor']:.3f}, {time.process_time() - began:.0f} s"
    )


if __name__ == "__main__":
    main()
