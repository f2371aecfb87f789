/// Four quadrature encoders on PIO 0, counted in the state machines: nothing is lost while the core is busy.
#ifndef TAUTLINE_RP2040_QUADRATURE_H
#define TAUTLINE_RP2040_QUADRATURE_H

#include <stdbool.h>
#include <stdint.h>

/// Starts state machine `axis` (0 to 3) on pins `pin_a` and `pin_a + 1`, with the count at 0 and pull-ups on.
/// Once per axis, before anything else uses PIO 0.
void quadrature_init(unsigned axis, unsigned pin_a);

/// Edges counted since the start, up while B leads A (forward, on Pimoroni's motors); wraps at 2^32. From any context,
/// about 40 cycles.
int32_t quadrature_count(unsigned axis);

/// Whether an edge was lost (A and B changed within one round, 80 ns) since the last call.
bool quadrature_slipped(unsigned axis);

#endif
