"""How strong each effect is drawn on the second instrument, in the words of reality.Truth."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from tautline.rig import Rig

Draw = Callable[[np.random.Generator, Rig], dict[str, float]]


def around(rng: np.random.Generator, low: float, high: float) -> float:
    """Log-uniform, either sign."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))) * rng.choice([-1.0, 1.0]))


def size(rng: np.random.Generator, low: float, high: float) -> float:
    return abs(around(rng, low, high))


def six(rng: np.random.Generator, prefix: str, turn: float, move: float) -> dict[str, float]:
    a, b = rng.normal(size=3), rng.normal(size=3)
    a, b = a / np.linalg.norm(a) * size(rng, 0.4 * turn, turn), b / np.linalg.norm(b) * size(rng, 0.2 * move, move)
    return {f"{prefix}_r{k}": float(v) for k, v in zip("xyz", a, strict=True)} | {
        f"{prefix}_{k}": float(v) for k, v in zip("xyz", b, strict=True)
    }


# Effect of the library -> how this instrument does it. Lengths are shares of the motor's range.
KNOWN: Mapping[str, Draw] = {
    "actuator.encoder_periodic": lambda g, r: {
        "encoder_period": size(g, 0.03, 0.15) * r.actuator.span,
        "encoder_error": size(g, 0.0015, 0.006) * r.actuator.span,
        "encoder_phase": float(g.uniform(0, 6.28)),
    },
    "transmission.smooth_onset": lambda g, r: {"softness": float(g.uniform(0.3, 0.9))},
    "transmission.asymmetric_backlash": lambda g, r: {
        "latch": around(g, 0.008, 0.03) * r.actuator.span,
        "latch_travel": size(g, 0.03, 0.12) * r.actuator.span,
    },
    "transmission.rate_dependent_backlash": lambda g, r: {
        "viscosity": size(g, 0.03, 0.12),
        "speed_scale": 0.6 * r.actuator.span,
    },
    "transmission.lag": lambda g, r: {"dashpot": size(g, 0.03, 0.15)},
    "transmission.creep": lambda g, r: {"creep_share": size(g, 0.05, 0.2), "creep_time": size(g, 0.7, 2.5)},
    "transmission.stick_slip": lambda g, r: {
        "static_grip": size(g, 0.004, 0.015) * r.actuator.span,
        "kinetic_grip": float(g.uniform(0.0, 0.3)),
        "grip_scatter": float(g.uniform(0.1, 0.4)),
    },
    "transmission.drift": lambda g, r: {
        "creeping_offset": around(g, 0.01, 0.04) * r.actuator.span,
        "widening": float(g.choice([0.0, 1.0])) * around(g, 0.1, 0.4),
        "warm_up": size(g, 200.0, 600.0),
    },
    "transmission.load_dependence": lambda g, r: {
        "stretch_per_load": around(g, 2e-4, 8e-4) * r.actuator.span,
        "capstan_per_load": around(g, 1e-3, 6e-3),
        "soften_per_load": around(g, 3e-4, 2e-3),
    },
    "configuration.axis_coupling": lambda g, r: {
        "pull_by_translation": around(g, 0.1, 0.6),
        "twist": around(g, 0.01, 0.06),
    },
    "configuration.contact": lambda g, r: {
        "obstacle": size(g, 0.3, 3.0),
        "obstacle_at": float(g.uniform(10.0, 28.0)),
        "obstacle_side": float(g.choice([-1.0, 1.0])),
    },
    "kinematics.nonconstant_curvature": lambda g, r: {"taper": around(g, 0.2, 0.8)},
    "registration.static": lambda g, r: six(g, "mount", 3.0, 1.0),
    "registration.direction_dependent": lambda g, r: {
        **{f"rock_{k}": float(v) for k, v in zip("xyz", g.normal(size=3) * size(g, 0.2, 0.8), strict=True)},
        "rock_travel": size(g, 0.001, 0.006) * r.actuator.span,
    },
    "registration.shift": lambda g, r: six(g, "slip", 2.0, 0.8),
    "camera.distortion": lambda g, r: (
        {"fisheye": size(g, 0.15, 0.8)}
        if g.random() < 0.5
        else {"barrel": around(g, 0.04, 0.25), "decentred": around(g, 0.002, 0.02)}
    ),
    "acquisition.delay": lambda g, r: {"late": around(g, 0.015, 0.05)},
    "acquisition.jitter": lambda g, r: {"unsteady": size(g, 0.004, 0.012)},
    "acquisition.held_samples": lambda g, r: {"stalls": float(g.uniform(0.1, 0.3)), "stall_s": size(g, 0.25, 0.8)},
    "acquisition.clock_rate": lambda g, r: {"skew": around(g, 3e-4, 2e-3)},
    "configuration.swing": lambda g, r: {
        "ring_hz": float(g.uniform(0.5, 2.0)),
        "ring_damping": float(g.uniform(0.05, 0.3)),
    },
    "configuration.remaining": lambda g, r: {
        "kink": around(g, 1.5, 5.0),
        "kink_at": r.actuator.range[0] + float(g.uniform(0.25, 0.75)) * r.actuator.span,
        "kink_reach": size(g, 0.03, 0.1) * r.actuator.span,
    },
    "transmission.backlash": lambda g, r: {
        "worn": size(g, 0.4, 1.5),
        "worn_at": r.actuator.range[0] + float(g.uniform(0.3, 0.7)) * r.actuator.span,
        "worn_reach": size(g, 0.06, 0.15) * r.actuator.span,
    },
    "transmission.offset": lambda g, r: {"homing": around(g, 0.005, 0.03) * r.actuator.span},
    "transmission.rest_dependent_backlash": lambda g, r: {
        "setting": size(g, 0.01, 0.06) * r.actuator.span,
        "setting_time": size(g, 0.5, 5.0),
        "setting_travel": size(g, 0.03, 0.15) * r.actuator.span,
    },
}

# Effects that the library does not hold.
UNKNOWN: Mapping[str, Draw] = {
    "breathing": lambda g, r: {"breath": size(g, 0.05, 0.3), "breath_hz": float(g.uniform(0.15, 0.4))},
    "zoom": lambda g, r: {"zoom": around(g, 0.01, 0.05)},
    "sliding_marker": lambda g, r: {"sliding_marker": size(g, 0.02, 0.15)},
    "marker_offset": lambda g, r: {"beside_x": around(g, 0.2, 0.8), "beside_y": around(g, 0.2, 0.8)},
    "pixel_locking": lambda g, r: {"locking": size(g, 0.15, 0.45), "locking_px": float(g.choice([1.0, 2.0, 4.0]))},
    "rolling_shutter": lambda g, r: {"readout": around(g, 0.02, 0.05)},
    "lost_counts": lambda g, r: {
        "lost_counts": size(g, 0.5, 2.0),
        "lost_size": size(g, 0.003, 0.012) * r.actuator.span,
    },
    "gravity": lambda g, r: {"sag": size(g, 0.2, 1.0), "sag_towards": float(g.uniform(0.0, 360.0))},
    "bouc_wen": lambda g, r: {
        "bulge": around(g, 0.006, 0.02) * r.actuator.span,
        "bulge_travel": size(g, 0.08, 0.3) * r.actuator.span,
    },
}
