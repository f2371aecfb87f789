"""LeRobot data sets, versions 2.1 (a file for each episode) and 3.0 (episodes side by side in files), by pyarrow."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tautline.errors import TautError
from tautline.io.importing.libraries import library
from tautline.io.importing.source import BATCH_ROWS, Array, Batch, Clip, Fact, no_video_error

INFO = "meta/info.json"
_EPISODES = {"v2": "meta/episodes.jsonl", "v3": "meta/episodes"}
# Features that say where a row is, and measure nothing.
_COUNTERS = ("timestamp", "frame_index", "episode_index", "index", "task_index", "next.done", "next.success")
_EPISODE = "episode_index"  # format: the number of a row's episode, in version 3.0
_FRAME = "frame_index"  # format: of an episode, from 0 on
_STATS = "meta/stats.json"
_OWN = ".pos"  # format: ends the names of joints that LeRobot's own drivers read: degrees or shares, never radians
_UNITS = ("deg", "rad", "mm", "m")


class LeRobot:
    """A LeRobot data set as a Source: its episodes, with one group "" whose channels are the features' numbers."""

    numbers = "feature"

    def __init__(self, path: Path) -> None:
        """Reads meta/info.json and the table of episodes. TautError where they are damaged or of another version."""
        self.path = path
        self.facts: dict[str, Fact] = {}
        self.notes: list[str] = []
        self.origin_s = 0.0
        self._parquet = library("pyarrow.parquet", f"{path}: a LeRobot data set")
        self._arrow_error: type[Exception] = library("pyarrow", "LeRobot").ArrowException
        self._info = self._read_json(path / INFO)
        version = str(self._info.get("codebase_version", ""))
        self._layout = version.split(".")[0]
        if self._layout not in _EPISODES:
            raise TautError(
                f"{path / INFO}: codebase_version is {version!r}: v2.1 and v3.0 are read: convert it with LeRobot first"
            )
        self.kind = f"LeRobot {version}"
        self._features: Mapping[str, Any] = self._info_value("features", dict)
        self.videos = [name for name, each in self._features.items() if each.get("dtype") == "video"]
        self.facts.update({name: Fact("video") for name in self.videos})
        self._numeric = {  # the features whose numbers are channels, by name: their entries in info.json
            name: each
            for name, each in self._features.items()
            if name not in _COUNTERS and str(each.get("dtype", "")).startswith(("float", "int", "uint"))
        }
        self.facts.update(self._numeric_facts())
        self._rows = self._episode_rows()
        if not any(fact.unit for fact in self.facts.values()):
            self.notes.append(
                f"{path / INFO}: says no unit: LeRobot writes degrees (use_degrees) or shares of each joint's range "
                "(-100 to 100) that only its calibration turns into degrees"
            )

    def _numeric_facts(self) -> dict[str, Fact]:
        """The facts on each channel of the numeric features, by the channel's name. Their lowest and highest values are
        those in stats.json, NaN where it says none."""
        file = self.path / _STATS
        stats = self._read_json(file) if file.is_file() else {}
        facts: dict[str, Fact] = {}
        for name, feature in self._numeric.items():
            named = _channel_names(name, feature)
            ends = (_stats_of(stats.get(name), which, len(named)) for which in ("min", "max"))
            for (key, label), low, high in zip(named, *ends, strict=True):
                usual = "deg" if label.endswith(_OWN) else ""
                facts[key] = Fact(str(feature["dtype"]), label, self._stated_unit(feature), usual, low, high)
        return facts

    def episodes(self) -> Sequence[int]:
        """The numbers of the episodes, rising."""
        return sorted(self._rows)

    def batches(self, episode: int, groups: Collection[str] | None = None) -> Iterator[Batch]:
        """Yields the episode's rows as batches of the one group ""; a number of rows that is not the listed one is
        added to `notes`. groups: as every Source takes it, unused. TautError where the file is missing, cut, or lacks
        the column of a feature, of the time or, in version 3.0, of the episode's number."""
        file = self._path_by_template("data_path", **self._template_values(episode, "data"))
        shared = self._layout == "v3"  # others may be in the file, and the column `episode_index` says whose a row is
        columns = [*self._numeric, "timestamp", *([_EPISODE] if shared else [])]
        if not file.is_file():
            raise TautError(f"{file}: is not there, {INFO} says that episode {episode} is in it: copy it too")
        count = 0
        try:
            opened = self._parquet.ParquetFile(file)
            missing = set(columns) - set(opened.schema_arrow.names)
            if missing:
                raise TautError(f"{file}: column {min(missing)} is missing, {INFO} names it")
            frame = {_FRAME} & set(opened.schema_arrow.names) - set(columns)  # its number need not be there
            for batch in opened.iter_batches(BATCH_ROWS, columns=[*columns, *frame]):
                if shared:
                    batch = batch.filter(np.asarray(batch.column(_EPISODE)) == episode)
                if batch.num_rows:
                    count += batch.num_rows
                    yield self._batch(batch, file)
        except (self._arrow_error, OSError) as error:
            what = " ".join(str(error).split())[:120]
            raise TautError(f"{file}: is cut short or no Parquet file ({what}): copy it again") from error
        if count != (length := self._rows[episode].get("length", count)):
            self.notes.append(f"{file}: episode {episode} has {count} rows, its list says {length}")

    def pictures(self, episode: int, video: str) -> Clip:
        """The episode's part of the file of one video, as a clip; in version 2.1 the whole file. TautError where there
        is no such video."""
        if video not in self.videos:
            raise no_video_error(self.path, video, self.videos)
        key = f"videos/{video}"
        path = self._path_by_template("video_path", video_key=video, **self._template_values(episode, key))
        if self._layout == "v2":
            return Clip(path)
        return Clip(
            path,
            self._episode_number(episode, f"{key}/from_timestamp"),
            self._episode_number(episode, f"{key}/to_timestamp"),
        )

    def _batch(self, batch: Any, file: Path) -> Batch:
        """A Batch made from one of pyarrow's, with a channel for each number of the numeric features. file: for
        messages. TautError where a feature has another count of numbers a row than info.json says."""
        values: dict[str, Array] = {}
        for name, feature in self._numeric.items():
            column = batch.column(name)
            keys = _channel_names(name, feature)
            flat = column.flatten() if hasattr(column, "flatten") and column.type.num_fields else column
            numbers = flat.cast("float64").to_numpy(zero_copy_only=False)
            if len(numbers) != len(keys) * batch.num_rows:
                raise TautError(f"{file}: {name} has not the {len(keys)} numbers a row that {INFO} says")
            for k, (key, _) in enumerate(keys):
                values[key] = numbers[k :: len(keys)]
        return Batch("", self._times(batch), None, values)

    def _times(self, batch: Any) -> Array:
        """The rows' times (n,), s. They are written in single precision, some us off; so the exact frame number / fps
        is taken wherever it rounds to the written time."""
        written = batch.column("timestamp").cast("float64").to_numpy(zero_copy_only=False)
        rate = self._info.get("fps")
        if _FRAME not in batch.schema.names or not isinstance(rate, int | float) or not rate > 0:
            return np.asarray(written)
        nominal = batch.column(_FRAME).cast("float64").to_numpy(zero_copy_only=False) / rate
        return np.where(nominal.astype(np.float32) == written, nominal, written)

    def _template_values(self, episode: int, what: str) -> dict[str, int]:
        """The values for info.json's path templates that give the file of an episode: its number and chunk in version
        2.1, chunk and file from the table of episodes in version 3.0. what: the prefix of their keys in that table,
        `data` or `videos/NAME`."""
        if self._layout == "v2":
            return {"episode_chunk": episode // int(self._info.get("chunks_size") or 1000), "episode_index": episode}
        return {name: int(self._episode_number(episode, f"{what}/{name}")) for name in ("chunk_index", "file_index")}

    def _episode_number(self, episode: int, key: str) -> float:
        """The number under a key in the table of episodes. TautError where it is missing."""
        value = self._rows[episode].get(key)
        if not isinstance(value, int | float):
            listed = self.path / _EPISODES[self._layout]
            raise TautError(f"{listed}: says no {key} of episode {episode}: copy the folder meta whole")
        return value

    def _episode_rows(self) -> dict[int, dict[str, Any]]:
        """Reads the table of episodes: a row by key for each episode number. TautError where it is missing or
        unreadable."""
        listed = self.path / _EPISODES[self._layout]
        if self._layout == "v2":
            try:
                lines = [json.loads(line) for line in listed.read_text(encoding="utf-8").splitlines() if line.strip()]
                return {int(line["episode_index"]): line for line in lines}
            except (OSError, ValueError, KeyError, TypeError) as error:
                raise TautError(f"{listed}: cannot be read as a list of episodes ({error}): copy it again") from error
        rows: dict[int, dict[str, Any]] = {}
        for file in sorted(listed.glob("*/*.parquet")):
            try:
                names = [name for name in self._parquet.read_schema(file).names if not name.startswith("stats/")]
                for row in self._parquet.read_table(file, columns=names).to_pylist():
                    rows[int(row["episode_index"])] = row
            except (self._arrow_error, OSError, KeyError, TypeError) as error:
                raise TautError(f"{file}: cannot be read as a list of episodes ({error}): copy it again") from error
        if not rows:
            raise TautError(f"{listed}: holds no list of episodes (*/*.parquet): copy the folder meta whole")
        return rows

    def _stated_unit(self, feature: Mapping[str, Any]) -> str:
        """The unit of a feature, of _UNITS, that its entry in info.json states under `unit`, or under `info` and there
        `unit`; "" where it states none of them."""
        inner = feature.get("info")
        stated = str(feature.get("unit") or (inner.get("unit") if isinstance(inner, Mapping) else "") or "")
        short = {"degrees": "deg", "degree": "deg", "radians": "rad", "radian": "rad"}.get(stated.lower(), stated)
        return short if short in _UNITS else ""

    def _path_by_template(self, key: str, **values: Any) -> Path:
        """The path that info.json's template under `key` gives with these values. TautError where the template asks for
        other values, or is none."""
        template: str = self._info_value(key, str)
        try:
            return self.path / template.format(**values)
        except (KeyError, ValueError, IndexError) as error:
            raise TautError(f"{self.path / INFO}: {key} is {template!r}, which is not of {self.kind}") from error

    def _info_value(self, key: str, kind: type[Any]) -> Any:
        """The value under a key of info.json. TautError where it is missing or not of this type."""
        value = self._info.get(key)
        if not isinstance(value, kind):
            raise TautError(f"{self.path / INFO}: {key} is missing: is the data set whole?")
        return value

    def _read_json(self, file: Path) -> Mapping[str, Any]:
        """Reads a JSON object from a file. TautError where it is unreadable or no object."""
        try:
            document = json.loads(file.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise TautError(f"{file}: cannot be read ({error}): is it a whole LeRobot data set?") from error
        if not isinstance(document, dict):
            raise TautError(f"{file}: holds no JSON object: is it a whole LeRobot data set?")
        return document


def _channel_names(name: str, feature: Mapping[str, Any]) -> list[tuple[str, str]]:
    """(channel, label) for each number of a feature: the channel is NAME, or NAME[k] where the feature has several or
    names them; the label is that of info.json, "" without. feature: its entry there."""
    shape = [int(n) for n in feature.get("shape") or (1,)]
    count = int(np.prod(shape))
    labels: Any = feature.get("names")
    if isinstance(labels, Mapping):  # {"motors": [...]} of older sets
        labels = next(iter(labels.values()), None)
    if count == 1 and not isinstance(labels, list):
        return [(name, "")]
    listed = labels if isinstance(labels, list) and len(labels) == count else [""] * count
    return [(f"{name}[{k}]", str(label)) for k, label in enumerate(listed)]


def _stats_of(stats: Any, which: str, count: int) -> list[float]:
    """The `min` or `max` (`which`) over all episodes of each of a feature's `count` numbers, by the feature's entry in
    stats.json; all NaN where that does not have so many numbers."""
    stated = stats.get(which) if isinstance(stats, Mapping) else None
    try:
        ends = np.ravel(np.array(stated, dtype=float))
    except (TypeError, ValueError):
        ends = np.zeros(0)
    return ends.tolist() if len(ends) == count else [float("nan")] * count


def is_dataset(path: Path) -> bool:
    """Whether a folder is a LeRobot data set."""
    return (path / INFO).is_file()
