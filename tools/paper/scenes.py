"""The instruments and motions of the paper's experiments, simulated."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from tautline import geometry, trajectory
from tautline.recording import Recording
from tautline.rig import Actuator, Coarse, HandEye, Rig
from tautline.simulated import simulate
from tautline.simulated.instrument import Instrument, preset, reference_rig
from tautline.vision.timing import FrameTiming

Array = np.ndarray

NOISE_PX = 0.05
TILT_DEG = 1.5  # of the instrument in its working channel, the sign with the tip's direction


def turned(rig: Rig, axis: str, angle_deg: float) -> Rig:
    """The rig with its hand-eye rotation R replaced by R R_axis(angle)."""
    assert rig.hand_eye is not None
    turn = Rotation.from_euler(axis, angle_deg, degrees=True).as_matrix()
    matrix = geometry.rotation(rig.hand_eye.rotation_deg) @ turn
    rx, ry, rz = (float(angle) for angle in Rotation.from_matrix(matrix).as_euler("xyz", degrees=True))
    return replace(rig, hand_eye=HandEye((rx, ry, rz), rig.hand_eye.translation_mm))


def fig7_rig() -> Rig:
    """The bending joint itself is the motor: q in deg, f_coarse = f_remain = identity."""
    return replace(reference_rig(), actuator=Actuator("deg", (-60.0, 60.0), 0.01), coarse=Coarse(1.0, 0.0))


def fig7_instrument(rig: Rig, width_deg: float = 15.0) -> Instrument:
    return Instrument.of(rig, lambda p: np.full_like(p, width_deg), lambda p: p, "fig7")


def fig7_recording(seed: int = 0, reversals: int = 38, noise_px: float = NOISE_PX) -> Recording:
    """Back and forth on a ramp at 15 deg/s, seen at 25 Hz: X_cam = R Ry(+-1.5 deg) X_base + t, the sign changing when
    the tip begins to move the other way. `reversals` on the way up, as many on the way down, and one between."""
    rig = fig7_rig()
    plant = fig7_instrument(rig)
    # 24.3071 deg at 15 deg/s is no multiple of the frame period, nor is the way back: onsets fall anywhere in a period
    motion = trajectory.back_and_forth(rig.actuator, [15.0], 24.3071, reversals, 300.0)
    made = simulate.run(rig, plant, motion, noise_px=0.0, timing=FrameTiming.of(rig, seed=seed), seed=seed)
    moved = np.sign(np.diff(made.p, prepend=made.p[0]))
    latest = np.maximum.accumulate(np.where(moved != 0, np.arange(len(moved)), 0))
    direction = np.where(moved[latest] != 0, moved[latest], 1.0)
    at = np.searchsorted(made.t_s, made.scene_s, side="right") - 1
    c = np.interp(made.scene_s, made.t_s, made.c_deg)
    forward, back = (geometry.project(turned(rig, "y", side * TILT_DEG), c) for side in (1.0, -1.0))
    image = np.where(direction[at, None] > 0, forward, back)
    image = image + np.random.default_rng([seed, 7]).normal(0.0, noise_px, image.shape)
    marker = made.recording.marker
    assert marker is not None
    return replace(made.recording, marker=replace(marker, u_px=image[:, 0], v_px=image[:, 1]))


@dataclass(frozen=True)
class Bench:
    """A flexible instrument with the paper's shape of B (a strong rise at the straight pose) and of f_remain (a dead
    zone there), and what its user believes of it."""

    plant: Instrument
    believed: Rig  # as the plant's, but for the registration

    def recording(self, motion: trajectory.Trajectory, seed: int, noise_px: float = NOISE_PX) -> Recording:
        rig = self.plant.rig
        return simulate.simulate(
            rig, self.plant, motion, noise_px=noise_px, timing=FrameTiming.of(rig, seed=seed), seed=seed
        )


def bench(tilt_deg: float = 6.0) -> Bench:
    """`tilt_deg`: how far the registration is off about the base's x axis, which moves the image mainly along v."""
    plant = preset("reference")
    return Bench(plant, turned(plant.rig, "x", tilt_deg))


def calibration_motion(rig: Rig, speed: float = 0.35, reversals: int = 24) -> trajectory.Trajectory:
    return trajectory.back_and_forth(rig.actuator, [speed], 2.0, reversals, 10 * speed)


def test_motion(rig: Rig, cycles: int = 14) -> trajectory.Trajectory:
    """The paper's Fig. 10: trapezoids on a linearly varying mean."""
    return trajectory.trapezoids(rig.actuator, 1.0, 4.0, cycles, 10.0, 0.8)
