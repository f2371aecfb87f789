"""python -m tools.family_evidence DIR: diagnoses a family's cases, and keeps what each verdict was worked out from.

DIR is as `python -m tools.family_two make --out DIR`, or another family's command, wrote it. DIR/diagnoses/NAME gets
what `tools.blindtest.work` writes (diagnosis.json, evidence.json, cost.json, both models) and what these predict of the
unseen motion (nominal.csv, corrected.csv): `python -m tools.learning DIR` learns from it, and `python -m tools.family
score DIR/diagnoses --truth DIR/truth --predictions DIR/diagnoses` scores it.
"""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

import click
from rich.progress import Progress

from tautline.folders import unpacked_folder
from tautline.model import Model
from tautline.prediction import predict_with_sigma, times_of, write_csv
from tautline.recording import load_motor
from tools.blindtest import sealed, work

CASES, UNSEEN, TRUTH = "cases", "unseen", "truth"


def diagnose_case(family: Path, name: str) -> None:
    """Writes DIR/diagnoses/NAME of one case; a case that fails has a diagnosis.json that says so, and no models."""
    unseen = family / UNSEEN / name
    with unpacked_folder(work.diagnose_folder(family / CASES / name)) as said:
        for which in ("nominal", "corrected") if (said / work.EVIDENCE).exists() else ():
            model = Model.load(said / which)
            motor = load_motor(unseen, model.rig, [])
            times = times_of(model, unseen, motor, unseen / "times.csv", [])
            write_csv(said / f"{which}.csv", times, predict_with_sigma(model, motor, times.scene_s))
        sealed.write(family / sealed.DIAGNOSES / name, sealed.read(said))  # whole: what is there is done


@click.command(help=__doc__)
@click.argument("family", metavar="DIR", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--processes", type=click.IntRange(1), default=1, show_default=True)
def main(family: Path, processes: int) -> None:
    """Diagnoses all cases that have no diagnosis yet."""
    done = family / sealed.DIAGNOSES
    names = sorted(p.name for p in (family / CASES).iterdir() if not (done / p.name).exists())
    with Progress() as progress, ProcessPoolExecutor(processes) as pool:
        bar = progress.add_task("diagnoses", total=len(names))
        for case in as_completed([pool.submit(diagnose_case, family, name) for name in names]):
            case.result()
            progress.update(bar, advance=1)


if __name__ == "__main__":
    main()
