#include "uart.h"

#define ON (UART_TX_ENABLE | UART_RX_ENABLE | UART_RX_INTERRUPT_ENABLE)

void uart_init(uart_t *uart, mps2_uart_t *port, uint32_t baud) {
    uart->port = port;
    uart->head = uart->tail = 0;
    uart->waits = false;
    port->divider = (MPS2_CLOCK_HZ + baud / 2U) / baud;
    port->interrupt = UART_RX_INTERRUPT;
    port->control = ON;
}

uint32_t uart_interrupt(uart_t *uart) {
    uint32_t count = 0;
    uart->port->interrupt = UART_RX_INTERRUPT;
    for (; (uart->port->state & UART_RX_FULL) != 0; count++) {
        const uint8_t byte = (uint8_t)uart->port->data;
        if (uart->head - uart->tail < UART_BUFFER) {
            uart->bytes[uart->head % UART_BUFFER] = byte;
            uart->head = uart->head + 1U;
        }
    }
    return count;
}

size_t uart_read(uart_t *uart, uint8_t *out, size_t room) {
    size_t size = 0;
    while (size < room && uart->tail != uart->head) {
        out[size++] = uart->bytes[uart->tail++ % UART_BUFFER];
    }
    return size;
}

size_t uart_write(uart_t *uart, const uint8_t *bytes, size_t size) {
    size_t sent = 0;
    while (sent < size && (uart->port->state & UART_TX_FULL) == 0) {
        uart->port->data = bytes[sent++];
    }
    if (uart->waits != (sent < size)) {
        uart->waits = !uart->waits;
        uart->port->control = uart->waits ? ON | UART_TX_INTERRUPT_ENABLE : ON;
    }
    return sent;
}

void uart_has_sent(uart_t *uart) {
    uart->port->interrupt = UART_TX_INTERRUPT;
}
