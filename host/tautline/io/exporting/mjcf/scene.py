"""The user's MJCF with a transmission in it: in XML alone, or with a joint that a callback leads.

Either holds the tip to one coordinate by an equality, so that the tip is where the transmission says; what acts on the
tip (weight, springs, contacts) is carried by the transmission's friction. The transmission's coordinates are slides in
the unit of q, which nothing pulls down and whose mass is large against the tip's own.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt
from numpy.polynomial import polynomial

from tautline.errors import TautError
from tautline.io.exporting.mjcf.chain import ORDER, Chain, Sum
from tautline.io.exporting.mjcf.nominal import OWN, Nominal

Array = npt.NDArray[np.float64]

MOTOR, CENTRE, HALF, LAGGING, LAW, LEAD, TIP = (OWN + n for n in ("q", "p", "half", "late", "law", "c", "tip"))
SEEN = f"{TIP}_seen"
_HEAVY = 100.0  # tolerance: the play's mass, in shares of the tip's that goes with it: the tip does not move it
_MOTOR_HEAVY = 1000.0  # tolerance: the motor's, in the play's: friction moves the motor by 1e-5 of the range
_STOPS = 5e3  # tolerance: of the range, 1/s^2: friction stops the play, at one range a second, within 1e-4 of the range
_FRICTION = 10.0  # tolerance: times what acts on the tip
_SERVO, _DAMPING = 0.8, 0.4  # tolerance: of the motor's position loop: its rate times the step; share of critical
_STEPS = 2.0  # limit: of the simulation: MuJoCo's shortest time constant of a constraint
_IMPEDANCE = (0.9999, 0.9999, 1e-3, 0.5, 2.0)  # limit: of every constraint: as stiff as MuJoCo takes it
_BEYOND = 1e9  # tolerance: an end that no tendon reaches
_LIGHTEST = 1e-9  # tolerance: kg, of what weighs nothing
_SAME = np.array([0.0, 1.0, 0.0, 0.0, 0.0])  # the polynomial that changes nothing


@dataclass(frozen=True)
class Law:
    """What a transmission does, for MuJoCo: B/2 and the tip's angle, rad, over q - middle as polynomials, and a
    first-order lag behind the play."""

    middle: float  # of the motor's range, unit of q
    span: float  # of the motor's range, unit of q
    steepest: float  # rad of tip per unit of q
    half: Chain  # B/2, unit of q
    angle: Sum  # of the tip, rad
    lag_s: float
    delay_s: float  # of the sensor


class Scene:
    """The user's MJCF with a transmission that is added to it, part by part. In the transmission's slides one unit of q
    is one metre to MuJoCo."""

    def __init__(self, nominal: Nominal, law: Law) -> None:
        """Opens the MJCF and adds sensors of the tip's angle."""
        import mujoco

        self.mj, self.nominal, self.law = mujoco, nominal, law
        self.spec = mujoco.MjSpec.from_file(str(nominal.path))
        self.mass = max(_HEAVY * nominal.inertia * law.steepest**2, _LIGHTEST)  # of a slide
        self.stiff = [_STEPS * nominal.timestep, 1.0]  # solref of the constraints
        self._add_tip_sensors()

    def text(self, out: Path) -> str:
        """The MJCF as text, with the parts added so far, for a file in the folder `out`, from which its meshes and
        textures are named. TautError where MuJoCo cannot compile it."""
        try:
            self.spec.compile()
            text = str(self.spec.to_xml())
        except ValueError as error:
            said = " ".join(str(error).split())
            raise TautError(f"{self.nominal.path}: MuJoCo refuses it with a transmission in it ({said})") from error
        if not any(
            each.file for each in (*self.spec.meshes, *self.spec.textures, *self.spec.hfields, *self.spec.skins)
        ):
            return text
        whole = ElementTree.fromstring(text)  # files are named from the old place, and have to be from the new one
        compiler = whole.find("compiler")
        compiler = ElementTree.SubElement(whole, "compiler") if compiler is None else compiler
        for name in ("meshdir", "texturedir"):
            folder = self.nominal.path.parent.resolve() / getattr(self.spec, name)
            compiler.set(name, os.path.relpath(folder, out.resolve()))
        return ElementTree.tostring(whole, encoding="unicode") + "\n"

    def add_slide(self, name: str, mass: float, reference: float) -> Any:
        """Adds a body on a slide joint, both called `name`, whose reference position is `reference`; gravity does not
        act on it. The file's key frames have it at rest there. mass: kg. Returns the joint (of mujoco.MjSpec)."""
        body = self.spec.worldbody.add_body(
            name=name,
            gravcomp=1.0,
            explicitinertial=True,
            mass=max(mass, _LIGHTEST),
            inertia=[max(mass, _LIGHTEST)] * 3,
            ipos=[0.0, 0.0, 0.0],
            iquat=[1.0, 0.0, 0.0, 0.0],
        )
        for key in self.spec.keys:  # a slide's coordinate comes after those of the user's file
            if len(key.qpos):
                key.qpos = [*key.qpos, reference]
            if len(key.qvel):
                key.qvel = [*key.qvel, 0.0]
        return body.add_joint(
            name=name, type=self.mj.mjtJoint.mjJNT_SLIDE, axis=[1.0, 0.0, 0.0], ref=reference, damping=[0.0, 0.0, 0.0]
        )

    def add_motor(self) -> None:
        """Adds the slide MOTOR, whose position is q, with a sensor of it, and makes the user's actuator drive it with a
        position loop, without its own dynamics, delay and limits of force. The control stays in the actuator's own
        unit, q times `scale`."""
        nominal, mass = self.nominal, _MOTOR_HEAVY * self.mass
        self.add_slide(MOTOR, mass, self.law.middle)
        rate, scale = _SERVO / nominal.timestep, nominal.scale
        # The gains are per unit of the actuator's length, scale q: so divided by scale^2.
        stiffness, damping = mass * rate**2 / scale**2, 2.0 * _DAMPING * mass * rate / scale**2
        actuator = self.spec.actuator(nominal.mount.actuator)
        actuator.trntype = self.mj.mjtTrn.mjTRN_JOINT
        actuator.target = MOTOR
        actuator.gear = [scale, 0.0, 0.0, 0.0, 0.0, 0.0]
        actuator.set_to_position(kp=stiffness, kv=damping)
        actuator.dyntype = self.mj.mjtDyn.mjDYN_NONE
        actuator.forcelimited = self.mj.mjtLimited.mjLIMITED_FALSE
        actuator.actlimited = self.mj.mjtLimited.mjLIMITED_FALSE
        actuator.delay = 0.0
        actuator.nsample = 0
        actuator.lengthrange = [0.0, 0.0]
        self.spec.add_sensor(
            name=MOTOR, type=self.mj.mjtSensor.mjSENS_JOINTPOS, objtype=self.mj.mjtObj.mjOBJ_JOINT, objname=MOTOR
        )

    def add_play(self) -> None:
        """Adds the slide CENTRE, whose position is p and which follows MOTOR through the play: two tendons with limits
        hold q - p - half <= 0 and q - p + half >= 0, half = B(p)/2. Between these walls friction holds p."""
        nominal, law, mass = self.nominal, self.law, self.mass
        centre = self.add_slide(CENTRE, mass, law.middle)
        centre.frictionloss = max(_FRICTION * nominal.load * law.steepest, _STOPS * law.span * mass)
        centre.solref_friction, centre.solimp_friction = self.stiff, _IMPEDANCE
        half, _ = self.add_chain(HALF, CENTRE, law.half.links, 0.0)
        for name, side, ends in (("rise", -1.0, (-_BEYOND, 0.0)), ("fall", 1.0, (0.0, _BEYOND))):
            wall = self.spec.add_tendon(name=OWN + name, limited=self.mj.mjtLimited.mjLIMITED_TRUE, range=ends)
            wall.solref_limit, wall.solimp_limit = self.stiff, _IMPEDANCE
            for joint, share in ((MOTOR, 1.0), (CENTRE, -1.0), (half, side)):
                wall.wrap_joint(joint, share)

    def add_law(self) -> None:
        """Makes the tip follow the slide CENTRE by f_remain; where the law has a lag, through a slide LAGGING that
        follows CENTRE in first order."""
        law, behind = self.law, CENTRE
        if law.lag_s > 0.0:  # a spring from the play, and a damper: lag_s is damping over stiffness
            damping = self.mass / self.nominal.timestep  # its own mass follows within a step, so that nothing swings
            late = self.add_slide(LAGGING, self.mass, law.middle)
            late.damping = [damping, 0.0, 0.0]
            spring = self.spec.add_tendon(
                name=LAGGING, stiffness=[damping / law.lag_s, 0.0, 0.0], springlength=[0.0, 0.0]
            )
            spring.wrap_joint(LAGGING, 1.0)
            spring.wrap_joint(CENTRE, -1.0)
            behind = LAGGING
        single = len(law.angle.chains) == 1  # its last link is the tip's own equality
        ends = [
            self.add_chain(f"{LAW}{i}", behind, chain.links[:-1] if single else chain.links, 0.0)
            for i, chain in enumerate(law.angle.chains)
        ]
        last = law.angle.chains[0].links[-1] if single else _SAME
        self.lead_tip([joint for joint, _ in ends], last, sum(at for _, at in ends))

    def add_led_joint(self) -> None:
        """Makes the tip follow the slide LEAD, rad, which the callback moves."""
        start = float(self.law.angle(0.0))
        self.add_slide(LEAD, _HEAVY * _MOTOR_HEAVY * self.nominal.inertia, start)
        self.lead_tip([LEAD], _SAME, start)

    def add_chain(self, name: str, joint: str, links: tuple[Array, ...], x0: float) -> tuple[str, float]:
        """Adds a slide for each link of a chain, NAME_1, NAME_2 and so on. An equality holds each slide at the link's
        polynomial (5,), the constant first, of the slide before it, the first one of `joint`. x0: position of `joint`
        at its reference. Returns the last slide's name and its reference position (`joint` and x0 without links)."""
        for i, link in enumerate(links):
            y0 = float(polynomial.polyval(x0, link))
            this = f"{name}_{i + 1}"
            self.add_slide(this, self.mass, y0)
            self._add_equality(self.mj.mjtObj.mjOBJ_JOINT, this, joint, _shifted_polynomial(link, x0, y0))
            joint, x0 = this, y0
        return joint, x0

    def lead_tip(self, joints: list[str], link: Array, x0: float) -> None:
        """Adds an equality that holds the tip's angle, rad, at the polynomial link (5,), the constant first, of the sum
        of these joints' positions. x0: that sum where all of them are at their references."""
        leads = self.spec.add_tendon(name=f"{TIP}_leads")
        for joint in joints:
            leads.wrap_joint(joint, 1.0)
        self._add_equality(
            self.mj.mjtObj.mjOBJ_TENDON, TIP, leads.name, _shifted_polynomial(link, x0, self.nominal.rest)
        )

    def _add_equality(self, kind: Any, one: str, other: str, coefficients: Array) -> None:
        """Adds an equality of MuJoCo: the position of `one` less its reference is the polynomial with these
        coefficients (5,), the constant first, of the position of `other` less its reference. kind: mjOBJ_JOINT or
        mjOBJ_TENDON, which both are."""
        of_joint = kind == self.mj.mjtObj.mjOBJ_JOINT
        equality = self.spec.add_equality(
            name=f"{one}_equal",
            type=self.mj.mjtEq.mjEQ_JOINT if of_joint else self.mj.mjtEq.mjEQ_TENDON,
            objtype=kind,
            name1=one,
            name2=other,
        )
        equality.data[: ORDER + 1] = coefficients
        equality.solref, equality.solimp = self.stiff, _IMPEDANCE

    def _add_tip_sensors(self) -> None:
        """Adds a tendon TIP over the tip's hinges, whose length is the tip's angle, and sensors of it: without delay,
        and, if the model has one, with the sensor's delay (SEEN)."""
        tip = self.spec.add_tendon(name=TIP)
        for name, sign in self.nominal.tip:
            tip.wrap_joint(name, sign)
        kind = {"type": self.mj.mjtSensor.mjSENS_TENDONPOS, "objtype": self.mj.mjtObj.mjOBJ_TENDON, "objname": TIP}
        self.spec.add_sensor(name=TIP, **kind)
        if self.law.delay_s > 0.0:
            kept = math.ceil(self.law.delay_s / self.nominal.timestep) + 2
            self.spec.add_sensor(name=SEEN, delay=self.law.delay_s, nsample=kept, **kind)


def _shifted_polynomial(link: Array, x0: float, y0: float) -> Array:
    """The coefficients (5,), the constant first, of link(x0 + d) - y0 in d; link (5,): likewise. MuJoCo's equalities
    count from the joints' references, x0 and y0."""
    shifted = np.zeros(1)  # Horner's rule, in polynomials of d
    for coefficient in link[::-1]:
        shifted = polynomial.polyadd(polynomial.polymul(shifted, [x0, 1.0]), [coefficient])
    shifted = np.pad(shifted, (0, ORDER + 1 - len(shifted)))
    shifted[0] -= y0
    return shifted
