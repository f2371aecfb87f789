"""What an effect is made of: the descriptor that owns its parameters, how it is looked for and how a model holds it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from tautline.model import Effect, Model

STAGES = ("actuator", "transmission", "configuration", "kinematics", "registration", "camera", "acquisition")
THROUGH_ANGLE = STAGES[:3]
_TABLED = STAGES[3:]  # these only change how the tip is seen
COLUMN = "column"  # format: of an effect's parameters, the name of the joint's column that it follows
SIMULATOR = "simulator"  # before them, where a user's simulator stands in the motor's place: its own parameters

Array = npt.NDArray[np.float64]
# (session times (n,) s, rising; what comes in (n,); the effect's parameters) -> what goes out (n,)
Run = Callable[[Array, Array, Mapping[str, float]], Array]

# A model that holds an effect of these parameters as it is at a time of the session, s.
Holds = Callable[[Model, Mapping[str, float], float], Model]


@dataclass(frozen=True)
class Parameter:
    """`scale` is a change that a user would notice: the step of differences and the unit of priors. For a parameter in
    the actuator's unit ("unit" at the start of its unit) it is a share of the motor's range, and so are its shapes."""

    name: str
    unit: str
    scale: float
    shape: tuple[float, ...] = ()  # values to start from; empty: an amplitude, zero when absent
    probe: float = 0.3  # of `scale`: how far to go to see what an amplitude does
    one_way: bool = False  # what it does when negative is another thing
    low: float = float("-inf")  # where it means something
    high: float = float("inf")
    searched: bool = False  # over its shapes or by scatter; never differentiated
    reached: bool = False  # a bending angle: one that the recordings go beyond


@dataclass(frozen=True)
class Event:
    """An effect without a path that repeats: it is told by its scatter (diagnosis/scatter.py)."""

    amount: str  # the parameter that says how much it scatters
    mean: str = ""  # and the one that says what of it repeats
    cause: str = ""  # what to mend
    what: str = ""  # that no model takes away


@dataclass(frozen=True)
class Transform:
    """An effect's law in Python, of another distribution's (tautline.effects.outside); what it does with all its
    amplitudes at zero is never asked. It is differentiated by differences, by its own parameters."""

    place: Literal["input", "state", "output"]  # of q, of the tip's p before f_remain, of c in deg
    run: Run


@dataclass(frozen=True)
class Kind:
    """An effect of the library. `amplitudes` at zero: absent."""

    id: str  # stage.name
    amplitudes: tuple[Parameter, ...]
    shapes: tuple[Parameter, ...] = ()
    says: str = ""
    tell: str = ""  # how a person tells it from what looks like it
    mend: str = ""  # what to do about it on the instrument
    # sensor: the model has a delay for what is observed; freedom: the instrument's second or third degree of freedom
    # moves; joint: a further joint's column does.
    needs: Literal["", "camera", "sensor", "load", "freedom", "joint"] = ""
    column: str = ""  # of motor.csv, that it follows
    of_joint: Callable[[str], Kind] | None = None  # the same for a further joint's column
    holds: Holds | None = None  # a corrected model holds it in its own tables, rig or delay; None: it is simulated
    undone: bool = False  # a section of the board's tables undoes it (tautline.undone)
    in_tables: bool = False  # it is simulated as the model that holds it
    course: Callable[[Mapping[str, float], float], float] | None = None  # over the session's time, s: how much of it
    event: Event | None = None
    law: bool = False  # the same equations everywhere: rigid motion, time
    material: bool = False  # of friction or a tendon's material, which no equation has exactly
    nominal: bool = False  # a recalibration has it already where it holds in all recordings
    posture: bool = False  # another posture, tension or homing changes it, together with others of the kind
    contains: tuple[str, ...] = ()  # effects that it can do too
    brings: tuple[str, ...] = ()  # parts of the nominal model that it may well move too, where it came later
    curve: tuple[str, ...] = ()  # amplitudes: coefficients of a cubic spline over the motor's range, in order
    simple: Kind | None = None  # the same with fewer parameters, where what is beside it could do the rest
    each: bool = False  # it alone may be another in every recording
    scan: Literal["probe", "period", "moment"] = "probe"  # how its shapes are screened
    transform: Transform | None = None  # None: the library's own C or tables simulate it
    # What it could do whatever its equations are, beside moving the tip through the angle (diagnosis/confined.py).
    leaves: Literal["", "lens", "plane", "channel", "time"] = ""

    @property
    def stage(self) -> str:
        return self.id.split(".", 1)[0]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (*self.amplitudes, *self.shapes)

    @property
    def moments(self) -> tuple[str, ...]:
        """Times of the session, s, at which it happens; there are as many amplitudes for each of them."""
        return tuple(p.name for p in self.shapes) if self.scan == "moment" else ()

    def happening(self, times: int) -> Kind:
        """The same effect with its first `times` moments alone, and their amplitudes."""
        each = len(self.amplitudes) // len(self.moments)
        return replace(self, amplitudes=self.amplitudes[: times * each], shapes=self.shapes[:times])

    @property
    def forms(self) -> tuple[Kind, ...]:
        """All variants with its id: itself, the one with fewer parameters, the one that follows a further joint's
        column."""
        of_joint = self.of_joint and self.of_joint("")
        return tuple(form for form in (self, self.simple, of_joint) if form)

    def of_values(self, values: Mapping[str, Any]) -> Effect:
        """The effect as a model has it, out of values that are known by their names."""
        own = {p.name: values[p.name] for p in self.parameters if p.name in values}
        return Effect(self.id, own | ({COLUMN: self.column} if self.column else {}))

    @property
    def through_angle(self) -> bool:
        """Whether it acts on the way from motor to bending angle, a simulator in its place included; else it changes
        only how, or when, the tip is seen."""
        return self.stage in (SIMULATOR, *THROUGH_ANGLE)

    @property
    def bends(self) -> bool:
        """Whether it adds to the bending angle, and not to the place that f_remain bends by alone."""
        return self.stage == THROUGH_ANGLE[2] or self.needs == "load"

    @property
    def carried(self) -> bool:
        """Whether it moves the tip by a law that is the same at all times: beside B and f_remain it can be fitted in
        any sensor's own coordinates, and a calibrated model may carry it."""
        repeats = not (self.event or self.course or self.moments)
        return self.through_angle and repeats and not self.nominal and self.holds is None

    @property
    def on_board(self) -> bool:
        """Whether the tables of a corrected model put the tip where that model says: what ends up in B and f_remain,
        what a section undoes, and what only changes how the tip is seen; what scatters nothing takes away."""
        seen = self.stage in _TABLED and self.event is None
        return self.holds is not None or self.undone or seen


def six(prefix: str) -> tuple[Parameter, ...]:
    """The parameters of a rigid motion, PREFIX_rx .. PREFIX_z: a turn as a rotation vector, deg, then a move, mm."""
    turn = tuple(Parameter(f"{prefix}_r{axis}", "deg", 0.5) for axis in "xyz")
    move = tuple(Parameter(f"{prefix}_{axis}", "mm", 0.2) for axis in "xyz")
    return turn + move


def simulator_id(parameter: str) -> str:
    """Of an effect, and of its only parameter: a change of a simulator's own one, which is declared by this name."""
    return f"{SIMULATOR}.{parameter}"


def of_simulator(
    parameter: str, unit: str = "", spread: float = 1.0, low: float = float("-inf"), high: float = float("inf")
) -> Kind:
    """The effect of a simulator's parameter that is another one on the robot. spread, low, high: of its change."""
    name = simulator_id(parameter)
    return Kind(
        name,
        (Parameter(name, unit, spread, low=low, high=high),),
        says=f"the simulator's {parameter} is not the robot's",
        tell="It is told by the whole course of the motion, as the simulator shows it with another value: what looks "
        "alike is named beside it.",
        mend="Put the value that is named into the simulator.",
    )
