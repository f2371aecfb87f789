#include "usbip.h"

#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <tusb.h>

#include "bus.h"

#define VERSION      0x0111U
#define OP_DEVLIST   0x8005U
#define OP_IMPORT    0x8003U
#define OP_REPLY     0x7FFFU // mask
#define CMD_SUBMIT   1U
#define CMD_UNLINK   2U
#define RET_SUBMIT   3U
#define RET_UNLINK   4U
#define ST_BUSY      2U
#define ST_NO_DEVICE 4U
#define SPEED_FULL   2U
#define BUS_NUMBER   1U
#define DEVICE       2U
#define HEADER       48U
#define BUS_ID       "1-1"
#define TRANSFER_MAX (64U * 1024U)
#define URBS         32

net_connection_t usbip_connections[USBIP_CONNECTIONS];

typedef enum { STAGE_SETUP, STAGE_DATA, STAGE_STATUS } stage_t; // of a control transfer

typedef struct {
    bool used;
    bool in;
    uint32_t sequence;
    uint32_t endpoint;
    uint32_t length; // of the host's buffer
    uint32_t actual;
    stage_t stage;
    uint8_t setup[8];
    uint8_t data[TRANSFER_MAX];
} urb_t;

static urb_t urbs[URBS];
static uint8_t order[URBS]; // urbs in the order of their submission
static size_t pending;
static net_connection_t *importer;
static bool plugged = true;
static uint32_t discard; // payload bytes of a refused transfer still to come, from the importer

static uint32_t get32(const uint8_t *in) {
    return ((uint32_t)in[0] << 24) | ((uint32_t)in[1] << 16) | ((uint32_t)in[2] << 8) | in[3];
}

static void put32(uint8_t *out, uint32_t value) {
    out[0] = (uint8_t)(value >> 24);
    out[1] = (uint8_t)(value >> 16);
    out[2] = (uint8_t)(value >> 8);
    out[3] = (uint8_t)value;
}

static void put16(uint8_t *out, uint32_t value) {
    out[0] = (uint8_t)(value >> 8);
    out[1] = (uint8_t)value;
}

// -- before an import -------------------------------------------------------------------------------------------

static void put_op(net_connection_t *connection, uint32_t code, uint32_t status) {
    uint8_t op[8];
    put16(op, VERSION);
    put16(op + 2, code & OP_REPLY);
    put32(op + 4, status);
    net_put(connection, op, sizeof(op));
}

static void put_device(net_connection_t *connection) {
    const tusb_desc_device_t *device = (const tusb_desc_device_t *)tud_descriptor_device_cb();
    const uint8_t *configuration = tud_descriptor_configuration_cb(0);
    uint8_t entry[312] = {0};
    snprintf((char *)entry, 256, "/sys/devices/tautline/usb%u/%s", BUS_NUMBER, BUS_ID);
    snprintf((char *)entry + 256, 32, "%s", BUS_ID);
    put32(entry + 288, BUS_NUMBER);
    put32(entry + 292, DEVICE);
    put32(entry + 296, SPEED_FULL);
    put16(entry + 300, device->idVendor);
    put16(entry + 302, device->idProduct);
    put16(entry + 304, device->bcdDevice);
    entry[306] = device->bDeviceClass;
    entry[307] = device->bDeviceSubClass;
    entry[308] = device->bDeviceProtocol;
    entry[309] = 1;
    entry[310] = device->bNumConfigurations;
    entry[311] = configuration[4];
    net_put(connection, entry, sizeof(entry));
}

static void put_interfaces(net_connection_t *connection) {
    const uint8_t *configuration = tud_descriptor_configuration_cb(0);
    const size_t total = (size_t)(configuration[2] | (configuration[3] << 8));
    for (size_t at = 0; at < total; at += configuration[at]) {
        if (configuration[at + 1] == TUSB_DESC_INTERFACE && configuration[at + 3] == 0) {
            const uint8_t interface[4] = {configuration[at + 5], configuration[at + 6], configuration[at + 7], 0};
            net_put(connection, interface, sizeof(interface));
        }
    }
}

static void import(net_connection_t *connection, const char *id) {
    if (!plugged || strcmp(id, BUS_ID) != 0) {
        put_op(connection, OP_IMPORT, ST_NO_DEVICE);
        connection->closing = true;
    } else if (importer != NULL) {
        put_op(connection, OP_IMPORT, ST_BUSY);
        connection->closing = true;
    } else {
        importer = connection;
        pending = 0;
        discard = 0;
        memset(urbs, 0, sizeof(urbs));
        bus_reset();
        const uint8_t set_address[8] = {0x00, TUSB_REQ_SET_ADDRESS, DEVICE, 0, 0, 0, 0, 0};
        uint8_t status[BUS_PACKET];
        bus_setup(set_address);
        bus_in(0, status);
        put_op(connection, OP_IMPORT, 0);
        put_device(connection);
    }
}

