"""How strong each effect is drawn on a mechanism: what is put into its parts, or into what stands around it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from tools.blindtest.draws import around, six, size
from tools.blindtest.physical.mechanism import ARM, RETURN, TENDON, Topology

Draw = Callable[[np.random.Generator, Topology], dict[str, float]]

_MOST = 0.84  # of what p moves, s does: the spring that pulls it back stretches the tendon
_STIFF = 307.0 + RETURN  # what s is held by: tendon and Kelvin element one after the other, and the spring


def _span(topology: Topology) -> float:
    return 2.0 * topology.half


def _load(rng: np.random.Generator, topology: Topology) -> dict[str, float]:
    if topology is ARM:  # a weight at its end
        return {"payload": size(rng, 1e-4, 4e-4)}
    return {"force_per_load": around(rng, 2e-4, 8e-4) * _span(topology) * _STIFF}


# Effect of the library -> what makes it here.
KNOWN: Mapping[str, Draw] = {
    "transmission.smooth_onset": lambda g, t: {"bristles": size(g, 0.03, 0.12)},
    "transmission.rate_dependent_backlash": lambda g, t: {
        "grip": -size(g, 0.006, 0.02) * _span(t) * TENDON,  # a viscous seat that gives way
        "grip_speed": 0.1 * _span(t),
    },
    "transmission.lag": lambda g, t: {"damper": size(g, 0.03, 0.12)},
    "transmission.creep": lambda g, t: {"kelvin_s": size(g, 0.7, 2.5)},
    "transmission.drift": lambda g, t: {"anchor": around(g, 0.01, 0.04) * _span(t), "anchor_s": size(g, 60.0, 200.0)},
    "transmission.load_dependence": _load,
    "transmission.backlash": lambda g, t: _wider(g, t),
    "transmission.offset": lambda g, t: {"homing": around(g, 0.005, 0.03) * _span(t)},
    "configuration.axis_coupling": lambda g, t: {"pull": around(g, 0.02, 0.1) * _span(t)},
    "configuration.contact": lambda g, t: {
        "wall_soft": size(g, 0.002, 0.006),
        "wall_at": float(g.uniform(0.6, 0.9)) * _MOST * t.gain * t.half,
        "wall_side": float(g.choice([-1.0, 1.0])),
    },
    "configuration.remaining": lambda g, t: {"kelvin_soft": size(g, 1.2, 2.0)},
    "configuration.swing": lambda g, t: _ringing(g),
    "registration.static": lambda g, t: six(g, "mount", 3.0, 1.0),
    "registration.shift": lambda g, t: six(g, "slip", 2.0, 0.8),
    "acquisition.delay": lambda g, t: {"late": around(g, 0.015, 0.05)},
    "acquisition.held_samples": lambda g, t: {"stalls": float(g.uniform(0.1, 0.3)), "stall_s": size(g, 0.25, 0.8)},
}
PROJECTION = frozenset({"registration.static", "registration.shift"})  # only a camera has them
# Outside of the library: the patient breathes, a heart beats, or somebody pushes now and then.
UNKNOWN: Mapping[str, Draw] = {
    "breathing": lambda g, t: {
        "breath": size(g, 0.004, 0.02) * _span(t) * _STIFF,
        "breath_hz": float(g.uniform(0.15, 0.4)),
    },
    "heartbeat": lambda g, t: {
        "heart": size(g, 0.008, 0.03) * _span(t) * _STIFF,
        "heart_hz": float(g.uniform(0.8, 1.6)),
    },
    "pushes": lambda g, t: {
        "push": size(g, 0.01, 0.04) * _span(t) * _STIFF,
        "push_seed": float(g.integers(1, 2**31)),
    },
}


def _wider(rng: np.random.Generator, topology: Topology) -> dict[str, float]:
    """Another play; or dry friction against the tendon's spring, which is one. (MuJoCo's friction does not stick.)"""
    if rng.random() < 0.5:
        return {"widened": math.exp(around(rng, 0.25, 0.7))}
    return {"rubbing": size(rng, 0.006, 0.02) * _span(topology) * TENDON}


def _ringing(rng: np.random.Generator) -> dict[str, float]:
    rate = 2.0 * math.pi * size(rng, 1.0, 3.0)
    inertia = (TENDON + RETURN) / rate**2
    return {"ringing": inertia / 0.01 - 1.0, "ring_damping": 2.0 * float(rng.uniform(0.05, 0.2)) * rate * inertia}
