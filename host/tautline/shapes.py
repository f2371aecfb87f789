"""A library of shapes: models that were calibrated with the shaft in different shapes, and what tells them apart.

A folder with an index, shapes.toml (format shapes/1), and a model's folder for each shape. Offset and scale are those
that a tracker of the first shape's model finds in another shape."""

from __future__ import annotations

import tomllib
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from tautline import tables
from tautline.errors import TautError
from tautline.folders import write_file
from tautline.model import Model
from tautline.prediction import foretold
from tautline.recording import Recording
from tautline.schema import Key, Section

INDEX = "shapes.toml"
FORMAT = "shapes/1"
SHAPE = Section(
    "shape",
    "One shape of the shaft, with its model in the folder of its name.",
    (
        Key(
            "name",
            "the shape's name, and its model's folder",
            "straight",
            "text",
            pattern=r"[\w-]{1,40}",
            described="1 to 40 letters, digits, - or _",
        ),
        Key("offset", "of the transmission beside the first shape's, unit of q", 0.0),
        Key("scale", "of B beside the first shape's", 1.0, above=0.0),
        Key("current_mA", "mean motor current in use; without it current does not count", 150.0, needed=False),
    ),
    "shapes",
)
_SIGMAS = 3.0  # loss: within which what is seen is a shape's
_ALIKE = 1.3  # loss: times the error of the best, up to which another might be it
_LEAST = 0.1, 0.05, 0.2  # prior: and at least so much of B (offset), of the scale, of the current


@dataclass(frozen=True)
class Shape:
    """One shape of the shaft. Offset and scale are relative to the library's first shape."""

    name: str
    offset: float = 0.0  # of the transmission, unit of q
    scale: float = 1.0  # of B
    current_mA: float | None = None  # mean, in use


@dataclass(frozen=True)
class Seen:
    """What a tracker has learnt, relative to the model that it tracks with."""

    offset: float
    offset_sigma: float
    scale: float
    scale_sigma: float
    current_mA: float | None = None


@dataclass(frozen=True)
class Library:
    """A library of shapes as its index lists them."""

    folder: Path
    shapes: tuple[Shape, ...] = ()

    @classmethod
    def load(cls, folder: str | Path) -> Library:
        """Reads a library's index; the models are read only when asked for. TautError where the folder has no index, or
        a damaged one."""
        folder = Path(folder)
        index = folder / INDEX
        try:
            document = tomllib.loads(index.read_text(encoding="utf-8"))
        except OSError:
            raise TautError(f"{folder}: no library of shapes: begin one with 'taut shapes add'") from None
        except (ValueError, RecursionError) as error:
            raise TautError(f"{index}: is no TOML ({error}): mend it, or add the shapes again") from error
        if document.get("format") != FORMAT:
            raise TautError(f'{index}: format is {document.get("format")!r}, expected "{FORMAT}"')
        listed = document.get("shape", [])
        if not isinstance(listed, list):
            raise TautError(f"{index}: shape is expected as [[shape]] tables")
        return cls(folder, tuple(Shape(**SHAPE.read({"shape": one}, str(index))) for one in listed))

    def model(self, name: str) -> Model:
        """Reads the model of the shape with this name. TautError where there is none."""
        return Model.load(self.folder / self.of(name).name)

    def first(self) -> Model:
        """Reads the model of the first shape, which offset and scale of the others are relative to. TautError for an
        empty library."""
        if not self.shapes:
            raise TautError(f"{self.folder}: no shapes in it: add them with 'taut shapes add'")
        return self.model(self.shapes[0].name)

    def of(self, name: str) -> Shape:
        """The entry of the shape with this name. TautError where there is none."""
        for shape in self.shapes:
            if shape.name == name:
                return shape
        raise TautError(
            f"{self.folder}: no shape {name!r}: it holds {', '.join(s.name for s in self.shapes) or 'none'}"
        )

    def add(self, name: str, model: Model, current_mA: float | None = None) -> Library:
        """Adds a model's shape, or replaces the one of that name, and writes model and index to the library's folder;
        returns the new library. Offset and scale are worked out against the first shape. current_mA: mean motor current
        in use, None if it is not to count. TautError for a name that is not allowed, for replacing the first shape
        while there are others, and as of `offset_and_scale`."""
        index = self.folder / INDEX
        SHAPE.keys[0].read(name, "shape.name", str(index), SHAPE.file)
        others = tuple(shape for shape in self.shapes if shape.name != name)
        first = next((shape for shape in self.shapes[:1] if shape.name != name), None)
        if first is None and others:
            raise TautError(f"{self.folder}: {name} is the shape that the others are told by: begin another library")
        offset, scale = (0.0, 1.0) if first is None else offset_and_scale(self.model(first.name), model)
        made = Library(self.folder, (*others, Shape(name, offset, scale, current_mA)))
        listed = [{k: v for k, v in asdict(shape).items() if v is not None} for shape in made.shapes]
        SHAPE.read({"shape": listed[-1]}, str(index))  # what is written can be read
        model.save(self.folder / name)
        document: dict[str, Any] = {"format": FORMAT, "shape": listed}
        write_file(index, tomli_w.dumps(document))
        return made

    def own(self, model: Model) -> Shape | None:
        """The shape whose model this is: the one from which the same tables are made (`tables.model_id`). None where it
        is not in the library."""
        wanted = tables.model_id(model)
        return next((s for s in self.shapes if tables.model_id(self.model(s.name)) == wanted), None)

    def nearest(self, seen: Seen, own: Shape, width: float) -> Shape | None:
        """The only shape whose offset and scale, and current if both have one, agree with `seen`; None where none or
        several do. own: the shape of the model that the tracker used; width: its mean B, unit of q. They agree within
        _SIGMAS sigmas or the least tolerances _LEAST."""
        fits = []
        for shape in self.shapes:
            # The library's values are relative to its first shape, what was seen is relative to `own`.
            off = (seen.offset - (shape.offset - own.offset), seen.scale - shape.scale / own.scale)
            most = (
                max(_SIGMAS * seen.offset_sigma, _LEAST[0] * width),
                max(_SIGMAS * seen.scale_sigma, _LEAST[1]),
            )
            near = all(abs(each) <= limit for each, limit in zip(off, most, strict=True))
            if near and seen.current_mA is not None and shape.current_mA is not None:
                near = abs(seen.current_mA - shape.current_mA) <= _LEAST[2] * abs(shape.current_mA)
            if near:
                fits.append(shape)
        return fits[0] if len(fits) == 1 else None


