/// A UART: what comes is taken by its interrupt into a buffer, what goes is written as far as there is room.
#ifndef TAUTLINE_MPS2_UART_H
#define TAUTLINE_MPS2_UART_H

#include <stdbool.h>
#include <stddef.h>

#include "mps2.h"

#define UART_BUFFER 4096U

typedef struct {
    mps2_uart_t *port;
    volatile uint32_t head; ///< bytes that have come, written by the interrupt alone
    uint32_t tail;          ///< bytes that were taken
    bool waits;             ///< there was no room for all that was written last
    uint8_t bytes[UART_BUFFER];
} uart_t;

void uart_init(uart_t *uart, mps2_uart_t *port, uint32_t baud);
/// For the interrupt of its receiver: how many bytes there were. What finds no room is lost: a frame that is not whole.
uint32_t uart_interrupt(uart_t *uart);
/// At most `room` bytes that have come; returns how many.
size_t uart_read(uart_t *uart, uint8_t *out, size_t room);
/// As many of the bytes as there is room for; returns how many. Where that is not all, an interrupt of the transmitter
/// tells when there is room again.
size_t uart_write(uart_t *uart, const uint8_t *bytes, size_t size);
/// For the interrupt of its transmitter.
void uart_has_sent(uart_t *uart);

static inline bool uart_has(const uart_t *uart) {
    return uart->head != uart->tail;
}

/// With interrupts off: nothing is there to be read, and what waits to be written waits for an interrupt.
static inline bool uart_rests(const uart_t *uart) {
    return !uart_has(uart) && (!uart->waits || (uart->port->state & UART_TX_FULL) != 0);
}

#endif
