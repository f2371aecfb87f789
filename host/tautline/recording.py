"""A recording: what motor, marker and sensor did, as a folder of CSV files and perhaps a video."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from filecmp import cmp
from functools import cached_property
from itertools import combinations
from pathlib import Path

import numpy as np
import pandas as pd

from tautline import layouts
from tautline.columns import Columns, read_columns
from tautline.errors import TautError
from tautline.folders import replaced_folder
from tautline.rig import RIG_FILE, Rig
from tautline.value import Value, same

# format of all: what a recording's files may hold

Array = np.ndarray

MAX_MOTOR_STEP_S = 1.0  # beyond it the times are not in seconds
MAX_MOTOR_GAP_S = 3600.0  # limit: between two samples of one log
FARTHEST = 1e4  # spans of the range beyond it
FARTHEST_PX = 1e5
FRAME_COLUMNS = ("width_px", "height_px")  # of marker.csv: what the frames measure
MOST_JOINTS = 8  # limit: that are looked at
VIDEO_NAMES = ("video.mkv", "video.mp4")
_OTHERS = ("q_cmd", "translation_mm", "rotation_deg", "load_mNm")  # of a motor beside t_s and q
_WRITTEN_ROWS = 200_000  # limit: at once: a copy of all of them is not held
PICTURE_NAME = "camera.png"
COLOUR_FILE, REGION_FILE = "marker.toml", "region.toml"  # beside a video: what is followed in it
IMPORT_FILE = "import.toml"  # where a recording came from
_FOLLOWED = (COLOUR_FILE, f"{Path(REGION_FILE).stem}.*")  # with the region's picture
# All that a recording's folder may hold, as patterns: another recording that takes its place leaves none of it.
FILES = (
    *(layout.file for layout in (layouts.MOTOR, layouts.MARKER, layouts.ANGLE, layouts.FRAMES)),
    *(RIG_FILE, *VIDEO_NAMES, PICTURE_NAME, *_FOLLOWED, IMPORT_FILE, "truth.*"),
)


@dataclass(frozen=True, eq=False, repr=False)
class Motor(Value):
    """Encoder samples, negligible delay. All arrays have one length; t_s rises strictly. A motor has a
    hash, so that what is computed from it can be kept with it as the key (encoder.py)."""

    t_s: Array
    q: Array  # bending motor, the rig's unit
    q_cmd: Array | None = None
    translation_mm: Array | None = None  # along the base z axis; None = 0
    rotation_deg: Array | None = None  # about the base z axis; None = 0
    load_mNm: Array | None = None
    extra: Mapping[str, Array] = field(default_factory=dict)  # unknown columns, kept

    def __hash__(self) -> int:  # type: ignore[override]
        """A hash of the number of samples and the last sample alone: equal motors have the same one, and it takes next
        to no time."""
        return hash((len(self.t_s), *self.t_s[-1:], *self.q[-1:]))

    @cached_property
    def period_s(self) -> float:
        """Median time between neighbouring samples, s; there are two at least."""
        return float(np.median(np.diff(self.t_s)))

    @property
    def joints(self) -> dict[str, Array]:
        """Further joints that move, by column name, NAME_deg or NAME_mm, (n,) each: columns of `extra` with a number in
        each row, not all the same; the first MOST_JOINTS of them."""
        numbers = {
            name: values
            for name, values in self.extra.items()
            if name.endswith(("_deg", "_mm")) and np.asarray(values).dtype.kind in "iuf"
        }
        moving = {
            name: values for name, values in numbers.items() if np.isfinite(values).all() and np.ptp(values) > 0.0
        }
        return dict(list(moving.items())[:MOST_JOINTS])

    def resampled(self, t_s: Array, q: Array, joints: Mapping[str, Array]) -> Motor:
        """The motor at other times t_s (n,), s, where it is at q (n,). Its other axes, its load and the columns
        `joints`, each with a value per own sample, are interpolated linearly. Without q_cmd and other further
        columns."""

        def at(values: Array | None) -> Array | None:
            """A column (n,) of the motor's samples, interpolated at t_s; None where there is none."""
            return None if values is None else np.interp(t_s, self.t_s, values)

        return Motor(
            t_s,
            q,
            translation_mm=at(self.translation_mm),
            rotation_deg=at(self.rotation_deg),
            load_mNm=at(self.load_mNm),
            extra={name: np.interp(t_s, self.t_s, values) for name, values in joints.items()},
        )


