// USB/IP server for the one device of this process: protocol version 1.1.1, as Linux's vhci-hcd and usbip(8) speak it.
#ifndef USBIP_H
#define USBIP_H

#include "net.h"

#define USBIP_CONNECTIONS 8

extern net_connection_t usbip_connections[USBIP_CONNECTIONS];

void usbip_init(void);
// Whether the device is on the bus: false ends the import, as pulling the plug does.
void usbip_plug(bool plugged);
bool usbip_attached(void);
// Takes in what the connections have received.
void usbip_receive(void);
// Moves the transfers under way as far as the device lets them; true where one went on.
bool usbip_transfer(void);
// The connection is gone.
void usbip_closed(net_connection_t *connection);

#endif
