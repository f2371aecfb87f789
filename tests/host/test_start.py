"""What was there from the first recording on has one name: a calibration's reason is what a diagnosis says."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from tautline.calibration import naming
from tautline.calibration.calibrate import calibrate
from tautline.calibration.result import Calibration
from tautline.diagnosis import start
from tautline.diagnosis.diagnose import diagnose
from tautline.errors import TautError
from tautline.model import Model
from tautline.quality import Reason
from tautline.recording import Recording
from tautline.simulated.instrument import reference_rig
from tools.naming.cases import SECOND, Case, make

RIPPLE, SPEED = "actuator.encoder_periodic", "transmission.rate_dependent_backlash"
DOUBT = Reason("transmission.lag", "late", "drive slowly")
MILD, OTHER = Reason("residual", "left", "diagnose", mild=True), Reason("coverage", "a hole", "move there")


def codes(found: Calibration) -> list[str]:
    return [reason.code for reason in found.model.quality.reasons]


def a_model() -> Model:
    q = np.linspace(-5.0, 5.0, 11)
    return Model(reference_rig(), q, 0.4 + 0 * q, 0.01 + 0 * q, 12.0 * q, 0.08, (-4.0, 4.0))


def told(monkeypatch: pytest.MonkeyPatch, names: Sequence[str], reasons: Sequence[Reason]) -> list[Reason]:
    """The reasons where the library's effects, weighed, have these names."""

    class Weighed:
        named = tuple(names)

    monkeypatch.setattr(start, "of_recordings", lambda *args: Weighed)
    asked = naming.effects_of_diagnosis(a_model(), [], lambda share, what: None)
    return list(reasons) if asked is None else naming.reasons_with_names(reasons, a_model(), asked.named)


def test_a_name_stands_for_all_looks_and_for_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    found = told(monkeypatch, [SPEED], [DOUBT, OTHER, MILD])
    assert [reason.code for reason in found] == [SPEED, "coverage"]
    assert not found[0].mild and found[1] is OTHER


@pytest.mark.parametrize("looks", [[], [MILD]])
def test_a_name_is_as_much_of_a_doubt_as_what_it_stands_for(
    looks: list[Reason], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert [reason.mild for reason in told(monkeypatch, [SPEED], looks)] == [True]


def test_without_a_name_the_looks_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    assert told(monkeypatch, [], [DOUBT, OTHER]) == [DOUBT, OTHER]


def test_what_no_diagnosis_can_score_keeps_its_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuses(*args: object) -> None:
        raise TautError("the tip is never driven through a full backlash")

    monkeypatch.setattr(start, "of_recordings", refuses)
    assert naming.effects_of_diagnosis(a_model(), [], lambda share, what: None) is None


@pytest.mark.parametrize("seed", [0, 3])  # with a motor whose counts show, and without
def test_nothing_is_asked_where_nothing_is_left(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    def asked(*args: object) -> None:
        raise AssertionError

    monkeypatch.setattr(start, "of_recordings", asked)
    case = make(SECOND, "", seed)
    assert codes(calibrate(case.recordings[:1], case.rig)) == []


def test_a_width_by_speed_is_named_where_its_looks_are_nobodys() -> None:
    case = make(SECOND, SPEED, 0)
    assert codes(calibrate(case.recordings[:1], case.rig)) == [SPEED]


@pytest.fixture(scope="module")
def rippled() -> tuple[Case, list[Recording], Calibration]:
    """A reading that errs once a turn, which a calibration takes for B and f_remain."""
    case = make(SECOND, RIPPLE, 1001)
    recordings = [every(recording, 3) for recording in case.recordings[:2]]
    return case, recordings, calibrate(recordings[:1], case.rig)


def every(recording: Recording, stride: int) -> Recording:
    """With fewer frames: all of it is quicker then."""
    marker = recording.marker
    assert marker is not None and marker.valid is not None
    few = {name: getattr(marker, name)[::stride] for name in ("t_s", "u_px", "v_px", "valid")}
    return replace(recording, marker=replace(marker, **few))


def test_what_a_calibration_swallowed_has_its_name_in_a_diagnosis(
    rippled: tuple[Case, list[Recording], Calibration],
) -> None:
    _, recordings, found = rippled
    document = diagnose(found.model, recordings[0], recordings[1:]).document
    assert codes(found)[0] == RIPPLE
    assert [effect["id"] for effect in document["effects"]] == [RIPPLE]
    assert document["effects"][0]["since"] == "start"


def test_what_is_there_from_the_start_is_weighed_in_all_recordings_alike(
    rippled: tuple[Case, list[Recording], Calibration],
) -> None:
    case, recordings, found = rippled
    asked = start.of_recordings(found.model, recordings[:1], lambda share, what: None)
    hypotheses = [candidate.fit.hypothesis for candidate in asked.gathered.candidates]
    assert not any(scope for hypothesis in hypotheses for scope in hypothesis.scopes)
    assert {name for h in hypotheses for name in (kind.id for kind in h.kinds)} <= start.NAMES
    assert asked.named == (RIPPLE,)
    model, truth = found.model, case.truth
    inside = (model.q > model.measured[0]) & (model.q < model.measured[1])
    off = (model.width - np.interp(model.q, truth.q, truth.width))[inside]
    assert np.sqrt(np.mean((off / model.width_sigma[inside]) ** 2)) < 2.0  # what B has taken of it is in its sigma
