"""An effect of one's own: a file outside of the package, in Python, found by its entry point."""

import os
import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tautline import effects
from tautline.effects import Kind, Parameter, Transform, outside, simulation
from tautline.errors import TautError
from tautline.model import Model
from tautline.recording import Motor
from tautline.simulated.instrument import preset, reference_rig

GRID = np.linspace(-5.0, 5.0, 101)

MODULE = '''
import numpy as np

from tautline.effects import Kind, Parameter, Transform


def run(session_s, q, values):
    """The motor's mount rocks, with the time of the session."""
    turn = 2.0 * np.pi * values["rocking_hz"] * session_s
    return q + values["rocking_sin"] * np.sin(turn) + values["rocking_cos"] * np.cos(turn)


EFFECTS = (
    Kind(
        "transmission.rocking",
        (Parameter("rocking_sin", "unit", 2e-3), Parameter("rocking_cos", "unit", 2e-3)),
        (Parameter("rocking_hz", "Hz", 0.01, (0.2, 0.25, 0.3), low=0.05, high=2.0),),
        says="the motor's mount rocks",
        tell="It goes on at rest.",
        mend="Tighten the mount.",
        transform=Transform("input", run),
    ),
)
'''

SESSION = """
import sys
from dataclasses import replace
from pathlib import Path
import numpy as np
from tautline import effects, trajectory
from tautline.calibration.calibrate import calibrate
from tautline.diagnosis.diagnose import diagnose
from tautline.diagnosis.folder import save
from tautline.explain import find
from tautline.model import Model
from tautline.prediction import predict
from tautline.simulated import simulate
from tautline.simulated.instrument import of_name, preset, reference_rig

rig = reference_rig()
instrument = preset("reference", rig)
before = simulate.simulate(rig, instrument, trajectory.back_and_forth(rig.actuator, [0.8, 1.6], 2.0, 12, 8.0, 0.3))
after = simulate.simulate(rig, instrument, trajectory.trapezoids(rig.actuator, 2.4, 3.0, 4, 20.0, 1.0), seed=1)
model = calibrate([before], rig).model
offset = float(before.motor.t_s[-1] - after.motor.t_s[0]) + 1.0  # where a session puts a recording that overlaps
truth = {"rocking_sin": 0.04, "rocking_cos": -0.02, "rocking_hz": 0.252}
scene = after.marker.t_s - model.delay_s
turn = 2.0 * np.pi * truth["rocking_hz"] * (after.motor.t_s + offset)  # not by the effect's own code
rocked = after.motor.q + truth["rocking_sin"] * np.sin(turn) + truth["rocking_cos"] * np.cos(turn)
moved = [predict(model, replace(after.motor, q=q), scene).image_px for q in (rocked, after.motor.q)]
u, v = (np.column_stack([after.marker.u_px, after.marker.v_px]) + moved[0] - moved[1]).T
found = diagnose(model, before, [replace(after, marker=replace(after.marker, u_px=u, v_px=v))])
named = {effect["id"]: effect["parameters"] for effect in found.document["effects"]}
assert list(named) == ["transmission.rocking"], (found.document["verdict"], named)
got = named["transmission.rocking"]
assert abs(got["rocking_hz"] - truth["rocking_hz"]) < 2e-3, got  # a tenth of a turn in a recording of 50 s
pull = [np.hypot(values["rocking_sin"], values["rocking_cos"]) for values in (got, truth)]
assert abs(pull[0] - pull[1]) < 0.05 * pull[1], got
assert not found.document["effects"][0]["loads_on_board"]
assert find("rocking").mend.startswith("Tighten the mount.")
out = Path(sys.argv[1])
save(found, out)
page = (out / "report.html").read_text()
assert "the motor&#39;s mount rocks" in page.lower() and "Tighten the mount." in page
corrected = Model.load(out / "corrected")
at = after.motor.t_s[::20]
driven = replace(after.motor, t_s=at, q=after.motor.q[::20])
with_it, without = (predict(m, driven, at).c_deg for m in (corrected, replace(corrected, effects=())))
assert np.max(np.abs(with_it - without)) > 0.1
np.testing.assert_allclose(of_name(str(out / "corrected")).move(at, driven.q), with_it, atol=0.05)
"""


def installed(folder: Path, text: str) -> dict[str, str]:
    """A distribution beside the package, and the environment in which it is found."""
    (folder / "rocking.py").write_text(text)
    about = folder / "rocking-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: rocking\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[tautline.effects]\nrocking = rocking:EFFECTS\n")
    return {**os.environ, "PYTHONPATH": str(folder), "OPENBLAS_NUM_THREADS": "1"}


