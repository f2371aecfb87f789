/// Four H-bridges (DRV8833) on PWM, and their currents over the board's one multiplexed ADC input.
#ifndef TAUTLINE_RP2040_BRIDGE_H
#define TAUTLINE_RP2040_BRIDGE_H

#include <stdint.h>

#include "tautline/tl_fixed.h"

/// All bridges off (coasting), PWM running at 25 kHz, ADC ready.
void bridge_init(void);

/// Drives axis 0 to 3: slow decay, so that the motor's voltage is proportional to `duty` (saturated at +-32768); 0 brakes.
/// The time that the bridge takes to switch over (450 ns) is added, so that small duties act. About 40 cycles.
void bridge_drive(unsigned axis, tl_duty_q15_t duty);

/// Both sides low: the motor is free and draws nothing. This is also the state after any reset.
void bridge_coast(unsigned axis);

/// Starts measuring a current; once per control tick. The multiplexer was set a tick ago and has settled.
void bridge_sense_start(void);

/// The result, at least 2 us after bridge_sense_start: stores the axis (each in turn) and returns its current averaged
/// over a PWM period by the board's filter, in mA as drawn from the supply, 0 to about 2000.
int32_t bridge_sense_finish(unsigned *axis);

#endif
