#include "uart.h"

void uart_init(uart_t *uart, mps2_uart_t *port, uint32_t baud) {
    uart->port = port;
    uart->head = uart->tail = 0;
    port->divider = (MPS2_CLOCK_HZ + baud / 2U) / baud;
    port->interrupt = UART_RX_INTERRUPT;
    port->control = UART_TX_ENABLE | UART_RX_ENABLE | UART_RX_INTERRUPT_ENABLE;
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
    return sent;
}
