// The desktop board's serial port: a TCP connection is the line, one at a time. It carries no baud rate.
#ifndef UART_H
#define UART_H

#include "net.h"
#include "tautline/tl_serial.h"

#define UART_CONNECTIONS 1

extern net_connection_t uart_connections[UART_CONNECTIONS];

void uart_init(void);
// Whether the cable is in: false closes the line.
void uart_plug(bool plugged);
bool uart_attached(void);
// Takes in what has come by now, so that bytes sent before a request on the sim link are there before it.
void uart_receive(void);
void uart_closed(net_connection_t *connection);
// The board's end.
const tl_serial_t *uart_line(void);

#endif
