"""Every condition by name. Importing this package registers all families."""

from __future__ import annotations

from tools.honesty.conditions import (
    benign,
    clocks,
    coverage,
    encoder,
    files,
    hysteresis,
    joints,
    mechanics,
    pictures,
    registration,
    sensors,
)
from tools.honesty.conditions.registry import CONDITIONS, Condition, build

__all__ = ["CONDITIONS", "Condition", "build"]
_ = (benign, clocks, coverage, encoder, files, hysteresis, joints, mechanics, pictures, registration, sensors)
