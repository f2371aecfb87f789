"""The descriptor of an effect: its parameters, how it is found in recordings, how a corrected model holds it, and what
is said of it to a user."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from tautline.model import Effect, Model

STAGES = ("actuator", "transmission", "configuration", "kinematics", "registration", "camera", "acquisition")
THROUGH_ANGLE = STAGES[:3]  # these move the tip by its bending angle
_SEEN = STAGES[3:]  # these only change how the tip is seen
FREEDOMS = "translation_mm", "rotation_deg"  # format: columns of motor.csv: where else the instrument is moved
COLUMN = "column"  # format: among an effect's parameters the name of the joint's column that it follows
_TURN_DEG, _MOVE_MM = 0.5, 0.2  # prior: changes of a registration that a user would notice
SIMULATOR = "simulator"  # the stage of a user's simulator's own parameters, in the motor's place before all others

Array = npt.NDArray[np.float64]
# (session times (n,) s, rising; what comes in (n,); the effect's parameters) -> what goes out (n,)
Run = Callable[[Array, Array, Mapping[str, float]], Array]

# A model that holds an effect of these parameters as it is at a time of the session, s.
Holds = Callable[[Model, Mapping[str, float], float], Model]


@dataclass(frozen=True)
class Parameter:
    """A number of an effect. A parameter whose unit begins with "unit" is in the actuator's unit; its `scale`, `shape`,
    `low` and `high` are then shares of the motor's range."""

    name: str
    unit: str
    scale: float  # a change that a user would notice: the unit of difference steps and of priors
    shape: tuple[float, ...] = ()  # values to start from; empty: an amplitude, zero when absent
    probe: float = 0.3  # tolerance: of `scale`: the small amplitude that is simulated to screen the effect
    one_way: bool = False  # whether a negative value does something else than the opposite, so that both are tried
    low: float = float("-inf")  # range in which it means something
    high: float = float("inf")
    searched: bool = False  # found over its `shape` or by scatter; never differentiated
    reached: bool = False  # whether it is a bending angle, deg, kept within those that the recordings reach
    follows: str = ""  # column of motor.csv without whose motion it does nothing

    def share(self, span: float) -> float:
        """What `scale` and `shape` count in: the motor's range `span` where the unit begins with "unit", else 1."""
        return span if self.unit.startswith("unit") else 1.0

    def limits(self, span: float) -> tuple[float, float]:
        """The range in which a value means something, in the parameter's own unit. span: of the motor, unit of q."""
        return self.low * self.share(span), self.high * self.share(span)

    def inside(self, value: float, span: float) -> float:
        """The value clipped to its `limits`. span: of the motor, unit of q."""
        low, high = self.limits(span)
        return min(max(value, low), high)


@dataclass(frozen=True)
class Event:
    """What makes an effect an event: it has no path that repeats and is identified by the statistics of its scatter
    (diagnosis/scatter.py)."""

    amount: str  # name of the parameter of how much it scatters
    mean: str = ""  # name of the parameter of its mean effect, which has a path; "" where there is none
    cause: str = ""  # in words, what to mend
    what: str = ""  # in words, what no model takes away


# (The nominal model, values by name, places (n,)) -> {amplitude: (n,) the curve's change there by one unit of it}; None
# where it is not linear in them.
Slopes = Callable[[Model, Mapping[str, float], Array], Mapping[str, Array] | None]


@dataclass(frozen=True)
class Transform:
    """The law in Python of an effect of another distribution (tautline.effects.outside). It is called only where one of
    its amplitudes is not zero, and differentiated by differences."""

    place: Literal["input", "state", "output"]  # what it changes: q, the tip's p before f_remain, or c in deg
    run: Run


