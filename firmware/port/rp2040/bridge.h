/// Four H-bridges (DRV8833) on PWM; their currents, supply and fault line over the board's one multiplexed ADC input.
#ifndef TAUTLINE_RP2040_BRIDGE_H
#define TAUTLINE_RP2040_BRIDGE_H

#include <stdint.h>

#include "tautline/tl_fixed.h"

/// All bridges off (coasting), PWM running at 20 kHz, ADC ready.
void bridge_init(void);

/// Stops the PWM and sets its phase: bridge_sense_start() is going to be called `ticks` of the system clock after it
/// goes on, and then every multiple of 50 us, and meets the end of a period, when a bridge that drives at all is
/// driving. Returns what pwm_set_mask_enabled() takes to let it go on: that write is all that has to be in time.
uint32_t bridge_align(uint32_t ticks);

/// Drives axis 0 to 3: slow decay, so that the motor's voltage is proportional to `duty` (saturated at +-32768); 0
/// brakes. The time that the bridge takes to switch over (450 ns) is added, so that small duties act. About 40 cycles.
void bridge_drive(unsigned axis, tl_duty_q15_t duty);

/// All bridges off at once, the motors free: whatever the PWM does, until the next reset. Needs neither flash nor
/// interrupts.
void bridge_coast_all(void);

/// Starts measuring a current; once per control tick. The multiplexer was set a tick ago and has settled.
void bridge_sense_start(void);

/// What is measured in turn: axes 0 to 3, and these.
enum { BRIDGE_SUPPLY = 4, BRIDGE_FAULT = 5 };

/// The result, at least 2 us after bridge_sense_start: stores what it is of and returns the size of a motor's current,
/// mA, 0 to 7000, each 1 kHz; the motors' supply, mV, 500 Hz; whether a driver reports a fault, 500 Hz. The DRV8833
/// limits the current at 425 by chopping, at about 50 kHz: the most of up to four samples 3 us apart is taken (as many
/// as the FIFO holds: eight on an RP2350), so that a blocked motor does not look like one without current where the
/// first sample meets the chopper's pause. The bridge drives at the first one: 0 below a duty of 4 %.
int32_t bridge_sense_finish(unsigned *what);

#endif
