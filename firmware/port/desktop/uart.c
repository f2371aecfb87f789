#include "uart.h"

#include <string.h>

net_connection_t uart_connections[UART_CONNECTIONS];
static bool plugged = true;

static net_connection_t *line(void) {
    return &uart_connections[0];
}

static size_t take(void *context, uint8_t *out, size_t room) {
    (void)context;
    const size_t size = line()->fd < 0 ? 0U : line()->in_fill < room ? line()->in_fill : room;
    memcpy(out, line()->in, size);
    net_consume(line(), size);
    return size;
}

// Nobody on the line: the bytes go nowhere, as on any.
static size_t give(void *context, const uint8_t *bytes, size_t size) {
    (void)context;
    if (line()->fd < 0) {
        return size;
    }
    const size_t fits = net_room(line()) < size ? net_room(line()) : size;
    net_put(line(), bytes, fits);
    return fits;
}

const tl_serial_t *uart_line(void) {
    static const tl_serial_t serial = {.read = take, .write = give};
    return &serial;
}

void uart_init(void) {
    line()->fd = -1;
}

void uart_closed(net_connection_t *connection) {
    net_close(connection);
    connection->in_fill = 0;
}

void uart_plug(bool on) {
    plugged = on;
    if (!on && line()->fd >= 0) {
        uart_closed(line());
    }
}

bool uart_attached(void) {
    return line()->fd >= 0;
}

void uart_receive(void) {
    if (!plugged && line()->fd >= 0) {
        uart_closed(line());
    }
    if (line()->fd >= 0 && !net_read(line())) {
        uart_closed(line());
    }
}
