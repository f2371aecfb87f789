"""Ranges of this family, each with its source; those of listed effects are the first family's."""

from tools.family import ranges as first
from tools.family.ranges import LUGRE, MADE, WEBCAM, Range

STEERED = "Petruska and Abbott 2013, magnets on catheters; friction on mucosa of 0.02 to 0.3; widths " + MADE
GUIDE = "Slocum 1992, narrow guides that bind; sliding carriages of flexible instruments lose 2 to 8 deg, " + MADE
CONTACT_LINE = "de Gennes 1985: contact angles between receding and advancing differ by 10 to 50 deg; widths " + MADE
SHEAVES = "Feyrer 2015, Wire Ropes: sheaves lose 2 to 10 % each; widths " + MADE
CROSSES = "Seherr-Thoss, Schmelz, Aucktor 2006, Universal Joints: crosses lose 0.5 to 5 %; wind-up of degrees, " + MADE
WALL = "Furlani 2001; makers of magnetic couplings: lag of degrees at the pull-out's tenth; widths " + MADE
SPEED = "Current and speed limits of servo drives: 0.3 to 1 of the speed asked for"
DROPOUT = "Undervoltage and safe-torque-off of drives: 0.2 to 2 s (IEC 61800-5-2); share lost " + MADE
COMPENSATED = (
    "Backlash parameters left on in motion controllers (LinuxCNC, Beckhoff): to the width; ramps of 0.4 to 1.5 s made"
)
SHAPED = "Zero-vibration shapers (Singer and Seering 1990) of 1 to 5 Hz: half the move 0.1 to 0.5 s later"
PAYNE = "Payne 1962; Lion and Kardelky 2004: filled rubber softens by 5 to 60 % with amplitude, recovers in seconds"
STARVED = "Fretting and starved grease (Lugt 2009): friction of short strokes 1.1 to 3 times; lengths " + MADE
DRAUGHT = "Ventilation and flow on light arms: 0.1 to 1 Hz; torques " + MADE
COUGH = "Cough: 0.3 to 0.5 s, centimetres of the chest, tenths of it at the instrument; deg " + MADE
LEAD = "Look-ahead queues of planners (G-code, ROS trajectories): 20 to 500 ms ahead while moving"
FLIPPED = "Bit errors on unguarded encoder lines: 1e-4 to 1e-2 of the words; bits " + MADE
SMOOTHED = "Logs smoothed without phase after the fact (filtfilt, cubic splines): 0.3 to 5 Hz"
PREDICTS = "Alpha-beta and Kalman trackers (Kalata 1984): tracking index 0.01 to 1"
BLIND = "Trackers that extrapolate while the target is hidden: 0.2 to 0.8 s; shares " + MADE
ANCHORS = "Optical flow between key frames: 0.5 to 10 % of the path lost, set right each 0.5 to 4 s"
LOCKS = "Trackers held by features behind the target; radii " + MADE
LAMP = "Lamps on arms swing at 0.3 to 1 Hz; shading moves centroids by tenths of px to px, " + MADE
STEPS = "Floors under footfall (AISC 11): 1.6 to 2.2 steps/s, 6 to 12 Hz, ring for tenths of s; px " + MADE
REPLAY = "Ring recorders that write a stretch twice: 0.2 to 1.5 s; " + MADE
DRAGS = "Camera heads and sheaths dragged along on insertion: tenths of deg to deg (" + first.CABRAS + ")"

# The healthy mechanism
MAGNET_WIDTH = Range(1.0, 6.0, "deg of the tip", STEERED)
DRAWER_WIDTH = Range(2.0, 8.0, "deg of the tip", GUIDE)
MENISCUS_WIDTH = Range(0.8, 4.0, "deg of the tip", CONTACT_LINE)
TACKLE_WIDTH = Range(1.0, 6.0, "deg of the tip", SHEAVES)
CARDAN_WIDTH = Range(0.8, 5.0, "deg of the tip", CROSSES)
COUPLING_WIDTH = Range(0.8, 4.0, "deg of the tip", WALL)
STRIBECK = Range(0.005, 0.05, "of the friction, at most; and at most a tenth of the noise", LUGRE)

# The recording
MARKER_NOISE = Range(0.03, 0.15, "px", "asked")
ANGLE_NOISE = first.ANGLE_NOISE
NOISE_MEMORY = Range(0.05, 0.5, "correlation of neighbouring frames", MADE)
CAMERA_DELAY = Range(0.030, 0.150, "s", WEBCAM)

# Causes that no list holds
LIMITED = Range(0.02, 0.9, "of the fastest speed asked for that is not reached", SPEED + ", rounded outwards")
FREEWHEELS = Range(0.005, 0.6, "of the way back to the middle", DROPOUT)
TAKE_UP = Range(0.03, 2.0, "of the width", COMPENSATED)
ECHO = Range(0.02, 0.5, "of the move that comes half a period later", SHAPED)
SOFTENS = Range(0.005, 0.4, "of the motion", PAYNE)
STARVES = Range(0.03, 2.5, "of the friction after the shortest strokes", STARVED)
BLOWS = Range(0.01, 1.0, "of the spring's torque, rms", DRAUGHT)
COUGHS = Range(0.05, 12.0, "deg of the tip", COUGH)
AHEAD = Range(0.005, 0.6, "s", LEAD + ", rounded outwards")
WRONG_BITS = Range(0.005, 0.5, "of the range: the bit that flips", FLIPPED)
WITHOUT_PHASE = Range(0.03, 1.6, "s of the window's deviation", SMOOTHED)
OVERSHOOTS = Range(0.01, 0.9, "1 less alpha", PREDICTS)
UNSEEN = Range(0.05, 1.2, "s", BLIND + ", rounded outwards")
LOST_PATH = Range(0.002, 0.3, "of the path since the key frame", ANCHORS)
HELD_NEAR = Range(0.3, 40.0, "px", LOCKS)
SHADES = Range(0.08, 8.0, "px", LAMP)
TREADS = Range(0.2, 15.0, "px", STEPS)
REPEATS = Range(0.02, 1.8, "s", REPLAY)
DRAGGED = Range(0.03, 4.0, "deg", DRAGS)

__all__ = ["MADE", "Range"]
