"""Backlash of a joint with an angle sensor, from arrays alone: no camera, no file.

python examples/angle_sensor.py [PICTURE]
"""

import sys

from matplotlib.figure import Figure

import tautline as tl
from tautline.simulated.instrument import preset
from tautline.simulated.simulate import simulate
from tautline.trajectory import back_and_forth

rig = tl.Rig.from_document(
    {
        "format": "rig/1",
        "actuator": {"unit": "deg", "range": [-60.0, 60.0], "encoder_resolution": 0.01},
        "coarse": {"gain": 1.0, "offset": 0.0},  # c = q: the motor's shaft and the joint turn alike
    },
    "angle_sensor.py",
)

# Here a simulated joint. On yours: t_s and q from the encoder, t_s and c_deg from the sensor.
motion = back_and_forth(rig.actuator, (10.0, 20.0), 30.0, 12, 60.0, 0.2)
seen = simulate(rig, preset("davinci", rig), motion, angle_noise_deg=0.02)
assert seen.angle is not None
recording = tl.Recording(
    "joint", tl.Motor(seen.motor.t_s, seen.motor.q), angle=tl.Angle(seen.angle.t_s, seen.angle.c_deg), rig=rig
)

calibration = tl.calibrate(recording)
model = calibration.model
inside = (model.q >= model.measured[0]) & (model.q <= model.measured[1])
print(f"{model.quality.verdict}: B from {model.width[inside].min():.2f} to {model.width[inside].max():.2f} deg")

figure = Figure(figsize=(7, 3), layout="constrained")
axes = figure.subplots()
axes.plot(model.q[inside], model.width[inside], color="#b3202c", label="B(q)")
low, high = model.width - 2 * model.width_sigma, model.width + 2 * model.width_sigma
axes.fill_between(model.q[inside], low[inside], high[inside], color="#f3c9cc", label="± 2 sigma")
used = [onset for onset in calibration.onsets if onset.used]
axes.plot([0.5 * (o.q1 + o.q2) for o in used], [o.width for o in used], ".", color="#22303c", label="reversals")
axes.set(xlabel="motor q (deg)", ylabel="backlash (deg)", title="A cable-driven joint, measured with an angle sensor")
axes.legend()
figure.savefig(sys.argv[1] if len(sys.argv) > 1 else "angle_sensor.png", dpi=100)
