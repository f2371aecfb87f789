"""The reasons that a calibration gives beside an effect's own id. Each is a code of Reason (quality.py)."""

from __future__ import annotations

from tautline.explain.topic import Topic


def _reason(code: str, what: str, tell: str, mend: str, *see: str) -> Topic:
    """Makes the topic of a reason. what: is wrong; tell: how to tell; mend: what to do; see: codes of related
    topics."""
    return Topic(code, "reason", what, tell=tell, mend=mend, see=see)


REASONS = (
    _reason(
        "coverage",
        "Too little of the range was driven in a way that shows B: no reversal with an onset, or positions that the "
        "tip passed one way only.",
        "In report.html the grey parts of B(q) are those that no reversal reached; every reversal says why it was not "
        "used.",
        "Move back and forth over the whole range, by more than the backlash each time, and run on for a while before "
        "each turn so that the tip is on an envelope.",
        "envelope",
        "B",
    ),
    _reason(
        "coarse",
        "The tip bends by another amount per unit of q than f_coarse says, or the other way round.",
        "The sentence has both gains: a ratio of -1 is a sign, 25.4 an inch, 57.3 a radian.",
        "Check the encoder's direction and scale, coarse.gain, actuator.unit, camera.fx_px and hand_eye; a mirrored "
        "image turns the sign too.",
        "rig.coarse.gain",
        "f_coarse",
    ),
    _reason(
        "range",
        "The motor's positions, or the bending that f_coarse makes of them, do not fit the rig's range.",
        "Compare the first and last numbers of motor.csv with actuator.range.",
        "Give actuator.range in the unit of q, and coarse.gain in deg per that unit.",
        "rig.actuator.range",
    ),
    _reason(
        "predicts",
        "The model predicts its own recording worse than f_coarse, or than a tip that never moves.",
        "Nothing in report.html follows the marker; the residuals are as large as the motion.",
        "Something contradicts everything else: check camera, hand_eye, actuator.unit and the clock of the frames.",
        "clock.offset",
        "registration.static",
    ),
    _reason(
        "residual",
        "More is left than noise, and it is none of the departures that calibration knows.",
        "The residuals of report.html show a pattern over time or q.",
        "taut diagnose, with this recording and another one, says at which stage it is.",
        "unexplained fraction",
    ),
    _reason(
        "noise",
        "The frames scatter more than a tip at rest does, from one to the next.",
        "It is there whether the tip moves or not.",
        "Check light, focus and the marker's colour; a larger marker helps most.",
        "acquisition.jitter",
    ),
    _reason(
        "outliers",
        "Some frames show the marker far from where it can be.",
        "They are single dots away from the track in report.html.",
        "Look for a second blob of the marker's colour, or glare: pick the colour again with taut marker.",
    ),
    _reason(
        "place",
        "Angles are known no better than the place on a bare instrument's tip that was followed.",
        "The sentence says by how much f_remain may be off, all of it together; B and the delay do not need it.",
        "Give tip_length_mm of the place that was shown, show a smaller one, or mark the tip.",
    ),
    _reason(
        "scene",
        "The camera sees the world from the tip: that tells when the tip moves, and not by how much it bends.",
        "What lies near turns by more than the tip does, as the tip goes sideways as well; how far it is nothing "
        "says. B, the onsets and the delay do not need it.",
        "Measure f_remain with a camera that sees the instrument, or an angle sensor.",
        "rig.camera.mount",
    ),
    _reason(
        "lost",
        "Over a part of the range the marker is mostly not seen.",
        "The sentence says from which position to which.",
        "Keep it in view and in light there, or pick its colour again with taut marker.",
    ),
    _reason(
        "steps",
        "The motor jumps within one sample of its log: what the tip did on the way cannot be told.",
        "motor.csv has rows between which q jumps by more than the motor can go.",
        "Log the motor at 100 Hz or more, and move it at a bounded speed.",
        "rate",
    ),
    _reason(
        "rate",
        "The motor's log, or the frames, come too slowly or at another rate than the rig says.",
        "A turn that lies between two samples is not known: that is the same error in every stroke, which no scatter "
        "shows.",
        "Log the motor faster, the sentence says how fast; set camera.frame_rate_hz to what the frames have.",
        "rig.camera.frame_rate_hz",
    ),
    _reason(
        "duration",
        "The frames last longer or shorter than the motor's log, or fit it only when stretched.",
        "The sentence has both durations.",
        "Start the camera first and stop it last, and log the motor for as long as it runs; give the frames' arrival "
        "times in frames.csv.",
        "frames.csv",
    ),
    _reason(
        "frame_size",
        "The frames, or where the marker is in them, are not of the size that the rig's camera was calibrated at.",
        "The sentence has both sizes, or the factor at which the marker would be on its path.",
        "Record at the rig's size, or calibrate the camera at this one and write it into rig.toml.",
        "rig.camera.width_px",
    ),
    _reason(
        "clock",
        "The times of motor and frames contradict each other: the image does not follow the motor.",
        "At no lag does the marker's motion look like the motor's.",
        "Give the frames' arrival times on the motor's clock.",
        "frames.csv",
        "clock.offset",
    ),
    _reason(
        "clock.offset",
        "The sensor's clock is off from the motor's by more than any delay.",
        "Calibration tries every offset within 10 s and takes off the one that fits; where two fit alike, or none, it "
        "says so.",
        "Put both on one clock; where it cannot be told, make a motion that does not repeat.",
        "delay",
    ),
    _reason(
        "clock.rate",
        "The camera's clock runs faster or slower than the motor's.",
        "The delay that fits best grows along the recording.",
        "Take both times from one clock. The rate is taken out of this calibration, not out of a prediction.",
        "acquisition.clock_rate",
    ),
    _reason(
        "clock.drift",
        "The delay of the images changes during the session.",
        "As clock.rate, but not in a straight line.",
        "Fix exposure and frame rate of the camera.",
        "delay",
    ),
    _reason(
        "encoder",
        "The motor's own readings are too coarse or too noisy for this backlash, or the tip does not rest where the "
        "counts say that the motor turned.",
        "motor.csv scatters at rest, or moves in steps that are seen beside B.",
        "Shield the encoder's lines or take one with finer counts; look for stick-slip.",
        "rig.actuator.encoder_resolution",
    ),
    _reason(
        "tracker",
        "The marker's place errs alike in neighbouring frames, and anew along every stroke.",
        "A video codec holds back what moves little; a camera's noise reduction mixes in the frame before.",
        "Record raw or MJPEG frames, give the codec more bits, switch the camera's noise reduction off.",
        "marker.csv",
    ),
    _reason(
        "repeatability",
        "The tip takes another path on every stroke.",
        "Reversals at one place have widths that differ by more than their sigma.",
        "Look for stick-slip, a loose coupling or a slipping cable: no table can follow what does not repeat.",
        "transmission.stick_slip",
    ),
    _reason(
        "registration.drift",
        "The image moves slowly against the instrument.",
        "The residuals of u and v drift over time, also at rest.",
        "Fix camera and instrument to each other.",
        "registration.shift",
        "hand-eye",
    ),
    _reason(
        "registration.breathing",
        "The image sways against the instrument, as with breathing.",
        "The residuals swing with one period, whatever the motor does.",
        "Hold the scope still while calibrating.",
        "hand-eye",
    ),
    _reason(
        "registration.repeatability",
        "The image is moved otherwise on every stroke.",
        "The residuals are constant within a stroke and another in the next.",
        "Fix camera and instrument to each other.",
        "registration.direction_dependent",
    ),
)
