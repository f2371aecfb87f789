"""What words mean here, for someone who knows motors or cameras but not this field."""

from __future__ import annotations

from tautline.explain.topic import Topic


def _term(code: str, what: str, *see: str, aliases: tuple[str, ...] = ()) -> Topic:
    """Makes the topic of a word. what: its meaning; see: codes of related topics; aliases: what else it is called."""
    return Topic(code, "term", what, see=see, aliases=aliases)


TERMS = (
    _term(
        "q",
        "The motor's position: mm of cable travel, or deg of a spindle. Its unit is actuator.unit of rig.toml.",
        "rig.actuator.unit",
    ),
    _term(
        "c", "The bending angle of the tip, deg: 0 is straight.", "f_remain", aliases=("bending angle", "configuration")
    ),
    _term(
        "backlash",
        "Motion that is lost between motor and tip after every change of direction: the motor turns, nothing moves. "
        "Its width is B.",
        "B",
        "play",
        "reversal",
        aliases=("lost motion", "dead zone"),
    ),
    _term(
        "B",
        "The backlash's width, in the unit of q: how far the motor turns after a reversal before the tip moves. It "
        "depends on where that happens, so it is a curve B(q), q the middle of the way.",
        "backlash",
        "onset",
        aliases=("B(q)", "width", "q_mean"),
    ),
    _term(
        "f_coarse",
        "The law from q to c that the instrument's kinematics says, before anything is measured: c = gain * q + "
        "offset ([coarse] of rig.toml).",
        "f_remain",
        "rig.coarse.gain",
    ),
    _term(
        "f_remain",
        "The law from q to c that is left once the backlash is taken out: the middle line between the way up and the "
        "way down. Measured from the camera's pose; f_coarse is what it would be on a perfect instrument.",
        "f_coarse",
        "play",
        "envelope",
        aliases=("central fibre", "remaining"),
    ),
    _term(
        "play",
        "The model of backlash: a tip that lies between two walls which the motor moves. p is its place, q - B/2 <= p "
        "<= q + B/2, and c = f_remain(p).",
        "B",
        "envelope",
        "play element",
        aliases=("p", "centre coordinate"),
    ),
    _term(
        "play element",
        "One of several plays whose mean is the tip: together they make an onset gradual (Prandtl-Ishlinskii). Their "
        "widths are shares of one B(q). Where friction builds up instead (Bouc-Wen's, Dahl's) a model has one state "
        "between the envelopes, and a board's tables the plays nearest to it.",
        "play",
        "transmission.smooth_onset",
        aliases=("elements", "Prandtl-Ishlinskii", "Bouc-Wen", "Dahl"),
    ),
    _term(
        "envelope",
        "The two curves of c over q on which the tip is once the backlash is taken up: one for rising q, one for "
        "falling. They lie B apart; between them the tip rests. A reversal counts only if the tip was on an envelope "
        "before it.",
        "play",
        "reversal",
        "branch",
    ),
    _term("branch", "Which envelope carries the tip: the rising one, the falling one, or neither.", "envelope"),
    _term(
        "reversal",
        "A place where the motor changes its direction. The board and the calibration look for the onset after it.",
        "onset",
    ),
    _term(
        "onset",
        "The moment at which the image begins to move after a reversal. The motor's way from the reversal until then, "
        "less the delay's share, is B.",
        "B",
        "delay",
    ),
    _term(
        "hand-eye",
        "Where the camera is to the instrument's base: a rotation and a translation ([hand_eye] of rig.toml). B does "
        "not need it; f_remain does.",
        "registration.static",
        "rig.hand_eye.rotation_deg",
        aliases=("hand-eye transform", "registration"),
    ),
    _term(
        "delay",
        "How old a frame is when it arrives, s: exposure, transfer, decoding. It is measured at the moments at which "
        "the image stops.",
        "onset",
        "rig.camera.delay_s",
        aliases=("t_delay",),
    ),
    _term("marker", "The coloured dot at the tip that the camera follows; taut marker picks its colour.", "marker.csv"),
    _term(
        "recording",
        "A folder with motor.csv and what was seen: marker.csv, a video or angle.csv.",
        "motor.csv",
        "marker.csv",
        "angle.csv",
    ),
    _term(
        "import.toml",
        "Beside a recording that taut import made: the file it is out of with its SHA-256, which channel became what, "
        "each one's unit and factor, whose times were used, and what was mended.",
        "channel",
        "stamp",
        aliases=("import", "taut import"),
    ),
    _term(
        "channel",
        "One number over time in another program's file: topic.field[index] of a message, a joint of a feature, or a "
        "column. A unit or a factor may stand behind its name, as in /joint_states.position[0]:rad.",
        "import.toml",
        "episode",
    ),
    _term(
        "episode",
        "One of the recordings that a LeRobot data set holds. taut import makes a folder of each.",
        "import.toml",
    ),
    _term(
        "stamp",
        "The time in a message's header, by the clock of who sent it; the log has its own, of when the message was "
        "written. taut import uses the stamps where all channels have them on one clock, else the log.",
        "import.toml",
        "clock.offset",
        aliases=("header stamp", "log time", "two clocks"),
    ),
    _term(
        "model",
        "A folder with what a calibration found: B(q), f_remain, the delay, all with their sigma, and its report.",
        "verdict",
        "tables",
    ),
    _term("tables", "B(q) and f_remain as the board holds them: sampled, in fixed point, at most 257 nodes.", "model"),
    _term(
        "verdict",
        "How far a calibration may be trusted. good: what it states covers the error. doubtful: something is there "
        "that the model does not hold. unusable: nothing should be driven with it.",
        "sigma",
        "residual",
    ),
    _term(
        "sigma",
        "One standard deviation of a number, what the calibration doubts included. Bands in reports are two of them.",
        "verdict",
    ),
    _term(
        "gap",
        "What a model's predictions miss of what was seen, rms per coordinate, on motions that it was not made from.",
        "noise floor",
    ),
    _term("noise floor", "The rms that a tip at rest has: no model gets below it.", "gap"),
    _term(
        "unexplained fraction",
        "The share of a gap's power above the noise floor that a fit leaves.",
        "gap",
        "noise floor",
    ),
    _term(
        "log-odds margin",
        "How far the leading explanation is ahead of the next, as the logarithm of how much likelier it is.",
        "gap",
    ),
    _term("held-out block", "A piece of a recording that a fit did not see, and on which it is scored.", "gap"),
    _term(
        "compensation",
        "Set-points for the motor that make the tip follow: q* = p* + B/2 while p* rises, p* - B/2 while it falls.",
        "take-up",
    ),
    _term(
        "take-up",
        "The bounded move of its own with which the controller crosses the backlash at a reversal.",
        "compensation",
    ),
    _term(
        "slack joint",
        "How a simulator without backlash is given one: a coordinate that is B/2 long, and two one-sided tendons, of "
        "motor, play and it, that push the play.",
        "play",
        "export.mjcf",
        aliases=("one-sided tendon",),
    ),
    _term("corrected model", "The model with the effects that a diagnosis named.", "gap"),
    _term(
        "descriptor",
        "All that is known of an effect in one place: its parameters, how it is looked for, how it is told and mended.",
    ),
    _term(
        "virtual time",
        "A simulated board's clock: it stands still between steps, so minutes of motion take seconds and repeat "
        "exactly.",
    ),
)
