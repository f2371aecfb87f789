"""A transmission with backlash for MuJoCo: play, law and what comes late, from the tables beside this file.

It needs numpy alone. With the model of scene_callback.xml, before each step:

    model = mujoco.MjModel.from_xml_path("scene_callback.xml")
    data = mujoco.MjData(model)
    control = Control(model)
    control.start(data, q=0.0)
    for q in motor:                     # where the motor is, mm or deg as tables.csv has it
        data.ctrl[control.actuator] = q * control.scale
        control(model, data)            # or once: mujoco.set_mjcb_control(control)
        mujoco.mj_step(model, data)

scene.xml needs no callback: rest(model, data, q) brings it to rest at q, then its control alone leads it.
Without MuJoCo, Transmission().start(q) and .step(q, dt) give the bending angle in deg.
"""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
SLOWER = 5.0  # times creep_time: the slow part of creep


class Transmission:
    """Simulates one motor's transmission, step by step: the play, of width B(q), whose elements stand side by side on
    an axis x that warp.csv maps q to, so that B is 1 everywhere on it; then what comes late, and the law f_remain."""

    def __init__(self, folder: Path = HERE) -> None:
        """Reads transmission.json, tables.csv and warp.csv in a folder; starts in the middle of the tables."""
        self.about: dict[str, Any] = json.loads((folder / "transmission.json").read_text(encoding="utf-8"))
        self.grid, self.width, self.c_deg = _columns(folder / "tables.csv", 3)
        self.r = 0.5 * np.array(self.about["elements"]["width"])  # (elements,) half widths, of B
        self.w = np.array(self.about["elements"]["weight"])  # (elements,) sum 1
        self.warp = _columns(folder / "warp.csv", 2) if len(self.r) > 1 else None
        self.narrow = float(self.about["narrow"])
        self.values: dict[str, float] = self.about["parameters"]
        self.start(float(self.grid[len(self.grid) // 2]))

    def start(self, q: float) -> float:
        """Puts the motor at rest at q, mm or deg by the encoder, with the tip on the centre line: every state of the
        play, the lag and the creep is set anew. Returns the bending angle c, deg."""
        q = self._true_position(q)
        self.single = q  # centre coordinate p of one play of width B
        if self.warp is not None:
            x = _interpolated_end_slopes(q, *self.warp)
            # The elements' mean on the warped axis, where B is 1: it is half of that above the play's lower end.
            half = 0.5 * max(_interpolated(q, self.grid, self.width), self.narrow)
            self.z = self._element_positions(x, _interpolated_end_slopes(q - half, *self.warp) + 0.5)
        p = self._centre()
        self.before = p
        self.lag = [p, p]  # the outputs of both stages
        self.creep = [p, p]  # the fast part's and the slow part's
        return self._bending_angle(p)

    def step(self, q: float, dt: float) -> float:
        """Moves the motor to q, mm or deg by the encoder, within dt s and at constant speed. Returns the bending angle
        c, deg, at the end."""
        q = self._true_position(q)
        half = 0.5 * self.width
        # The play's bounds at q: low + B(low)/2 = q and high - B(high)/2 = q.
        low = _interpolated_slope_1(q, self.grid + half, self.grid)
        high = _interpolated_slope_1(q, self.grid - half, self.grid)
        self.single = min(max(self.single, low), high)
        if self.warp is not None:
            x = _interpolated_end_slopes(q, *self.warp)  # element i of the play stays within x -+ r[i]
            self.z = np.minimum(np.maximum(self.z, x - self.r), x + self.r)
        p = self._centre()
        before, self.before = self.before, p
        return self._bending_angle(self._lag_and_creep(before, p, dt))

    def _centre(self) -> float:
        """The centre coordinate p, unit of q: the elements' weighted mean, taken back through the warp. Without a warp,
        and where B(p) is below `narrow`, it is the single play's."""
        if self.warp is None:
            return self.single
        y = float(self.w @ self.z)
        q, x = self.warp
        # Both ends of a play of width 1 about y, taken back to q: p is their middle.
        p = 0.5 * (_interpolated_end_slopes(y - 0.5, x, q) + _interpolated_end_slopes(y + 0.5, x, q))
        return self.single if _interpolated(p, self.grid, self.width) < self.narrow else p

    def _element_positions(self, x: float, y: float) -> Any:
        """Positions (elements,) of the elements, with the weighted mean y, for a motor at x; all on the warped axis,
        where B is 1. Each element lies at the same distance `at` from the motor, or at its half width r if that is
        smaller."""
        # From the motor to the elements' mean: half of B at most, as the mean of r is 0.5.
        off = min(max(y, x - 0.5), x + 0.5) - x
        # Solves sum of w min(at, r) = |off| for `at`, from one half width r (they rise) to the next. left: what is
        # not made up yet of |off|; rest: the weight of the elements whose r is not reached.
        sign, left, rest, reached = math.copysign(1.0, off), abs(off), 1.0, 0.0
        for r, w in zip(self.r, self.w, strict=True):
            if left <= rest * (r - reached):
                break
            left -= rest * (r - reached)
            reached = float(r)
            rest -= float(w)
        at = reached + (left / rest if rest > 1e-9 else 0.0)
        return x + sign * np.minimum(at, self.r)

    def _lag_and_creep(self, u0: float, u1: float, dt: float) -> float:
        """The centre coordinate, unit of q, after a lag of up to two stages and then creep, at the end of a step of dt
        s in which it went from u0 to u1; moves both states on. `lag`, s, is the sum of the stages' time constants, the
        second one has the share `lag_second` of it. Creep holds back the share `creep_share` of the motion, which
        follows with the time constant creep_time, s, and of it the share creep_slow SLOWER times slower."""
        get = self.values.get
        lag, second = get("lag", 0.0), get("lag_second", 0.0)
        if lag > 0.0:
            stages = (lag * (1.0 - second), lag * second)
            for i, time in enumerate(stages):
                if time > 0.0:
                    before = self.lag[i]
                    self.lag[i] = _first_order(before, u0, u1, dt, time)
                    u0, u1 = before, self.lag[i]
        share = get("creep_share", 0.0)
        if share:
            time, slow = get("creep_time", 1.0), get("creep_slow", 0.0)
            for i, each in enumerate((time, SLOWER * time)):
                self.creep[i] = _first_order(self.creep[i], u0, u1, dt, each)
            u1 -= share * (u1 - (1.0 - slow) * self.creep[0] - slow * self.creep[1])
        return u1

    def _bending_angle(self, p: float) -> float:
        """The bending angle c, deg, at the centre coordinate p: f_remain(p), less what an obstacle holds back. It lies
        at the angle contact_c, on the side contact_side (1 or -1), and holds back the share contact_hold of what goes
        beyond, setting in over contact_soft deg."""
        c = _interpolated_end_slopes(p, self.grid, self.c_deg)
        get = self.values.get
        beyond = (c - get("contact_c", 0.0)) * get("contact_side", 1.0)
        if get("contact_hold", 0.0) and beyond > 0.0:
            soft = get("contact_soft", 0.0)
            yields = math.exp(-beyond / soft) if soft > 0.0 else 0.0
            c -= get("contact_hold", 0.0) * (beyond - soft * (1.0 - yields)) * get("contact_side", 1.0)
        return c

    def _true_position(self, q: float) -> float:
        """The true motor position x where the encoder reads q, both in the unit of q: x = q + e(x), the encoder's error
        e having one and two periods in each encoder_period. Solved by Newton's method."""
        get = self.values.get
        sin, cos, sin2, cos2 = (get(f"encoder_{name}", 0.0) for name in ("sin", "cos", "sin2", "cos2"))
        if not (sin or cos or sin2 or cos2):
            return q
        turn, x = 2.0 * math.pi / get("encoder_period", 1.0), q
        for _ in range(3):  # Newton's steps: the error is a small part of a turn
            s, c, s2, c2 = (f(k * turn * x) for k in (1.0, 2.0) for f in (math.sin, math.cos))
            error = sin * s + cos * c + sin2 * s2 + cos2 * c2
            slope = turn * (sin * c - cos * s + 2.0 * (sin2 * c2 - cos2 * s2))
            x -= (x - q - error) / max(1.0 - slope, 0.2)  # 0.2: a step stays finite
        return x


class Control:
    """Moves the joint that scene_callback.xml couples the tip to. It is called once a step, by hand or by MuJoCo."""

    def __init__(self, model: Any, folder: Path = HERE) -> None:
        """model: the mujoco.MjModel of scene_callback.xml; folder: of the transmission's files."""
        self.transmission = Transmission(folder)
        about = self.transmission.about
        self.scale = float(about["scale"])  # of the control, per unit of q
        self.actuator = int(model.actuator(about["actuator"]).id)
        self.lead = model.joint(about["lead"])
        self.model = model
        self.time = -math.inf

    def start(self, data: Any, q: float) -> None:
        """Brings a simulation (mujoco.MjData) to rest with the motor at q, mm or deg, the tip on the centre line."""
        data.qpos[self.lead.qposadr[0]] = math.radians(self.transmission.start(q))
        rest(self.model, data, q, self.transmission.about)
        self.time = -math.inf

    def __call__(self, model: Any, data: Any) -> None:
        """Moves the transmission on by a step, to the motor position that the actuator's control commands, and sets the
        speed with which the led joint, and so the tip, gets to the resulting angle within the step. A second call in
        the same step does nothing."""
        if data.time == self.time:  # a stage of the same step
            return
        self.time = float(data.time)
        dt = float(model.opt.timestep)
        c = math.radians(self.transmission.step(float(data.ctrl[self.actuator]) / self.scale, dt))
        data.qvel[self.lead.dofadr[0]] = (c - data.qpos[self.lead.qposadr[0]]) / dt


def rest(model: Any, data: Any, q: float, about: dict[str, Any] | None = None) -> None:
    """Brings either scene (mujoco.MjModel and MjData) to rest with the motor at q, mm or deg. The motor's joints are
    set to q, then each joint that an equality leads to where that puts it (they are in order from the motor to the
    tip), all speeds to 0 and the control to q's. about: transmission.json, by default the one beside this file."""
    about = about or json.loads((HERE / "transmission.json").read_text(encoding="utf-8"))
    named = {str(model.joint(i).name): i for i in range(model.njnt)}
    for name in about["moves"]:
        if name in named:
            data.qpos[model.jnt_qposadr[named[name]]] = q
    place = model.jnt_qposadr
    for i in range(model.neq):
        if not str(model.equality(i).name).startswith(about["own"]):
            continue
        follower, leader = int(model.eq_obj1id[i]), int(model.eq_obj2id[i])
        of_tip = str(model.equality(i).name) == about["leads"]
        leaders = [leader]
        if of_tip:  # its objects are tendons: over the tip's hinges, and over the joints that lead them
            first = int(model.tendon_adr[leader])
            leaders = [int(joint) for joint in model.wrap_objid[first : first + int(model.tendon_num[leader])]]
        from_rest = sum(data.qpos[place[joint]] - model.qpos0[place[joint]] for joint in leaders)
        moved = sum(float(a) * from_rest**k for k, a in enumerate(model.eq_data[i, :5]))  # MuJoCo's quartic
        if not of_tip:
            data.qpos[place[follower]] = model.qpos0[place[follower]] + moved
            continue
        # The tip's angle is the hinges' sum with their signs: each gets an equal share of it.
        hinges = [(place[named[name]], sign) for name, sign in about["tip"]]
        angle = sum(sign * model.qpos0[at] for at, sign in hinges) + moved
        for at, sign in hinges:
            data.qpos[at] = sign * angle / len(hinges)
    data.qvel[:] = 0.0
    data.ctrl[model.actuator(about["actuator"]).id] = q * about["scale"]


def _columns(path: Path, count: int) -> list[Any]:
    """Reads the first `count` columns of a CSV below its header line, (n,) each."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))[1:]
    return [np.array([float(row[i]) for row in rows]) for i in range(count)]


def _interpolated_end_slopes(x: float, grid: Any, values: Any) -> float:
    """Linear interpolation of values (n,) over a rising grid (n,) at x; beyond the ends with the slope of the end
    spans."""
    i = min(max(int(np.searchsorted(grid, x)) - 1, 0), len(grid) - 2)
    slope = (values[i + 1] - values[i]) / (grid[i + 1] - grid[i])
    return float(values[i] + (x - grid[i]) * slope)


def _interpolated_slope_1(x: float, grid: Any, values: Any) -> float:
    """Linear interpolation of values (n,) over a rising grid (n,) at x; beyond the ends with a slope of 1."""
    return float(np.interp(x, grid, values)) + min(x - float(grid[0]), 0.0) + max(x - float(grid[-1]), 0.0)


def _interpolated(x: float, grid: Any, values: Any) -> float:
    """Linear interpolation of values (n,) over a rising grid (n,) at x; beyond the ends with the value of the end."""
    return float(np.interp(x, grid, values))


def _first_order(y: float, u0: float, u1: float, dt: float, time: float) -> float:
    """The output of a first-order element with the time constant `time`, s, after dt s in which its input went from u0
    to u1 in a straight line; before them the output was y. Exact."""
    behind = time * (u1 - u0) / dt
    return u1 - behind + (y - u0 + behind) * math.exp(-dt / time)
