"""A model that predicts worse than f_coarse or a constant is never good."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.signal import lfilter

from tautline.calibration import worth as worths
from tautline.calibration.calibrate import calibrate
from tautline.calibration.observations import observe
from tautline.calibration.worth import predictive_worth
from tautline.quality import Quality, Verdict
from tautline.recording import Recording
from tautline.simulated.instrument import preset, reference_rig
from tautline.simulated.simulate import run
from tautline.trajectory import back_and_forth

RIG = reference_rig()


@pytest.fixture(scope="module")
def made() -> Recording:
    path = back_and_forth(RIG.actuator, [1.2], 1.6, 16, 5.0, 0.1)
    return run(RIG, preset("random", RIG, 3), path, seed=72).recording


def quality(recording: Recording, rig=RIG) -> Quality:
    return calibrate([recording], rig).model.quality


def turned(degrees: float):
    away = tuple(np.array(RIG.hand_eye.rotation_deg) + degrees * np.array([1.0, -1.0, 1.0]) / np.sqrt(3))
    return replace(RIG, hand_eye=replace(RIG.hand_eye, rotation_deg=away))


def test_a_right_model_is_measured_against_the_two_simplest(made: Recording) -> None:
    found = calibrate([made], RIG)
    right = predictive_worth(found.model, observe([made], RIG), None, None)
    assert right is not None
    assert right.model == pytest.approx(0.05, rel=0.1) and right.predicts and not right.doubts
    assert right.coarse > 50 * right.model and right.constant > 5 * right.coarse
    worse = replace(found.model, c_deg=found.model.c_deg[::-1].copy())
    told = predictive_worth(worse, observe([made], RIG), None, None)
    assert told is not None and not told.predicts and told.doubts[0].fatal


def test_a_model_no_better_than_a_constant_is_unusable(made: Recording) -> None:
    found = quality(made, turned(45.0))
    assert found.verdict is Verdict.UNUSABLE and "predicts" in {r.code for r in found.reasons}


def test_a_registration_that_is_a_little_off_is_doubtful(made: Recording) -> None:
    found = quality(made, turned(5.0))
    assert found.verdict is Verdict.DOUBTFUL
    assert [r.code for r in found.reasons] == ["registration.static"]


def test_a_mirrored_image_bends_f_remain_beyond_belief(made: Recording) -> None:
    mirrored = replace(made, marker=replace(made.marker, u_px=719.0 - made.marker.u_px))
    found = quality(mirrored)
    assert found.verdict is Verdict.UNUSABLE
    assert next(r for r in found.reasons if r.code == "registration.static").fatal


def test_a_block_is_foretold_as_a_fit_without_it_does(made: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    """By Newton's step from the whole fit; the reference is fitted anew."""
    monkeypatch.setattr(worths, "STAYS", 0.0)
    asked: list[Any] = []
    foretold = worths._held_out_errors
    monkeypatch.setattr(worths, "_held_out_errors", lambda *all_of: asked.append(all_of) or foretold(*all_of))
    found = calibrate([made], RIG, naming=False)
    assert found.evidence["foretold_blocks"] == worths.BLOCKS
    fit, curves, _, masks, labels = asked[0]
    curves = fit.solve(curves, iterations=12, adapt=False).curves
    rows = fit.residuals(curves)[0]
    missed = foretold(fit, curves, rows, masks, labels)[0]
    more = [np.mean(missed[labels[0] == k] ** 2) > np.mean(rows[0][labels[0] == k] ** 2) for k in range(8)]
    assert sum(more) >= 6
    for block in (0, 5):
        without = [
            replace(each, use=each.use & (label != block)) for each, label in zip(fit.tracks, labels, strict=True)
        ]
        own = replace(fit, tracks=without, smoothing=dict(fit.smoothing))
        again = own.residuals(own.solve(curves, iterations=8, adapt=False).curves)[0][0]
        here = labels[0] == block
        moved = np.sqrt(np.mean((missed - rows[0])[here] ** 2))
        assert np.sqrt(np.mean((missed - again)[here] ** 2)) < 0.5 * moved


