"""MuJoCo as the simulator: the user's own MJCF or URDF, one actuator of it driven by the motor's log."""

from __future__ import annotations

import copy
import hashlib
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from tautline import _native
from tautline.errors import TautError
from tautline.recording import Motor
from tautline.simulators.scene import (
    carried_by,
    carries_weight,
    check_mujoco,
    check_named,
    read_mujoco,
    tip_of,
    with_servo,
)
from tautline.simulators.simulator import Declared, Simulator

if TYPE_CHECKING:
    import mujoco

Array = npt.NDArray[np.float64]

KIND = "mjcf"
_PER_UNIT = {"mm": 1e-3, "deg": math.radians(1.0)}  # equation: m or rad of a control, per unit of q
_UNITS = {True: ("Nm", "rad"), False: ("N", "m")}  # of a hinge, of a slide or a tendon
_SETTLE_S = 2.0  # tolerance: at the first control, before the log begins
_DELAY_S = 0.02  # prior: a change that a user would notice
_DAMPED = 0.2  # prior: share of critical damping: the same, where a joint has none
_STUCK_RAD = 5e-3  # prior: by which the servo is off where friction that the file does not have holds the joint
_HALF, _HUNDREDTH = 0.5, 0.01  # prior: of a gain or a mass: its spread, and its least
_DELAY_MOST_S = 0.5  # prior: no command takes longer
_LAG_S = 0.02  # prior: of a servo that follows in first order: as of a delay


