"""A fleet's folder: which sessions of which robots are in it, and the files that each is calibrated from.

FOLDER/ROBOT/SESSION/   a recording, or a folder of recordings of one session
FOLDER/robots.csv       optional: robot,batch; further columns do not count
rig.toml                in the recording, else the session, else the robot's folder, else FOLDER
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from tautline.errors import TautError, of_system
from tautline.layouts import ANGLE, FRAMES, MARKER
from tautline.layouts import MOTOR as MOTOR_LAYOUT
from tautline.recording import COLOUR_FILE, REGION_FILE, VIDEO_NAMES
from tautline.rig import RIG_FILE

MANIFEST = "robots.csv"
MOTOR = MOTOR_LAYOUT.file
_TABLES = (MOTOR, MARKER.file, ANGLE.file, RIG_FILE)
_OF_VIDEO = (*VIDEO_NAMES, FRAMES.file, COLOUR_FILE, f"{Path(REGION_FILE).stem}.*")  # a region has a picture, too
_DATE = re.compile(r"\d{4}-\d{2}-\d{2}")


@dataclass(frozen=True)
class Session:
    """One session of one robot. A robot's sessions follow each other in the order of their names."""

    robot: str
    name: str
    batch: str | None
    folder: Path
    rig: Path | None  # the rig.toml that holds for all of its recordings; None: there is none

    @property
    def id(self) -> str:
        """ROBOT/SESSION, unique in a fleet."""
        return f"{self.robot}/{self.name}"

    @property
    def date(self) -> str | None:
        """The date (YYYY-MM-DD) with which the session's name begins; None where it begins with none."""
        found = _DATE.match(self.name)
        return found.group() if found else None

    def files(self) -> dict[str, bytes]:
        """Reads all files that a calibration of the session needs, so that they can be sent to a worker on another
        machine. Returns their bytes by path: RECORDING/FILE, and rig.toml for the session's rig. A recording's video is
        read only where it has no marker.csv. TautError where a file cannot be read, or there is no recording."""
        try:
            found = {} if self.rig is None else {RIG_FILE: self.rig.read_bytes()}
            recordings = _recordings(self.folder)
            if not recordings:
                raise TautError(f"holds no {MOTOR}, and no folder with one: it is no session, or was not copied whole")
            for recording in recordings:
                tracked = (recording / MARKER.file).exists()
                wanted = _TABLES if tracked else (*_TABLES, *_OF_VIDEO)
                for path in (each for pattern in wanted for each in sorted(recording.glob(pattern))):
                    if path.is_file():
                        found[f"{recording.name}/{path.name}"] = path.read_bytes()
        except OSError as error:
            raise TautError(of_system(error)) from error
        return found


def digest(files: dict[str, bytes], made_by: str) -> str:
    """A hash (SHA-256, hex) over everything that a session's row depends on: a later run calibrates again where it
    differs. files: as `Session.files` returns them; made_by: the version of the program that calibrates."""
    hashed = hashlib.sha256(made_by.encode())
    for name in sorted(files):
        hashed.update(f"\n{name} ".encode() + hashlib.sha256(files[name]).digest())
    return hashed.hexdigest()


def sessions_in(folder: Path) -> list[Session]:
    """The sessions in a fleet's folder, robot by robot, each robot's in the order of their names. TautError where there
    is no such folder, robots.csv is damaged, or no session has a recording."""
    if not folder.is_dir():
        raise TautError(f"{folder}: there is no such folder: a fleet is a folder ROBOT/SESSION of recordings")
    batches = _batches(folder / MANIFEST)
    found = [
        session for robot in _folders(folder) for session in _sessions_of_robot(folder, robot, batches.get(robot.name))
    ]
    if not any(_recordings(session.folder) for session in found):
        raise TautError(f"{folder}: no session is in it: lay recordings out as {folder.name}/ROBOT/SESSION/{MOTOR}")
    return found


def _sessions_of_robot(folder: Path, robot: Path, batch: str | None) -> Iterator[Session]:
    """Yields the sessions in the folder `robot` of the fleet's `folder`, in the order of names, also those that hold no
    recording. A session's rig is the first rig.toml found in its recordings, the session's folder, the robot's, and the
    fleet's, in this order."""
    for session in _folders(robot):
        places = (*_recordings(session), session, robot, folder)
        rig = next((at / RIG_FILE for at in places if (at / RIG_FILE).is_file()), None)
        yield Session(robot=robot.name, name=session.name, batch=batch, folder=session, rig=rig)


def _recordings(session: Path) -> list[Path]:
    """The folders of a session's recordings: the session's own folder if it holds a motor.csv, else the folders in it
    that hold one."""
    if (session / MOTOR).exists():
        return [session]
    return [each for each in _folders(session) if (each / MOTOR).exists()]


def _folders(folder: Path) -> list[Path]:
    """The folders in `folder`, in the order of names, without hidden ones (.NAME)."""
    return sorted(each for each in folder.iterdir() if each.is_dir() and not each.name.startswith("."))


def _batches(manifest: Path) -> dict[str, str]:
    """Reads the batch of each robot that has one from `manifest` (robots.csv), by robot; of several lines of one robot
    the last counts. Empty without the file or its column `batch`. TautError where the file cannot be read, or has no
    column `robot`."""
    if not manifest.exists():
        return {}
    try:
        table = pd.read_csv(manifest, dtype=str, skipinitialspace=True)
    except (OSError, ValueError) as error:
        raise TautError(f"{manifest}: cannot be read ({error}): it is a CSV with the columns robot, batch") from error
    if "robot" not in table:
        raise TautError(f"{manifest}: column robot is missing: it says which robot a line is of")
    named = table.dropna(subset=["robot"]).drop_duplicates("robot", keep="last").set_index("robot")
    return {} if "batch" not in named else {str(k): str(v) for k, v in named["batch"].dropna().items()}
