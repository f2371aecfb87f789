"""Why the measurements saw a conditional branch going one way only: the budget fails where no reason is given here.

A branch is told by the source line that it comes from, so that another compiler's layout changes nothing; a reason
covers so many branches of its line, and one that covers none any more does no harm.
"""

from __future__ import annotations

import linecache
import re
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Reason:
    """`count` branches of a line of `file` that contains `line`."""

    file: str
    line: str
    count: int
    why: str


_HIGH = "64-bit compare: the high words of two near times differ once in 71 minutes"
_LOW = "64-bit compare: the low words decide only where the high ones are equal"
_NEAR = "64-bit compare: the high words of squared distances say nothing within 256 px"
_SIGN = "the sign of a real number is in its high word"
_LEVEL = "sums of squares: 0 only where the image, or the motor, stands still to the last bit"
_ANEW = "within 60 ms a take-up hardly ends, p rests and goes on the same way: seldom"
_FAR = "positions within 4 M counts and images within 4096 px: no difference saturates"

REASONS = (
    # -- the control step
    Reason("tl_axis_step.c", "while (job < TL_AXIS_JOBS)", 1, "at 5 kHz each tick of a millisecond has a job"),
    Reason("tl_servo.h", "servo->velocity = tl_clamp(", 2,
           "the copy for a motor that is off; driven it went both ways"),
    Reason("tl_axis_rest.c", "const bool blind =", 2, "no encoder is lost while it is measured: tests/c/test_safety.c"),
    Reason("tl_path.h", "return path->speed == 0 &&", 1, "at its target at speed 0 a path has ended its last bend"),
    Reason("tl_reference.c", "velocity = up ? (before > a", 1,
           "a target at the range's end that moves within the tick in which the reference starts: seldom"),
    Reason("tl_reference.c", "if (speed > a ? stopping(", 1,
           "slower than a tick's acceleration it ends at the target, in the range, or beyond one that moves: seldom"),
    Reason("tl_reference.c", "return (speed + a) >> 8 > distance_q16", 1,
           "a target that jumps to beside the reference, which has just turned: seldom"),
    Reason("tl_reference.c", "return speed > a ? speed - a : 0;", 2,
           "slower than a tick's acceleration and yet too fast for the way left: seldom"),
    Reason("tl_reference.c", "room_q16 = tl_clamp(room, -FAR, FAR)", 3,
           "room is not negative: the range was widened to where the reference began"),
    Reason("tl_feed.h", "return ahead > k->band || ahead < -k->band;", 2,
           "where the side is known p lies behind its furthest point, and the band is not negative"),
    Reason("tl_lookup.c", "(int32_t)tl_scale(away < end->", 2,
           "Y goes on for eight widths and more, and the motor is never so far beyond the grid"),
    Reason("tl_lookup.c", "if (beyond == 0)", 1, "the copy for p beyond the last node: on it to the last bit, seldom"),
    Reason("tl_several.c", "} else if (k->side == 0 || k->p != k->anchor) {", 1,
           "before the first motion, or turned back by less than the band: seldom in a millisecond that moves p"),
    Reason("tl_several.c", "const tl_count_q8_t before = tl_clamp(", 2,
           "p is within the range, and an end of it nearer than the plays' offset: seldom"),
    Reason("tl_several.c", "const tl_count_q8_t after = tl_clamp(", 2,
           "p is within the range, and an end of it nearer than the plays' offset: seldom"),
    Reason("tl_fixed.h", "tl_mul_high(x, ratio.mantissa) >> -ratio.shift", 1,
           "beyond the grid: of Y's unit and Q8 counts the same one is the finer in all these tables"),
    Reason("tl_elements.c", "moved = tl_clamp(moved", 2, "the instrument moves by less than a period in a millisecond"),
    Reason("tl_elements.c", "while (++element < end)", 1, "a table of several plays has two or more"),
    Reason("tl_elements.h", "span = p < lookup->q0 ? 0U", 2,
           "p* is kept within [q_min, q_max], which lies on the grid"),
    Reason("tl_lookup.h", "if (offset >= lookup->extent)", 2,
           "p* lies on the grid: only at its very end, or where the motor began outside"),
    Reason("tl_lookup.c", "if (p < lookup->q0)", 1, "p* is kept within [q_min, q_max], which lies on the grid"),
    Reason("tl_ratio.h", "return bits <= TL_RATIO_BITS", 1,
           "more than 20 bits has only a span longer than 4096 counts: one grid in thirty"),
    Reason("tl_takeup.c", "if (takeup->ahead_q36 < takeup->accel_q36)", 2, _LOW),
    Reason("tl_takeup.c", "if (spare < 0 || takeup->limits_pending)", 2,
           "a table changes only while the motor is off, and limits are taken over at rest"),
    # -- what is undone beside play and curve
    Reason("tl_ratio.h", "if (x >> 16 != 0U)", 2, "a step of a small table is one of 256"),
    Reason("tl_ratio.h", "if (x >> 8 != 0U)", 2, "the same"),
    Reason("tl_ratio.h", "if (x >> 4 != 0U)", 1, "the copy of the control step sees four bits and more"),
    Reason("tl_ratio.h", "return bits + (x >= 8U", 3, "the same: what is left of four bits is seldom all of them"),
    Reason("tl_lookup.h", "if (offset >= lookup->extent)", 1, "p* lies on the grid, whose end has no span: seldom"),
    Reason("tl_fixed.h", "if (overflow >> 31)", 3, _FAR),
    Reason("tl_undo.c", "if (high >> (right - 2U) == 0)", 1, "what sections may say is small enough"),
    Reason("tl_undo.c", "return (a ^ b) < 0 ?", 1, "a width has no sign"),
    Reason("tl_undo.c", "return tl_lerp(values[node]", 1, "a step of a small table beyond 256 counts: seldom"),
    Reason("tl_undo.c", "const int32_t moves = tl_clamp(carried", 2, "axes within 65 000 counts"),
    Reason("tl_undo.c", "undo->before = tl_clamp(before", 2, "axes that move the motor by less than 65 000 counts"),
    Reason("tl_undo.c", "const int32_t more = tl_clamp(undo->caught", 1, "no side falls by 64 counts in a millisecond"),
    Reason("tl_undo.c", "const int32_t grown_q12 = tl_clamp(", 1, "B changes by less than that in a millisecond"),
    Reason("tl_undo.c", "undo->turned_at = tl_clamp(", 2, "it stays near p"),
    Reason("tl_undo.c", "return tl_clamp((int32_t)sum", 2, "a lead is at most 2^28"),
    Reason("tl_undo.c", "const int32_t most = f->most, rest", 1, "the copy for a short one: seldom beyond it"),
    Reason("tl_undo.c", "undo->side != sides->side || undo->side == 0", 1, "a table with sides names one"),
    Reason("tl_undo.c", "const int32_t off = tl_clamp(by", 2, "p* is slower than four million counts a second"),
    Reason("tl_feed.h", "return k->p + (k->side > 0 ?", 2, "the copies behind a turn: there the side is known"),
    Reason("tl_feed.h", "return tl_clamp(pushed(k, half)", 1, "the copy of the sections: beyond the range, seldom"),
    Reason("tl_takeup.h", "const int64_t jump = ", 1, "the copy of the sections: one way at a turn that is not over"),
    Reason("tl_undoing.c", "const tl_count_q8_t low = last", 1, "the motor was last sent beyond the range: seldom"),
    Reason("tl_undo.c", "if (HAS(lookup, pressed))", 1, "tables that are measured have it: without, it is shorter"),
    Reason("tl_undo.c", "const int32_t ahead = half", 1, "w's growth is clamped: B changes by less in a millisecond"),
    Reason("tl_feed.h", "if (p > k->high)", 1, "the copy of the sections: p beyond the range at the upper end, seldom"),
    Reason("tl_feed.h", "next = p + tl_clamp(goal - p", 1, "the copy of the sections: seldom on both sides"),
    Reason("tl_feed.h", "return ahead > k->band || ahead < -k->band;", 2, "their copy: as in the other"),
    Reason("tl_undoing.c", "if (turns || anew)", 1, _ANEW),
    Reason("tl_undoing.c", "if (begins(k, anchor", 1, _ANEW),
    Reason("tl_undoing.c", "return k->reading = tl_clamp", 1, "met by the encoder's error or another axis alone"),
    # -- the calibration motion
    Reason("tl_motion.c", "if (!is_forward(m))", 1, "a tick ends forward legs only; tl_motion_onset() ends the others"),
    Reason("tl_motion.c", "return goes_back(m) ? low_end(m)", 2,
           "a forward leg rises exactly where its pass does not go back"),
    Reason("tl_motion.c", "m->direction = target < m->position", 5,
           "the second leg of the preparation leads down; every other is longer than a count, the high word's unit"),
    Reason("tl_motion.c", "if (speed_up(m, cap)", 2,
           "speeds have no sign; at rest there is room for a tick's acceleration, or the tick before has landed"),
    Reason("tl_motion.c", "m->speed = larger(m->speed - m->acceleration, 0);", 1,
           "slower than a tick's acceleration it keeps its speed, or lands"),
    # -- the onset update
    Reason("tl_history.c", "while (count != history->count)", 1, "nothing interrupts the reader here"),
    Reason("tl_history.c", "if (kept == 0 || t_us > grid_us)", 2, _HIGH),
    Reason("tl_history.c", "if (grid_us - t_us > ", 2, _HIGH),
    Reason("tl_fixed.h", "if (overflow >> 31)", 2, _FAR),
    Reason("tl_onset.c", "return tl_abs_sat(tl_sub_sat(a, b));", 1, _FAR),
    Reason("tl_onset.c", "r->direction > 0 ? tl_add_sat(r->q1, knot)", 1, _FAR),
    Reason("tl_onset.c", "if (scene_us > known_us + d->config.lost_us)", 1, _HIGH),
    Reason("tl_onset.c", "if (scene_us > d->reversal.turn_us + d->config.timeout_us)", 1, _HIGH),
    Reason("tl_onset.c", "while (d->scanned_us + TL_HISTORY_STEP_US <= until_us)", 1, _HIGH),
    Reason("tl_onset.c", "if (marker->arrival_us <= d->arrival_us)", 1, _HIGH),
    Reason("tl_onset.c", "way * 8000000 <", 2, _LOW),
    Reason("tl_onset.c", "if (tl_hinge_meet(&d->approach, &d->all", 1,
           "the tip was on an envelope: an approach of three frames that did not move at all has no noise either"),
    Reason("tl_onset.c", "d->approach.n >= 3)", 1,
           "the tip was on an envelope and yet hardly seen before the turn: seldom"),
    Reason("tl_onset.c", "d->approach.n < 3 || level->n", 2, "an end whose line or level has hardly a frame: seldom"),
    Reason("tl_onset.c", "return off > OUTLIER * OUTLIER * variance", 1, _LOW),
    Reason("tl_onset.c", "if (cleared) {", 1, _NEAR),
    Reason("tl_onset.c", "!cleared && is_outlier", 1, _NEAR),
    Reason("tl_onset.c", "const bool fitted = ", 1, "after a glance that passed the fit has its samples"),
    Reason("tl_onset.c", "if (seen > 0)", 2, _SIGN),
    Reason("tl_onset.c", "first > 0 ? first - 1 : 0);", 1, "beyond a knot lie at most all samples but one"),
    Reason("tl_onset.c", "way_us = gap > 0 && way > 0", 3,
           "of 32-bit positions the high words say no more than the sign"),
    Reason("tl_onset.c", "residual = residual > 0 ? residual", 3, _LEVEL),
    Reason("tl_onset.c", "return weight < 1 ? 1 : (weight > 64", 2, "the quotient is below 2^31"),
    Reason("tl_onset.c", "d->known = d->known == 0 ? 1 : 2;", 1, "the copy where something is known"),
    Reason("tl_onset.c", "if (d->reversal.frames < UINT16_MAX)", 1, "eleven minutes of frames at 100 Hz"),
    Reason("tl_real.c", "if (a <= 0)", 2, _SIGN),
    Reason("tl_real.c", "if (e > 0) {", 1, "beyond 32 bits it saturates: only wild settings make such a number"),
    Reason("tl_real.c", "half = e < 0 ?", 1, "a number that has 31 bits before the point: seldom"),
    Reason("tl_confirm.c", "while (d->noise_dof > DOF_MAX)", 1, "a reversal adds less than DOF_MAX: halved once"),
    Reason("tl_confirm.c", "if (!tl_hinge_break(d, &jump))", 1, "a confirmed hinge has three samples beyond a knot"),
    Reason("tl_confirm.c", "if (d->held < d->config.frames_min || dof < 1)", 1,
           "three samples leave a degree of freedom"),
    Reason("tl_confirm.c", "return tl_real_less(e->variance, wide)", 1,
           "a likelihood narrower than its parabola where two sigma reach over a frame: seldom"),
    Reason("tl_hinge.c", "tl_real(cxx > 0 ? cxx : 0, 0)", 1, _LEVEL),
    Reason("tl_hinge.c", ".x = tl_clamp(travel(", 2, "tl_hinge_scale() makes travels fit"),
    Reason("tl_hinge.c", "return scatter > 0 ? scatter", 2, _LEVEL),
    Reason("tl_hinge.c", "if (level->n < 1 || line->n < 2", 2, "its callers have a level and a line"),
    Reason("tl_hinge.c", "quotient(beyond->xx, determinant > 0", 1, _LEVEL),
    Reason("tl_hinge.c", "fit->residual = fit->residual > 0", 1, _LEVEL),
    Reason("tl_hinge.c", "if (gain.denominator != 0 &&", 1, _LEVEL),
)  # fmt: skip

