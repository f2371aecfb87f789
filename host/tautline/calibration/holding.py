"""A tracker that says the last place again while its marker is covered: frames that show where the tip was."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tautline.calibration.observations import Mask, Track
from tautline.calibration.smooth import Domain, fit_jointly, prepare_tracks
from tautline.independence import stretches

_RUN = 4  # tolerance: frames at one place from which it may be held
_MOVES = 0.02  # of the motor's span, by which it moves meanwhile
_OFF = 6.0  # tolerance: scales of what is left, by which the tip is elsewhere then


def released(
    tracks: Sequence[Track], on_one_curve: Callable[[], Sequence[Track]], domain: Domain, delay_s: float
) -> list[Track]:
    """`tracks` without frames that repeat a covered marker's last place while the tip is elsewhere. on_one_curve: the
    same tracks, as a play is fitted to them: that fit is made only where a place is repeated while the motor moves."""
    runs = [_runs(track) for track in tracks]
    if not any(runs):
        return list(tracks)
    joint_fit = fit_jointly(prepare_tracks(on_one_curve(), delay_s), domain, delay_s, fit_delay=False)
    if joint_fit is None:
        return list(tracks)
    kept = []
    for track, places, rows in zip(tracks, runs, joint_fit.residuals, strict=True):
        off = np.sqrt(np.mean(rows**2, axis=1)) > _OFF * max(joint_fit.scale, 1.0)
        held: Mask = np.zeros(len(track.t_s), dtype=bool)
        for run in places:
            held[run] = off[run].any()
        kept.append(replace(track.only(~held), held=track.held + int(held.sum())))
    return kept


def _runs(track: Track) -> list[slice]:
    """Slices of frames that repeat the place of the one before, in runs of at least _RUN frames with that one in which
    the motor moves by more than _MOVES of its span."""
    same = np.concatenate([[False], (track.y[1:] == track.y[:-1]).all(axis=1)])
    q, least = track.motor_at(track.t_s), _MOVES * float(np.ptp(track.motor.q))
    runs = [(run, slice(run.start - 1, run.stop)) for run in stretches(same)]  # and with the first of each
    return [run for run, whole in runs if whole.stop - whole.start >= _RUN and np.ptp(q[whole]) > least]
