"""The CSV files that are read and written: what their columns are called and what they hold."""

from __future__ import annotations

from tautline.schema import Column, Layout

_VALID = Column("valid", "1, or 0 where the row shows nothing that counts; without the column every finite row counts")

MOTOR = Layout(
    "motor.csv",
    "The motor's encoder, 10 Hz to 10 kHz, as it was read: nothing filtered, nothing resampled. Further columns "
    "NAME_deg or NAME_mm are other joints that may couple in.",
    (
        Column("t_s", "s: when the encoder was read, rising, on the clock of the other files", needed=True),
        Column("q_{unit}", "mm or deg, the rig's unit: the bending motor's position", needed=True),
        Column("q_cmd_{unit}", "mm or deg: where the motor was sent"),
        Column("translation_mm", "mm: the instrument along the base z axis; without it 0"),
        Column("rotation_deg", "deg: the instrument about the base z axis; without it 0"),
        Column("load_mNm", "mNm: the load on the motor; what depends on load is only seen with it"),
    ),
)
MARKER = Layout(
    "marker.csv",
    "Where the marker was seen, a row for each frame, lost ones too.",
    (
        Column("t_s", "s: when the frame arrived, which is the camera's delay after what it shows", needed=True),
        Column(
            "u_px",
            "px: the marker's centre from the left, the first pixel's centre is 0; empty where lost",
            needed=True,
        ),
        Column("v_px", "px: the same from the top", needed=True),
        _VALID,
        Column("sigma_px", "px: the tracker's own standard deviation per coordinate, above 0"),
        Column("width_px", "px: what the frames measure; compared with the rig's camera"),
        Column("height_px", "px: the same"),
    ),
)
ANGLE = Layout(
    "angle.csv",
    "What an external sensor says of the bending angle.",
    (
        Column("t_s", "s: when the value arrived", needed=True),
        Column("c_deg", "deg: the bending angle", needed=True),
        _VALID,
    ),
)
FRAMES = Layout(
    "frames.csv",
    "Beside a video: when each of its frames arrived.",
    (
        Column("frame", "which one, from 0, rising", needed=True),
        Column("t_s", "s: when it arrived, on motor.csv's clock", needed=True),
    ),
)
TRAJECTORY = Layout(
    "trajectory.csv",
    "What the tip is asked for (--trajectory), straight between its rows.",
    (
        Column("t_s", "s: when, rising", needed=True),
        Column("c_deg", "deg: the bending angle then", needed=True),
    ),
)
LAYOUTS = (MOTOR, MARKER, ANGLE, FRAMES, TRAJECTORY)
