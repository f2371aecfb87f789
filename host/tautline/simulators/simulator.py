"""What a simulator is to a diagnosis: a function of a motor's log and of parameters that it declares."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from tautline.errors import TautError
from tautline.recording import Motor

Array = npt.NDArray[np.float64]
Simulate = Callable[[Motor, Mapping[str, float]], npt.ArrayLike]


@dataclass(frozen=True)
class Declared:
    """A parameter of the simulator whose value may differ on the robot."""

    name: str  # such as elbow.damping
    unit: str
    nominal: float  # what the simulator has
    spread: float  # above 0: a change that a user would notice, the step of differences and the unit of priors
    low: float = float("-inf")  # the least value that makes sense
    high: float = float("inf")  # the greatest

    def __post_init__(self) -> None:
        """Raises TautError where the nominal value is not finite or is outside of [low, high], or the spread is not
        finite and above 0."""
        if not (np.isfinite(self.nominal) and np.isfinite(self.spread) and self.spread > 0.0):
            raise TautError(f"parameter {self.name}: expected a finite nominal value, and a spread above 0")
        if not self.low <= self.nominal <= self.high:
            raise TautError(f"parameter {self.name}: its nominal value {self.nominal:g} is outside of its own range")


@dataclass(frozen=True)
class Simulator:
    """A user's simulator of the robot. `simulate(motor, parameters)` gives the tip's bending angles (n,), deg, at the
    times of motor.t_s (n,), which are a fixed step apart; the same arguments give the same angles, to the last bit.
    parameters has a value for every declared name."""

    simulate: Simulate
    parameters: tuple[Declared, ...]  # what may be different on the robot
    source: Mapping[str, Any] = field(default_factory=dict)  # plain: what `source.opened` finds it again by
    step_s: float | None = None  # of its integration, where it can be made shorter
    at_step: Callable[[float], Simulator] | None = None  # the same simulator at another step, s

    def __post_init__(self) -> None:
        """Raises TautError where two parameters have the same name."""
        names = [each.name for each in self.parameters]
        if twice := {name for name in names if names.count(name) > 1}:
            raise TautError(f"parameter {min(twice)} of the simulator is declared twice: give each a name of its own")

    def tip(self, motor: Motor, changes: Mapping[str, float]) -> Array:
        """Runs the simulator: the tip's angles (n,), deg, at motor.t_s (n,). changes: by parameter's name, its value
        less its nominal value; 0 for those left out. TautError where the simulator gives another number of angles than
        there are times, or an angle that is not finite."""
        values = {each.name: each.nominal + changes.get(each.name, 0.0) for each in self.parameters}
        angles = np.asarray(self.simulate(motor, values), dtype=float)
        if angles.shape != motor.t_s.shape:
            raise TautError(f"the simulator gave angles of shape {angles.shape} for {len(motor.t_s)} times")
        if not np.isfinite(angles).all():
            off = ", ".join(f"{name} {values[name]:g}" for name in changes) or "its own values"
            raise TautError(f"the simulator's angles are no numbers with {off}: make its time step shorter")
        return angles
