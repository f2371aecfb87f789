"""A path of the tip, followed open loop with set-points that know the backlash, and with ones that do not.

python examples/open_loop.py [PICTURE]
"""

import sys
from typing import Literal

import numpy as np
from matplotlib.figure import Figure

import tautline as tl
from tautline.simulated.instrument import preset
from tautline.simulated.simulate import simulate
from tautline.trajectory import back_and_forth

instrument = preset("reference")  # 10 mm of cable, 120 deg of bending, an endoscope of 720 x 576
rig = instrument.rig
model = tl.calibrate(simulate(rig, instrument, back_and_forth(rig.actuator, (4.0,), 2.5, 12, 5.0, 0.2))).model

t_s = np.linspace(0.0, 20.0, 2001)
wanted = 30.0 * np.sin(2 * np.pi * t_s / 10.0) + 8.0 * np.sin(2 * np.pi * t_s / 2.9)
figure = Figure(figsize=(7, 4), layout="constrained")
top, bottom = figure.subplots(2, 1, sharex=True)
top.plot(t_s, wanted, color="#22303c", lw=3, alpha=0.35, label="asked for")
MODES: tuple[tuple[Literal["off", "full"], str, str], ...] = (
    ("off", "#d9772b", "without tables"),
    ("full", "#1f6fb2", "with tables"),
)
for mode, colour, name in MODES:
    points = tl.compensate(model, t_s, wanted, rate_hz=500, mode=mode)
    instrument.reset()
    tip = instrument.move(points.t_s, points.q)  # on your robot: send points.q to the motor's controller
    off = tip - np.interp(points.t_s, t_s, wanted)
    rms = np.sqrt(np.mean(off[points.t_s > 5.0] ** 2))  # after the first take-up both ways
    print(f"{name}: {rms:.2g} deg rms")
    top.plot(points.t_s, tip, color=colour, lw=1, label=name)
    bottom.plot(points.t_s, off, color=colour, lw=1, label=f"{rms:.2g} deg rms")
top.set(ylabel="tip (deg)", title="The tip follows a path open loop")
bottom.set(xlabel="time (s)", ylabel="off by (deg)")
for axes in (top, bottom):
    axes.legend(loc="upper right", ncols=3, fontsize=8)
figure.savefig(sys.argv[1] if len(sys.argv) > 1 else "open_loop.png", dpi=100)
