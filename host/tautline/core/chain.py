"""From the motor to what is seen, with parts of the way that are written in Python."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np
import numpy.typing as npt

from tautline import effects
from tautline.core.motor import MotorPath
from tautline.errors import TautError, check_start
from tautline.model import Model
from tautline.recording import Motor

Array = npt.NDArray[np.float64]
Run = Callable[[Array, Array, Array], Array]  # (times (n,), what comes in (n,), values (m,)) -> what goes out (n,)


class Stage(StrEnum):
    """Where a part of the chain stands, by what comes in and goes out."""

    INPUT = "input"  # q to q
    PLANT = "plant"  # q to p: instead of the model's play
    STATE = "state"  # p to p
    OUTPUT = "output"  # c to c, deg


@dataclass(frozen=True)
class OutsideBlock:
    """A user's own part of the chain; times rise and hold every knot of the motor's path. It is differentiated by
    differences of its own steps."""

    name: str
    stage: Stage
    run: Run
    values: tuple[float, ...] = ()
    steps: tuple[float, ...] = ()  # of the values, over which what goes out is near enough straight

    def __post_init__(self) -> None:
        """Raises ValueError unless each value has a step above 0."""
        if len(self.values) != len(self.steps) or not all(step > 0.0 for step in self.steps):
            raise ValueError(f"{self.name}: every value needs a step above 0")


@dataclass(frozen=True)
class Seen:
    """At scene times (n,): (n, 1) c in deg, or (n, 3) c, u and v in deg and px where the model's rig has a camera."""

    rows: Array

    @property
    def c_deg(self) -> Array:
        """(n,) Bending angles, deg."""
        return self.rows[:, 0]

    @property
    def image_px(self) -> Array | None:
        """(n, 2) Image positions of the marker, px, NaN where it cannot be seen; None without a camera."""
        return self.rows[:, 1:] if self.rows.shape[1] > 1 else None


@dataclass(frozen=True)
class Chain:
    """A model with its effects, and blocks from outside in the order in which they act within a stage. TautError for
    a second plant, and for a plant or a state beside effects of the library: they would stand between their states."""

    model: Model
    outside: Sequence[OutsideBlock] = field(default=())

    def __post_init__(self) -> None:
        """Raises TautError for more than one plant, and for a plant or a state block beside effects of the library."""
        inside = [block for block in self.outside if block.stage in (Stage.PLANT, Stage.STATE)]
        if sum(block.stage is Stage.PLANT for block in inside) > 1:
            raise TautError("a chain has one plant: put the others into states")
        if inside and effects.of_model(self.model):
            raise TautError(f"{inside[0].name}: the model's own effects stand where it would: use its nominal model")

    def at(self, path: MotorPath, scene_s: npt.ArrayLike, start_deg: float | None = None) -> Seen:
        """What is seen at scene times scene_s (n,), s, on the motor's clock, in any order. The tip starts on the centre
        line, or at start_deg. TautError where start_deg is no number, or a block gives another shape than it was
        given."""
        check_start(start_deg)
        scene, begin_s = np.asarray(scene_s, dtype=float), float(path.lines.t_s[0])
        if not self.outside:
            return Seen(_seen_rows(self.model, self._simulated(path.lines, scene, start_deg, begin_s)))
        course = np.union1d(path.lines.t_s, scene)  # blocks may remember: they see all of the motor's way
        q = self._through_blocks(Stage.INPUT, course, path.at(course))
        tip = self._simulated(path.lines.resampled(course, q, path.lines.extra), course, start_deg, begin_s)
        if any(block.stage in (Stage.PLANT, Stage.STATE) for block in self.outside):
            # A plant makes p of q in the play's place; a state block changes p, the plant's or the model's own.
            plant = any(block.stage is Stage.PLANT for block in self.outside)
            p = self._through_blocks(Stage.PLANT, course, q) if plant else tip.p
            p = self._through_blocks(Stage.STATE, course, p)
            tip = replace(tip, p=p, tip=p, c_deg=self.model.remaining(p))
        tip = replace(tip, c_deg=self._through_blocks(Stage.OUTPUT, course, tip.c_deg))
        return Seen(_seen_rows(self.model, tip)[np.searchsorted(course, scene)])

    def slopes(self, path: MotorPath, scene_s: npt.ArrayLike, start_deg: float | None = None) -> Array:
        """(n, 1 or 3, m) Derivatives of `at`'s rows by the values of all blocks from outside, in their order, by
        central differences of the blocks' own steps."""
        values = np.array([value for block in self.outside for value in block.values])
        steps = np.array([step for block in self.outside for step in block.steps])
        return by_differences(lambda x: self._with(x).at(path, scene_s, start_deg).rows, values, steps)

    def _with(self, values: Array) -> Chain:
        """The chain with other values (m,) of its blocks from outside: those of all blocks, one after the other."""
        rest = iter(values.tolist())
        return replace(self, outside=[replace(b, values=tuple(next(rest) for _ in b.values)) for b in self.outside])

    def _through_blocks(self, stage: Stage, t_s: Array, x: Array) -> Array:
        """(n,) What the blocks of this stage, one after the other, make of values x at times t_s (n,), s. TautError
        where one gives another shape."""
        for block in self.outside:
            if block.stage is stage:
                x = np.asarray(block.run(t_s, x, np.array(block.values)), dtype=float)
                if x.shape != t_s.shape:
                    raise TautError(f"{block.name}: gave {x.shape} for {t_s.shape} times")
        return x

    def _simulated(self, lines: Motor, scene: Array, start_deg: float | None, begin_s: float) -> effects.Path:
        """The tip at scene times (n,), s, by the model and its own effects, without blocks from outside. begin_s: when
        the motor's path begins, s; `lines` may have further knots before that."""
        own, reference = effects.of_model(self.model), self.model.load_reference_mNm
        return effects.follow(self.model, lines, scene, own, start_deg, reference, clock_begin_s=begin_s)


def by_differences(rows: Callable[[Array], Array], at: Array, steps: Array) -> Array:
    """(..., m) Central differences of an array rows(values) (...) by its values at `at` (m,), with half-widths `steps`
    (m,); 0 where a step is 0."""
    columns = []
    for i, step in enumerate(steps):
        away = np.zeros(len(at))
        away[i] = step
        columns.append((rows(at + away) - rows(at - away)) / (2.0 * step) if step else np.zeros_like(rows(at)))
    return np.stack(columns, axis=-1) if columns else np.zeros((*rows(at).shape, 0))


def _seen_rows(model: Model, tip: effects.Path) -> Array:
    """The rows of `Seen` for a tip's path: (n, 1) deg, or (n, 3) deg and px where a camera sees the tip."""
    c = tip.c_deg[:, None]
    if not model.rig.has_camera:
        return c
    return np.column_stack([c, effects.image(model, tip, effects.of_model(model))])