// Bytes taken, 0 where the request is not whole yet.
static size_t take_op(net_connection_t *connection) {
    const uint8_t *in = connection->in;
    if (connection->in_fill < 8U) {
        return 0;
    }
    const uint32_t code = (uint32_t)(in[2] << 8 | in[3]);
    if (code == OP_DEVLIST) {
        uint8_t count[4];
        put32(count, plugged ? 1U : 0U);
        put_op(connection, OP_DEVLIST, 0);
        net_put(connection, count, sizeof(count));
        if (plugged) {
            put_device(connection);
            put_interfaces(connection);
        }
        connection->closing = true;
        return 8U;
    }
    if (code == OP_IMPORT) {
        if (connection->in_fill < 40U) {
            return 0;
        }
        char id[33] = {0};
        memcpy(id, in + 8, 32);
        import(connection, id);
        return 40U;
    }
    connection->closing = true; // not USB/IP
    return connection->in_fill;
}

// -- transfers --------------------------------------------------------------------------------------------------

static void put_return(uint32_t kind, uint32_t sequence, int32_t status, uint32_t actual, const uint8_t *data,
                       size_t size) {
    uint8_t header[HEADER] = {0};
    put32(header, kind);
    put32(header + 4, sequence);
    put32(header + 20, (uint32_t)status);
    put32(header + 24, actual);
    net_put(importer, header, sizeof(header));
    if (size > 0) {
        net_put(importer, data, size);
    }
}

static void forget(size_t index) {
    urbs[order[index]].used = false;
    pending--;
    memmove(order + index, order + index + 1, pending - index);
}

static void submit(const uint8_t *header) {
    const uint32_t length = get32(header + 24);
    const bool in = get32(header + 12) != 0U;
    const uint32_t sequence = get32(header + 4);
    if (pending == URBS) {
        put_return(RET_SUBMIT, sequence, -ENOMEM, 0, NULL, 0);
        return;
    }
    uint8_t slot = 0;
    while (urbs[slot].used) {
        slot++;
    }
    urb_t *urb = &urbs[slot];
    urb->used = true;
    urb->in = in;
    urb->sequence = sequence;
    urb->endpoint = get32(header + 16);
    urb->length = length;
    urb->actual = 0;
    urb->stage = STAGE_SETUP;
    memcpy(urb->setup, header + 40, 8);
    if (!in) {
        memcpy(urb->data, header + HEADER, length);
    }
    order[pending++] = slot;
}

static void unlink_urb(uint32_t sequence, uint32_t target) {
    for (size_t i = 0; i < pending; i++) {
        if (urbs[order[i]].sequence == target) {
            forget(i);
            put_return(RET_UNLINK, sequence, -ECONNRESET, 0, NULL, 0);
            return;
        }
    }
    put_return(RET_UNLINK, sequence, 0, 0, NULL, 0); // it was complete already
}

// Bytes taken of an importer's stream, 0 where the command is not whole yet.
static size_t take_command(net_connection_t *connection) {
    const uint8_t *in = connection->in;
    if (discard > 0U) {
        const size_t size = discard < connection->in_fill ? discard : connection->in_fill;
        discard -= (uint32_t)size;
        return size;
    }
    if (connection->in_fill < HEADER) {
        return 0;
    }
    const uint32_t kind = get32(in);
    if (kind == CMD_UNLINK) {
        unlink_urb(get32(in + 4), get32(in + 20));
        return HEADER;
    }
    if (kind != CMD_SUBMIT) {
        connection->closing = true;
        return connection->in_fill;
    }
    const uint32_t length = get32(in + 24);
    const bool out = get32(in + 12) == 0U;
    if (length > TRANSFER_MAX) {
        discard = out ? length : 0U;
        put_return(RET_SUBMIT, get32(in + 4), -EMSGSIZE, 0, NULL, 0);
        return HEADER;
    }
    const size_t size = HEADER + (out ? length : 0U);
    if (connection->in_fill < size) {
        return 0;
    }
    submit(in);
    return size;
}

