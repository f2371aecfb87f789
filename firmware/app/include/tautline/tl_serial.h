/// Serial side of the app: tl_wire.h's frames over a UART, for boards without USB. Stateless: a line has no bus, so
/// that a session begins with hello (tl_app_line), and tables travel in messages.
#ifndef TAUTLINE_TL_SERIAL_H
#define TAUTLINE_TL_SERIAL_H

#include "tautline/tl_app.h"

/// A UART as the port has it: TL_WIRE_SERIAL_BAUD where it can, 8 data bits, no parity, 1 stop bit, no flow control.
typedef struct {
    void *context;
    /// Takes at most `room` bytes that have come, without waiting; returns how many. Its buffer holds what comes while
    /// the task is busy: 256 bytes are 2.8 ms. While flash is written a host waits for the answer, and sends nothing.
    size_t (*read)(void *context, uint8_t *out, size_t room);
    /// Sends at most `size` bytes without waiting; returns how many it took.
    size_t (*write)(void *context, const uint8_t *bytes, size_t size);
} tl_serial_t;

/// Once per start of the board, after tl_app_init(). The line must outlive the app.
void tl_serial_init(tl_app_t *app, const tl_serial_t *line);

/// Moves bytes between the line and the app; whether there were any. Task; call as often as possible, at least every
/// millisecond.
bool tl_serial_task(void);

#endif
