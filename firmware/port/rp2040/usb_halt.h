/// What TinyUSB 0.18 leaves out where a host clears an endpoint's halt (CLEAR_FEATURE), halted or not: the transfer
/// that was under way is neither ended nor free to start again, so that the endpoint would never move data again. Links
/// with --wrap=dcd_edpt_clear_stall,--wrap=dcd_edpt_xfer.
#ifndef TAUTLINE_RP2040_USB_HALT_H
#define TAUTLINE_RP2040_USB_HALT_H

/// Ends what a cleared halt has left without an end, so that its class starts the next transfer. Task, after
/// tl_usb_task().
void usb_halt_task(void);

#endif