# Inlined in many places: the line that asks for them says more.
_HELPERS = {"tl_clamp", "tl_add_sat", "tl_sub_sat", "tl_abs_sat", "smaller", "larger"}


def lines_of(elf: Path, addresses: Sequence[int]) -> dict[int, tuple[str, int]]:
    """Address -> file and line of the source that it comes from, through inlined helpers."""
    if not addresses:
        return {}
    command = ["arm-none-eabi-addr2line", "-i", "-f", "-a", "-e", str(elf), *map(hex, addresses)]
    lines: dict[int, list[tuple[str, str]]] = {}
    at = 0
    output = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
    while output:
        first = output.pop(0)
        if first.startswith("0x"):
            at = int(first, 16)
            lines[at] = []
        else:
            lines[at].append((first, output.pop(0)))
    places = {}
    for address, frames in lines.items():
        place = next((place for name, place in frames if name not in _HELPERS), frames[0][1])
        file, line = place.split(" ")[0].rsplit(":", 1)
        places[address] = (re.sub(r"^.*/\./|^\./", "", file), int(line) if line.isdigit() else 0)
    return places


def unexplained(elf: Path, addresses: Sequence[int]) -> dict[int, str]:
    """Of these branches those that no reason covers: address -> file, line and its text."""
    left = {reason: reason.count for reason in REASONS}
    missing = {}
    for address, (file, line) in lines_of(elf, addresses).items():
        text = linecache.getline(str(ROOT / file), line).strip()
        name = Path(file).name
        reason = next((r for r in REASONS if r.file == name and r.line in text and left[r] > 0), None)
        if reason is None:
            missing[address] = f"{file}:{line}: {text}"
        else:
            left[reason] -= 1
    return missing