@dataclass(frozen=True)
class Mjcf:
    """One actuator and one tip of an MJCF or URDF file, simulated by MuJoCo."""

    path: Path
    actuator: str  # its name; of a file without actuators a joint's
    tip: str  # joint:NAME, or site:NAME: the free hinges above it
    scale: float  # control (the actuator's unit) per unit of q
    step_s: float | None = None  # of the simulation, instead of the file's own

    def simulate(self, motor: Motor, parameters: Mapping[str, float]) -> Array:
        """Simulates the motor's log: returns the tip's angle (n,), deg, at motor.t_s (n,). parameters: the value of
        each of `parameters`, by name. The log is interpolated to the simulation's steps. The simulation begins
        _SETTLE_S before the log, at rest at its first position."""
        import mujoco
        from mujoco import rollout

        model = self._model_with(parameters)
        step = self.time_step
        begin = float(motor.t_s[0]) - _SETTLE_S
        steps = math.ceil((float(motor.t_s[-1]) - begin) / step) + 1
        t_s = begin + step * np.arange(steps)
        command_times = t_s - parameters[f"{self.actuator}.delay"]
        data = self._initial_state(model, self.scale * float(motor.q[0]))
        control = np.tile(data.ctrl, (steps, 1))  # of all actuators: the others stay as they begin
        command = self.scale * np.interp(command_times, motor.t_s, motor.q)
        if not self._has_filter and self._lag_name:
            command = _first_order_response(command, parameters[self._lag_name] / step)
        control[:, self._actuator_index] = command
        first = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
        mujoco.mj_getState(model, data, first, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        with _without_warnings():
            states, _ = rollout.rollout(model, data, first[None], control[None])
        # State k is the one after the step with control k, at t_s[k] + step. It begins with the time, then comes qpos.
        angle = np.zeros(steps)
        for name, sign in self._tip_hinges:
            angle += sign * states[0, :, 1 + int(model.joint(name).qposadr[0])]
        return np.asarray(np.degrees(np.interp(motor.t_s, t_s + step, angle)))

    @property
    def time_step(self) -> float:
        """The length of a step of the simulation, s: `step_s`, or without it the file's."""
        return float(self._model.opt.timestep) if self.step_s is None else self.step_s

    @cached_property
    def parameters(self) -> tuple[Declared, ...]:
        """The parameters that may differ on the robot, with their values in the file and their ranges: those of the
        actuator, of the joint that it drives and of the tip's hinges."""
        return tuple(self._all_declared())

    @cached_property
    def _model(self) -> mujoco.MjModel:
        """The file, compiled by MuJoCo. A file without any actuator, such as a URDF, gets a servo on the joint
        `actuator`. TautError where the actuator, or that joint, is not in the file."""
        model = read_mujoco(self.path)
        if not model.nu:
            return with_servo(self.path, self.actuator)
        check_named(self.path, "actuator", self.actuator, [str(model.actuator(i).name) for i in range(model.nu)])
        return model

    @cached_property
    def _tip_hinges(self) -> tuple[tuple[str, float], ...]:
        """Names of the hinges whose angles add up to the tip's, each with its sign, 1 or -1."""
        return tip_of(self._model, self.path, self.tip)

    @cached_property
    def _actuator_index(self) -> int:
        """The actuator's number in the compiled model."""
        return int(self._model.actuator(self.actuator).id)

    @property
    def _is_servo(self) -> bool:
        """Whether the actuator is a position servo: its force is kp (control - length) - kv speed."""
        gain, bias = (
            self._model.actuator_gainprm[self._actuator_index],
            self._model.actuator_biasprm[self._actuator_index],
        )
        return bool(gain[0] > 0.0 and bias[1] == -gain[0])

    @property
    def _has_filter(self) -> bool:
        """Whether the file's actuator follows its control in first order, with a state of its own."""
        import mujoco

        kind = int(self._model.actuator_dyntype[self._actuator_index])
        return kind in (mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT)

    @property
    def _lag_name(self) -> str:
        """The name of the parameter that is the time constant of the actuator's first-order lag. The file has that lag
        as a filter, or `simulate` adds it. "" for an actuator with another kind of state, such as a muscle."""
        import mujoco

        follows = self._has_filter or self._model.actuator_dyntype[self._actuator_index] == mujoco.mjtDyn.mjDYN_NONE
        return f"{self.actuator}.timeconst" if follows else ""

    @cached_property
    def _changeable_joints(self) -> tuple[str, ...]:
        """The names of the joints whose parameters may change, each once: the tip's hinges, then the joint that the
        actuator drives."""
        names = [name for name, _ in self._tip_hinges]
        if self._driven_joint is not None:
            names.append(str(self._model.joint(self._driven_joint).name))
        return tuple(dict.fromkeys(names))

    @cached_property
    def _driven_joint(self) -> int | None:
        """The number of the joint that the actuator drives; None where it drives something else, such as a tendon."""
        import mujoco

        drives = self._model.actuator_trntype[self._actuator_index] == mujoco.mjtTrn.mjTRN_JOINT
        return int(self._model.actuator_trnid[self._actuator_index, 0]) if drives else None

    def _all_declared(self) -> Iterator[Declared]:
        """Yields the parameters of the file that a diagnosis may change. Their spread is the file's own value (half of
        it for kp and a mass, which cannot be 0); where that is 0, it is a value that would be noticed at this joint's
        inertia and stiffness."""
        import mujoco

        model, data = self._model, mujoco.MjData(self._model)
        mujoco.mj_forward(model, data)
        mass_matrix = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass_matrix)
        kp = float(model.actuator_gainprm[self._actuator_index, 0]) if self._is_servo else 0.0
        for name in self._changeable_joints:
            yield from self._declared_of_joint(data, name, mass_matrix, kp)
        if self._is_servo:
            kv = -float(model.actuator_biasprm[self._actuator_index, 2])
            usual = 2.0 * _DAMPED * math.sqrt(kp * float(np.max(np.diag(mass_matrix))))
            rotary = (
                self._driven_joint is not None and model.jnt_type[self._driven_joint] == mujoco.mjtJoint.mjJNT_HINGE
            )
            force, per = _UNITS[rotary]
            yield Declared(f"{self.actuator}.kp", f"{force}/{per}", kp, spread=_HALF * kp, low=_HUNDREDTH * kp)
            yield Declared(f"{self.actuator}.kv", f"{force} s/{per}", kv, spread=kv or usual, low=0.0)
        if self._lag_name:
            tau = float(model.actuator_dynprm[self._actuator_index, 0]) if self._has_filter else 0.0
            explicit = int(model.actuator_dyntype[self._actuator_index]) == mujoco.mjtDyn.mjDYN_FILTER
            least = min(tau, self.time_step) if explicit else 0.0  # such a filter is not stable below half a step
            yield Declared(self._lag_name, "s", tau, spread=tau or _LAG_S, low=least, high=tau + _DELAY_MOST_S)
        yield Declared(f"{self.actuator}.delay", "s", 0.0, spread=_DELAY_S, low=0.0, high=_DELAY_MOST_S)

    def _declared_of_joint(self, data: mujoco.MjData, name: str, mass_matrix: Array, kp: float) -> Iterator[Declared]:
        """Yields the parameters of the joint `name` itself: damping, friction, armature, and the mass that it carries,
        if its weight loads the joint and no other joint has declared it. data: of the model, after mj_forward;
        mass_matrix (nv, nv): MuJoCo's; kp: the servo's stiffness, 0 without one."""
        import mujoco

        model = self._model
        dof = int(model.joint(name).dofadr[0])
        inertia = float(mass_matrix[dof, dof])
        stiffness = kp or inertia / _DELAY_S**2
        rotary = model.joint(name).type[0] == mujoco.mjtJoint.mjJNT_HINGE
        force, per = _UNITS[rotary]
        damping, friction = float(model.dof_damping[dof]), float(model.dof_frictionloss[dof])
        armature = float(model.dof_armature[dof])
        light = 2.0 * _DAMPED * math.sqrt(stiffness * inertia)
        stuck = _STUCK_RAD * stiffness
        inertia_unit = "kg m^2" if rotary else "kg"
        yield Declared(f"{name}.damping", f"{force} s/{per}", damping, spread=damping or light, low=0.0)
        yield Declared(f"{name}.frictionloss", force, friction, spread=friction or stuck, low=0.0)
        yield Declared(f"{name}.armature", inertia_unit, armature, spread=armature or inertia, low=0.0)
        if carries_weight(model, data, name) and not self._is_in_other_load(data, name):
            mass = float(model.body_subtreemass[int(model.joint(name).bodyid[0])])
            yield Declared(f"{name}.load", "kg", mass, spread=_HALF * mass, low=_HUNDREDTH * mass)

    def _is_in_other_load(self, data: mujoco.MjData, name: str) -> bool:
        """Whether the mass that the joint `name` carries is in another joint's load already, as that one carries this
        joint's body: a mass is declared once. Of joints on the same body the first one declares it. data: of the model,
        after mj_forward."""
        model, own = self._model, int(self._model.joint(name).bodyid[0])
        before = self._changeable_joints[: self._changeable_joints.index(name)]
        for other in self._changeable_joints:
            carries = other != name and own in carried_by(model, other)
            on_the_same_body = int(model.joint(other).bodyid[0]) == own
            if carries and (not on_the_same_body or other in before) and carries_weight(model, data, other):
                return True
        return False

    def _model_with(self, parameters: Mapping[str, float]) -> mujoco.MjModel:
        """A copy of the model with these values of `parameters` and MuJoCo's constants derived from them. The delay,
        and a lag that the file does not have, are not in it: `simulate` applies those."""
        import mujoco

        model = copy.copy(self._model)
        model.opt.timestep = self.time_step
        for name in self._changeable_joints:
            at = int(model.joint(name).dofadr[0])
            model.dof_damping[at] = parameters[f"{name}.damping"]
            model.dof_frictionloss[at] = parameters[f"{name}.frictionloss"]
            model.dof_armature[at] = parameters[f"{name}.armature"]
            if (load := parameters.get(f"{name}.load")) is not None:
                carried = carried_by(model, name)
                factor = load / float(self._model.body_subtreemass[carried[0]])
                model.body_mass[carried] *= factor
                model.body_inertia[carried] *= factor
        if self._is_servo:
            kp = parameters[f"{self.actuator}.kp"]
            model.actuator_gainprm[self._actuator_index, 0], model.actuator_biasprm[self._actuator_index, 1] = kp, -kp
            model.actuator_biasprm[self._actuator_index, 2] = -parameters[f"{self.actuator}.kv"]
        if self._has_filter:
            model.actuator_dynprm[self._actuator_index, 0] = parameters[self._lag_name]
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return model

    def _initial_state(self, model: mujoco.MjModel, control: float) -> mujoco.MjData:
        """The state (mujoco.MjData) in which a simulation begins: the file's first key frame, if it has any, with a
        servo's joint and an actuator's filter at the first command `control`, in the actuator's unit."""
        import mujoco

        data = mujoco.MjData(model)
        if model.nkey:
            mujoco.mj_resetDataKeyframe(model, data, 0)
        index = self._actuator_index
        if self._is_servo and self._driven_joint is not None:
            data.qpos[model.jnt_qposadr[self._driven_joint]] = control / model.actuator_gear[index, 0]
        if self._has_filter:
            data.act[model.actuator_actadr[index]] = control
        mujoco.mj_forward(model, data)
        return data


