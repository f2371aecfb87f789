"""A source opened by what it is, and its episodes written as recordings that say where they came from."""

from __future__ import annotations

import hashlib
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import tomli_w

from tautline import __version__, recording
from tautline.errors import TautError
from tautline.folders import check_replaceable, replaced_folder
from tautline.io.importing.assemble import Assembled, Roles, assemble
from tautline.io.importing.delimited import Delimited
from tautline.io.importing.lerobot import LeRobot, is_dataset
from tautline.io.importing.listing import Listing, Progress, check_episode, resolve
from tautline.io.importing.mcap import Mcap
from tautline.io.importing.propose import Proposal
from tautline.io.importing.rosbag import Rosbag
from tautline.io.importing.source import Source, no_messages_error
from tautline.io.importing.units import Named, parse_channel
from tautline.layouts import MOTOR
from tautline.recording import IMPORT_FILE
from tautline.rig import Rig

FORMAT = "import/1"
_HASHED_BYTES = 1 << 20  # limit: of memory: at once
_BAG = "metadata.yaml"


@dataclass(frozen=True)
class Imported:
    """A recording that was written."""

    episode: int
    folder: Path
    rows: int  # of motor.csv
    channels: Sequence[dict[str, Any]]  # what became of each, as in import.toml
    clock: str  # which times were used, of Clock
    warnings: Sequence[str]


def open_source(path: str | Path, time: str = "") -> Source:
    """Opens the file or folder at a path by its content: an MCAP file, a ROS bag, a LeRobot data set, or else a CSV.
    time: the name of a CSV's column of times, "" finds it. TautError where it is none of these, or `time` is given for
    another kind."""
    path = Path(path)
    source = _recognised_source(path)
    if source is None:
        return Delimited(path, time)
    if time:
        raise TautError(f"--time {time}: goes with a CSV, {path} has times of its own: leave it out")
    return source


def _recognised_source(path: Path) -> Source | None:
    """Opens a file or folder whose kind is recognised by its files or its first bytes; None for a file that may be a
    CSV. TautError, with the remedy, where it is missing, of an unknown kind, or only a part of a bag or a data set."""
    if not path.exists():
        raise TautError(f"{path}: there is no such file or folder")
    if path.is_dir():
        if is_dataset(path):
            return LeRobot(path)
        if (path / _BAG).is_file():
            return Rosbag(path)
        if (path / MOTOR.file).is_file():
            raise TautError(f"{path}: is a recording already: 'taut calibrate {path}' takes it as it is")
        inner = sorted(each.name for each in path.iterdir())[:4]
        raise TautError(
            f"{path}: is no LeRobot data set (meta/info.json) and no ROS 2 bag ({_BAG}; 'ros2 bag reindex' makes it "
            f"again): it holds {', '.join(inner) or 'nothing'}"
        )
    with path.open("rb") as stream:
        start = stream.read(16)
    if start.startswith(b"\x89MCAP"):
        return Mcap(path)
    if start.startswith(b"#ROSBAG"):
        return Rosbag(path)
    if start.startswith(b"SQLite format 3"):
        if (path.parent / _BAG).is_file():
            return Rosbag(path.parent)
        raise TautError(f"{path}: has no {_BAG} beside it: 'ros2 bag reindex {path.parent}' makes it; name the folder")
    if start.startswith(b"PAR1"):
        raise TautError(f"{path}: is one file of a data set: name the folder that holds meta/info.json")
    if path.suffix in (".mcap", ".bag"):
        raise TautError(f"{path}: is cut short or no {path.suffix[1:]} file: its first bytes are {start[:8]!r}")
    return None


