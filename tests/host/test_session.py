"""One clock: the same recordings lie at the same times, whoever asks and in whatever order their files are given."""

import pickle
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import tautline as tl
from tautline.calibration.counted import counted_frames
from tautline.calibration.observations import observe
from tautline.calibration.smooth import Domain, fit_jointly, prepare_tracks
from tautline.core.session import GAP_S, SessionClock
from tautline.diagnosis.segment import prepare
from tautline.reports import evidence
from tools.tracking.sessions import Instrument, calibration, ideal_model

INSTRUMENT = Instrument(1)
MODEL = ideal_model(INSTRUMENT)
LATER_S = 137.25


def at(start: float, end: float, name: str = "r") -> tl.Recording:
    return tl.Recording(name, tl.Motor(np.array([start, end]), np.zeros(2)))


def later(recording: tl.Recording, by_s: float) -> tl.Recording:
    motor, marker = recording.motor, recording.marker
    moved = replace(recording, name="later", motor=replace(motor, t_s=motor.t_s + by_s))
    return replace(moved, marker=replace(marker, t_s=marker.t_s + by_s))


@pytest.fixture(scope="module")
def two() -> list[tl.Recording]:
    """The later first."""
    return [later(calibration(INSTRUMENT, 2), LATER_S), calibration(INSTRUMENT, 1)]


def test_recordings_share_a_clock_where_their_times_do_not_overlap():
    shared = SessionClock.of([at(10, 20), at(0, 10), at(25, 30)])
    assert shared.offset_s == (0.0, 0.0, 0.0) and shared.known == (True, True, True)
    apart = SessionClock.of([at(0, 20), at(5, 15), at(16, 17), at(0, 1)])
    assert apart.known == (True, False, True, False)
    assert apart.offset_s == (0.0, 15.0 + GAP_S, 15.0 + GAP_S, 17.0 + 15.0 + 2 * GAP_S)


@given(st.lists(st.tuples(st.floats(0, 50), st.floats(0.1, 20)), min_size=1, max_size=6), st.randoms())
def test_no_two_overlap_and_those_that_share_a_clock_may_come_in_any_order(spans, random):
    made = [at(begin, begin + length, str(i)) for i, (begin, length) in enumerate(spans)]
    clock = SessionClock.of(made)
    ends = sorted((r.motor.t_s + offset).tolist() for r, offset in zip(made, clock.offset_s, strict=True))
    assert all(before[1] <= after[0] + 1e-9 for before, after in pairwise(ends))
    in_time = tl.Session(made).in_time()
    assert dict(zip([r.name for r in in_time], in_time.clock.offset_s, strict=True)) == {
        str(i): offset for i, offset in enumerate(clock.offset_s)
    }
    if all(clock.known):
        random.shuffle(made)
        assert SessionClock.of(made).offset_s == (0.0,) * len(made)


def test_calibration_diagnosis_and_report_have_one_clock(two):
    for recordings in (two, two[::-1], [two[1], replace(two[0], motor=two[1].motor, marker=two[1].marker)]):
        offsets = tl.Session(recordings).clock.offset_s
        tracks = observe(recordings, MODEL.rig)
        assert tuple(track.session_s for track in tracks) == offsets
        assert tuple(segment.offset_s for segment in prepare(MODEL, recordings[0], recordings[1:])) == offsets
        shown = evidence.collect(MODEL, recordings)
        assert tuple(shown.offset_s) == offsets
        fitted = fit_jointly(prepare_tracks(tracks, MODEL.delay_s), Domain(-5.0, 5.0), MODEL.delay_s, fit_delay=False)
        assert fitted is not None
        counted = counted_frames(fitted, fitted.curves, MODEL.rig, np.zeros(2))
        for i, (track, offset) in enumerate(zip(tracks, offsets, strict=True)):
            mine = counted.recording == i
            np.testing.assert_allclose(counted.time_s[mine], track.t_s[counted.frame[mine]] + offset, atol=1e-9)
        assert abs(counted.t).max() <= 0.5
        ended = counted.at_the_end()
        assert ended.recording[0] == np.argmax([r.motor.t_s[-1] + o for r, o in zip(recordings, offsets, strict=True)])


def test_a_calibration_does_not_depend_on_the_order_of_its_files(two):
    one, other = (tl.calibrate(tl.Session(recordings)) for recordings in (two, two[::-1]))
    assert one == other


def test_a_session_is_a_value(two):
    session = tl.Session(two)
    assert len(session) == 2 and list(session) == two and session[1] is two[1]
    assert [recording.name for recording in session.in_time()] == ["calibration", "later"]
    assert pickle.loads(pickle.dumps(session)) == session != tl.Session(two[:1])
    assert repr(session).startswith("Session(") and len(repr(session)) < 200
