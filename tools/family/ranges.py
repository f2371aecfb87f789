"""Ranges of every strength and time constant, each with the source that it is taken from.

A range is what the source's values span, rounded outwards. `made` marks what no source gives: it is this family's own
choice and says so. Weak causes may go below `lo` (a small eccentricity is always possible), never above `hi`.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Range:
    lo: float
    hi: float
    unit: str
    source: str

    def draw(self, rng: np.random.Generator) -> float:
        """Log-uniform where the range is positive, else uniform."""
        if self.lo > 0:
            return float(np.exp(rng.uniform(np.log(self.lo), np.log(self.hi))))
        return float(rng.uniform(self.lo, self.hi))


AGRAWAL = "Agrawal, Peine, Yao 2010 (T-RO), closed-loop tendon-sheath transmission, distributed Coulomb friction"
PALLI = "Palli, Borghesan, Melchiorri 2012 (T-RO), tendon-based transmission with sheaths"
DO = "Do, Tjahjowidodo, Lau, Phee 2013-2015, dynamic friction and Bouc-Wen models of tendon sheaths"
BARDOU = "Bardou et al. 2012 (BioRob) and Reilink et al. 2013, hysteresis of flexible endoscopes, 5 to 30 deg"
XSERIES = "Robotis e-Manual, X series: 4096 counts per turn (0.088 deg), backlash 0.25 deg without load"
AMS = "ams AS5045/AS5048/AS5600 data sheets: integral non-linearity 0.4 to 1.4 deg, more with a magnet off centre"
DVRK = (
    "Hwang et al. 2020 (RA-L), calibrating cable-driven surgical robots: wrist errors of some degrees, coupled joints"
)
MIYASAKA = "Miyasaka et al. 2016, hysteresis model of longitudinally loaded cables (Bouc-Wen), Raven II"
CHOI = "Choi and Park 2018 (Microsyst. Technol.), elongation, creep and recovery of polymer cables"
LUGRE = "Canudas de Wit et al. 1995; Armstrong 1994: breakaway 1.2 to 2 times kinetic friction, Stribeck 0.1 to 10 mm/s"
DIETERICH = (
    "Dieterich 1978, rate and state friction: 1 to 10 % of strength for each decade of rest or speed, more for polymers"
)
WEBCAM = "dVRK video latency tool; measurements of USB cameras: 30 to 150 ms with 2 to 15 ms scatter"
WEBSTER = "Webster and Jones 2010 (IJRR), constant curvature and where it fails: friction, gravity, shear"
CABRAS = "Cabras et al. 2017, registration of instruments in endoscope channels: play of degrees and tenths of mm"
ENDOSCOPE = "Barrel distortion of endoscopes, k1 of -0.05 to -0.4 in OpenCV's model, as camera calibrations print it"
CRYSTAL = (
    "Quartz data sheets: 20 to 100 ppm; USB cameras that free-run on an RC oscillator or a wrong nominal rate: to 0.3 %"
)
RESPIRATION = "Respiratory motion in the abdomen: 0.2 to 0.35 Hz, millimetres"
ROLLING = "Rolling-shutter CMOS sensors: read-out of 10 to 33 ms"
MULLINS = "Diani, Fayolle, Gilormini 2009, Mullins effect: stress softening of 5 to 40 % up to the largest strain"
MADE = "this family's own choice"

# The healthy mechanism
WRAP = Range(1.6, 9.4, "rad of sheath bend", AGRAWAL)
MU = Range(0.04, 0.17, "Coulomb coefficient, lined or bare sheath", AGRAWAL + "; " + PALLI)
FLEXIBLE_WIDTH = Range(3.0, 30.0, "deg of the tip", BARDOU)
WRIST_WIDTH = Range(1.0, 8.0, "deg of the tip", DVRK)
SERVO_WIDTH = Range(0.5, 6.0, "deg of the tip", XSERIES + "; linkage pins added")
BENDING = Range(8.0, 18.0, "deg of the tip for each mm of cable", BARDOU)

# The recording
MARKER_NOISE = Range(0.03, 0.10, "px", "asked")
ANGLE_NOISE = Range(0.01, 0.10, "deg", "asked; electromagnetic and magnetic sensors")
NOISE_MEMORY = Range(0.05, 0.40, "correlation of neighbouring frames", MADE)
CAMERA_DELAY = Range(0.030, 0.150, "s", WEBCAM)

# Causes that formats.md lists
ENCODER = Range(0.0004, 0.006, "share of a turn", AMS)
ROUNDING = Range(0.03, 0.8, "of the width", DO + "; " + MIYASAKA)
BREAKAWAY = Range(0.05, 0.9, "above kinetic friction, one way", LUGRE)
CATCH_UP = Range(0.1, 0.5, "of the width, travel of the tip", LUGRE)
RATE = Range(0.02, 0.35, "of the friction for each e-fold of speed", DIETERICH + "; polymer liners")
RATE_SPEED = Range(0.05, 0.3, "of the usual speed", LUGRE)
LAG = Range(0.008, 0.25, "s", DO)
CREEP = Range(0.003, 0.12, "of the motion", CHOI)
CREEP_TIME = Range(2.0, 40.0, "s", CHOI)
JUMP = Range(0.01, 0.30, "of the width", LUGRE)
DRIFT = Range(0.02, 0.5, "of the width in 100 s", CHOI + "; " + PALLI)
LOAD = Range(0.02, 0.6, "of the width at full load", PALLI)
COUPLING = Range(0.005, 0.3, "of the width for the other joint's stroke", DVRK)
WALL = Range(
    0.05,
    0.95,
    "of the motion beyond the wall that is taken away",
    "soft to stiff tissue against a bending section; " + MADE,
)
CURVATURE = Range(0.03, 0.7, "relative slope of curvature along the section", WEBSTER)
REGISTRATION = Range(0.05, 5.0, "deg", CABRAS)
CHANNEL_PLAY = Range(0.03, 2.0, "deg", CABRAS)
DISTORTION = Range(0.005, 0.4, "k1", ENDOSCOPE)
DELAY = Range(0.003, 0.08, "s", WEBCAM)
JITTER = Range(0.0015, 0.02, "s", WEBCAM)
WIDTH_CHANGE = Range(0.02, 0.6, "of the width", BARDOU + "; the same endoscope in another posture")
OFFSET_CHANGE = Range(0.02, 1.0, "of the width", BARDOU)
LAW_CHANGE = Range(0.005, 0.15, "of the gain", BARDOU)
TOOTH = Range(0.03, 1.0, "of the width", "belt tooth, cable winding or lost counts; " + MADE)
SWING_RATE = Range(1.2, 6.0, "Hz", "light tips on slender sections; " + MADE)
SWING_DAMPING = Range(0.01, 0.08, "damping ratio", "light tips on slender sections; " + MADE)
SWING = Range(0.02, 1.0, "share of the motion that swings", MADE)
HELD = Range(0.01, 0.4, "share of frames", WEBCAM)
CLOCK = Range(0.0002, 0.004, "relative rate", CRYSTAL)

# Causes that no list holds and that a source bounds; the others stand beside their cause
READ_OUT = Range(0.010, 0.033, "s", ROLLING)
BREATHS = Range(0.2, 0.35, "Hz", RESPIRATION)
SOFTENING = Range(0.01, 0.4, "of the motion", MULLINS)
AGEING = Range(0.02, 0.6, "of the friction for each e-fold of rest", DIETERICH + "; polymer liners")
