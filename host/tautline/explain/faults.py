"""What to look at when an axis has stopped, beside the line that the board's own header has for it (tl_wire.h)."""

from __future__ import annotations

LOOK = {
    "FOLLOWING": "The motor was sent somewhere and stayed behind. It happens at once where something blocks it, and "
    "at speed where supply or gains are too weak.",
    "CURRENT": "The mean current over 20 ms was above the limit. A blocked instrument, a short in the motor, or a "
    "limit that is too low.",
    "HOST_LOST": "The program that moved the axis went away or was too slow. The axis came to rest by itself.",
    "TABLE": "Both slots hold damaged tables, as after two cuts of power while writing.",
    "OVERRUN": "The control loop was late. It never is on a sound board: note what it did, and the counters.",
    "WATCHDOG": "The firmware hung; the board restarted with its motors off.",
    "STOPPED": "Somebody asked for it: an emergency stop, or a program that ended badly. There is nothing to mend.",
    "ENCODER": "Between two samples the position changed by more than any motor can. The position is not known any "
    "more.",
    "EDGES": "Both encoder lines changed at once. The position is not known any more.",
    "STALL": "Driven, and no motion for a while: the motor is blocked or has no power, or the encoder shows nothing.",
    "DRIVER": "The driver chip's own protection acted.",
    "SUPPLY": "Under load the supply sagged, or the fuse is gone.",
    "OSCILLATION": "The servo excited itself. Commissioning tunes it again: taut commission.",
    "REVERSED": "At low drive, before the loop was closed, the encoder counted the other way.",
    "SCALE": "The motor turned three times faster or slower than the gains say: another motor, gear or encoder than "
    "they are for.",
    "UNMOVED": "The check at low drive saw nothing: plug, supply, or something that blocks.",
    "NO_END": "Homing went its whole reach and nothing stopped it.",
    "GROUP": "The axes of a group hold one instrument between them, as antagonists do: none is driven while another "
    "has a fault. That one's own fault says what happened.",
    "ESTOP": "Somebody pressed the stop button, or its wire is broken where it is one that opens. The settings say "
    "how it is wired: 'taut commission --estop'.",
    "SETTINGS": "Both copies of the settings are damaged: the axis works with none.",
}
AFTER = "Then 'taut clear' and run the command again; 'taut home' where the position is not known any more."
