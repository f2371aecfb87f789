"""A further effect is one descriptor and one C file: put beside the others in a copy, it is built, simulated, screened,
fitted and named, and not another line is touched."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
BUILT = ("CMakeLists.txt", "common", "firmware", "host")

LAW = """
#include "effect.h"

#include <math.h>

enum { SIN, COS, HZ, COUNT };
static const struct effect_parameter PARAMETERS[COUNT] = {
    {"breath_sin", 0, "unit", "by how much breathing pulls the tendon"},
    {"breath_cos", 0, "unit", "a quarter of a breath later"},
    {"breath_hz", 1, "Hz", "how often"},
};

static int present(const double *v) {
    return v[SIN] != 0.0 || v[COS] != 0.0;
}

static void drive(const double *v, double *state, const struct effect_moment *now, struct effect_drive *to) {
    (void)state;
    const double turn = 6.283185307179586 * v[HZ] * now->session_s;
    to->q += v[SIN] * sin(turn) + v[COS] * cos(turn);
    to->again_s = fmin(to->again_s, 0.02 / v[HZ]);
}

const struct effect effect_breath = {"transmission.breath", PLACE_DRIVE, PARAMETERS, COUNT, .present = present,
                                     .drive = drive};
"""

DESCRIPTOR = """
from tautline.effects.kind import Kind, Parameter

EFFECTS = (
    Kind(
        "transmission.breath",
        (Parameter("breath_sin", "unit", 2e-3), Parameter("breath_cos", "unit", 2e-3)),
        (Parameter("breath_hz", "Hz", 0.01, (0.2, 0.25, 0.3), low=0.05, high=2.0),),
        says="breathing pulls the tendon",
    ),
)
"""

SESSION = """
import sys
from dataclasses import replace
from pathlib import Path

sys.meta_path[:] = [finder for finder in sys.meta_path if not type(finder).__name__.startswith("ScikitBuild")]
sys.path.insert(0, sys.argv[1])
import numpy as np
import tautline
from tautline import effects
from tautline.calibration.calibrate import calibrate
from tautline.diagnosis.diagnose import diagnose
from tautline.encoder import straight_lines
from tautline import trajectory
from tautline.simulated import simulate
from tautline.simulated.instrument import preset, reference_rig

assert Path(tautline.__file__).is_relative_to(sys.argv[1]), tautline.__file__
rig = reference_rig()
instrument = preset("reference", rig)
before = simulate.simulate(rig, instrument, trajectory.back_and_forth(rig.actuator, [0.8, 1.6], 2.0, 12, 8.0, 0.3))
after = simulate.simulate(
    rig, instrument, trajectory.trapezoids(rig.actuator, 2.4, 3.0, 6, 20.0, 1.0).with_sway(2.0, 20.0, 17.0), seed=1
)
model = calibrate([before], rig).model
lines = straight_lines(after.motor, rig.actuator.encoder_resolution)
truth = {"breath_sin": 0.04, "breath_cos": -0.02, "breath_hz": 0.252}
offset = 0.0 if after.motor.t_s[0] >= before.motor.t_s[-1] else float(before.motor.t_s[-1] - after.motor.t_s[0])
scene = after.marker.t_s - model.delay_s
moved = [effects.simulate(model, lines, scene, values, clock_offset_s=offset).image_px for values in (truth, {})]
u, v = (np.column_stack([after.marker.u_px, after.marker.v_px]) + moved[0] - moved[1]).T
found = diagnose(model, before, [replace(after, marker=replace(after.marker, u_px=u, v_px=v))]).document
named = {effect["id"]: effect["parameters"] for effect in found["effects"]}
assert found["verdict"] == "effect" and list(named) == ["transmission.breath"], (found["verdict"], named)
got = named["transmission.breath"]
pull = [np.hypot(values["breath_sin"], values["breath_cos"]) for values in (got, truth)]
assert abs(pull[0] - pull[1]) < 0.03 * pull[1], got
assert abs(got["breath_hz"] - truth["breath_hz"]) < 1e-3, got  # a tenth of a turn in a recording of 100 s
"""


@pytest.mark.long
def test_one_descriptor_and_one_c_file_are_an_effect(tmp_path):
    pytest.importorskip("nanobind")
    for name in BUILT:
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy2
        copy(ROOT / name, tmp_path / name)
    (tmp_path / "host/native/effects/breath.c").write_text(LAW)
    (tmp_path / "host/tautline/effects/library/breath.py").write_text(DESCRIPTOR)
    build = tmp_path / "build"
    configure = [
        "cmake",
        "-S",
        tmp_path,
        "-B",
        build,
        "-G",
        "Ninja",
        "-DTAUTLINE_PYTHON=ON",
        f"-DPython_EXECUTABLE={sys.executable}",
    ]
    for command in (configure, ["cmake", "--build", build, "--target", "_native"]):
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
    (module,) = (build / "host/native").glob("_native*.so")
    shutil.copy2(module, tmp_path / "host/tautline")
    command = [sys.executable, "-c", SESSION, tmp_path / "host"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