def import_episodes(
    source: Source, out: Path, roles: Roles, progress: Progress, unit: str | None = None,
    rig: Rig | None = None, episode: int | None = None,
) -> tuple[list[Imported], list[str]]:  # fmt: skip
    """Imports the episodes of a source, or the one with the number `episode`, as recordings, whole or not at all: a
    single one into the folder `out`, several into OUT/episode_NNNNNN. unit, rig: as in `assemble`. Returns what was
    written, and a line on each of several episodes that was left out and why. TautError where the named episode, or
    every one, cannot be imported, or the source itself would be overwritten."""
    listed = list(source.episodes())
    if not listed:
        raise no_messages_error(source.path)
    if episode is not None:
        check_episode(source, episode)
    read = source.path.resolve()
    if read.parent == out.resolve() and any(map(read.match, recording.FILES)):
        raise TautError(f"{out}: its {read.name} would be overwritten, and is read here: name another --out")
    origin = _origin(source)
    if episode is not None or len(listed) == 1:
        only = listed[0] if episode is None else episode
        check_replaceable(out, MOTOR.file)
        return [_write_recording(source, origin, out, roles, unit, rig, only, progress)], []
    return _import_all(source, origin, listed, out, roles, progress, unit, rig)


def _import_all(
    source: Source, origin: dict[str, Any], listed: Sequence[int], out: Path, roles: Roles, progress: Progress,
    unit: str | None, rig: Rig | None,
) -> tuple[list[Imported], list[str]]:  # fmt: skip
    """`import_episodes` for several episodes, those with the numbers `listed`, into OUT/episode_NNNNNN each. An episode
    that cannot be imported is left out. origin: as of `_origin`. TautError, that of the first episode, where none can
    be imported."""
    written: list[Imported] = []
    skipped: list[str] = []
    first: TautError | None = None
    check_replaceable(out, IMPORT_FILE)
    with replaced_folder(out, IMPORT_FILE, stale=("episode_*", *recording.FILES)) as target:
        for k, each in enumerate(listed):
            progress(k / len(listed), f"episode {each}")
            name = f"episode_{each:06d}"
            try:
                made = _write_recording(source, origin, target / name, roles, unit, rig, each, lambda share, what: None)
            except TautError as error:
                first = first or error
                skipped.append(f"episode {each} was left out: {str(error).replace(str(target), str(out))}")
                continue
            written.append(replace(made, folder=out / name))
        _share_rig([target / f"episode_{each.episode:06d}" for each in written], rig)
        if not written:
            assert first is not None
            raise TautError(str(first).replace(str(target), str(out)))
        document = {"format": FORMAT, "source": origin, "episodes": [each.episode for each in written]}
        (target / IMPORT_FILE).write_bytes(tomli_w.dumps(document | {"skipped": skipped}).encode())
    return written, skipped


def _share_rig(folders: Sequence[Path], named: Rig | None) -> None:
    """Rewrites the rig.toml of all episodes' folders so that they have one rig, as recordings that go together do: it
    covers all ranges, and has the finest encoder step and the coarse law of the episode with the widest range. Does
    nothing where the user named a rig, or no rig.toml was written."""
    files = [folder / "rig.toml" for folder in folders if (folder / "rig.toml").is_file()]
    if named is not None or not files:
        return
    rigs = [Rig.load(file) for file in files]
    whole_range = (min(rig.actuator.range[0] for rig in rigs), max(rig.actuator.range[1] for rig in rigs))
    actuator = replace(rigs[0].actuator, range=whole_range)
    widest = max(rigs, key=lambda rig: rig.actuator.span)  # whose slope is known best
    finest = min(rig.actuator.encoder_resolution for rig in rigs)
    for file in files:
        replace(widest, actuator=replace(actuator, encoder_resolution=finest)).save(file)


