"""Ranges of this family, each with its source; those of listed effects are the first family's."""

from tools.family import ranges as first
from tools.family.ranges import LUGRE, MADE, WEBCAM, Range

SEAL = "Parker O-Ring Handbook: seal friction of some to 20 % of the force; fluid-driven arms lose degrees, widths made"
GEAR = "DIN 58405 and makers' data: worm gears 3 to 30 arcmin new, degrees when worn, cable-driven output included"
ROLLS = "Suh et al. 2015, rolling joints; Johnson 1985, Contact Mechanics: resistance of rolling; widths " + MADE
CAPSTAN = "Werkmeister and Slocum 2007, cable and capstan drives; Feyrer 2015: bending losses of wire ropes; widths "
CAM = "Slocum 1992, friction angle of steel on steel 6 to 13 deg; grippers' lost motion 1 to 5 deg, " + MADE
SEEPAGE = "Spool and seal leakage: a loaded cylinder settles by 0.01 to 1 % of its stroke a second; " + MADE
WATER = "Hoerner 1965, Fluid-Dynamic Drag: a drag that grows with the square of speed; sizes " + MADE
FILM = "Hamrock 1994, Fundamentals of Fluid Film Lubrication: a film drains in seconds to minutes; sizes " + MADE
PLOUGH = "Fung 1993, Biomechanics: tissue yields and recovers in 10 to 100 s; " + MADE
GRASP = "Trejos et al. 2010: grasps of 1 to 10 N, held for seconds; deflections " + MADE
WHIRL = "Two bending modes of a slender tip, coupled by unequal stiffness: 1.5 to 7 Hz; " + MADE
CLIP = "Integer registers that saturate at a wrong limit; " + MADE
BIT = "A dead line of a parallel or Gray-coded encoder: a bit that always reads 0"
REPORT = "Report-on-change of field buses (CANopen TPDO delta, OPC UA deadband): 0.1 to 5 % of the range"
STALL = "USB and serial logs stall for 50 to 800 ms (FTDI latency, operating system); gaps filled in on a line"
STEP_OF_CLOCK = "NTP (RFC 5905) steps from 128 ms, slews or manual settings below: 3 to 120 ms"
RING = "Buffers of a capture ring handed out in the wrong order; shares " + MADE
LIGHT = "UVC auto-exposure of 1 to 33 ms follows the brightness of the scene, so the middle moves by up to 16 ms"
DROP = "A drop of water is a lens of some mm focal length that runs down a window; shifts " + MADE
EIS = "Electronic image stabilisation: follows motion below 0.3 to 1.5 Hz, keeps out a part of what is faster; " + MADE
GHOST = "Specular reflections in endoscopy (Stehle 2006): trackers mix a target with its reflection; shares " + MADE
SKIP = "H.264 skip macroblocks (ITU-T H.264): no motion below a threshold until the next key frame, 0.3 to 2 s"
CAUTERY = "Electrosurgery bursts of 0.3 to 2 s disturb video and sensors; sizes " + MADE

# The healthy mechanism
SEAL_WIDTH = Range(1.5, 8.0, "deg of the tip", SEAL)
TOOTH_WIDTH = Range(0.8, 5.0, "deg of the tip", GEAR)
ROLLING_WIDTH = Range(1.0, 6.0, "deg of the tip", ROLLS)
IDLER_WIDTH = Range(2.0, 9.0, "deg of the tip", CAPSTAN + MADE)
CAM_WIDTH = Range(0.8, 4.0, "deg of the tip", CAM)
STRIBECK = Range(0.005, 0.04, "of the friction, at most; and at most a quarter of the noise", LUGRE)

# The recording
MARKER_NOISE = Range(0.03, 0.15, "px", "asked")
ANGLE_NOISE = first.ANGLE_NOISE
NOISE_MEMORY = Range(0.05, 0.5, "correlation of neighbouring frames", MADE)
CAMERA_DELAY = Range(0.030, 0.150, "s", WEBCAM)
TAIL = 4.0  # degrees of freedom of Student's noise, where tails are heavy

# Causes that no list holds
LEAK = Range(0.0003, 0.12, "of the distance to rest, a second", SEEPAGE)
SQUARE = Range(0.002, 1.5, "of the width left behind at the usual speed", WATER)
DRAINED = Range(0.02, 0.9, "of the friction, where the film has drained", FILM)
PLOUGHED = Range(0.05, 0.9, "of the motion beyond the tissue that is taken away", PLOUGH)
HELD_THING = Range(0.02, 1.5, "of the width", GRASP)
SIDEWAYS = Range(0.02, 12.0, "deg of sideways lean for the usual speed gained at once", WHIRL)
CLIPPED = Range(0.02, 0.5, "of the range, out of reach of the log", CLIP)
STUCK = Range(0.02, 0.6, "of the width", BIT)
DEADBAND = Range(0.03, 1.5, "of the width", REPORT)
STALLS = Range(0.05, 0.8, "s", STALL)
CLOCK_STEP = Range(0.003, 0.12, "s", STEP_OF_CLOCK)
EXCHANGED = Range(0.005, 0.5, "of the frames", RING)
DARK = Range(0.002, 0.016, "s", LIGHT)
WET = Range(0.1, 15.0, "px at the drop's rim", DROP)
STABILISED = Range(0.003, 0.6, "of the fast motion", EIS)
REFLECTION = Range(0.003, 0.4, "share of the reflection in what is tracked", GHOST)
SKIPPED = Range(0.1, 8.0, "px that a block must move", SKIP)
BURSTS = Range(0.1, 25.0, "px rms within a burst", CAUTERY)

__all__ = ["MADE", "Range"]
