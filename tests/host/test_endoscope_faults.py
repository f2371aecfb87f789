"""Faults of the benchmark's endoscope, whose laws are its own, by where its marker is: without pictures."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))

from tautline.diagnosis.diagnose import diagnose
from tautline.model import Model
from tautline.recording import Marker, Motor, Recording, Video
from tautline.rig import Rig
from tools.bench import endoscopy, faults

NOISE = 0.065
CONDITION = endoscopy.Condition("plain")
GRID = np.linspace(*endoscopy.RANGE_MM, 401)


def seen(world: endoscopy.World, rig: Rig, rng: np.random.Generator, name: str) -> Recording:
    scene = np.arange(world.t[0] + rng.uniform(0.2, 0.24), world.t[-1] - 0.1, 1.0 / endoscopy.RATE_HZ)
    u, v = (world.seen(scene)[0] + rng.normal(0.0, NOISE, (len(scene), 2))).T
    motor = Motor(world.t, np.rint(world.q / endoscopy.COUNT_MM) * endoscopy.COUNT_MM)
    marker = Marker(scene + endoscopy.DELAY_S, u, v, np.ones(len(scene), bool))
    return Recording(name, motor, marker=marker, video=Video(Path("video.mkv"), None), rig=rig)


def case(fault: str, seed: int, folder: Path) -> tuple[Model, list[Recording]]:
    """The instrument as it was when it was calibrated, its calibration and its tests."""
    world = endoscopy.World(CONDITION, seed, np.zeros((8, 8, 3), np.uint8))
    (folder / "rig.toml").write_text(endoscopy._rig(world))
    rig, rng = Rig.load(folder / "rig.toml"), np.random.default_rng([seed, 77])
    ends = float(world.q.min()), float(world.q.max())
    model = Model(rig, GRID, world.width(GRID), np.full(401, 0.003), world.bend(GRID), endoscopy.DELAY_S, ends)
    made, clock = [seen(world, rig, rng, "calibration")], float(world.t[-1])
    drawn = faults.FAULTS[fault][1](np.random.default_rng([seed, list(faults.FAULTS).index(fault)]), clock + 5.0)
    for k, (lasts_s, mm_s, rests) in enumerate(faults.TESTS, 1):
        use = endoscopy.Use(world, 1000 * seed + k, clock + 5.0, lasts_s, mm_s, rests, drawn)
        made.append(seen(endoscopy.World(CONDITION, seed, use=use), rig, rng, f"test-{k}"))
        clock = use.begins_s + lasts_s
    return model, made


@pytest.mark.parametrize(
    ("fault", "seed", "not_alike"),
    [
        ("nothing", 12, ""),
        ("lag of 30 ms", 12, ""),  # a delay, but for the frame after each turn
        pytest.param("width by speed", 2, "transmission.creep", marks=pytest.mark.long),  # which goes on for seconds
    ],
)
def test_a_fault_has_its_name(fault: str, seed: int, not_alike: str, tmp_path: Path) -> None:
    model, made = case(fault, seed, tmp_path)
    document = diagnose(model, made[0], made[1:]).document
    effects = document["effects"]
    assert faults.FAULTS[fault][0] == (effects[0]["id"] if effects else document["verdict"])
    assert not_alike not in (effects[0]["ambiguous_with"] if effects else [])
