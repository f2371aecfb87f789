"""What `tl.Tracker` takes: readings that are no numbers, more or fewer of them than there are, next to no B."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tautline as tl
from tautline.errors import TautError
from tautline.model import Model, Uncertainty
from tautline.prediction import predict, predict_with_sigma
from tautline.recording import Motor
from tautline.tracking import State, Tracker
from tautline.tracking.beyond import Beyond
from tautline.tracking.law import LawFamily, calibrated_theta
from tautline.tracking.passes import Passes
from tools.tracking.sessions import Change, Instrument, Session, ideal_model, session


@pytest.fixture(scope="module")
def narrowing() -> Session:
    return session(Instrument(1), "scale", 1, 22.0, change=Change("scale", scale=0.6), start_s=10.0)


def started(made: Session) -> Tracker:
    tracker = Tracker(ideal_model(made.instrument))
    tracker.motor(made.recording.motor.t_s, made.recording.motor.q)
    return tracker


def test_a_sigma_that_is_no_number_is_not_known(narrowing: Session) -> None:
    """And leaves the tracker as watchful as before."""
    tracker, marker = started(narrowing), narrowing.recording.marker
    seen = np.flatnonzero(marker.valid)
    for k in seen.tolist():
        sigma = (np.nan,) if k == seen[80] else ()
        row = tracker.see(marker.t_s[k], marker.u_px[k], marker.v_px[k], *sigma)
        assert np.isfinite([row.c_deg, row.offset_sigma, row.scale_sigma]).all()
    assert State.STALE in [change.state for change in tracker.changes]
    assert row.scale == pytest.approx(0.6, abs=0.02)


def test_what_is_no_frame_is_refused_and_the_next_one_taken(narrowing: Session) -> None:
    tracker = started(narrowing)
    for t_s in (np.inf, np.nan, -np.inf):
        with pytest.raises(TautError, match="in order of time"):
            tracker.see(t_s)
    for seen in ((300.0,), (300.0, 300.0, 0.1, 0.1)):
        with pytest.raises(TautError, match=r"u, v \(and sigma\) px"):
            tracker.see(1.0, *seen)
    assert tracker.see(1.0).state is State.TRUSTED


def test_no_recording_is_told_in_a_line(narrowing: Session) -> None:
    with pytest.raises(TautError, match="a recording"):
        tl.track(ideal_model(narrowing.instrument), [])


def test_a_model_of_next_to_no_width_has_no_more_cells_than_a_frame_has_time_for(narrowing: Session) -> None:
    model: Model = ideal_model(narrowing.instrument)
    for width in (1e-5, 1e-3, 0.1, 0.5):
        passes = Passes(replace(model, width=np.full(len(model.q), width)), width)
        assert len(passes.place) <= 4097
        assert width < 0.1 or np.diff(passes.place)[0] == pytest.approx(width / 16)


@pytest.mark.parametrize("least", [0.0, 1e-7])
@pytest.mark.parametrize("narrower", [1.0, 0.5])
def test_the_share_of_b_is_told_beside_places_without_b(narrowing: Session, least: float, narrower: float) -> None:
    """A play whose B is next to nothing in the middle is narrower than calibrated by a share, alike everywhere."""
    model: Model = ideal_model(narrowing.instrument)
    width = np.clip(0.4 * (np.abs(model.q) - 1.0), least, 0.4)
    model = replace(model, width=width, width_sigma=np.full_like(width, 1e-3))
    passes, rng, sigma = Passes(model, 0.4), np.random.default_rng(1), 1e-3
    for stroke, way in enumerate((1, -1)):
        for entry, y in enumerate(way * np.arange(-4.0, 4.0, 0.05), 200 * stroke):
            q = y + way * 0.5 * narrower * np.interp(y, model.q, width)
            passes.add(q, y + sigma * rng.normal(), sigma, 0.5, stroke, travel=2.0, entry=entry)
    law = LawFamily(Beyond.prior(model)).law(calibrated_theta())
    told = passes.narrowing(law, calibrated_theta(), 1.0, 0)
    if narrower == 1.0:
        assert told is None
    else:
        assert told is not None and told.sigma < 1.0 and abs(told.share - narrower) < 4.0 * told.sigma


def test_a_stated_noise_of_none_at_all_is_no_usual_noise(narrowing: Session) -> None:
    """A simulator's camera may have none: then sigma is that of the tables alone, and a tracker learns at once."""
    model, recording = ideal_model(narrowing.instrument), narrowing.recording
    exact = replace(model, uncertainty=Uncertainty(noise=0.0))
    at = recording.marker.t_s[200:400] - model.delay_s
    told, usual = (predict_with_sigma(each, recording.motor, at) for each in (exact, model))
    tables = replace(exact, uncertainty=Uncertainty(noise=1e-9))
    np.testing.assert_allclose(
        told.c_sigma_deg, predict_with_sigma(tables, recording.motor, at).c_sigma_deg, rtol=1e-6, atol=1e-9
    )
    assert np.median(told.c_sigma_deg) < 0.5 * np.median(usual.c_sigma_deg)
    tracker, quiet = Tracker(exact), Motor(recording.motor.t_s, recording.motor.q)
    tracker.motor(quiet.t_s, quiet.q)
    for t_s, place in zip(at, predict(exact, quiet, at).image_px, strict=True):
        row = tracker.see(t_s + model.delay_s, *place)
    assert np.isfinite([row.c_deg, row.offset_sigma, row.scale_sigma]).all() and tracker.state is State.TRUSTED