def offset_and_scale(first: Model, other: Model) -> tuple[float, float]:
    """What a tracker with the model `first` would find where `other` holds. Returns the offset, unit of q, by which
    `first` needs a larger q for the same angle (the median over the range that both were measured in), and the scale of
    B, `other`'s mean over `first`'s. TautError where the two have no range, angle or unit in common, or no backlash."""
    if first.rig.actuator.unit != other.rig.actuator.unit:
        raise TautError(f"one model is in {first.rig.actuator.unit}, the other in {other.rig.actuator.unit}")
    low, high = (pick(a, b) for pick, a, b in zip((max, min), first.measured, other.measured, strict=True))
    if not high > low:
        raise TautError("the two models were measured in ranges that do not overlap: calibrate in the same range")
    q = np.linspace(low, high, 201)
    order = np.argsort(first.c_deg)
    other_deg = np.asarray(other.remaining(q))
    inside = (other_deg >= first.c_deg.min()) & (other_deg <= first.c_deg.max())
    if not inside.any():
        raise TautError("the two models have no bending angle in common: they are not of one instrument")
    q_of_first = np.interp(other_deg[inside], first.c_deg[order], first.q[order])  # where it has the same angles
    offset = float(np.median(q_of_first - q[inside]))
    mean = [float(np.mean(np.interp(q, m.q, m.width))) for m in (first, other)]
    if not min(mean) > 0.0:
        raise TautError("a model without backlash cannot be told apart by its width: leave it out")
    return offset, mean[1] / mean[0]


def recalled(library: Library, recording: Recording) -> tuple[Shape, dict[str, float]]:
    """The shape whose model predicts a recording best, and the rms error of every shape's model by name, px or deg.
    TautError for an empty library, and where the second best has less than _ALIKE times the error of the best."""
    rms = {shape.name: foretold(library.model(shape.name), recording) for shape in library.shapes}
    if not rms:
        raise TautError(f"{library.folder}: no shapes in it: add them with 'taut shapes add'")
    order = sorted(rms, key=lambda name: rms[name])
    if len(order) > 1 and rms[order[1]] < _ALIKE * rms[order[0]]:
        raise TautError(f"{order[0]} and {order[1]} foretell it alike: record a longer motion, both ways")
    return library.of(order[0]), rms