// Each returns 1 while the device is not ready, else the transfer's final status.
static int step_bulk(urb_t *urb) {
    for (;;) {
        if (urb->in) {
            uint8_t packet[BUS_PACKET];
            const int size = bus_in(urb->endpoint, packet);
            if (size < 0) {
                return size == BUS_NAK ? 1 : -EPIPE;
            }
            const uint32_t room = urb->length - urb->actual;
            const uint32_t kept = (uint32_t)size < room ? (uint32_t)size : room;
            memcpy(urb->data + urb->actual, packet, kept);
            urb->actual += kept;
            if ((uint32_t)size > room) {
                return -EOVERFLOW;
            }
            if (size < BUS_PACKET || urb->actual == urb->length) {
                return 0;
            }
        } else {
            const uint32_t left = urb->length - urb->actual;
            const uint32_t size = left < BUS_PACKET ? left : BUS_PACKET;
            const int sent = bus_out(urb->endpoint, urb->data + urb->actual, size);
            if (sent < 0) {
                return sent == BUS_NAK ? 1 : -EPIPE;
            }
            urb->actual += size;
            if (urb->actual == urb->length) {
                return 0;
            }
        }
    }
}

static int step_control(urb_t *urb) {
    const bool in = (urb->setup[0] & TUSB_DIR_IN_MASK) != 0;
    const uint32_t asked = (uint32_t)(urb->setup[6] | urb->setup[7] << 8);
    const uint32_t wanted = asked < urb->length ? asked : urb->length;
    uint8_t packet[BUS_PACKET];
    if (urb->stage == STAGE_SETUP) {
        bus_setup(urb->setup);
        urb->stage = asked > 0U ? STAGE_DATA : STAGE_STATUS;
    }
    while (urb->stage == STAGE_DATA) {
        uint32_t size;
        if (in) {
            const int got = bus_in(0, packet);
            if (got < 0) {
                return got == BUS_NAK ? 1 : -EPIPE;
            }
            size = (uint32_t)got;
            if (size > wanted - urb->actual) {
                return -EOVERFLOW;
            }
            memcpy(urb->data + urb->actual, packet, size);
        } else {
            const uint32_t left = wanted - urb->actual;
            size = left < BUS_PACKET ? left : BUS_PACKET;
            const int sent = bus_out(0, urb->data + urb->actual, size);
            if (sent < 0) {
                return sent == BUS_NAK ? 1 : -EPIPE;
            }
        }
        urb->actual += size;
        if (size < BUS_PACKET || urb->actual == wanted) {
            urb->stage = STAGE_STATUS;
        }
    }
    const int status = in && asked > 0U ? bus_out(0, NULL, 0) : bus_in(0, packet);
    if (status < 0) {
        return status == BUS_NAK ? 1 : -EPIPE;
    }
    return 0;
}

bool usbip_transfer(void) {
    bool moved = false;
    uint32_t waiting = 0; // bits: endpoints whose first transfer is not done, so that the next must wait
    for (size_t i = 0; importer != NULL && i < pending;) {
        urb_t *urb = &urbs[order[i]];
        const uint32_t bit = urb->endpoint == 0U ? 1U : (urb->in ? 2U : 4U);
        const uint32_t before = urb->actual;
        int status = 1;
        if ((waiting & bit) == 0U && net_room(importer) >= HEADER + urb->length) {
            if (urb->endpoint > 1U) {
                status = -EPIPE;
            } else {
                status = urb->endpoint == 0U ? step_control(urb) : step_bulk(urb);
            }
        }
        moved = moved || urb->actual != before;
        if (status > 0) {
            waiting |= bit;
            i++;
            continue;
        }
        if (importer == NULL) {
            return moved; // the device left the bus meanwhile
        }
        put_return(RET_SUBMIT, urb->sequence, status, urb->actual, urb->data, urb->in ? urb->actual : 0U);
        forget(i);
    }
    return moved;
}

// -- connections ------------------------------------------------------------------------------------------------

void usbip_init(void) {
    for (size_t i = 0; i < USBIP_CONNECTIONS; i++) {
        usbip_connections[i].fd = -1;
    }
}

void usbip_closed(net_connection_t *connection) {
    net_close(connection);
    if (connection == importer) {
        importer = NULL;
        pending = 0;
        bus_unplug();
    }
}

void usbip_plug(bool on) {
    plugged = on;
    if (!on && importer != NULL) {
        net_write(importer);
        usbip_closed(importer);
    }
}

bool usbip_attached(void) {
    return importer != NULL;
}

void usbip_receive(void) {
    for (size_t i = 0; i < USBIP_CONNECTIONS; i++) {
        net_connection_t *connection = &usbip_connections[i];
        while (connection->fd >= 0 && !connection->closing) {
            const size_t taken = connection == importer ? take_command(connection) : take_op(connection);
            if (taken == 0U) {
                break;
            }
            net_consume(connection, taken);
            usbip_transfer();
        }
    }
}
