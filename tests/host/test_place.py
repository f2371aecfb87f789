"""Errors that go with the place: measured from repeated passes, and in the stated sigma."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tautline.calibration.calibrate import calibrate
from tautline.calibration.result import Calibration
from tautline.model import Model
from tautline.quality import Verdict
from tautline.recording import Recording
from tautline.simulated.instrument import Instrument, preset, reference_rig
from tautline.simulated.simulate import run
from tautline.trajectory import back_and_forth

RIG = reference_rig()


def made(seed: int) -> tuple[Instrument, Recording]:
    plant = preset("random", RIG, seed)
    path = back_and_forth(RIG.actuator, [1.2], 1.6, 24, 5.0, 0.1)
    return plant, run(RIG, plant, path, seed=seed, noise_px=0.02).recording


def moved(recording: Recording, error: np.ndarray) -> Recording:
    marker = recording.marker
    return replace(
        recording, marker=replace(marker, u_px=marker.u_px + error[:, 0], v_px=marker.v_px + error[:, 1], sigma_px=None)
    )


def lingering(recording: Recording, rms: float, frames: float, seed: int) -> np.ndarray:
    """An error (n, 2) that is alike over so many frames: what a video's codec leaves where it was."""
    rng = np.random.default_rng(seed)
    error = np.zeros((len(recording.marker.t_s), 2))
    share = np.exp(-1.0 / frames)
    for k in range(1, len(error)):
        error[k] = share * error[k - 1] + rng.normal(0.0, rms * np.sqrt(1 - share**2), 2)
    return error


def of_the_place(recording: Recording, rms: float, length: float) -> np.ndarray:
    """An error (n, 2) that is the same whenever the marker is at the same place."""
    u, v = recording.marker.u_px, recording.marker.v_px
    waves = [np.sin((np.cos(a) * u + np.sin(a) * v) / length * k + a) for a, k in ((0.3, 1.0), (1.4, 1.3), (2.2, 0.8))]
    return rms * np.sqrt(2 / 3) * np.column_stack([sum(waves), np.sqrt(3) * waves[2]])


def z_of(model: Model, plant: Instrument) -> float:
    inside = (model.q > model.measured[0]) & (model.q < model.measured[1])
    return float(np.sqrt(np.mean(((model.width - plant.backlash(model.q)) / model.width_sigma)[inside] ** 2)))


def place_of(found: Calibration) -> dict[str, float]:
    return {key.removeprefix("place_"): value for key, value in found.evidence.items()}


def test_neighbouring_frames_that_err_alike_are_fewer() -> None:
    squares, effects = [], []
    for seed in (801, 802, 803):
        plant, recording = made(seed)
        model = calibrate([moved(recording, lingering(recording, 0.12, 7.0, seed))], RIG, naming=False).model
        squares.append(z_of(model, plant) ** 2)
        effects.append(model.extra["evidence"]["place_effect"])
    assert np.sqrt(np.mean(squares)) < 1.5  # 3.5 were they counted as independent
    assert 6.0 < np.median(effects) < 20.0  # 14 of an unending record


def test_independent_frames_count_in_full() -> None:
    plant, recording = made(804)
    found = calibrate([recording], RIG)
    noise = place_of(found)
    assert found.model.quality.verdict is Verdict.GOOD
    assert noise["effect"] < 1.25 and noise["length"] < 0.5
    assert noise["at_rest"] == pytest.approx(0.02, rel=0.15)
    assert z_of(found.model, plant) < 2.0


def test_what_passes_repeat_at_a_place_is_told_from_scatter() -> None:
    _, recording = made(805)
    noise = place_of(calibrate([moved(recording, of_the_place(recording, 0.1, 0.15))], RIG, naming=False))
    assert noise["common"] == pytest.approx(0.1, rel=0.35)
    assert noise["at_rest"] == pytest.approx(0.02, rel=0.3)
    lasting = place_of(calibrate([moved(recording, lingering(recording, 0.1, 5.0, 1))], RIG, naming=False))
    assert lasting["common"] < 0.04
