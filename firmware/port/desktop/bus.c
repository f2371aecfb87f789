#include "bus.h"

#include <device/dcd.h>
#include <string.h>
#include <tusb.h>

#define ENDPOINTS 2

typedef struct {
    uint8_t *buffer;
    uint16_t total;
    uint16_t done;
    bool armed; // a transfer of the device's waits for tokens
    bool stalled;
} endpoint_t;

static endpoint_t endpoints[ENDPOINTS][2];

static endpoint_t *endpoint_at(uint8_t address) {
    return &endpoints[tu_edpt_number(address) % ENDPOINTS][tu_edpt_dir(address)];
}

// -- the host's side --------------------------------------------------------------------------------------------

static void complete(endpoint_t *endpoint, uint8_t address) {
    endpoint->armed = false;
    dcd_event_xfer_complete(0, address, endpoint->done, XFER_RESULT_SUCCESS, false);
    tud_task();
}

void bus_reset(void) {
    memset(endpoints, 0, sizeof(endpoints));
    dcd_event_bus_reset(0, TUSB_SPEED_FULL, false);
    tud_task();
}

void bus_unplug(void) {
    memset(endpoints, 0, sizeof(endpoints));
    dcd_event_bus_signal(0, DCD_EVENT_UNPLUGGED, false);
    tud_task();
}

void bus_setup(const uint8_t setup[8]) {
    memset(endpoints[0], 0, sizeof(endpoints[0])); // a SETUP ends whatever went on, a stall included
    dcd_event_setup_received(0, setup, false);
    tud_task();
}

int bus_in(unsigned number, uint8_t packet[BUS_PACKET]) {
    const uint8_t address = (uint8_t)(number | TUSB_DIR_IN_MASK);
    endpoint_t *endpoint = endpoint_at(address);
    if (number >= ENDPOINTS || endpoint->stalled) {
        return BUS_STALL;
    }
    if (!endpoint->armed) {
        return BUS_NAK;
    }
    const uint16_t size = tu_min16((uint16_t)(endpoint->total - endpoint->done), BUS_PACKET);
    if (size > 0) {
        memcpy(packet, endpoint->buffer + endpoint->done, size);
    }
    endpoint->done = (uint16_t)(endpoint->done + size);
    if (endpoint->done == endpoint->total) {
        complete(endpoint, address);
    }
    return size;
}

int bus_out(unsigned number, const uint8_t *packet, size_t size) {
    endpoint_t *endpoint = endpoint_at((uint8_t)number);
    if (number >= ENDPOINTS || endpoint->stalled) {
        return BUS_STALL;
    }
    if (!endpoint->armed) {
        return BUS_NAK;
    }
    const size_t room = (size_t)(endpoint->total - endpoint->done);
    if (size > room) {
        return BUS_STALL; // more than the device has room for: babble
    }
    if (size > 0) {
        memcpy(endpoint->buffer + endpoint->done, packet, size);
    }
    endpoint->done = (uint16_t)(endpoint->done + size);
    if (endpoint->done == endpoint->total || size < BUS_PACKET) {
        complete(endpoint, (uint8_t)number);
    }
    return (int)size;
}

// -- the device's side: what TinyUSB asks of a controller ---------------------------------------------------------

bool dcd_init(uint8_t port, const tusb_rhport_init_t *init) {
    (void)port;
    (void)init;
    memset(endpoints, 0, sizeof(endpoints));
    return true;
}

bool dcd_deinit(uint8_t port) {
    (void)port;
    return true;
}

// One thread: nothing to keep out.
void dcd_int_enable(uint8_t port) {
    (void)port;
}
void dcd_int_disable(uint8_t port) {
    (void)port;
}
void dcd_int_handler(uint8_t port) {
    (void)port;
}
void dcd_remote_wakeup(uint8_t port) {
    (void)port;
}

void dcd_sof_enable(uint8_t port, bool enable) {
    (void)port;
    (void)enable;
}

void dcd_edpt0_status_complete(uint8_t port, tusb_control_request_t const *request) {
    (void)port;
    (void)request;
}

void dcd_set_address(uint8_t port, uint8_t address) {
    (void)address; // one device on this bus: its address selects nothing
    dcd_edpt_xfer(port, TUSB_DIR_IN_MASK, NULL, 0);
}

bool dcd_edpt_open(uint8_t port, tusb_desc_endpoint_t const *descriptor) {
    (void)port;
    memset(endpoint_at(descriptor->bEndpointAddress), 0, sizeof(endpoint_t));
    return tu_edpt_number(descriptor->bEndpointAddress) < ENDPOINTS;
}

void dcd_edpt_close(uint8_t port, uint8_t address) {
    (void)port;
    memset(endpoint_at(address), 0, sizeof(endpoint_t));
}

void dcd_edpt_close_all(uint8_t port) {
    (void)port;
    memset(endpoints[1], 0, sizeof(endpoints[1]));
}

bool dcd_edpt_xfer(uint8_t port, uint8_t address, uint8_t *buffer, uint16_t total) {
    (void)port;
    endpoint_t *endpoint = endpoint_at(address);
    endpoint->buffer = buffer;
    endpoint->total = total;
    endpoint->done = 0;
    endpoint->armed = true;
    return true;
}

// A transfer that waits stays queued over a stall: TinyUSB's vendor class does not queue it again.
void dcd_edpt_stall(uint8_t port, uint8_t address) {
    (void)port;
    endpoint_at(address)->stalled = true;
}

void dcd_edpt_clear_stall(uint8_t port, uint8_t address) {
    (void)port;
    endpoint_at(address)->stalled = false;
}
