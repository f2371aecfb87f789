#include "usb_halt.h"

#include "device/dcd.h"
#include "device/usbd.h"
#include "hardware/structs/usb.h"
#include "hardware/timer.h"
#include "pico/platform.h"

#define SETTLE_US 2000U // TinyUSB may hold an IN transfer back until the next frame (erratum RP2040-E15)

static uint32_t cleared;    // bits as in the controller's registers: IN at 2 n, OUT at 2 n + 1
static uint32_t cleared_us; // when the last one was

void __real_dcd_edpt_clear_stall(uint8_t port, uint8_t endpoint);
void __wrap_dcd_edpt_clear_stall(uint8_t port, uint8_t endpoint);
bool __real_dcd_edpt_xfer(uint8_t port, uint8_t endpoint, uint8_t *buffer, uint16_t size);
bool __wrap_dcd_edpt_xfer(uint8_t port, uint8_t endpoint, uint8_t *buffer, uint16_t size);

static uint32_t bit_of(uint8_t endpoint) {
    return 1u << (2u * tu_edpt_number(endpoint) + (tu_edpt_dir(endpoint) == TUSB_DIR_IN ? 0u : 1u));
}

static io_rw_32 *buffer_control(uint8_t endpoint) {
    const uint8_t number = tu_edpt_number(endpoint);
    return tu_edpt_dir(endpoint) == TUSB_DIR_IN ? &usb_dpram->ep_buf_ctrl[number].in
                                                : &usb_dpram->ep_buf_ctrl[number].out;
}

// The buffer is taken back from the controller, but not where it has completed meanwhile: the interrupt that tells is
// held back only as long as this takes, and reads it.
void __wrap_dcd_edpt_clear_stall(uint8_t port, uint8_t endpoint) {
    if (tu_edpt_number(endpoint) == 0) {
        __real_dcd_edpt_clear_stall(port, endpoint);
        return;
    }
    const uint32_t bit = bit_of(endpoint);
    const bool can_abort = rp2040_chip_version() >= 2; // before, an abort never ends (erratum RP2040-E2)
    dcd_int_disable(port);
    if (can_abort) {
        hw_set_bits(&usb_hw->abort, bit);
        while (!(usb_hw->abort_done & bit)) {
        }
    }
    if (!(usb_hw->buf_status & bit)) {
        *buffer_control(endpoint) = 0;
    }
    if (can_abort) {
        hw_clear_bits(&usb_hw->abort_done, bit);
        hw_clear_bits(&usb_hw->abort, bit);
    }
    __real_dcd_edpt_clear_stall(port, endpoint); // the toggle, too
    dcd_int_enable(port);
    cleared |= bit;
    cleared_us = time_us_32();
}

bool __wrap_dcd_edpt_xfer(uint8_t port, uint8_t endpoint, uint8_t *buffer, uint16_t size) {
    cleared &= ~bit_of(endpoint); // its class goes on
    return __real_dcd_edpt_xfer(port, endpoint, buffer, size);
}

// Whether the transfer is nowhere: not with the controller, not completed, nor its completion on its way through
// TinyUSB's queue. Interrupts of USB are off.
static bool is_dead(uint8_t endpoint) {
    return !tud_task_event_ready() && !(usb_hw->buf_status & bit_of(endpoint)) &&
           !(*buffer_control(endpoint) & (USB_BUF_CTRL_AVAIL | USB_BUF_CTRL_AVAIL << 16));
}

void usb_halt_task(void) {
    if (cleared == 0 || time_us_32() - cleared_us < SETTLE_US) {
        return;
    }
    for (uint8_t number = 1; number < USB_NUM_ENDPOINTS; number++) {
        for (unsigned in = 0; in < 2; in++) {
            const uint8_t endpoint = tu_edpt_addr(number, in != 0 ? TUSB_DIR_IN : TUSB_DIR_OUT);
            if (!(cleared & bit_of(endpoint))) {
                continue;
            }
            dcd_int_disable(0);
            const bool dead = is_dead(endpoint);
            dcd_int_enable(0);
            if (dead) {
                dcd_event_xfer_complete(0, endpoint, 0, XFER_RESULT_SUCCESS, false); // its class starts the next one
            }
        }
    }
    cleared = 0;
}
