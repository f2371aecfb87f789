/// USB side of the app: descriptors and class callbacks on TinyUSB, the same on every port.
///
/// Interface 0, vendor: bulk 0x01 OUT and 0x81 IN carry tl_wire.h's frames. Interface 1, DFU mode: alternate setting n
/// is the table of axis n; a download is checked and stored when it is complete, an upload gives the table in use.
/// bcdDevice is the protocol version, major.minor. Windows loads WinUSB by the MS OS 2.0 descriptors.
#ifndef TAUTLINE_TL_USB_H
#define TAUTLINE_TL_USB_H

#include "tautline/tl_app.h"

/// Makes the descriptors for this app's board and starts TinyUSB. Once per start of the board.
void tl_usb_init(tl_app_t *app);

/// Moves bytes between USB and the app. Task; call as often as possible, at least every millisecond.
void tl_usb_task(void);

#endif
