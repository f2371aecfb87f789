"""One session of a campaign, in a process of its own."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from tautline.calibration.calibrate import calibrate
from tautline.model import Model, Uncertainty
from tautline.prediction import predict
from tautline.tracking import replay
from tools.tracking.score import score
from tools.tracking.sessions import COST, OUTSIDE, Instrument, calibration, ideal_model, session

INSTRUMENTS = 6  # whose calibrations are shared by the sessions of a worker


def one(case: tuple[str, int, float, bool]) -> dict[str, Any]:
    """A session's scores."""
    kind, seed, seconds, ideal = case
    outside = kind in OUTSIDE
    instrument = Instrument(10_000 + seed % INSTRUMENTS, kind if outside else "play")
    model = single_play(instrument) if outside else (ideal_model if ideal else calibrated)(instrument)
    made = session(instrument, kind, seed, seconds)
    tries = 0
    while made.change_s < np.inf and made.cost < COST and tries < 8:  # what costs less need not be seen
        tries += 1
        made = session(instrument, kind, seed + 100_000 * tries, seconds)
    tracked = replay(model, [made.recording])
    return {"seed": seed, **score(made, model, tracked)}


@cache
def calibrated(instrument: Instrument) -> Model:
    return calibrate([calibration(instrument, instrument.seed)], instrument.rig).model


@cache
def single_play(instrument: Instrument) -> Model:
    """The best that one play can say of an instrument that is none: its residual is known, as a calibration's is."""
    model, made = ideal_model(instrument), session(instrument, "nothing", instrument.seed, 60.0)
    told = predict(model, made.recording.motor, made.recording.marker.t_s - model.delay_s).image_px
    assert told is not None
    return replace(model, uncertainty=Uncertainty(noise=float(np.sqrt(np.mean((told - made.true_px)[200:] ** 2)))))
