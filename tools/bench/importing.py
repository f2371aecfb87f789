"""./run bench importing: rows, seconds and peak memory of an import, each in a process of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from tautline.errors import TautError
from tautline.io.importing.libraries import library

RATE_HZ = 5000.0  # of the motor: half of what a recording may have
BLOCK = 100_000  # rows that are written at once
_RUN = "import sys; from tautline.cli import main; sys.argv[0] = 'taut'; main()"


def motion(first: int, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """t_s, q and c of rows: a sine of 30 deg, and a tip that lags by 20 ms."""
    t_s = np.arange(first, first + count) / RATE_HZ
    return t_s, 30.0 * np.sin(0.7 * t_s), 27.0 * np.sin(0.7 * (t_s - 0.02))


def write_csv(folder: Path, rows: int) -> tuple[Path, list[str]]:
    path = folder / "log.csv"
    with path.open("w") as stream:
        stream.write("Zeit [s];Soll [deg];Motor [deg];Gelenk [deg];Moment [Nm]\n")
        for first in range(0, rows, BLOCK):
            t_s, q, c = motion(first, min(BLOCK, rows - first))
            for row in zip(t_s, q, q, c, c, strict=True):
                stream.write(";".join(f"{x:.6f}" for x in row).replace(".", ",") + "\n")
    named = ["--motor", "Motor [deg]", "--tip", "Gelenk [deg]", "--command", "Soll [deg]", "--load", "Moment [Nm]"]
    return path, named


def write_lerobot(folder: Path, rows: int) -> tuple[Path, list[str]]:
    arrow, parquet = library("pyarrow", "the benchmark"), library("pyarrow.parquet", "the benchmark")
    root = folder / "set"
    for inner in ("meta/episodes/chunk-000", "data/chunk-000"):
        (root / inner).mkdir(parents=True)
    joints = ["pan.pos", "lift.pos", "elbow.pos", "wrist.pos", "roll.pos", "gripper.pos"]
    feature = {"dtype": "float32", "shape": [6], "names": joints, "unit": "deg"}
    data_path = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
    info = {
        "codebase_version": "v3.0",
        "data_path": data_path,
        "features": {"action": feature, "observation.state": feature},
    }
    (root / "meta/info.json").write_text(json.dumps(info))
    episode = {"episode_index": 0, "length": rows, "data/chunk_index": 0, "data/file_index": 0}
    parquet.write_table(arrow.Table.from_pylist([episode]), root / "meta/episodes/chunk-000/file-000.parquet")
    writer = None
    for first in range(0, rows, BLOCK):
        t_s, q, c = motion(first, min(BLOCK, rows - first))
        six = [arrow.FixedSizeListArray.from_arrays(arrow.array(np.repeat(x, 6), arrow.float32()), 6) for x in (q, c)]
        table = arrow.table(
            {
                "action": six[0],
                "observation.state": six[1],
                "timestamp": arrow.array(t_s),
                "episode_index": np.zeros(len(t_s), int),
            }
        )
        writer = writer or parquet.ParquetWriter(root / data_path.format(chunk_index=0, file_index=0), table.schema)
        writer.write_table(table)
    if writer is not None:
        writer.close()
    return root, ["--motor", "action[0]", "--tip", "observation.state[0]"]


def write_mcap(folder: Path, rows: int) -> tuple[Path, list[str]]:
    path = folder / "log.mcap"
    with path.open("wb") as stream:
        writer = library("mcap.writer", "the benchmark").Writer(stream)
        writer.start()
        schema = writer.register_schema("robot", "jsonschema", b'{"type": "object"}')
        channel = writer.register_channel("/robot", "json", schema)
        for first in range(0, rows, BLOCK):
            for t, q, c in zip(*motion(first, min(BLOCK, rows - first)), strict=True):
                message = f'{{"q_deg": {q:.9g}, "c_deg": {c:.9g}, "load": 0.5}}'.encode()
                writer.add_message(channel, round(1e9 * t), message, round(1e9 * t))
        writer.finish()
    return path, ["--motor", "/robot.q_deg", "--tip", "/robot.c_deg", "--load", "/robot.load"]


FORMATS: dict[str, Callable[[Path, int], tuple[Path, list[str]]]] = {
    "CSV, decimal commas": write_csv,
    "LeRobot v3.0, 12 columns": write_lerobot,
    "MCAP, JSON": write_mcap,
}


def measure(words: list[str]) -> tuple[float, float]:
    """Seconds and peak MB of a taut command."""
    began = time.perf_counter()
    process = subprocess.Popen([sys.executable, "-c", _RUN, *words], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    assert process.stderr is not None
    said = process.stderr.read().decode()
    _, status, used = os.wait4(process.pid, 0)
    if status:
        raise TautError(said.strip().splitlines()[-1] if said.strip() else f"taut {words[0]} failed")
    return time.perf_counter() - began, used.ru_maxrss / 1024.0


@click.command("importing")
@click.option("--rows", type=click.IntRange(1000), default=3_000_000, show_default=True)
@click.option("--only", type=click.Choice(list(FORMATS)), help="One format.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as one JSON object on stdout.")
def command(rows: int, only: str | None, as_json: bool) -> None:
    """What 'taut import' costs: a listing with its proposal, and an import."""
    found = []
    for name, write in FORMATS.items():
        if only not in (None, name):
            continue
        with TemporaryDirectory(prefix="taut-bench-") as made:
            path, named = write(Path(made), rows)
            for what, words in (("proposal", []), ("import", [*named, "--out", str(Path(made) / "out")])):
                seconds, megabytes = measure(["import", str(path), *words, "--json"])
                found.append({"format": name, "step": what, "rows": rows, "seconds": seconds, "peak_mb": megabytes})
    if as_json:
        click.echo(json.dumps({"importing": found}))
        return
    table = Table(title="taut import")
    for name in ("format", "step", "rows", "s", "peak, MB"):
        table.add_column(name, justify="left" if name in ("format", "step") else "right")
    for row in found:
        table.add_row(row["format"], row["step"], f"{rows:,}", f"{row['seconds']:.1f}", f"{row['peak_mb']:.0f}")
    Console().print(table)