def _first_order_response(command: Array, steps: float) -> Array:
    """The exact response (n,) of a first-order system, at rest at the command's first value, to a command (n,) that is
    straight between its samples. steps: the time constant in samples; 0: no lag, the command itself."""
    if steps == 0.0:
        return command
    kept = math.exp(-1.0 / steps)
    lag = steps * (1.0 - kept)  # share of a step's change that the output lacks at its end
    moved = command - command[0]
    # equation: y[k] = kept y[k - 1] + (1 - lag) u[k] + (lag - kept) u[k - 1]
    driven = (1.0 - lag) * moved
    driven[1:] += (lag - kept) * moved[:-1]
    rows = driven[:, None]
    _native.first_order_sums(rows, kept)  # in place: to each row `kept` times the one before is added
    return np.asarray(command[0] + rows[:, 0])


def scale_of(scale: float | None, unit: str) -> float:
    """The scale of an actuator's control per unit of q: `scale`, or for None m per mm or rad per deg. TautError where
    it is 0 or not finite."""
    scale = _PER_UNIT[unit] if scale is None else scale
    if not (math.isfinite(scale) and scale != 0.0):
        raise TautError(f"--scale {scale:g}: expected what the control is per {unit} of q, not 0")
    return scale


def simulator(
    path: str | Path,
    actuator: str,
    tip: str,
    unit: str = "deg",
    scale: float | None = None,
    step_s: float | None = None,
) -> Simulator:
    """An MJCF or URDF file as a Simulator. actuator: its control is the motor's position times `scale` (default: rad
    from deg, m from mm); in a file without actuators it is the name of a joint, which gets a servo. tip: joint:NAME, or
    site:NAME for the sum of the free hinges above it. unit: of the motor's position, mm or deg; step_s: of the
    simulation, by default the file's. TautError where the file lacks one of these names."""
    check_mujoco()
    scale = scale_of(scale, unit)
    made = Mjcf(Path(path), actuator, tip, scale, step_s)
    source = {
        "kind": KIND,
        "path": str(Path(path).resolve()),
        "sha256": digest(Path(path)),
        "actuator": actuator,
        "tip": tip,
        "scale": scale,
    }
    at_step = partial(simulator, path, actuator, tip, unit, scale)
    return Simulator(made.simulate, made.parameters, source, step_s=made.time_step, at_step=at_step)


@contextmanager
def _without_warnings() -> Iterator[None]:
    """A context in which MuJoCo writes no warnings, which would go into a file in the working directory. It warns when
    a simulation with a fit's trial values is unstable and restarts; its result then does not fit, and the fit drops
    it."""
    import mujoco

    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


def digest(path: Path) -> str:
    """The SHA-256 of a file, hexadecimal. TautError where the file cannot be read."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise TautError(f"{path}: cannot be read ({error.strerror}): name your MJCF with --simulator") from error
