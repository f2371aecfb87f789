"""Ranges of this family, each with its source; those of listed effects are the first family's."""

from tools.family import ranges as first
from tools.family.ranges import LUGRE, MADE, WEBCAM, Range

# The healthy mechanism
SOFT = "Soft pneumatic actuators (Polygerinos et al. 2015; Gorissen et al. 2017) lose 2 to 15 %; widths " + MADE
TUBES = "Push-pull tubes (Oliver-Butler et al. 2021; Rox et al. 2020), friction of nitinol on nitinol; widths " + MADE
STACKS = "Leaf springs (SAE HS-788): friction of 2 to 12 % of the load; widths " + MADE
SLIDES = "Slides and Scotch yokes (Norton, Design of Machinery): 2 to 10 % lost; widths " + MADE
WEDGES = "Wedges and cams (Shigley): friction of 0.03 to 0.15, oiled; widths " + MADE
CAPSTANS = "Capstan drives (Baser and Konukseven 2010; Werkmeister and Slocum 2007); widths " + MADE
BELLOWS_WIDTH = Range(1.5, 8.0, "deg of the tip", SOFT)
SLEEVE_WIDTH = Range(1.5, 9.0, "deg of the tip", TUBES)
LEAVES_WIDTH = Range(1.0, 6.0, "deg of the tip", STACKS)
YOKE_WIDTH = Range(0.8, 4.0, "deg of the tip", SLIDES)
WEDGE_WIDTH = Range(0.8, 4.5, "deg of the tip", WEDGES)
CAPSTAN_WIDTH = Range(0.8, 4.0, "deg of the tip", CAPSTANS)

# The recording
MARKER_NOISE = Range(0.03, 0.15, "px", "asked")
ANGLE_NOISE = first.ANGLE_NOISE
NOISE_MEMORY = Range(0.05, 0.5, "correlation of neighbouring frames", MADE)
CAMERA_DELAY = Range(0.030, 0.150, "s", WEBCAM)

# Causes that no list holds
HUNTS = Range(0.05, 3.0, "of the width", "Integral action with stiction (Armstrong, Amin 1996): limit cycles; " + MADE)
TENSIONER = Range(0.03, 0.9, "of the friction", "Automatic belt and cable tensioners that hunt, 4 to 15 s; " + MADE)
RINGS = Range(0.03, 0.7, "of the step by which it overshoots", "Servo loops of low phase margin: 5 to 60 %, 1 to 5 Hz")
LEADS = Range(0.02, 1.5, "of the width", "Light guides and drapes dragged along (umbilicals of robots); " + MADE)
PLATEAU = Range(0.03, 2.5, "of the width", "Superelastic nitinol (Auricchio and Taylor 1997): loops from 1 % strain")
SUCKS = Range(0.01, 0.8, "of the way from where it was sucked on", "Suction on tissue (Vonck et al. 2010); " + MADE)
RATCHETS = Range(0.01, 1.5, "of the width in ten strokes", "Ratchetting and shakedown (Bree 1967); sizes " + MADE)
SPARSE = Range(0.05, 1.5, "s", "Loggers and bus gateways of 1 to 20 Hz, joined by lines; rounded outwards")
COUNTED = Range(0.005, 0.5, "s by which rows come to be off", "Rows stamped by number, lost on a busy bus; " + MADE)
WINDOW = Range(0.3, 32.0, "px", "Regions of interest of machine-vision sensors, moved in steps of 2 to 32 px")
GATE = Range(0.02, 0.95, "of the fastest motions that are refused", "Gates on innovations (Bar-Shalom 2001); " + MADE)
EYES = Range(0.3, 30.0, "px of disparity", "Stereo endoscopes of 4 to 6 mm base; rounded outwards")
PANS = Range(0.003, 0.5, "of the marker's way", "Camera assistants and tracking endoscope holders; " + MADE)
FOGS = Range(0.1, 12.0, "px", "Fogged laparoscopes, wiped each 8 to 25 s (Lawrentschuk et al. 2010); px " + MADE)
SLEWS = Range(0.002, 0.12, "s", "chrony slews by up to 8 %, ntpd by 0.05 %; sizes rounded outwards")
YIELDS = Range(0.03, 5.0, "deg", "Abdominal wall about ports, relaxing in 1 to 5 s (Fung 1993); deg " + MADE)
LABELS = Range(0.2, 25.0, "px", "Corners of square markers that swap labels; px " + MADE)
TEARS = Range(0.1, 3.0, "frames", "Screen capture without vertical synchronisation: up to two frames, rounded outwards")

__all__ = ["LUGRE", "MADE", "Range"]