@dataclass(frozen=True)
class Kind:
    """The descriptor of an effect. With its amplitudes at zero it is absent."""

    id: str  # stage.name
    amplitudes: tuple[Parameter, ...]
    shapes: tuple[Parameter, ...] = ()  # parameters that mean nothing while all amplitudes are zero
    says: str = ""  # what it does, in words
    tell: str = ""  # how a person tells it from what looks like it
    mend: str = ""  # what to do about it on the instrument
    # sensor: the model has a delay for what is observed; freedom: the instrument's second or third degree of freedom
    # moves; joint: a further joint's column does.
    # simulator: a user's simulator stands in the motor's place, and all is fitted together.
    needs: Literal["", "camera", "sensor", "load", "freedom", "joint", "simulator"] = ""
    column: str = ""  # of motor.csv, that it follows
    of_joint: Callable[[str], Kind] | None = None  # makes the same effect of a further joint's column, by its name
    holds: Holds | None = None  # puts it into a corrected model's tables, rig or delay; None: it is simulated beside
    undone: bool = False  # whether a section of the board's tables undoes it (tautline.undone)
    in_tables: Literal["", "width", "remaining"] = ""  # the model's curve that it changes: `holds` simulates it
    slopes: Slopes | None = None  # of an effect in tables: what each amplitude adds to that curve
    course: Callable[[Mapping[str, float], float], float] | None = None  # its size at a time of the session, s
    event: Event | None = None  # None: it has a path that repeats
    law: bool = False  # whether it has one exact equation everywhere: rigid motion, time
    # Whether it is of friction or of a material (a tendon's, an obstacle's), which no equation has exactly.
    material: bool = False
    nominal: bool = False  # whether it is a part of the nominal model, which a recalibration changes by itself
    posture: bool = False  # whether another posture, tension or homing changes it, together with others of these
    contains: tuple[str, ...] = ()  # ids of simpler effects that it can imitate exactly
    brings: tuple[str, ...] = ()  # ids of parts of the nominal model that it may well change too, if it came later
    curve: tuple[str, ...] = ()  # amplitudes that are coefficients of a cubic spline over the motor's range, in order
    simple: Kind | None = None  # the same with fewer parameters, used where a curve could imitate what is beside it
    each: bool = False  # whether it may on its own have other amplitudes in each recording
    # How its shapes are screened: by simulation, by the period of an encoder, or by the moments at which it happens.
    scan: Literal["probe", "period", "moment"] = "probe"
    transform: Transform | None = None  # None: the library's own C or tables simulate it
    # What else its stage could do whatever its equations are, beside changing the angle (diagnosis/confined.py).
    leaves: Literal["", "lens", "plane", "channel", "time"] = ""

    @property
    def stage(self) -> str:
        """Where it acts: one of STAGES, or SIMULATOR."""
        return self.id.split(".", 1)[0]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Amplitudes, then shapes."""
        return (*self.amplitudes, *self.shapes)

    @property
    def moments(self) -> tuple[str, ...]:
        """Names of the parameters that are times of the session, s, at which it happens; each has as many amplitudes.
        () of an effect that goes on."""
        return tuple(p.name for p in self.shapes) if self.scan == "moment" else ()

    def happening(self, times: int) -> Kind:
        """The same effect happening `times` times: with its first moments and their amplitudes alone."""
        per_moment = len(self.amplitudes) // len(self.moments)
        return replace(self, amplitudes=self.amplitudes[: times * per_moment], shapes=self.shapes[:times])

    def only(self, names: Collection[str]) -> Kind:
        """The same effect with the parameters of these names alone."""
        kept = [tuple(p for p in of if p.name in names) for of in (self.amplitudes, self.shapes)]
        return replace(self, amplitudes=kept[0], shapes=kept[1])

    def following(self, moving: Collection[str]) -> Kind:
        """The same effect without the parameters that follow a column which is not among the `moving` ones."""
        return self.only([p.name for p in self.parameters if not p.follows or p.follows in moving])

    @property
    def forms(self) -> tuple[Kind, ...]:
        """All descriptors with its id: itself, the simple one, and the one of a further joint's column, if it has
        these."""
        of_joint = self.of_joint and self.of_joint("")
        return tuple(form for form in (self, self.simple, of_joint) if form)

    def of_values(self, values: Mapping[str, Any]) -> Effect:
        """The effect as a model has it, with those of its parameters that are among `values`, by name."""
        own = {p.name: values[p.name] for p in self.parameters if p.name in values}
        return Effect(self.id, own | ({COLUMN: self.column} if self.column else {}))

    @property
    def through_angle(self) -> bool:
        """Whether it changes the bending angle (as a simulator's parameters do too); else it changes only how, or when,
        the tip is seen."""
        return self.stage in (SIMULATOR, *THROUGH_ANGLE)

    @property
    def bends(self) -> bool:
        """Whether it changes c beside the play's centre p, so that c is not f_remain(p) alone: behind the transmission,
        or by a load, which changes the angle's gain as well as the play."""
        return self.stage == "configuration" or self.needs == "load"

    @property
    def carried(self) -> bool:
        """Whether a calibrated model may carry it beside B and f_remain: it changes the bending angle by a law that is
        the same at all times, and is no part of the model's tables."""
        repeats = not (self.event or self.course or self.moments)
        behind_motor = self.needs != SIMULATOR
        return self.through_angle and behind_motor and repeats and not self.nominal and self.holds is None

    @property
    def on_board(self) -> bool:
        """Whether a board with the corrected model's tables needs nothing else against it: it is held in these tables,
        a section of them undoes it, or it only changes how the tip is seen. No event is: nothing undoes scatter."""
        only_seen = self.stage in _SEEN and self.event is None
        return self.holds is not None or self.undone or only_seen


def rigid_motion(prefix: str) -> tuple[Parameter, ...]:
    """The six parameters of a rigid motion: PREFIX_rx, _ry, _rz, a turn as a rotation vector in deg, then PREFIX_x, _y,
    _z, a move in mm, each with the change that a user would notice."""
    turn = tuple(Parameter(f"{prefix}_r{axis}", "deg", _TURN_DEG) for axis in "xyz")
    move = tuple(Parameter(f"{prefix}_{axis}", "mm", _MOVE_MM) for axis in "xyz")
    return turn + move


def simulator_id(parameter: str) -> str:
    """The id of the effect that a simulator's declared `parameter` is another on the robot; its only parameter has the
    same name."""
    return f"{SIMULATOR}.{parameter}"


def of_simulator(
    parameter: str, unit: str = "", spread: float = 1.0, low: float = float("-inf"), high: float = float("inf")
) -> Kind:
    """The effect that a simulator's declared `parameter` is another on the robot. unit: its own; spread: a change that
    a user would notice; low, high: range of its change."""
    name = simulator_id(parameter)
    return Kind(
        name,
        (Parameter(name, unit, spread, low=low, high=high),),
        says=f"the simulator's {parameter} is not the robot's",
        tell="It is told by the whole course of the motion, as the simulator shows it with another value: what looks "
        "alike is named beside it.",
        mend="Put the value that is named into the simulator.",
    )
