// What TinyUSB 0.18 leaves out where a host clears an endpoint's halt (CLEAR_FEATURE), halted or not: the transfer that
// was under way is neither ended nor free to start again, so that the endpoint would never move data again. Linked by
// --wrap=dcd_edpt_clear_stall.
#include "device/dcd.h"
#include "hardware/structs/usb.h"
#include "pico/platform.h"

void __real_dcd_edpt_clear_stall(uint8_t port, uint8_t endpoint);
void __wrap_dcd_edpt_clear_stall(uint8_t port, uint8_t endpoint);

void __wrap_dcd_edpt_clear_stall(uint8_t port, uint8_t endpoint) {
    const uint8_t number = tu_edpt_number(endpoint);
    const bool in = tu_edpt_dir(endpoint) == TUSB_DIR_IN;
    if (number > 0) {
        const uint32_t bit = 1u << (2u * number + (in ? 0u : 1u));
        const bool can_abort = rp2040_chip_version() >= 2; // before, an abort never ends (erratum RP2040-E2)
        if (can_abort) {
            hw_set_bits(&usb_hw->abort, bit);
            while (!(usb_hw->abort_done & bit)) {
            }
        }
        if (in) {
            usb_dpram->ep_buf_ctrl[number].in = 0;
        } else {
            usb_dpram->ep_buf_ctrl[number].out = 0;
        }
        if (can_abort) {
            hw_clear_bits(&usb_hw->abort_done, bit);
            hw_clear_bits(&usb_hw->abort, bit);
        }
    }
    __real_dcd_edpt_clear_stall(port, endpoint); // the toggle, too
    if (number > 0) {
        dcd_event_xfer_complete(port, endpoint, 0, XFER_RESULT_SUCCESS, false); // its class starts the next one
    }
}
