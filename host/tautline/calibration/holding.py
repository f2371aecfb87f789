"""Leaves out frames in which a tracker repeats the last place of a marker that is covered, though the tip moves on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tautline.calibration.observations import Mask, Track
from tautline.calibration.smooth import Domain, fit_jointly, prepare_tracks
from tautline.core.samples import repeats
from tautline.independence import stretches

_RUN = 4  # tolerance: frames at one place from which it may be held
_MOVES = 0.02  # tolerance: of the motor's span, by which it moves meanwhile
_OFF = 6.0  # tolerance: scales of what is left, by which the tip is elsewhere then


def without_held_places(
    tracks: Sequence[Track], on_one_curve: Callable[[], Sequence[Track]], domain: Domain, delay_s: float
) -> list[Track]:
    """`tracks` without each run of frames that repeats a place while the motor moves, if in any of its frames a joint
    fit has the tip elsewhere: the residual there is more than _OFF times the usual one. All frames stay if there is no
    such run or no joint fit. on_one_curve: gives the same tracks as a play is fitted to them (some frames may be
    missing); it is called only if there is such a run. delay_s: delay at which the fit is made."""
    runs = [_repeated_while_moving(track) for track in tracks]
    if not any(runs):
        return list(tracks)
    joint_fit = fit_jointly(prepare_tracks(on_one_curve(), delay_s), domain, delay_s, fit_delay=False)
    if joint_fit is None:
        return list(tracks)
    kept, limit = [], _OFF * max(joint_fit.scale, 1.0)
    fitted = zip(joint_fit.fit.tracks, joint_fit.residuals, strict=True)
    for track, repeated, (prepared, rows) in zip(tracks, runs, fitted, strict=True):
        off = np.zeros(len(track.t_s), dtype=bool)  # of those without a pose nothing is known
        off[np.isin(track.t_s, prepared.track.t_s)] = np.sqrt(np.mean(rows**2, axis=1)) > limit
        held: Mask = np.zeros(len(track.t_s), dtype=bool)
        for run in repeated:
            held[run] = off[run].any()
        kept.append(replace(track.only(~held), held=track.held + int(held.sum())))
    return kept


def _repeated_while_moving(track: Track) -> list[slice]:
    """Slices of the frames that show exactly the place of the frame before them. Only runs that have at least _RUN
    frames, counting the one that is repeated, and during which the motor moves by more than _MOVES of its span."""
    same = repeats(track.y)
    q, least = track.motor_at(track.t_s), _MOVES * float(np.ptp(track.motor.q))
    runs = [(run, slice(run.start - 1, run.stop)) for run in stretches(same)]  # and with the first of each
    return [run for run, whole in runs if whole.stop - whole.start >= _RUN and np.ptp(q[whole]) > least]
