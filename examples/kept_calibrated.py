"""A tendon is tightened while the instrument is used: the model follows, from the endoscope's own image.

    python examples/kept_calibrated.py [PICTURE]
"""

import sys
from pathlib import Path

import tautline as tl
from tautline import figures
from tautline.simulated.instrument import Instrument, preset
from tautline.simulated.simulate import simulate
from tautline.simulated.trajectory import back_and_forth, random_smooth
from tautline.tracking.picture import draw

before = preset("reference")
rig = before.rig
tightened = Instrument.of(rig, lambda p: 0.7 * before.backlash(p), before.bend, "tightened")

model = tl.calibrate(simulate(rig, before, back_and_forth(rig.actuator, (4.0,), 2.5, 12, 5.0, 0.2))).model
use = [
    simulate(rig, before, random_smooth(rig.actuator, 2.0, 40.0, 1), name="first hour", seed=1),
    simulate(rig, tightened, random_smooth(rig.actuator, 2.0, 60.0, 2), name="tightened", seed=2),
]
tracked = tl.track(model, use)
for change in tracked.changes:
    print(f"{use[change.recording].name}, {change.t_s:.1f} s: {change.state}, {change.says}")
last = tracked.rows[-1]
print(f"in the end: B is {last.scale:.3f} ± {last.scale_sigma:.3f} of what was calibrated (true: 0.700)")
figures.save(draw(tracked, use, rig.actuator.unit), Path(sys.argv[1] if len(sys.argv) > 1 else "kept_calibrated.png"))
