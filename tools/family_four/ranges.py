"""Ranges of this family, each with its source; those of listed effects are the first family's."""

from tools.family import ranges as first
from tools.family.ranges import CABRAS, DVRK, LUGRE, MADE, WEBCAM, Range

BRAID = "Chou and Hannaford 1996; Tondu and Lopez 2000: hysteresis of 5 to 20 % of a muscle's force; widths " + MADE
NOTCH = (
    "York, Swaney et al. 2015, cable-driven notched tubes; Kutzer et al. 2011: degrees of hysteresis; widths " + MADE
)
PINS = "Slocum 1992: friction circles of pins; hand-held toggles lose 1 to 5 deg, " + MADE
CHANNEL = "Palli et al. 2012, Do et al. 2013: rods and cables in channels, 3 to 20 deg of the tip; widths " + MADE
CYCLOIDAL = "Makers' data: lost motion below 1 arcmin (industrial) to 1 deg; printed cycloidal drives 0.5 to 3 deg"
BELTS = "Gates and SKF design guides for toothed belts: elongation 0.1 to 0.5 %; bearing loss with tension; " + MADE
DITHER = "Dynamic friction under vibration (Armstrong 1994; Littmann 2001): reduced by 10 to 95 %"
PULSE = "Cardiac motion of tissue: 0.9 to 1.7 Hz, tenths of mm to mm (Ginhoux 2005); deg of the tip " + MADE
STICKY = "Johnson, Kendall, Roberts 1971; mucosal adhesion of some 10 mN to N; pull-off lengths " + MADE
CLUTCH = "Slip of capstan, clamp and clutch under high load (Euler); share lost " + MADE
ROLL = "Torsional snapping of curved tubes (Dupont 2010): degrees; strengths " + MADE
SQUASH = "Camarillo et al. 2008: backbones shorten by 0.1 to 5 % under cable tension"
TWIST = "Out-of-plane bending of continuum sections: 1 to 10 deg over the range (Webster and Jones 2010); " + MADE
ROLLERS = "Roller-driven insertion of endoscopes and catheters slips by 1 to 20 %; rounded outwards"
AVERAGE = "Moving averages of drives' position output, 10 to 400 ms (EtherCAT and CAN drive manuals)"
TICKS = "Timer ticks of operating systems: 10 and 15.6 ms; PLC cycles to 100 ms"
ZOOM = "Zoom creep of lenses under gravity: 0.1 to 5 % of the focal length over minutes; " + MADE
HIDDEN = "Partial occlusion of a disc moves its centroid by up to its radius; sizes of edges " + MADE
BLEND = "Frame-rate conversion by blending (25 to 30, 24 to 30 Hz); weights 0.05 to 0.5"
DROPS = "Constant-rate writers (OpenCV VideoWriter, AVI) that lose 0.1 to 10 % of frames without a mark"
FILLING = "Ring buffers that fill and are flushed: latency climbs by 1 to 10 frames (GStreamer queue, V4L2)"
FAN = "Fans of 1200 to 3000 rpm on a camera's stand: 20 to 50 Hz, micrometres to tenths of mm; px " + MADE
HAZE = "Refraction by warm air, vapour and smoke: wander of tenths of px to px, 0.3 to 4 s"

# The healthy mechanism
BRAID_WIDTH = Range(1.0, 6.0, "deg of the tip", BRAID)
SELF_WIDTH = Range(1.5, 8.0, "deg of the tip", NOTCH)
PIN_WIDTH = Range(0.8, 4.0, "deg of the tip", PINS)
CHANNEL_WIDTH = Range(2.5, 9.0, "deg of the tip", CHANNEL)
CYCLOID_WIDTH = Range(0.8, 4.5, "deg of the tip", CYCLOIDAL)
BELT_WIDTH = Range(0.8, 4.5, "deg of the tip", BELTS)
STRIBECK = Range(0.005, 0.05, "of the friction, at most; and at most a tenth of the noise", LUGRE)

# The recording
MARKER_NOISE = Range(0.03, 0.15, "px", "asked")
ANGLE_NOISE = first.ANGLE_NOISE
NOISE_MEMORY = Range(0.05, 0.5, "correlation of neighbouring frames", MADE)
CAMERA_DELAY = Range(0.030, 0.150, "s", WEBCAM)

# Causes that no list holds
FREED = Range(0.05, 0.95, "of the friction while it vibrates", DITHER)
HEART = Range(0.01, 4.0, "deg of the tip at the beat's peak", PULSE)
PRESSED = Range(0.03, 3.0, "of the friction, per full stroke of the other joint", DVRK + "; sheaths; " + MADE)
ADHERES = Range(0.03, 3.0, "deg of the tip held back", STICKY)
SLIPS = Range(0.003, 0.4, "of the motor's way beyond the threshold", CLUTCH)
SNAPS = Range(0.05, 25.0, "deg of roll", ROLL)
SHORTENS = Range(0.01, 2.5, "mm of length for the full pull and friction", SQUASH)
TWISTS = Range(0.1, 25.0, "deg of plane at the range's end", TWIST)
ROLL_PLAY = Range(0.1, 12.0, "deg of play in the rotation", CABRAS)
FEED = Range(0.005, 0.3, "of the translation", ROLLERS)
AVERAGED = Range(0.02, 0.8, "s", AVERAGE)
TICK = Range(0.008, 0.2, "s", TICKS)
ZOOMS = Range(0.0003, 0.06, "of the focal length in 100 s", ZOOM)
CUT_OFF = Range(0.2, 12.0, "px of radius of the marker", HIDDEN)
BLENDED = Range(0.05, 0.95, "weight of the frame before", BLEND)
LOST = Range(0.001, 0.1, "of the frames", DROPS)
FILLS = Range(0.006, 0.3, "s of latency before it is flushed", FILLING)
SHAKES = Range(0.08, 6.0, "px", FAN)
WANDERS = Range(0.08, 10.0, "px rms", HAZE)

__all__ = ["MADE", "Range"]
