"""./run bench bare: what a calibration makes of an instrument without a marker, beside what a marker gives.

Each world is drawn twice: bare, followed by a square that is shown in its first picture, and with a marker, moved by
the same motor over the same tissue. The square is one that lies on the instrument: as wide as the tip, in the middle of
its rigid part, which was bent until the camera sees it from its side. A tip whose tendon is torn is drawn once, bare,
and shows itself as it hangs. OUT keeps a line of JSON and a picture of each; what is there is not done again.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

import click
import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from tautline.cli._common import json_option, log, progress_bar
from tautline.plain import plain
from tautline.pool import pool
from tools.bench import endoscopy, tube
from tools.bench.videos import Outcome, backgrounds, bends, said

WIDEST_PX = 48  # of a square that is shown
NEAR = 2.0  # times the marker's error, beyond which a good verdict is wrong
SHEET_PX = 180  # height of one picture on the sheet of all


@dataclass(frozen=True)
class Pair:
    """bare, marked: None where the calibration refuses, which `refused` then says of the bare one. onsets: reversals
    after which the tip is said to have been seen to begin to move. bends_deg, bends_sigma_deg: error of f_remain and
    its stated sigma, rms within `measured`."""

    kind: str
    seed: int
    scene: dict[str, Any]
    bare: Outcome | None
    marked: Outcome | None
    onsets: int = 0
    bends_deg: float = float("nan")
    bends_sigma_deg: float = float("nan")
    refused: str = ""

    @classmethod
    def read(cls, line: str) -> Self:
        row = json.loads(line)
        for key in ("bare", "marked"):
            if row[key] is not None:
                row[key] = Outcome(**{**_numbers(row[key]), "reasons": tuple(row[key]["reasons"])})
        return cls(**_numbers(row))

    @property
    def good(self) -> bool:
        return self.bare is not None and self.bare.verdict == "good"

    @property
    def near(self) -> bool:
        """B is as near the truth as the Show asks."""
        return bool(self.bare and self.marked and self.bare.error_um <= NEAR * self.marked.error_um)

    @property
    def holds(self) -> bool:
        return not self.onsets if self.kind == "torn" else self.near or not self.good

    def cells(self) -> list[str]:
        marked = f"{self.marked.error_um:.2f}" if self.marked else "-"
        scene = tube.Scene(**self.scene)
        looks = f"{scene.texture:.2f}, {scene.breath_px:.0f}, {scene.glint:.0f}, {scene.smoke:.2f}, {scene.codec}"
        first = [self.kind, str(self.seed), looks]
        if (o := self.bare) is None:
            return [*first, "-", "-", "-", "-", "-", marked, "0", "refused", self.refused]
        return [
            *first, f"{o.error_um:.2f}", f"{o.sigma_um:.2f}", f"{o.z:.2f}", f"{self.bends_deg:.2f}",
            f"{self.bends_sigma_deg:.2f}", marked, str(self.onsets), o.verdict, ", ".join(o.reasons),
        ]  # fmt: skip


_COLUMNS = (
    "", "seed", "texture, breath px, glint, smoke", "B off, um", "sigma", "z", "f off, deg", "sigma",
    "a marker's, um", "onsets", "verdict", "reasons",
)  # fmt: skip


def _numbers(row: dict[str, Any]) -> dict[str, Any]:
    """JSON has no NaN."""
    nothing = float("nan")
    return {
        key: nothing if value is None and key.endswith(("_um", "_deg", "z")) else value for key, value in row.items()
    }


def run(
    wanted: Sequence[tuple[int, str]],
    out: Path,
    say: Callable[[float, str], None],
    done: Callable[[Pair], None],
    jobs: int | None = 1,
) -> list[Pair]:
    """What is not yet in `out`, and all that was wanted."""
    out.mkdir(parents=True, exist_ok=True)
    lines = out / "pairs.jsonl"
    there = [Pair.read(line) for line in lines.read_text(encoding="utf-8").splitlines()] if lines.is_file() else []
    found = {(pair.kind, pair.seed): pair for pair in there}
    left = [(seed, kind) for seed, kind in wanted if (kind, seed) not in found]
    work = ((f"{kind}, seed {seed}", (kind, seed, out / f"{kind}-{seed}.jpg")) for seed, kind in left)
    with pool(jobs, None) as workers:
        for k, (name, pair) in enumerate(workers(_pair, work)):
            found[pair.kind, pair.seed] = pair
            with lines.open("a", encoding="utf-8") as file:
                file.write(json.dumps(plain(asdict(pair)), allow_nan=False) + "\n")
            done(pair)
            say((k + 1) / len(left), name)
    order = {kind: k for k, kind in enumerate(tube.KINDS)}
    return sorted((found[kind, seed] for seed, kind in wanted), key=lambda pair: (order[pair.kind], pair.seed))


def _behind(seed: int) -> np.ndarray | None:
    """Always a real frame, where there are any."""
    real = backgrounds()
    return real[seed % len(real)] if real else None


def _pair(kind: str, seed: int, picture: Path) -> Pair:
    with tempfile.TemporaryDirectory() as room:
        return _calibrated_twice(Path(room), kind, seed, picture)


def _calibrated_twice(room: Path, kind: str, seed: int, picture: Path) -> Pair:
    scene, marked = tube.Scene.drawn(kind, seed), None
    world, folder = tube.BareWorld(scene, seed, _behind(seed)), room / "bare"
    endoscopy.write(folder, world)
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    video = next(folder.glob("video.*"))
    u, v = world.patch(world.t[:1])[0]
    _shown(video, (float(u), float(v)), world.side_px, picture)
    said("marker", str(video), "--region", f"{u:.1f},{v:.1f},{world.side_px:.1f}")
    if not scene.still:
        endoscopy.write(room / "marked", tube.MarkedWorld(scene, seed, _behind(seed)))
        marked = _calibrated(room / "marked", kind, seed, truth)
    bare = _calibrated(folder, kind, seed, truth)
    outcome = marked[0] if isinstance(marked, tuple) else None
    if isinstance(bare, str):
        return Pair(kind, seed, asdict(scene), None, outcome, refused=bare)
    onsets = sum(bool(onset["used"]) for onset in bare[1]["onsets"])
    return Pair(kind, seed, asdict(scene), bare[0], outcome, onsets, *bends(bare[1], truth))


def _calibrated(folder: Path, kind: str, seed: int, truth: dict[str, Any]) -> tuple[Outcome, dict[str, Any]] | str:
    try:
        status, document = said("calibrate", str(folder), "--out", str(folder) + "-model")
    except RuntimeError as error:
        return str(error)
    return Outcome.of(kind, seed, status, document, truth), document


def _shown(video: Path, at: tuple[float, float], side_px: float, picture: Path) -> None:
    """A frame from the middle of the video, half its size; beside it the square in the first one, twice its size."""
    capture = cv2.VideoCapture(str(video))
    first = capture.read()[1]
    for _ in range(int(capture.get(cv2.CAP_PROP_FRAME_COUNT)) // 2):
        capture.grab()
    frame = capture.retrieve()[1]
    half = cv2.resize(frame, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    side, high = round(side_px), half.shape[0] // 2
    cut = cv2.getRectSubPix(first, (2 * side, high), at)
    corner = side // 2, (high - side) // 2
    cv2.rectangle(cut, corner, (corner[0] + side, corner[1] + side), (255, 255, 255), 1)
    large = cv2.resize(cut, None, fx=2.0, fy=2.0, interpolation=cv2.INTER_CUBIC)
    # Beside each other on the sheet: all are as wide as the widest square.
    room = np.full((half.shape[0], 4 * WIDEST_PX, 3), 255, np.uint8)
    room[: large.shape[0], : large.shape[1]] = large[: room.shape[0], : room.shape[1]]
    cv2.imwrite(str(picture), np.hstack([half, room]))


def _sheet(pairs: Sequence[Pair], out: Path) -> None:
    """One picture of all, each with what was made of it."""
    cells = []
    for pair in pairs:
        cell = cv2.imread(str(out / f"{pair.kind}-{pair.seed}.jpg"))
        cell = cv2.resize(cell, None, fx=SHEET_PX / cell.shape[0], fy=SHEET_PX / cell.shape[0])
        says = f"{pair.onsets} onsets" if pair.kind == "torn" else f"{pair.cells()[3]} ({pair.cells()[8]})"
        says = f"{pair.kind} {pair.seed}: {says} {pair.cells()[10]}"
        cell = cv2.copyMakeBorder(cell, 22, 4, 2, 2, cv2.BORDER_CONSTANT, value=(255, 255, 255))
        colour = (40, 110, 30) if pair.holds else (30, 30, 200)
        cells.append(cv2.putText(cell, says, (4, 15), cv2.FONT_HERSHEY_SIMPLEX, 0.42, colour, 1, cv2.LINE_AA))
    cells += [np.full_like(cells[0], 255)] * (-len(cells) % 5)
    cv2.imwrite(str(out / "sheet.png"), np.vstack([np.hstack(cells[k : k + 5]) for k in range(0, len(cells), 5)]))


def _summary(pairs: Sequence[Pair]) -> list[str]:
    lines = []
    for kind in tube.KINDS:
        own = [pair for pair in pairs if pair.kind == kind]
        if not own:
            continue
        if kind == "torn":
            believed = sum(pair.bare is not None and pair.bare.verdict != "unusable" for pair in own)
            lines.append(
                f"torn: onsets in {sum(pair.onsets > 0 for pair in own)} of {len(own)} recordings of a tip that does "
                f"not move, not called unusable {believed}"
            )
            continue
        covered = sum(pair.bare is not None and pair.bare.z <= NEAR for pair in own)
        lines.append(
            f"{kind}: B within {NEAR:g} times the marker's error, or not called good: {sum(p.holds for p in own)} of "
            f"{len(own)}; within: {sum(p.near for p in own)}; good: {sum(p.good for p in own)}; z at most 2: {covered}"
        )
    return lines


@click.command("bare")
@click.option("--torn", type=click.IntRange(0, 1000), default=20, show_default=True, help="Tips that do not move.")
@click.option("--clean", type=click.IntRange(0, 1000), default=20, show_default=True, help="Nothing but a real frame.")
@click.option(
    "--hard", type=click.IntRange(0, 1000), default=20, show_default=True,
    help="Tissue that breathes, glints, smoke, H.264.",
)  # fmt: skip
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The first one of each kind.")
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), default=Path("build/bare"), show_default=True,
    help="What is there already is not done again.",
)  # fmt: skip
@click.option("--jobs", type=click.IntRange(1), help="Processes. Default: one on each core.")
@json_option
def command(torn: int, clean: int, hard: int, seed: int, out: Path, jobs: int | None, as_json: bool) -> None:
    """Calibrates from videos of an instrument without a marker; of torn tendons too, which move nothing."""
    numbers = zip(tube.KINDS, (torn, clean, hard), strict=True)
    wanted = sorted((seed + k, kind) for kind, number in numbers for k in range(number))
    if not backgrounds():
        log("no folder shared/data/backgrounds above the repository: all seeds are drawn over tissue made here")
    with progress_bar("bare") as progress:
        pairs = run(wanted, out, progress, lambda pair: log("  ".join(pair.cells())), jobs)
    if not pairs:
        return
    _sheet(pairs, out)
    if as_json:
        click.echo(json.dumps(plain([asdict(pair) for pair in pairs]), allow_nan=False))
        return
    table = Table(title="B(q) without a marker, and with one: error and stated sigma, rms within `measured`")
    for name in _COLUMNS:
        table.add_column(name, justify="left" if name in ("", "verdict", "reasons") else "right")
    for pair in pairs:
        table.add_row(*pair.cells())
    Console(width=None if sys.stdout.isatty() else 180).print(table)
    for line in _summary(pairs):
        click.echo(line)
    click.echo(f"each of them: {out / 'sheet.png'}")
