"""What makes blind cases: named generators, and mechanisms whose truth is measured on themselves."""

import json
import sys

import numpy as np
import pytest

from tautline.calibration.calibrate import calibrate
from tautline.errors import TautError
from tautline.prediction import foretold
from tautline.recording import Recording
from tools.blindtest import generators, work
from tools.blindtest.campaign import Order
from tools.blindtest.cases import Case
from tools.blindtest.generators import GENERATORS, SECOND

LAG = "transmission.lag"
MECHANISMS = [name for name in GENERATORS if name.startswith("mujoco.")]


def mechanism():
    pytest.importorskip("mujoco", reason="the package mujoco is not installed")
    from tools.blindtest.physical import mechanism

    return mechanism


def seen(recording: Recording) -> np.ndarray:
    if recording.marker is not None:
        return np.stack([recording.marker.u_px, recording.marker.v_px])
    assert recording.angle is not None
    return recording.angle.c_deg


def test_the_generators_are_named_and_one_can_be_left_out(monkeypatch):
    monkeypatch.setattr(generators, "find_spec", lambda name: None)
    assert generators.chosen((), ()) == ((SECOND,), ())
    assert generators.chosen((), ("second",)) == (("library",), tuple(MECHANISMS))
    with pytest.raises(TautError, match=r"run ./run setup"):
        generators.chosen(("mujoco",), ())
    monkeypatch.setattr(generators, "find_spec", lambda name: sys)
    assert generators.chosen(("mujoco",), ("mujoco.arm",))[0] == tuple(n for n in MECHANISMS if n != "mujoco.arm")
    assert generators.chosen((), ("mujoco",))[0] == (SECOND, "library")
    with pytest.raises(TautError, match="leave fewer out"):
        generators.chosen((), ("all",))
    assert len(MECHANISMS) >= 5


def test_an_order_asks_each_generator_for_what_it_makes():
    order = Order(seed=3, single=1, none=1, unknown=0, pairs=0, only=("registration.static", "none"))
    cases = Order(**{**vars(order), "generators": ("mujoco.section", "mujoco.arm")}).cases()
    assert cases == [
        (3, "single", ("registration.static",), "mujoco.section"),
        (3, "none", (), "mujoco.section"),
        (3, "none", (), "mujoco.arm"),  # an angle sensor has no camera to be registered
    ]


@pytest.mark.parametrize("name", MECHANISMS)
def test_the_play_is_as_wide_as_it_was_built(name):
    built = mechanism()
    topology = next(t for t in built.TOPOLOGIES if t.name == name)
    found = [built.backlash(topology, built.Values({"widened": by} if by != 1.0 else {})) for by in (1.0, 1.6)]
    # What viscosity adds to it: the damper against all that holds s, and at most the Kelvin element's own time.
    speed = 0.9 * topology.half * np.pi / 20.0
    late = 3.5 / (307.0 + built.RETURN) + 0.004
    assert 0.0 < found[0] - topology.width < 2.0 * late * speed
    assert found[1] - found[0] == pytest.approx(0.6 * topology.width, rel=0.03)


@pytest.mark.parametrize("name", MECHANISMS)
def test_the_wall_holds_the_tip_and_throws_it_nowhere(name):
    built = mechanism()
    topology = next(t for t in built.TOPOLOGIES if t.name == name)
    n = int(12.0 / built.STEP_S)
    stroke = -topology.half * np.cos(np.linspace(0.0, 2.0 * np.pi, n))
    still = np.zeros(n)

    def bent(values):
        """Chord of the tip from the base, rad."""
        x, _, z = built.drive(topology, built.Values(values), stroke, still, still, still).tip_mm.T
        return np.arctan2(x, z)

    free = bent({})
    at = 0.5 * topology.gain * topology.half
    wall = {"wall_at": at, "wall_side": 1.0, "wall_soft": 0.003}
    held = bent(wall)
    bend, reach = topology.bending_mm, topology.reach_mm
    chord = np.arctan2(bend * (1 - np.cos(at)) / at + reach * np.sin(at), bend * np.sin(at) / at + reach * np.cos(at))
    assert free.max() > chord + 0.1  # it would go well beyond
    assert chord - 0.03 < held.max() < chord + 0.02
    before = free < chord - 0.03
    np.testing.assert_allclose(held[before], free[before], atol=0.02)
    assert np.abs(np.diff(held)).max() < 4.0 * np.abs(np.diff(free)).max()  # a light chain whips