@dataclass(frozen=True)
class Shown:
    """A square that somebody pointed out in a picture: the place that is followed on an instrument without a marker."""

    at_px: tuple[float, float]
    side_px: float


@dataclass(frozen=True, eq=False, repr=False)
class Marker(Value):
    """Marker positions. t_s is when the frame arrived: it showed the scene t_delay earlier."""

    t_s: Array
    u_px: Array  # NaN where not valid
    v_px: Array
    valid: Array  # bool
    sigma_px: Array | None = None
    extra: Mapping[str, Array] = field(default_factory=dict)
    frame_px: tuple[int, int] | None = None  # width and height of the frames, where they are known
    untimed: int = 0  # frames of its video that frames.csv gives no time: they have no row
    shown: Shown | None = None  # what is followed instead; None: a marker


@dataclass(frozen=True, eq=False, repr=False)
class Angle(Value):
    """An external sensor's bending angle. t_s is when a value arrived: it is delay_s older."""

    t_s: Array
    c_deg: Array  # NaN where not valid
    valid: Array | None = None  # bool; None: all are
    extra: Mapping[str, Array] = field(default_factory=dict)

    @property
    def seen(self) -> Array:
        """(n,) bool: which rows hold a valid angle."""
        finite: Array = np.isfinite(self.c_deg)
        return finite if self.valid is None else finite & self.valid


@dataclass(frozen=True, eq=False, repr=False)
class Video(Value):
    """A video of the tip, and when its frames arrived."""

    path: Path
    arrival_s: Array | None  # of each frame, from frames.csv, NaN where it is not named; None: the container's times


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Value):
    """What was recorded of one motion. At least one of marker, angle and video is there."""

    name: str
    motor: Motor
    marker: Marker | None = None
    angle: Angle | None = None
    video: Video | None = None
    rig: Rig | None = None  # the rig.toml in its folder
    warnings: tuple[str, ...] = field(default=(), compare=False)  # they name files
    picture: Path | None = None  # a frame that was kept


def load(path: str | Path, rig: Rig | None = None) -> Recording:
    """Reads a recording's folder. rig: used in place of a rig.toml in the folder; the result's `rig` is the folder's
    own all the same, None without one. TautError, with file, line and column, where a file cannot be read, no rig is
    known, nothing shows the tip, or times do not overlap the motor's."""
    folder = _folder(path)
    _check_links(folder)
    warnings: list[str] = []
    own = _own_rig(folder, rig, warnings)
    used = rig or own
    if used is None:
        raise TautError(f"{folder}: no rig.toml is here: name one with --rig")
    motor = load_motor(folder, used, warnings)
    marker = _load_marker(folder / "marker.csv", warnings) if (folder / "marker.csv").exists() else None
    angle = _load_angle(folder / "angle.csv", warnings) if (folder / "angle.csv").exists() else None
    video = _find_video(folder, marker is not None, warnings)
    if marker is None and angle is None and video is None:
        raise TautError(f"{folder}: holds no marker.csv, angle.csv, {' or '.join(VIDEO_NAMES)}: one of them is needed")
    if marker is not None:
        _check_overlap(folder / "motor.csv", motor.t_s, folder / "marker.csv", marker.t_s)
    if angle is not None:
        _check_overlap(folder / "motor.csv", motor.t_s, folder / "angle.csv", angle.t_s)
    if video is not None and video.arrival_s is not None and marker is None:  # else marker.csv has the frames' times
        _check_overlap(
            folder / "motor.csv", motor.t_s, folder / "frames.csv", video.arrival_s[np.isfinite(video.arrival_s)]
        )
    picture = folder / PICTURE_NAME
    return Recording(
        folder.resolve().name,
        motor,
        marker,
        angle,
        video,
        rig=own,
        warnings=tuple(warnings),
        picture=picture if picture.is_file() else None,
    )


