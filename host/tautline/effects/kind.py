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
    """One number of an effect. If its unit begins with "unit" it is in the actuator's unit (that of q), and its
    `scale`, `shape`, `low` and `high` are shares of the motor's range."""

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
        """The factor from the unit of `scale`, `shape`, `low` and `high` to the parameter's own unit: the motor's range
        `span`, unit of q, where the parameter's unit begins with "unit", else 1."""
        return span if self.unit.startswith("unit") else 1.0

    def limits(self, span: float) -> tuple[float, float]:
        """(Low, high): the range in which a value is meaningful, in the parameter's own unit. span: the motor's range,
        unit of q."""
        return self.low * self.share(span), self.high * self.share(span)

    def inside(self, value: float, span: float) -> float:
        """The value, in the parameter's own unit, clipped to `limits`. span: the motor's range, unit of q."""
        low, high = self.limits(span)
        return min(max(value, low), high)


@dataclass(frozen=True)
class Event:
    """The part of a descriptor that makes its effect an event: an effect without a path that repeats, which is
    identified by the statistics of its scatter (diagnosis/scatter.py)."""

    amount: str  # name of the parameter of how much it scatters
    mean: str = ""  # name of the parameter of its mean effect, which has a path; "" where there is none
    cause: str = ""  # in words, what to mend
    what: str = ""  # in words, what no model takes away


# (The nominal model, values by name, places (n,)) -> {amplitude: (n,) the curve's change there by one unit of it}; None
# where it is not linear in them.
Slopes = Callable[[Model, Mapping[str, float], Array], Mapping[str, Array] | None]


@dataclass(frozen=True)
class Transform:
    """The law in Python of an effect from another distribution (tautline.effects.outside). It is called only where one
    of the effect's amplitudes is not zero, and it is differentiated by difference quotients."""

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
        """The stage at which the effect acts: one of STAGES, or SIMULATOR."""
        return self.id.split(".", 1)[0]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The effect's amplitudes, followed by its shapes."""
        return (*self.amplitudes, *self.shapes)

    @property
    def moments(self) -> tuple[str, ...]:
        """Names of the parameters that are moments (s of the session) at which the effect happens; the amplitudes are
        shared out evenly among them. () for an effect that acts continuously."""
        return tuple(p.name for p in self.shapes) if self.scan == "moment" else ()

    def happening(self, times: int) -> Kind:
        """The same effect restricted to its first `times` moments and the amplitudes of these. Only for an effect with
        `moments`."""
        per_moment = len(self.amplitudes) // len(self.moments)
        return replace(self, amplitudes=self.amplitudes[: times * per_moment], shapes=self.shapes[:times])

    def only(self, names: Collection[str]) -> Kind:
        """A copy of this descriptor that keeps only the parameters whose names are in `names`."""
        kept = [tuple(p for p in of if p.name in names) for of in (self.amplitudes, self.shapes)]
        return replace(self, amplitudes=kept[0], shapes=kept[1])

    def following(self, moving: Collection[str]) -> Kind:
        """A copy without the parameters that need a column of motor.csv (`Parameter.follows`) which is not in `moving`,
        the names of the columns that vary."""
        return self.only([p.name for p in self.parameters if not p.follows or p.follows in moving])

    @property
    def forms(self) -> tuple[Kind, ...]:
        """All descriptors with this id: this one, its `simple` variant if there is one, and its variant for a further
        joint's column (made with the name "") if there is one."""
        of_joint = self.of_joint and self.of_joint("")
        return tuple(form for form in (self, self.simple, of_joint) if form)

    def of_values(self, values: Mapping[str, Any]) -> Effect:
        """The entry `Effect` of a model: this id with the effect's own parameters, picked by name from `values` (others
        are ignored), and the name of the column that it follows, if any."""
        own = {p.name: values[p.name] for p in self.parameters if p.name in values}
        return Effect(self.id, own | ({COLUMN: self.column} if self.column else {}))

    @property
    def through_angle(self) -> bool:
        """Whether the effect changes the bending angle, as those of the first three stages and of a simulator's
        parameters do; the others change only how, or when, the tip is seen."""
        return self.stage in (SIMULATOR, *THROUGH_ANGLE)

    @property
    def bends(self) -> bool:
        """Whether the effect changes the angle c other than through the play's centre p, so that c is no longer
        f_remain(p): it acts behind the transmission, or goes with a load, which changes dc/df_remain as well as the
        play."""
        return self.stage == "configuration" or self.needs == "load"

    @property
    def carried(self) -> bool:
        """Whether a calibrated model may carry this effect beside B and f_remain: it changes the bending angle by a law
        that is the same at all times, is neither a simulator's parameter nor a part of the nominal model, and no table,
        rig or delay of the model holds it."""
        repeats = not (self.event or self.course or self.moments)
        behind_motor = self.needs != SIMULATOR
        return self.through_angle and behind_motor and repeats and not self.nominal and self.holds is None

    @property
    def on_board(self) -> bool:
        """Whether a board that has the corrected model's tables needs nothing else against the effect: the tables hold
        it, a section of them undoes it, or it only changes how the tip is seen and is no event (nothing undoes
        scatter)."""
        only_seen = self.stage in _SEEN and self.event is None
        return self.holds is not None or self.undone or only_seen


def rigid_motion(prefix: str) -> tuple[Parameter, ...]:
    """Makes the six parameters of a rigid motion: PREFIX_rx, _ry, _rz, a turn as a rotation vector, deg, then PREFIX_x,
    _y, _z, a move, mm."""
    turn = tuple(Parameter(f"{prefix}_r{axis}", "deg", _TURN_DEG) for axis in "xyz")
    move = tuple(Parameter(f"{prefix}_{axis}", "mm", _MOVE_MM) for axis in "xyz")
    return turn + move


def simulator_id(parameter: str) -> str:
    """The id "simulator.NAME" of the effect that a simulator's declared `parameter` has another value on the robot. The
    effect's only parameter has the same id as its name."""
    return f"{SIMULATOR}.{parameter}"


def of_simulator(
    parameter: str, unit: str = "", spread: float = 1.0, low: float = float("-inf"), high: float = float("inf")
) -> Kind:
    """The effect of a simulator's declared `parameter` that has another value on the robot; its amplitude is the change
    of that value. unit: of the parameter; spread: a change that a user would notice; low, high: range of the change."""
    name = simulator_id(parameter)
    return Kind(
        name,
        (Parameter(name, unit, spread, low=low, high=high),),
        says=f"the simulator's {parameter} is not the robot's",
        tell="It is told by the whole course of the motion, as the simulator shows it with another value: what looks "
        "alike is named beside it.",
        mend="Put the value that is named into the simulator.",
    )