@pytest.fixture(scope="module")
def lagging() -> Case:
    mechanism()
    return GENERATORS["mujoco.coupled"].make(5, "single", (LAG,))


def test_a_seed_makes_the_same_case_again(lagging):
    again = GENERATORS["mujoco.coupled"].make(5, "single", (LAG,))
    assert lagging.label == again.label and again.label.generator == "mujoco.coupled"
    for a, b in zip([lagging.calibration, *lagging.tests], [again.calibration, *again.tests], strict=True):
        np.testing.assert_array_equal(seen(a), seen(b))
        np.testing.assert_array_equal(a.motor.q, b.motor.q)


def test_identifiable_is_what_the_mechanism_itself_does_beyond_noise(lagging, monkeypatch):
    from tools.blindtest.physical import draws, make

    assert lagging.label.identifiable
    monkeypatch.setattr(make, "_DRAWS", 1)
    monkeypatch.setitem(draws.KNOWN, LAG, lambda rng, topology: {"damper": 1e-4})
    weak = GENERATORS["mujoco.coupled"].make(5, "single", (LAG,))
    assert not weak.label.identifiable and 0.0 < weak.label.left[0] < weak.label.noise_px
    # The calibration came before the effect, whatever the effect is.
    assert weak.label.noise_px == lagging.label.noise_px
    np.testing.assert_array_equal(seen(weak.calibration), seen(lagging.calibration))
    assert not np.array_equal(seen(weak.tests[0]), seen(lagging.tests[0]))


def test_what_pushes_from_outside_comes_after_the_calibration_and_is_seen():
    mechanism()
    from tools.blindtest.physical.draws import UNKNOWN

    some = list(UNKNOWN)[:2]  # all take twenty seconds
    made = {name: GENERATORS["mujoco.arm"].make(5, "unknown", (name,)) for name in some}
    for name, case in made.items():
        assert case.label.identifiable and case.label.effects == (name,)
        assert np.abs(seen(case.tests[0])).max() < 2.0 * np.abs(seen(case.calibration)).max()  # pushed, not thrown
        assert case.label.left[0] > 2.0 * case.label.noise_px
    assert len({case.label.left for case in made.values()}) == 2 < len(UNKNOWN)


def test_what_happens_before_the_play_was_crossed_is_not_identifiable(monkeypatch):
    """The tests begin at one end of the range: what is met there only is never scored."""
    mechanism()
    from tools.blindtest.physical import draws, make

    contact = "configuration.contact"
    monkeypatch.setattr(make, "_DRAWS", 1)
    left = {}
    for side in (-1.0, 1.0):
        wall = {"wall_at": 0.55, "wall_side": side, "wall_soft": 0.003}
        monkeypatch.setitem(draws.KNOWN, contact, lambda rng, topology, wall=wall: wall)
        label = GENERATORS["mujoco.antagonists"].make(720001, "single", (contact,)).label
        left[side] = label.left[0] / label.noise_px
    assert left[-1.0] < 2.0 < 10.0 < left[1.0]


def test_a_case_of_angles_goes_through_sealing_and_scoring():
    mechanism()
    visible, opened = work.make_case(9, "none", (), "salt", "mujoco.coupled")
    assert "calibration/angle.csv" in visible and "test-1/motor.csv" in visible and "label.json" in opened
    with work.unpacked_folder(visible) as folder:
        rig, recordings = work.recordings_of(folder)
        found = calibrate(recordings[:1], rig).model
        noise = json.loads(opened["label.json"])["label"]["noise_px"]
        assert found.quality.verdict == "good"
        assert noise < 1.05 * foretold(found, recordings[1]) < 1.3 * noise


def test_the_library_makes_cases_of_its_own_effects_under_a_noise_that_remembers():
    case = GENERATORS["library"].make(4, "single", (LAG,))
    assert case.label.generator == "library" and case.label.identifiable
    with pytest.raises(TautError, match="leave --unknown out"):
        GENERATORS["library"].make(4, "unknown", ())