def load_all(paths: Sequence[str | Path], rig: Rig | None = None) -> list[Recording]:
    """Reads recordings, in the order given, each on its own clock (core.session puts them on one), and makes their
    names unique."""
    return told_apart([load(path, rig) for path in paths])


def told_apart(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings with unique names, as onsets, offsets and reports identify them by name: a number is put behind a
    name that an earlier one has, as in "NAME (2)"."""
    told: list[Recording] = []
    for recording in recordings:
        taken = {other.name for other in told}
        name, number = recording.name, 1
        while name in taken:
            number += 1
            name = f"{recording.name} ({number})"
        told.append(recording if name == recording.name else replace(recording, name=name))
    return told


def shifted(recordings: Sequence[Recording], offsets_s: Mapping[str, float]) -> list[Recording]:
    """The recordings with their offsets, s, by name in offsets_s (0 if not named), subtracted from the times of marker
    and angle."""

    def moved(recording: Recording) -> Recording:
        """The recording with its own offset taken off the times of marker and angle."""
        offset_s = offsets_s.get(recording.name, 0.0)
        marker, angle = recording.marker, recording.angle
        if not offset_s:
            return recording
        return replace(
            recording,
            marker=marker and replace(marker, t_s=marker.t_s - offset_s),
            angle=angle and replace(angle, t_s=angle.t_s - offset_s),
        )

    return [moved(recording) for recording in recordings]


def load_motor(path: str | Path, rig: Rig, warnings: list[str] | None = None) -> Motor:
    """Reads motor.csv of a recording's folder, q in the rig's unit: all that a prediction needs. warnings, TautError:
    as in `read_motor`."""
    return read_motor(_folder(path) / "motor.csv", rig, warnings)


def read_motor(file: Path, rig: Rig, warnings: list[str] | None = None) -> Motor:
    """Reads a file with the columns of motor.csv, q in the rig's unit. An empty column counts as absent. warnings: if
    given, gets what was mended. TautError, with file and line, where it is no such file, is in another unit, or the
    motor is absurdly far beyond the rig's range."""
    warnings = [] if warnings is None else warnings
    unit = rig.actuator.unit
    q_name, other = f"q_{unit}", "q_deg" if unit == "mm" else "q_mm"
    expected = layouts.MOTOR.header(unit)
    columns = read_columns(file, ["t_s"], expected, mend=False)
    if q_name not in columns.names:
        if other in columns.names:
            raise TautError(f'{file}: has column {other}, but the rig\'s actuator.unit is "{unit}": expected {q_name}')
        raise columns.missing(q_name, expected)
    columns.drop_truncated(["t_s", q_name])
    t_s = columns.rising_times()
    _check_motor_times(t_s, str(file), lambda row: f"line {columns.line(row)}")
    _check_reach(columns, q_name, rig)
    known = {
        "q": q_name,
        "q_cmd": f"q_cmd_{unit}",
        "translation_mm": "translation_mm",
        "rotation_deg": "rotation_deg",
        "load_mNm": "load_mNm",
    }
    values = {}
    for key, name in known.items():
        if name not in columns.names:
            continue
        if key != "q" and not np.isfinite(columns.raw(name)).any():
            columns.warnings.append(f"{file}: column {name} is empty: taken as absent")
            continue
        values[key] = columns.finite(name)
    warnings += columns.warnings
    return Motor(t_s=t_s, **values, extra=_extra(columns, {"t_s", *known.values()}))


def check_motor(motor: Motor, name: str = "motor") -> None:
    """Raises TautError for a motor made of arrays that no file could hold: columns of different lengths, values that
    are not finite, times that do not rise or are those of no motor. name: what the message calls it."""
    columns = {each: getattr(motor, each) for each in ("t_s", "q", *_OTHERS) if getattr(motor, each) is not None}
    _check_columns({**columns, **motor.extra}, name, tuple(columns))
    _check_motor_times(motor.t_s, name, _row)


def check(recording: Recording) -> None:
    """Raises TautError for a recording made of arrays that no files could hold; motor, marker and angle are checked."""
    check_motor(recording.motor, f"{recording.name}: motor")
    if (marker := recording.marker) is not None:
        columns = {"t_s": marker.t_s, "u_px": marker.u_px, "v_px": marker.v_px, "valid": marker.valid}
        sigma = {} if marker.sigma_px is None else {"sigma_px": marker.sigma_px}
        _check_columns({**columns, **sigma, **marker.extra}, f"{recording.name}: marker")
    if (angle := recording.angle) is not None:
        valid = {} if angle.valid is None else {"valid": angle.valid}
        _check_columns({"t_s": angle.t_s, "c_deg": angle.c_deg, **valid, **angle.extra}, f"{recording.name}: angle")


def check_distinct(recordings: Sequence[Recording]) -> None:
    """Raises TautError where two recordings hold the same, under whatever names: one would count as evidence twice."""
    for one, other in combinations(recordings, 2):
        alike = all(same(getattr(one, what), getattr(other, what)) for what in ("motor", "marker", "angle"))
        if alike and _same_video(one.video, other.video):
            raise TautError(f"{other.name}: is the same recording as {one.name}: name it once")


def of_another_rig(recordings: Sequence[Recording], rig: Rig) -> Recording | None:
    """The first recording whose own rig.toml is not `rig`; None if there is none."""
    return next((each for each in recordings if each.rig is not None and each.rig != rig), None)


def save(recording: Recording, folder: str | Path) -> None:
    """Writes the recording's folder, whole or not at all. It replaces a recording that was there, with all of FILES;
    other files in the folder stay. TautError where it has no rig, its video is of another type than VIDEO_NAMES, or the
    folder cannot be written."""
    if recording.rig is None:
        raise TautError(f"{folder}: a recording is saved with its rig, which names the unit of q")
    if (video := recording.video) is not None and f"video{video.path.suffix}" not in VIDEO_NAMES:
        raise TautError(f"{video.path}: a recording's video is a {' or '.join(VIDEO_NAMES)}: convert it")
    with replaced_folder(Path(folder), layouts.MOTOR.file, stale=FILES) as target:
        motor, unit = recording.motor, recording.rig.actuator.unit
        recording.rig.save(target / RIG_FILE)
        _write(
            target / "motor.csv",
            {
                "t_s": motor.t_s,
                f"q_{unit}": motor.q,
                f"q_cmd_{unit}": motor.q_cmd,
                "translation_mm": motor.translation_mm,
                "rotation_deg": motor.rotation_deg,
                "load_mNm": motor.load_mNm,
                **motor.extra,
            },
        )
        if (marker := recording.marker) is not None:
            _write(
                target / "marker.csv",
                {
                    "t_s": marker.t_s,
                    "u_px": marker.u_px,
                    "v_px": marker.v_px,
                    "valid": marker.valid.astype(int),
                    "sigma_px": marker.sigma_px,
                    **_sizes(marker),
                    **marker.extra,
                },
            )
        if (angle := recording.angle) is not None:
            valid = None if angle.valid is None else angle.valid.astype(int)
            _write(target / "angle.csv", {"t_s": angle.t_s, "c_deg": angle.c_deg, "valid": valid, **angle.extra})
        if recording.picture is not None:
            shutil.copyfile(recording.picture, target / PICTURE_NAME)
        if video is not None:
            shutil.copyfile(video.path, target / f"video{video.path.suffix}")
            for beside in (each for pattern in _FOLLOWED for each in video.path.parent.glob(pattern)):
                shutil.copyfile(beside, target / beside.name)
            if video.arrival_s is not None:
                seen = np.flatnonzero(np.isfinite(video.arrival_s))
                _write(target / "frames.csv", {"frame": seen, "t_s": video.arrival_s[seen]})


def _same_video(one: Video | None, other: Video | None) -> bool:
    """Whether two videos are the same: the same frames' times and the same bytes, or none at all."""
    if one is None or other is None:
        return one is other
    return same(one.arrival_s, other.arrival_s) and cmp(one.path, other.path, shallow=False)


def _row(row: int) -> str:
    """A row of arrays, from 0, as messages name it."""
    return f"row {row}"


def _check_columns(columns: Mapping[str, Array], name: str, finite: Sequence[str] = ("t_s",)) -> None:
    """Raises TautError unless all columns (n,), by name, have one length, those named in `finite` hold finite numbers
    alone, and t_s rises. name: what the message calls the table."""
    lengths = {each: np.shape(values) for each, values in columns.items()}
    if len(set(lengths.values())) > 1 or any(len(shape) != 1 for shape in lengths.values()):
        told = ", ".join(f"{each} {'x'.join(map(str, shape))}" for each, shape in lengths.items())
        raise TautError(f"{name}: its columns have not one length ({told})")
    for each in finite:
        if (bad := np.flatnonzero(~np.isfinite(columns[each]))).size:
            raise TautError(f"{name}, {_row(bad[0])}: {each} is {columns[each][bad[0]]}, expected a finite number")
    t_s = columns["t_s"]
    if (back := np.flatnonzero(np.diff(t_s) <= 0)).size:
        row = int(back[0]) + 1
        raise TautError(
            f"{name}, {_row(row)}: t_s goes from {t_s[row - 1]:.9g} to {t_s[row]:.9g}: times must rise, on one clock"
        )


def _check_motor_times(t_s: Array, name: str, at: Callable[[int], str]) -> None:
    """Raises TautError where rising times t_s (n,), s, are fewer than two or too far apart for a motor's. name: what
    the message calls it; at: gives the words for the place of a row, by its index."""
    if len(t_s) < 2:
        rows = "a single row" if len(t_s) else "no rows"
        raise TautError(f"{name}: has {rows}: expected encoder samples over some time")
    step = np.diff(t_s)
    if np.median(step) >= MAX_MOTOR_STEP_S:
        raise TautError(f"{name}: rows are {np.median(step):.4g} s apart: expected 10 Hz or more, t_s in seconds")
    if step.max() > MAX_MOTOR_GAP_S:
        row = int(step.argmax()) + 1
        raise TautError(
            f"{name}, {at(row)}: t_s jumps from {t_s[row - 1]:.9g} to {t_s[row]:.9g} s: split the recording there"
        )


def _folder(path: str | Path) -> Path:
    """The path of a recording's folder. TautError where there is no such folder, or it is a file or a model's
    folder."""
    folder = Path(path)
    if not folder.exists():
        raise TautError(f"{folder}: there is no such folder: a recording is a folder with motor.csv")
    if not folder.is_dir():
        raise TautError(f"{folder}: is a file: a recording is the folder that holds motor.csv")
    if (folder / "model.json").exists() and not (folder / "motor.csv").exists():
        raise TautError(f"{folder}: is a model: name the recording, a folder that holds motor.csv")
    return folder


def _check_links(folder: Path) -> None:
    """Raises TautError where a link in the folder leads to nothing: somebody meant a file to be there."""
    for path in sorted(folder.iterdir()):
        if path.is_symlink() and not path.exists():
            raise TautError(
                f"{path}: is a link to {path.readlink()}, which is not there: mount or copy it, or remove the link"
            )


def _check_reach(columns: Columns, name: str, rig: Rig) -> None:
    """Raises TautError where column `name` has the motor more than FARTHEST ranges beyond the rig's range. Adds a
    warning to `columns` where it is more than one range beyond, as its unit may be another."""
    q = columns.finite(name)
    low, high = rig.actuator.range
    beyond = np.maximum(low - q, q - high)
    row = int(beyond.argmax())
    if beyond[row] > FARTHEST * rig.actuator.span:
        raise TautError(
            f"{columns.path}, line {columns.line(row)}: {name} is {q[row]:.6g}, the rig's range is [{low:g}, {high:g}]"
        )
    if beyond[row] > rig.actuator.span:
        columns.warnings.append(
            f"{columns.path}: {name} reaches {q[row]:.6g}, the rig's range is [{low:g}, {high:g}]: is its unit "
            f"{rig.actuator.unit}?"
        )


def _own_rig(folder: Path, rig: Rig | None, warnings: list[str]) -> Rig | None:
    """Reads the folder's rig.toml; None where there is none. rig: another one that was named; with it a damaged
    rig.toml gives None and a warning, without it a TautError. warnings: gets also which keys look misspelt, if this rig
    is the one in use."""
    path = folder / RIG_FILE
    if not path.exists():
        return None
    try:
        own = Rig.load(path)
    except TautError as error:
        if rig is None:
            raise
        warnings.append(f"{error} (ignored: another rig was named)")
        return None
    if rig is None or rig == own:
        warnings += [f"{path}: {said}" for said in own.misspelt]
    return own


def _load_marker(file: Path, warnings: list[str]) -> Marker:
    """Reads marker.csv. A row that is marked as valid without a finite place in an image is taken as not valid, and a
    column sigma_px that is not above 0 in each valid row is left out; `warnings` gets both."""
    columns = read_columns(file, layouts.MARKER.required(), layouts.MARKER.header())
    t_s = columns.rising_times()
    u_px, v_px = columns.raw("u_px"), columns.raw("v_px")
    seen = np.isfinite(u_px) & np.isfinite(v_px)
    valid = columns.flags("valid") if "valid" in columns.names else np.ones(len(t_s), dtype=bool)
    seen &= (np.abs(u_px) < FARTHEST_PX) & (np.abs(v_px) < FARTHEST_PX)
    if lost := int(np.sum(valid & ~seen)):
        columns.warnings.append(f"{file}: {lost} rows without finite u_px, v_px of an image: taken as not valid")
        valid = valid & seen
    sigma_px = None
    if "sigma_px" in columns.names:
        sigma_px = columns.raw("sigma_px")
        if not np.all(np.isfinite(sigma_px[valid]) & (sigma_px[valid] > 0)):
            columns.warnings.append(f"{file}: sigma_px is not above 0 in every valid row: the column is ignored")
            sigma_px = None
    frame_px = _frame_size(columns)
    warnings += columns.warnings
    return Marker(
        t_s,
        np.where(valid, u_px, np.nan),
        np.where(valid, v_px, np.nan),
        valid=valid,
        sigma_px=sigma_px,
        extra=_extra(columns, set(layouts.MARKER.names())),
        frame_px=frame_px,
    )


def _frame_size(columns: Columns) -> tuple[int, int] | None:
    """(width, height) of the frames, px, by columns width_px and height_px; None without them, and, with a warning,
    where they are not the same in each row."""
    if not set(FRAME_COLUMNS) <= set(columns.names):
        return None
    sizes = [columns.raw(name) for name in FRAME_COLUMNS]
    if any(len(np.unique(side)) != 1 or not 1 <= side[0] < FARTHEST_PX for side in sizes):
        columns.warnings.append(f"{columns.path}: {', '.join(FRAME_COLUMNS)} are not one size in all rows: ignored")
        return None
    return int(sizes[0][0]), int(sizes[1][0])


def _sizes(marker: Marker) -> dict[str, Array]:
    """The frames' size, if it is known, as columns width_px and height_px of marker.csv, (n,) each; else no columns."""
    if marker.frame_px is None:
        return {}
    return {name: np.full(len(marker.t_s), n) for name, n in zip(FRAME_COLUMNS, marker.frame_px, strict=True)}


def _load_angle(file: Path, warnings: list[str]) -> Angle:
    """Reads angle.csv. Rows without a finite angle are taken as not valid; `warnings` gets how many there are that were
    not marked so. TautError where no row is valid."""
    columns = read_columns(file, layouts.ANGLE.required(), layouts.ANGLE.header())
    t_s = columns.rising_times()
    c_deg = columns.raw("c_deg")
    finite = np.isfinite(c_deg)
    if not finite.any():
        raise TautError(f"{file}: c_deg holds no number")
    stated = columns.flags("valid") if "valid" in columns.names else None
    valid = finite if stated is None else finite & stated
    if not valid.any():
        raise TautError(f"{file}: no row is valid: check the sensor, or leave the column valid out")
    if lost := int(np.sum(~finite if stated is None else stated & ~finite)):
        columns.warnings.append(f"{file}: {lost} rows have no finite c_deg: taken as not valid")
    warnings += columns.warnings
    or_none = None if stated is None and finite.all() else valid  # None: all are
    extra = _extra(columns, set(layouts.ANGLE.names()))
    return Angle(t_s, np.where(valid, c_deg, np.nan), valid=or_none, extra=extra)


def _find_video(folder: Path, tracked: bool, warnings: list[str]) -> Video | None:
    """The folder's video with its frames' arrival times, s, from frames.csv, NaN for frames not named there; None
    without a video. tracked: whether a marker.csv has the frames' times; if not, `warnings` gets a line where
    frames.csv is missing. TautError for frame numbers that do not rise from 0 or more."""
    path = next((folder / name for name in VIDEO_NAMES if (folder / name).exists()), None)
    if path is None:
        return None
    file = folder / "frames.csv"
    if not file.exists():
        if not tracked:
            warnings.append(
                f"{path}: no frames.csv beside it: the container's times are used, with the first frame at 0"
            )
        return Video(path, None)
    columns = read_columns(file, layouts.FRAMES.required(), layouts.FRAMES.header())
    t_s = columns.rising_times()
    frames = columns.finite("frame")
    if np.any(frames != np.floor(frames)) or frames[0] < 0 or np.any(np.diff(frames) <= 0) or frames[-1] > 1e8:
        raise TautError(f"{file}: column frame must hold rising whole numbers from 0 on")
    arrival_s = np.full(int(frames[-1]) + 1, np.nan)
    arrival_s[frames.astype(np.int64)] = t_s
    warnings += columns.warnings
    return Video(path, arrival_s)


def _check_overlap(motor_file: Path, motor_s: Array, file: Path, t_s: Array) -> None:
    """Raises TautError where a file's rising times t_s (m,) do not overlap the motor's, motor_s (n,), both in s."""
    if t_s[0] <= motor_s[-1] and t_s[-1] >= motor_s[0]:
        return
    raise TautError(
        f"{file}: times {t_s[0]:.6g} to {t_s[-1]:.6g} s do not overlap {motor_file.name}'s "
        f"{motor_s[0]:.6g} to {motor_s[-1]:.6g} s: both must be seconds of one clock"
    )


def _extra(columns: Columns, known: set[str]) -> dict[str, Array]:
    """The columns whose names are not `known`, by name, as they were read."""
    return {name: columns.cells[name] for name in columns.names if name and name not in known}


def _write(path: Path, columns: Mapping[str, Array | None]) -> None:
    """Writes columns (n,), by name, as a CSV file, _WRITTEN_ROWS rows at a time; columns that are None are left out."""
    present = {name: values for name, values in columns.items() if values is not None}
    rows = max((len(values) for values in present.values()), default=0)
    for first in range(0, max(rows, 1), _WRITTEN_ROWS):
        part = pd.DataFrame({name: values[first : first + _WRITTEN_ROWS] for name, values in present.items()})
        part.to_csv(path, index=False, lineterminator="\n", mode="a" if first else "w", header=not first)
