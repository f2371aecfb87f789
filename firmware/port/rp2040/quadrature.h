/// Four quadrature encoders on PIO 0, counted in the state machines: nothing is lost while the core is busy.
#ifndef TAUTLINE_RP2040_QUADRATURE_H
#define TAUTLINE_RP2040_QUADRATURE_H

#include "hardware/pio.h"

#include <stdbool.h>
#include <stdint.h>

/// Starts state machine i on pins `pins_a[i]` and the one above, for `axes` of them (1 to 4), with pull-ups on and the
/// counts at 0. Waits 0.5 ms for the pull-ups: an open-collector encoder's lines rise slowly, and are no edges. Once,
/// before anything else uses PIO 0.
void quadrature_init(const uint8_t *pins_a, unsigned axes);

/// Edges counted since the start, up while B leads A (forward, on Pimoroni's motors); wraps at 2^32. From any context,
/// about 40 cycles; inline, as calls would cost a tick of four axes 48 more.
static inline int32_t quadrature_count(unsigned axis) {
    // Changing the join empties the FIFO: what comes next is at most a round old.
    hw_xor_bits(&pio0->sm[axis].shiftctrl, PIO_SM0_SHIFTCTRL_FJOIN_RX_BITS);
    hw_xor_bits(&pio0->sm[axis].shiftctrl, PIO_SM0_SHIFTCTRL_FJOIN_RX_BITS);
    const uint32_t empty = 1u << (PIO_FSTAT_RXEMPTY_LSB + axis);
    while (pio0->fstat & empty) {
    }
    return (int32_t)pio0->rxf[axis];
}

/// Whether an edge was lost since the last call: A and B changed within one round (90 ns), and it was no glitch of less
/// than 1.2 us.
bool quadrature_slipped(unsigned axis);

#endif
