"""taut fleet FOLDER --out FLEET"""

from __future__ import annotations

from pathlib import Path

import click

from tautline.cli._common import emit, json_option, log, progress_bar
from tautline.cli._outputs import folder_option
from tautline.errors import TautError


@click.command("fleet")
@click.argument("folder", type=click.Path(path_type=Path))
@folder_option("--out", "Where results go. Default: FOLDER-fleet beside it.", required=False)
@click.option("--cluster", metavar="ADDRESS", help="Work on a Dask cluster: its scheduler's address.")
@click.option("--jobs", type=click.IntRange(1), help="Processes on this machine. Default: one on each core.")
@json_option
def command(folder: Path, out: Path | None, cluster: str | None, jobs: int | None, as_json: bool) -> None:
    """Calibrate every session of many robots, and say who drifts, which batch is worn, what is unlike.

    FOLDER holds ROBOT/SESSION, each session a recording or a folder of recordings, and a rig.toml. What was done is not
    done again: only what is new, or has changed, is calibrated.
    """
    from tautline.fleet import page, prior
    from tautline.fleet.findings import findings
    from tautline.fleet.rows import DATA_SET
    from tautline.fleet.run import row_of_lost_worker, run
    from tautline.pool import pool

    out = out or folder.absolute().with_name(f"{folder.absolute().name}-fleet")
    with progress_bar("fleet") as progress, pool(jobs, cluster, row_of_lost_worker) as workers:
        done = run(folder, out, workers, progress)
    for row in done.rows:
        if row.error is not None:
            log(f"taut: {row.id}: {row.error}")
    found = findings(done.rows)
    page.write(done.rows, found, out)
    lines = [*found.sentences(), f"{out / page.FILE} shows it."]
    try:
        prior.write(done.rows, out)
        lines.append(f"A shorter calibration of the next robot: 'taut calibrate RECORDING --out MODEL --prior {out}'.")
    except TautError as error:
        (out / prior.FILE).unlink(missing_ok=True)  # of an earlier run
        log(f"taut: nothing is known beforehand of the next robot: {error}")
    result = {
        **found.to_json(),
        "new": done.new,
        "errors": {row.id: row.error for row in done.rows if row.error is not None},
        "data": out / DATA_SET,
        "report": out / page.FILE,
    }
    emit(result, as_json, "\n".join(lines))
