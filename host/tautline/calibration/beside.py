"""Effects of the library that were there from the first recording on, fitted together with B, path and delay.

Effects move the tip's place along the curve that it follows, so the same values hold in fits with poses and without. An
effect that adds to the bending angle (a load's gain, another joint) moves that place by as much as the law f_remain,
known from an earlier fit, needs for the angle. With all amplitudes at zero the fit is the one without effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from tautline import effects
from tautline.effects import COLUMN, LIBRARY, SCATTERS, Kind, Parameter
from tautline.elements import Elements, Hysteresis
from tautline.encoder import straight_lines
from tautline.model import Effect, Model
from tautline.recording import Motor

Array = npt.NDArray[np.float64]

# Ids of the effects that a fit can contain.
FITTED = frozenset(kind.id for kind in LIBRARY if kind.carried)

_DIFFERENCE = 0.05  # tolerance: of a parameter's scale: the step of its difference quotient
_WIDER = 5e-4  # tolerance: of the motor's range: the step of B in difference quotients
_AHEAD_S = 5e-3  # tolerance: the interval over which the tip's velocity is taken
_FAR = 30.0  # prior: times a parameter's scale: standard deviation of a step of it


@dataclass(frozen=True)
class FittedEffects:
    """Effects of the library that a joint fit contains beside B, path and delay. Their fitted parameters are amplitudes
    and shapes in which the tip's path can be differentiated; `values` (m,) always has these in the order of
    `parameters`. `held` has the values of all other parameters."""

    kinds: tuple[Kind, ...]
    law: Model  # f_remain, as far as it is known, and the load at which it holds
    held: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, found: Sequence[Effect], law: Model, others_rest: bool = False) -> tuple[Self, Array]:
        """Those of the effects `found` that can be fitted, and their values (m,) to begin with: the numbers that they
        have, else 0 for an amplitude and its first typical value for a shape. law: f_remain, as it is known so far.
        others_rest: translation and rotation rest at all frames that count, so that parameters of effects that follow
        these axes are held."""
        known = [effect for effect in found if effect.id in FITTED]
        kinds = tuple(effects.kind_of(effect) for effect in known)
        untold = [kind for kind in kinds if others_rest and kind.needs == "freedom"]
        fixed = {p.name for kind in kinds for p in kind.parameters if p.searched or kind in untold}
        numbers = {name: float(v) for effect in known for name, v in effect.parameters.items() if name != COLUMN}
        held = {name: v for name, v in numbers.items() if name in fixed - SCATTERS}
        beside = cls(kinds, law.alone, held)
        span = law.rig.actuator.span
        start = {p.name: p.shape[0] * p.share(span) if p.shape else 0.0 for p in beside.parameters}
        return beside, np.array([numbers.get(name, value) for name, value in start.items()])

    @property
    def forms(self) -> tuple[Self, ...]:
        """This, and for each held parameter with two possible values one more in which it has the other value."""
        twofold = [p for kind in self.kinds for p in kind.parameters if p.name in self.held and len(p.shape) == 2]
        others = ((p.name, sum(p.shape) - self.held[p.name]) for p in twofold)  # the sum of both less this one
        return self, *(replace(self, held={**self.held, name: other}) for name, other in others)

    @property
    def bends(self) -> bool:
        """Whether any of the effects adds to the bending angle, beside those that move the play's centre."""
        return any(kind.bends for kind in self.kinds)

    @property
    def parameters(self) -> list[Parameter]:
        """The fitted parameters in the order of `values`: those that are neither searched nor held."""
        every = (p for kind in self.kinds for p in kind.parameters)
        return [p for p in every if not p.searched and p.name not in self.held]

    @property
    def scales(self) -> Array:
        """(m,) a noticeable change of each fitted parameter, in its own unit; for parameters in the motor's unit it is
        a share of the motor's range."""
        span = self.law.rig.actuator.span
        return np.array([p.scale * p.share(span) for p in self.parameters])

    @property
    def precision(self) -> Array:
        """(m,) what is added to the normal matrix's diagonal for each value, in units of the residuals' variance: 1 /
        sigma^2 with sigma _FAR scales. It is the prior of a step from the present value, not of the value: it keeps a
        value that no frame tells where it is, and pulls none towards 0."""
        return np.asarray((_FAR * self.scales) ** -2.0)

    def inside(self, values: Array) -> Array:
        """Values (m,) clipped to the ranges of their parameters."""
        span = self.law.rig.actuator.span
        return np.array([p.inside(value, span) for p, value in zip(self.parameters, values.tolist(), strict=True)])

    def any_at_end(self, values: Array) -> bool:
        """Whether any of the values (m,) is at an end of its range other than 0. Then the effect is the limit of its
        law there, which is a simpler law."""
        span = self.law.rig.actuator.span
        own = zip(values.tolist(), (p.limits(span) for p in self.parameters), strict=True)
        return any(value != 0.0 and (value <= low or value >= high) for value, (low, high) in own)

    def amplitudes(self, values: Array, of: Kind | None = None) -> Array:
        """(m,) the values with all but amplitudes set to 0. of: keeps the amplitudes of this effect only; of all by
        default."""
        own = {p.name for kind in self.kinds for p in kind.amplitudes if of in (None, kind)}
        return np.where([p.name in own for p in self.parameters], values, 0.0)

    def at_ends(self, values: Array, towards: Array) -> npt.NDArray[np.intp]:
        """Indices of those values (m,) that are at an end of their range and would leave it in the direction `towards`
        (m,), of which only the sign counts."""
        onward = self.inside(values + np.sign(towards) * 1e-6 * self.scales)
        return np.flatnonzero(onward == values)

    def _parameters_by_name(self, values: Array) -> dict[str, Any]:
        """All parameters of the effects by name: the fitted ones with values (m,), the held ones, and the columns of
        motor.csv that effects follow."""
        fitted = zip((p.name for p in self.parameters), values.tolist(), strict=True)
        followed = [(COLUMN, kind.column) for kind in self.kinds if kind.column]
        return {**dict(fitted), **self.held, **dict(followed)}

    def to_effects(self, values: Array) -> tuple[Effect, ...]:
        """The effects with values (m,), as a model carries them."""
        named = self._parameters_by_name(values)
        return tuple(kind.of_values(named) for kind in self.kinds)

    def follow(
        self, motor: Motor, at_s: Array, grid: Array, width: Array, hysteresis: Hysteresis, values: Array
    ) -> effects.Path:
        """Simulates the tip at times at_s (n,), s, of a motor's log, with B width (grid,) on the grid, the hysteresis
        and effects of values (m,). The path's `tip` is the position along f_remain that has the path's bending angle,
        so that what adds to the angle moves the tip, too. The log is turned into straight lines first, as in
        predictions, since the speed of readings between an encoder's counts would be rough."""
        plays = {"elements": hysteresis} if isinstance(hysteresis, Elements) else {"friction": hysteresis}
        law, rig = self.law.remaining(grid), self.law.rig
        model = Model(rig, grid, width, np.zeros_like(grid), law, 0.0, (grid[0], grid[-1]), **plays)
        lines = straight_lines(motor, rig.actuator.encoder_resolution)
        path = effects.follow(
            model, lines, at_s, self._parameters_by_name(values), load_reference=self.law.load_reference_mNm
        )
        # What the effects add to the bending angle, as a way along f_remain, unit of q.
        bent = model.remaining_inverse(path.c_deg) - model.remaining_inverse(model.remaining(path.tip))
        return replace(path, tip=path.tip + bent)

    def slopes(
        self, motor: Motor, at_s: Array, grid: Array, width: Array, hysteresis: Hysteresis, values: Array
    ) -> tuple[Array, Array, Array]:
        """Derivatives of the tip's place, unit of q, by differences of `follow`, whose arguments these are: (n,) by B
        if it is wider by the same everywhere; (n, m) by each value; (n,) by the delay, per s."""

        def tip(times: Array, there: Array, wider: float = 0.0) -> Array:
            """The tip's place (n,), unit of q, at these times and values; B is wider everywhere by `wider`, unit of
            q."""
            return self.follow(motor, times, grid, width + wider, hysteresis, there).tip

        steps = _DIFFERENCE * self.scales
        columns = np.zeros((len(at_s), len(values)))
        for i, step in enumerate(steps):
            ahead, behind = (self.inside(values + sign * step * np.eye(len(values))[i]) for sign in (1.0, -1.0))
            columns[:, i] = (tip(at_s, ahead) - tip(at_s, behind)) / (ahead - behind)[i]
        wider = _WIDER * self.law.rig.actuator.span
        narrower = min(wider, float(width.min()))
        by_width = (tip(at_s, values, wider) - tip(at_s, values, -narrower)) / (wider + narrower)
        return by_width, columns, (tip(at_s, values) - tip(at_s + _AHEAD_S, values)) / _AHEAD_S
