"""Ranges of this family, each with its source; where the first family's range holds it is taken from there."""

from tools.family.ranges import (
    ANGLE_NOISE,
    BREAKAWAY,
    CAMERA_DELAY,
    CATCH_UP,
    CHANNEL_PLAY,
    CLOCK,
    COUPLING,
    CREEP,
    CREEP_TIME,
    CURVATURE,
    DELAY,
    DISTORTION,
    DRIFT,
    ENCODER,
    HELD,
    JITTER,
    JUMP,
    LAG,
    LAW_CHANGE,
    LOAD,
    MADE,
    OFFSET_CHANGE,
    RATE,
    RATE_SPEED,
    REGISTRATION,
    ROUNDING,
    SWING,
    SWING_DAMPING,
    SWING_RATE,
    TOOTH,
    WALL,
    WIDTH_CHANGE,
    Range,
)

__all__ = [
    "ANGLE_NOISE",
    "BREAKAWAY",
    "CAMERA_DELAY",
    "CATCH_UP",
    "CHANNEL_PLAY",
    "CLOCK",
    "COUPLING",
    "CREEP",
    "CREEP_TIME",
    "CURVATURE",
    "DELAY",
    "DISTORTION",
    "DRIFT",
    "ENCODER",
    "HELD",
    "JITTER",
    "JUMP",
    "LAG",
    "LAW_CHANGE",
    "LOAD",
    "MADE",
    "OFFSET_CHANGE",
    "RATE",
    "RATE_SPEED",
    "REGISTRATION",
    "ROUNDING",
    "SWING",
    "SWING_DAMPING",
    "SWING_RATE",
    "TOOTH",
    "WALL",
    "WIDTH_CHANGE",
    "Range",
]

DUPONT = "Lock and Dupont 2011 (ICRA); Ha, Fagogenis, Dupont 2018 (T-RO), friction of concentric tubes; degrees of lag"
TAGHIRAD = "Seyfferth et al. 1995; Taghirad and Belanger 1998, hysteresis of harmonic drives, 0.02 to 0.5 deg"
IRVINE = "Irvine 1981, Cable Structures; Riehl et al. 2009, sag of cables of large cable robots"
WUERTZ = "Wuertz et al. 2010; Palli et al. 2013 (T-Mech), twisted strings: hysteresis of 2 to 10 % of the stroke"
THREAD = "Data sheets of rolled lead screws: axial play 0.05 to 0.2 mm; push-pull controls: lost motion 2 to 6 %"
LUGRE_ARM = "Canudas de Wit et al. 1995, LuGre; cable-driven arms lose 1 to 6 deg (Hwang et al. 2020)"
ONE_EURO = "Casiez, Roussel, Vogel 2012 (CHI), 1 euro filter: low cut-off when slow, higher when fast"
LOCKING = "Raffel et al., Particle Image Velocimetry: peak locking of sub-pixel estimates, 0.05 to 0.3 px"
FLANGE = "Cable against a pulley's flange: working radius larger by a part of the cable's diameter, 1 to 15 %"
TREMOR = "Elble and Koller 1990: physiological tremor at 8 to 12 Hz; sway of a held camera below 1 Hz"
STAND = "Camera stands and arms ring at 2 to 9 Hz, damping ratio 0.02 to 0.08"
EXPOSURE = "UVC cameras: exposure 1 to 33 ms by automatic control, so the middle of it moves by up to 16 ms"
INTERLACED = "ITU-R BT.601: fields a line apart; interpolated ones by a part of it"
IDLE = "Stepper drivers: hold current 0.1 s (Zaber T series) to 5 s (RMS R101) after a move; sag up to a full step"
UNTWIST = "Feyrer 2015, Wire Ropes: torque of a laid rope turns its free end, degrees to turns by load"

# The healthy mechanism
TUBE_WIDTH = Range(2.0, 12.0, "deg of the tip", DUPONT)
GEAR_WIDTH = Range(0.6, 3.0, "deg of the tip", TAGHIRAD + "; worn, cable-driven output included")
SPAN_WIDTH = Range(1.0, 7.0, "deg of the tip", IRVINE + "; widths " + MADE)
NUT_WIDTH = Range(1.0, 6.0, "deg of the tip", THREAD)
STRING_WIDTH = Range(1.0, 6.0, "deg of the tip", WUERTZ)
WINCH_WIDTH = Range(1.0, 7.0, "deg of the tip", LUGRE_ARM)

# The recording
MARKER_NOISE = Range(0.03, 0.15, "px", "asked")
NOISE_MEMORY = Range(0.05, 0.5, "correlation of neighbouring frames", MADE)
TAIL = 4.0  # degrees of freedom of Student's noise, where tails are heavy

# Causes that no list holds
COAST = Range(0.5, 60.0, "1 / braking, of the reach per s^2", MADE)
RETURN = Range(0.15, 8.0, "s to come back over the reach", MADE)
SNAG = Range(0.05, 3.0, "of the width, before it lets go", MADE)
CLIMB = Range(0.003, 0.15, "of the gain", FLANGE)
INSERTION = Range(0.02, 8.0, "mm", MADE)
SAG = Range(0.1, 3.0, "of the width", IDLE)
STALE = Range(0.002, 0.03, "s", "fieldbuses and serial servos polled at 30 to 500 Hz; " + MADE)
ROLL = Range(0.05, 12.0, "deg of roll at full pull", UNTWIST)
NUDGE = Range(0.03, 4.0, "deg", MADE)
HELD_BY_HAND = Range(0.01, 1.5, "deg rms", TREMOR)
RINGING = Range(0.005, 1.5, "deg for the usual speed stopped at once", STAND)
LOOSE = Range(0.005, 1.2, "mm", MADE)
TEMPLATE = Range(0.006, 0.45, "px for each root of a px of path", "template trackers (Matthews et al. 2004)")
PIXEL = Range(0.03, 0.3, "px amplitude", LOCKING)
HUNTING_EXPOSURE = Range(0.002, 0.016, "s", EXPOSURE)
FIELDS = Range(0.05, 1.0, "px between fields: a line of the frame and parts of it", INTERLACED)
FILTER = Range(0.01, 0.3, "s at rest", ONE_EURO)
BRAKE = Range(0.02, 0.8, "s", "spring-applied holding brakes, data sheets: release in 20 to 150 ms, more when worn")