def _write_recording(
    source: Source, origin: dict[str, Any], folder: Path, roles: Roles, unit: str | None, rig: Rig | None,
    episode: int, progress: Progress,
) -> Imported:  # fmt: skip
    """Writes one episode as a recording with its import.toml into `folder`. A rig.toml is written if the user named a
    rig, or an angle tells the coarse law; warnings say which. origin: as of `_origin`; unit, rig: as in `assemble`.
    TautError as there."""
    with TemporaryDirectory(prefix="taut-import-") as scratch:
        made = assemble(source, episode, roles, unit, rig, Path(scratch), progress)
        known = made.rig_known or made.recording.angle is not None
        with replaced_folder(folder, MOTOR.file, stale=recording.FILES) as target:
            recording.save(made.recording, target)
            if not known:
                (target / "rig.toml").unlink()
            (target / IMPORT_FILE).write_bytes(tomli_w.dumps(_provenance(source, origin, episode, made)).encode())
    if not known:
        made.warnings.append(
            "no rig.toml was written, as pixels need the camera: name one with --rig, here or to calibrate"
        )
    elif not made.rig_known:
        made.warnings.append(f"rig.toml: range, one count and coarse law are {source.path.name}'s own: check them")
    rows = len(made.recording.motor.t_s)
    return Imported(episode, folder, rows, made.channels, made.clock, (*source.notes, *made.warnings))


def _provenance(source: Source, origin: dict[str, Any], episode: int, made: Assembled) -> dict[str, Any]:
    """The document of import.toml: where a recording came from and what was done to it. origin: as of `_origin`."""
    return {
        "format": FORMAT,
        "source": origin | {"episode": episode},
        "clock": {"used": made.clock, "origin_s": made.origin_s},
        "rig": {"from": "named" if made.rig_known else "the recording"},
        "channels": made.channels,
        "warnings": [*source.notes, *made.warnings],
    }


def _origin(source: Source) -> dict[str, Any]:
    """What import.toml says of the source: path, kind, SHA-256, size in bytes, and tautline's version."""
    hashed, size = _sha256(source.path)
    return {"path": str(source.path), "kind": source.kind, "sha256": hashed, "bytes": size, "taut": __version__}


def _sha256(path: Path) -> tuple[str, int]:
    """SHA-256, hexadecimal, and size in bytes of a file or a folder. A folder's hash is over the names, sizes and
    contents of its files in order; the contents of videos do not go in, as they are large."""
    digest, size = hashlib.sha256(), 0
    files = [path] if path.is_file() else sorted(each for each in path.rglob("*") if each.is_file())
    for file in files:
        length = file.stat().st_size
        size += length
        if path.is_dir():
            digest.update(f"{file.relative_to(path).as_posix()} {length}\n".encode())
        if file.suffix in (".mp4", ".mkv"):
            continue
        with file.open("rb") as stream:
            while part := stream.read(_HASHED_BYTES):
                digest.update(part)
    return digest.hexdigest(), size


def named_roles(roles: Roles, listing: Listing, source: Source, unit: str | None) -> Proposal:
    """The roles that the user has named already, resolved to channels, as a Proposal that `propose` completes. unit: of
    q, None where the user named none. TautError where a name means no channel."""
    known = listing.channels

    def of(text: str) -> Named:
        """The channel that a text (NAME, NAME:UNIT, NAME:FACTOR) means."""
        each = parse_channel(text, known)
        return replace(each, name=resolve(each.name, source, known))

    motor = of(roles.motor) if roles.motor else None
    command, load = of(roles.command) if roles.command else None, of(roles.load) if roles.load else None
    return Proposal(motor, tuple(map(of, roles.tip)), command, load, roles.video, unit or "")


def proposed_command(
    source: Source, out: Path | None, found: Proposal, joints: Sequence[str], episode: int | None, time: str = ""
) -> str:
    """The whole `taut import` command line for a proposal, ready to be copied; "" where the proposal lacks the motor,
    or both tip and video. out, joints, episode, time: the user's options."""
    if found.motor is None or not (found.tip or found.video):
        return ""
    words = ["taut", "import", str(source.path), "--out", str(out or "recording"), "--motor", found.motor.text]
    for each in found.tip:
        words += ["--tip", each.text]
    if found.command is not None:
        words += ["--command", found.command.text]
    if found.load is not None:
        words += ["--load", found.load.text]
    if found.video is not None:
        words += ["--video", found.video]
    for joint in joints:
        words += ["--joint", joint]
    words += ["--unit", found.unit]
    if episode is not None:
        words += ["--episode", str(episode)]
    if time:
        words += ["--time", time]
    return shlex.join(words)
