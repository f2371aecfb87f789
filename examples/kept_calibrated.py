"""A tendon is tightened while the instrument is used: the model follows, from what the sensor sees of the use itself.

python examples/kept_calibrated.py [PICTURE]
"""

import sys
from pathlib import Path

import numpy as np

import tautline as tl
from tautline.reports import figures
from tautline.simulated.instrument import Instrument, preset
from tautline.simulated.simulate import simulate
from tautline.tracking.picture import draw
from tautline.trajectory import back_and_forth, random_smooth

TIGHTENED_S = 40.0
rig = tl.Rig.from_document(
    {
        "format": "rig/1",
        "actuator": {"unit": "mm", "range": [-5.0, 5.0], "encoder_resolution": 0.001},
        "coarse": {"gain": 12.0, "offset": 0.0},
    },
    "kept_calibrated.py",
)
before = preset("reference", rig)
after = Instrument.of(rig, lambda p: 0.7 * before.backlash(p), before.bend)
motion = back_and_forth(rig.actuator, (4.0,), 2.5, 12, 5.0, 0.2)
model = tl.calibrate(simulate(rig, before, motion, angle_noise_deg=0.02)).model

# A minute and a half of use: an angle every 20 ms; after TIGHTENED_S the backlash is 0.7 of what it was.
use = random_smooth(rig.actuator, 4.0, 90.0, 1)
early = use.t_s < TIGHTENED_S
before.reset()
c_deg = [before.move(use.t_s[early], use.q[early])]
after.reset(before.p)
c_deg.append(after.move(use.t_s[~early], use.q[~early]))
seen = np.concatenate(c_deg)[::20]
seen += np.random.default_rng(5).normal(0.0, 0.02, len(seen))
recording = tl.Recording("use", tl.Motor(use.t_s, use.q), angle=tl.Angle(use.t_s[::20], seen), rig=rig)

tracked = tl.track(model, recording)
for change in tracked.changes:
    print(f"{change.t_s:.1f} s: {change.state}, {change.says}")
last = tracked.rows[-1]
print(f"in the end B is {last.scale:.3f} ± {last.scale_sigma:.3f} of what was calibrated (true: 0.700)")
figures.save(
    draw(tracked, [recording], rig.actuator.unit), Path(sys.argv[1] if len(sys.argv) > 1 else "kept_calibrated.png")
)
