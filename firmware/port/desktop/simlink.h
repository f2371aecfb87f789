// The sim link: what a simulated instrument and its tests need of the desktop board's world. TCP, one request a line,
// one JSON object a line back; docs/protocol.md lists the requests.
#ifndef SIMLINK_H
#define SIMLINK_H

#include "net.h"

#define SIMLINK_CONNECTIONS 4

extern net_connection_t simlink_connections[SIMLINK_CONNECTIONS];

void simlink_init(bool realtime);
void simlink_receive(void);
// Time that was granted and is still to be run. Runs part of it; false: none is left.
bool simlink_run(void);
// Milliseconds until the world must go on, -1: until a request comes. With `realtime`, the wall clock drives it.
int simlink_wait(void);
void simlink_closed(net_connection_t *connection);
bool simlink_quit(void);
bool simlink_cable(void); // whether the USB cable is plugged in

#endif