def test_a_file_outside_of_the_package_is_diagnosed_explained_and_simulated(tmp_path):
    command = [sys.executable, "-c", SESSION, str(tmp_path / "out")]
    done = subprocess.run(command, env=installed(tmp_path, MODULE), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_distribution_that_cannot_be_taken_is_one_line_that_names_it(tmp_path):
    command = [sys.executable, "-m", "tautline", "explain", "B"]
    broken = installed(tmp_path, "import nothing_of_that_name")
    done = subprocess.run(command, env=broken, capture_output=True, text=True, check=False)
    assert done.returncode == 1 and done.stderr.count("\n") == 1, done.stderr
    assert "rocking (rocking:EFFECTS) of rocking cannot be imported" in done.stderr


def test_a_module_that_is_imported_before_tautline_is_told_what_to_do(tmp_path):
    environment = installed(tmp_path, MODULE)
    for lines, says in (
        ("import rocking", "put 'import tautline.effects' before it"),
        ("import tautline.effects, rocking", ""),
    ):
        command = [sys.executable, "-c", lines]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        assert bool(done.returncode) == bool(says) and says in done.stderr, done.stderr


def made() -> Model:
    rig, instrument = reference_rig(), preset("reference", reference_rig())
    return Model(rig, GRID, instrument.backlash(GRID), np.full(101, 0.003), instrument.bend(GRID), 0.08, (-4.0, 4.0))


MODEL = made()


def own(place, run, name="transmission.own") -> Kind:
    shift = Parameter(f"{name}_by", "", 0.1)
    return Kind(name, (shift,), says="it", tell="So.", mend="So.", transform=Transform(place, run))


def shifted(t_s, values, parameters):
    return values + next(iter(parameters.values()))


@given(seed=st.integers(0, 2**32 - 1), by=st.floats(-0.5, 0.5).filter(bool))
def test_a_shift_at_each_place_is_that_shift(seed, by):
    """Of q as a motor that stands elsewhere, of p before f_remain, of c in deg; whatever the order of the times."""
    patch = pytest.MonkeyPatch()
    kinds = tuple(own(place, shifted, f"transmission.{place}") for place in ("input", "state", "output"))
    patch.setattr(simulation, "_TRANSFORMED", kinds)
    rng = np.random.default_rng(seed)
    t_s = np.arange(0.0, 8.0, 0.05)
    q = np.clip(np.cumsum(rng.normal(0.0, 0.2, len(t_s))), -4.0, 4.0)
    scene = rng.permutation(np.arange(0.01, 7.9, 0.03))
    plain = effects.follow(MODEL, Motor(t_s, q), scene, {})
    try:
        told = {
            place: effects.follow(MODEL, Motor(t_s, q), scene, {f"transmission.{place}_by": by}).c_deg
            for place in ("input", "state", "output")
        }
    finally:
        patch.undo()
    elsewhere = effects.follow(MODEL, Motor(t_s, q + by), scene, {}).c_deg
    np.testing.assert_allclose(told["input"], elsewhere, atol=1e-9)
    np.testing.assert_allclose(told["state"], MODEL.remaining(plain.tip + by), atol=1e-9)
    np.testing.assert_allclose(told["output"], plain.c_deg + by, atol=1e-9)


def test_a_law_of_time_has_the_sessions(monkeypatch):
    law = own("output", lambda t_s, c, values: c + values["transmission.own_by"] * t_s)
    monkeypatch.setattr(simulation, "_TRANSFORMED", (law,))
    motor = Motor(np.arange(4.0), np.zeros(4))
    by = {"transmission.own_by": 0.5}
    first, later = (effects.follow(MODEL, motor, motor.t_s, by, clock_offset_s=at).c_deg for at in (0.0, 100.0))
    np.testing.assert_allclose(later - first, 50.0, atol=1e-9)


def test_a_law_that_gives_no_numbers_is_said_to(monkeypatch):
    monkeypatch.setattr(simulation, "_TRANSFORMED", (own("output", lambda t_s, c, values: c[:-1]),))
    motor = Motor(np.arange(3.0), np.zeros(3))
    with pytest.raises(TautError, match="gave no 3 numbers"):
        effects.follow(MODEL, motor, motor.t_s, {"transmission.own_by": 0.1})


@pytest.mark.parametrize(
    ("kind", "why"),
    [
        (own("input", shifted, "camera.own"), "is no STAGE.NAME"),
        (own("input", shifted, "own"), "is no STAGE.NAME"),
        (Kind("transmission.own", (Parameter("x", "", 1.0),)), "needs a transform"),
        (Kind("transmission.own", (), transform=Transform("input", shifted)), "at least one amplitude"),
        (own("input", shifted, "transmission.lag"), "is there already"),
        (
            Kind(
                "transmission.own", (Parameter("lag", "s", 0.01),), says="it", tell="So.", mend="So.",
                transform=Transform("input", shifted),
            ),
            "has a parameter lag",
        ),
        (
            Kind("transmission.own", (Parameter("x", "", 1.0),), says="it", transform=Transform("input", shifted)),
            "needs says",
        ),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)  # fmt: skip
def test_a_descriptor_that_would_not_do_is_refused_with_its_reason(monkeypatch, kind, why):
    entry = EntryPoint("own", "module:EFFECTS", outside.GROUP)
    monkeypatch.setattr(outside, "entry_points", lambda group: [entry])
    monkeypatch.setattr(outside, "_loaded", lambda entry: (kind,))
    with pytest.raises(TautError, match=why):
        outside.installed_effects(effects.LIBRARY)