def over_noise(off: np.ndarray, moving: np.ndarray, placed: float = 0.0, place: np.ndarray | None = None) -> float:
    """Of misses (n, 2) of an image in which the tip moves along u, over the frames' noise; placed: what a tracker adds
    to that at each place, in noise; place (n,): where along u the tip is, up and down by turns; without it each frame
    is at a place of its own."""
    n = len(off)
    at = 10.0 * np.arange(n) if place is None else place
    track = SimpleNamespace(unit="px", sigma=np.ones(n), placed_px=placed, t_s=0.04 * np.arange(n), step=0.0)
    fit = SimpleNamespace(
        tracks=[SimpleNamespace(track=track)],
        simulated=[SimpleNamespace(moving=moving, tip=at, side=np.where(np.gradient(at) > 0, 1, -1))],
        predicted=lambda track, curves, tip: np.column_stack([tip, np.zeros(n)]),
        slope_in_view=lambda track, curves, p: np.tile([50.0, 0.0], (n, 1)),
        width=lambda curves: np.ones(3),
    )
    masks = worths._frames_of_tip(cast(Any, fit), cast(Any, None), [off], [np.ones(n, bool)])
    return worths._over_noise(cast(Any, fit), cast(Any, None), [off], masks)


def test_what_neighbours_miss_alike_is_the_models_and_the_rest_is_noise() -> None:
    """Misses of 0.8, 2 and 3 times the noise in both coordinates: 1.28, 2.24 and 3.16 with it."""
    rng, t = np.random.default_rng(17), np.arange(6000)
    moving = (t // 60) % 2 == 0
    noise, wave = rng.normal(0.0, 1.0, (6000, 2)), np.sqrt(2.0) * np.sin(t / 30.0)[:, None] * np.ones(2)
    assert over_noise(noise, moving) < 1.03
    assert over_noise(1.7 * noise, moving) < 1.03  # stated too small
    for size in (0.8, 2.0, 3.0):
        assert over_noise(noise + size * wave, moving) == pytest.approx(np.hypot(1.0, size), rel=0.03)
        assert over_noise(1.7 * (noise + size * wave), moving) == pytest.approx(np.hypot(1.0, size), rel=0.03)
        share = size / np.hypot(1.0, 1.5)
        assert over_noise(noise + size * wave, moving, 1.5) == pytest.approx(np.hypot(1.0, share), rel=0.03)
    lost = noise.copy()
    lost[1000:1200] += [300.0, -200.0]  # another blob
    assert over_noise(lost, moving) < 1.05
    jitter = noise + np.column_stack([3.0 * rng.normal(size=6000) * moving, np.zeros(6000)])  # frames' times
    assert over_noise(jitter, moving) == pytest.approx(np.sqrt(1.0 + 0.5 * 0.5 * 9.0), rel=0.05)  # of half of them
    elsewhere = noise * (1.0 + 2.0 * moving)[:, None]  # noise of where the tip moves, both ways alike
    assert over_noise(elsewhere, moving) < 1.1


def test_what_every_pass_over_a_place_misses_alike_is_no_noise() -> None:
    """A marker that is drawn to the pixels' centres goes up and down: from frame to frame that looks like noise."""
    rng, t = np.random.default_rng(19), np.arange(6000)
    moving = (t // 60) % 2 == 0
    place = 900.0 * np.abs(2.0 * (t / 61.7 % 1.0) - 1.0)
    noise = rng.normal(0.0, 1.0, (6000, 2))
    drawn = 1.6 * np.sin(0.3 * place)[:, None] * moving[:, None] * np.ones(2)
    assert over_noise(noise, moving, place=place) < 1.05
    assert over_noise(noise + drawn, moving, place=place) == pytest.approx(np.sqrt(1.0 + 0.25 * 1.6**2), rel=0.05)


@pytest.mark.parametrize("rho", [0.4, 0.7])
def test_what_the_noise_remembers_is_no_model_s_miss(rho: float) -> None:
    """Its neighbours are alike wherever the tip rests and across its path; what is missed beside it is told as before,
    and what goes along the path alone, however alike, is not noise."""
    rng, t = np.random.default_rng(18), np.arange(12000)
    moving = (t // 30) % 2 == 0
    noise = lfilter([np.sqrt(1.0 - rho**2)], [1.0, -rho], rng.normal(0.0, 1.0, (12000, 2)), axis=0)
    wave = np.sqrt(2.0) * np.sin(t / 30.0)[:, None] * np.ones(2)
    assert over_noise(noise, moving) < 1.1
    assert over_noise(1.7 * noise, moving) < 1.1
    for size in (0.8, 2.0):
        told = over_noise(noise + size * wave, moving)
        assert np.hypot(1.0, size) - 0.05 < told < 1.1 * np.hypot(1.0, size)  # no more memory than it shows
    late = rng.normal(0.0, 1.0, (12000, 2)) + np.column_stack([2.0 * noise[:, 0], np.zeros(12000)])
    assert over_noise(late, moving) > np.sqrt(1.0 + 0.5 * rho * 4.0) - 0.05
