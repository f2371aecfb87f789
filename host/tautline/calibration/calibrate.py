"""From recordings to a model: the order of a calibration's steps. Recordings are put on one clock and measured
(measuring.py), what was measured is judged (verdict.py), and what departs gets the name that a diagnosis gives it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from tautline.calibration import clock
from tautline.calibration import naming as effect_names
from tautline.calibration.acquisition import rig_contradictions
from tautline.calibration.measuring import Measured, Measuring, Progress
from tautline.calibration.observations import Track, observe
from tautline.calibration.options import Options
from tautline.calibration.result import Calibration
from tautline.calibration.verdict import judged_calibration
from tautline.calibration.worth import PREDICTS
from tautline.core.session import Session
from tautline.diagnosis import start
from tautline.errors import TautError
from tautline.quality import Quality
from tautline.recording import Recording, shifted
from tautline.rig import MARKER, Rig

_LEAST_FRAMES = 10  # tolerance: frames from which anything is said


def calibrate(
    recordings: Sequence[Recording],
    rig: Rig,
    options: Options | None = None,
    progress: Progress | None = None,
    naming: bool = True,
) -> Calibration:
    """Measures B(q), f_remain and the delay from recordings of any motion. progress: is told a share, 0 to 1, and what
    is done. naming: also names what departs, as a diagnosis does, for as much time again. Raises TautError if nothing
    can be measured; what else could not be measured is said in notes and reasons of the result."""
    options, recordings = options or Options(), Session(recordings).in_time()
    say = progress or (lambda share, what: None)
    say(0.0, "reading frames")
    every = observe(recordings, rig)
    tracks = [track for track in every if len(track.t_s)]
    if not tracks:
        if any(track.sensor == MARKER for track in every):
            raise TautError("the marker was never seen: check the marker's colour (taut marker) and the camera's view")
        raise TautError("the angle sensor has no valid value: check angle.csv, or its sensor's wiring and power")
    frames = sum(len(track.t_s) for track in tracks)
    if frames < _LEAST_FRAMES:
        raise TautError(f"the tip was seen in {frames} frames only: record the calibration motion with it in view")
    with threadpool_limits(1, "blas"):  # its systems are small: threads that wait for each other cost 10 times more
        aligned = clock.align(tracks, rig) if options.delay_s is None else clock.AlignedTracks.without_offsets(tracks)
        on_clock, offsets_s = aligned.merged_into(every)
        reasons = rig_contradictions(recordings, on_clock, offsets_s, rig)
        aligned = aligned.with_frames
        if not aligned.tracks:
            raise TautError("the tip was seen only where the motor steps: move it at a speed, with the tip in view")
        measured = Measuring(aligned, rig, options, say, reasons).run()
        say(0.8, "naming what departs")
        found = judged_calibration(measured)
        if naming and _worth_naming(measured, found):
            aligned, offsets = _aligned_for_naming(tracks, rig, aligned, found)
            told = effect_names.effects_of_diagnosis(
                *(found.model, shifted(recordings, offsets)), lambda share, what: say(0.8 + 0.15 * share, what)
            )
            if told is not None:
                anew = Measuring(aligned, rig, options, lambda share, what: say(0.95 + 0.05 * share, what), reasons)
                again = anew.run_with_effects(measured, told)
                found = _with_effects(found, told, None if again is None else judged_calibration(again))
        say(1.0, "done")
        return found


def _aligned_for_naming(
    tracks: Sequence[Track], rig: Rig, aligned: clock.AlignedTracks, found: Calibration
) -> tuple[clock.AlignedTracks, Mapping[str, float]]:
    """The aligned tracks, and the sensors' offsets, s by recording, with which effects are named. Differences of delay
    between the recordings are not taken for clocks that differ here (same_delay_for_all is False): an effect also makes
    the image of one recording stop later than another's. found: the calibration without effects."""
    own = clock.align(tracks, rig, same_delay_for_all=False).with_frames if found.offsets else aligned
    return (own, own.offsets) if own.offsets != aligned.offsets else (aligned, found.offsets)


def _worth_naming(measured: Measured, found: Calibration) -> bool:
    """Whether a diagnosis is run to name the effect that departs. Never for an unusable calibration, and always for one
    that does not predict the blocks left out. For one that does, only if something departs, or an effect may have been
    there while calibrating (`start.concerns`), and a diagnosis can weigh all departures."""
    reasons = found.model.quality.reasons
    if not found.model.quality.usable:
        return False
    if not _predicts(found):
        return True
    return (measured.departs or start.concerns(found.model)) and not effect_names.has_unweighed(reasons)


def _predicts(found: Calibration) -> bool:
    """Whether the blocks left out are predicted to within PREDICTS times the noise; False if none were left out."""
    return found.evidence.get("foretold_over_noise", np.inf) <= PREDICTS


def _predicts_better(with_effects: Calibration, found: Calibration) -> bool:
    """Whether the calibration with effects is usable and predicts blocks left out with a smaller rms error than the one
    without."""
    own, other = (each.evidence.get("error", np.inf) for each in (with_effects, found))
    return with_effects.model.quality.usable and own < other


def _fits_like_components(with_effects: Calibration, found: Calibration) -> bool:
    """Whether the fit with effects leaves at most PREDICTS times the rms residual of the fit with components, which
    follow no law of an effect; False without components."""
    return with_effects.evidence.get("residual_joint", np.inf) <= PREDICTS * found.evidence.get(
        "residual_components", 0.0
    )


def _with_effects(found: Calibration, told: start.Start, with_effects: Calibration | None) -> Calibration:
    """The calibration to return, of three: the one whose model carries the named effects, if it predicts the blocks
    left out better than `found`, which has none; else `found` with the effects' names among its reasons; or `found` as
    it is, if something departs that a diagnosis does not weigh. In that case the effects count only if the fit with
    them is about as close as the components. told: the diagnosis; with_effects: None if effects could not be fitted."""
    reasons = found.model.quality.reasons
    unweighed = effect_names.has_unweighed(reasons)
    better = with_effects is not None and _predicts_better(with_effects, found)
    if with_effects is not None and better and (not unweighed or _fits_like_components(with_effects, found)):
        model, predicts = with_effects.model, _predicts(with_effects)
        own = effect_names.reasons_with_carried(reasons, model.quality.reasons, model, predicts)
        return replace(with_effects, model=replace(model, quality=Quality.of(own)))
    if unweighed:
        return found
    own = effect_names.reasons_with_names(reasons, found.model, told.named)
    return replace(found, model=replace(found.model, quality=Quality.of(own)))
