#include "tautline/tl_usb.h"

#include <device/dcd.h>
#include <string.h>
#include <tusb.h>

enum { INTERFACE_VENDOR, INTERFACE_DFU, INTERFACES };
enum { STRING_LANGUAGE, STRING_MANUFACTURER, STRING_PRODUCT, STRING_SERIAL, STRING_VENDOR, STRING_AXIS };

#define ENDPOINT_OUT  0x01
#define ENDPOINT_IN   0x81
#define REQUEST_MS_OS 0x01
#define MS_OS_INDEX   0x07
#define POWER_MA      100
#define MANIFEST_MS   50U // typical flash erase and eight pages

static tl_app_t *app;

// -- device, configuration --------------------------------------------------------------------------------------

static const tusb_desc_device_t device_descriptor = {
    .bLength = sizeof(tusb_desc_device_t),
    .bDescriptorType = TUSB_DESC_DEVICE,
    .bcdUSB = 0x0210, // so that hosts ask for the BOS descriptor
    .bDeviceClass = 0,
    .bDeviceSubClass = 0,
    .bDeviceProtocol = 0,
    .bMaxPacketSize0 = CFG_TUD_ENDPOINT0_SIZE,
    .idVendor = TL_WIRE_USB_VENDOR,
    .idProduct = TL_WIRE_USB_PRODUCT,
    .bcdDevice = (TL_WIRE_MAJOR << 8) | TL_WIRE_MINOR,
    .iManufacturer = STRING_MANUFACTURER,
    .iProduct = STRING_PRODUCT,
    .iSerialNumber = STRING_SERIAL,
    .bNumConfigurations = 1,
};

uint8_t const *tud_descriptor_device_cb(void) {
    return (const uint8_t *)&device_descriptor;
}

#define CONFIGURATION_SIZE(alternates) (TUD_CONFIG_DESC_LEN + TUD_VENDOR_DESC_LEN + TUD_DFU_DESC_LEN(alternates))
static uint8_t configuration[CONFIGURATION_SIZE(TL_WIRE_AXES_MAX + 1U)];

// The table of each axis and, behind them, the firmware.
static uint8_t alternates(void) {
    return (uint8_t)(app->port->axes + (app->port->update != NULL ? 1U : 0U));
}

static bool is_firmware(uint8_t alternate) {
    return alternate == app->port->axes && app->port->update != NULL;
}

static void make_configuration(void) {
    const uint16_t size = (uint16_t)CONFIGURATION_SIZE(alternates());
    const uint8_t head[] = {
        TUD_CONFIG_DESCRIPTOR(1, INTERFACES, 0, 0, 0, POWER_MA),
        TUD_VENDOR_DESCRIPTOR(INTERFACE_VENDOR, STRING_VENDOR, ENDPOINT_OUT, ENDPOINT_IN, TL_WIRE_USB_PACKET),
    };
    uint8_t *out = configuration;
    memcpy(out, head, sizeof(head));
    out[2] = (uint8_t)size;
    out[3] = (uint8_t)(size >> 8);
    out += sizeof(head);
    for (uint8_t i = 0; i < alternates(); i++) {
        const uint8_t alternate[] = {9,
                                     TUSB_DESC_INTERFACE,
                                     INTERFACE_DFU,
                                     i,
                                     0,
                                     TUSB_CLASS_APPLICATION_SPECIFIC,
                                     APP_SUBCLASS_DFU_RUNTIME,
                                     DFU_PROTOCOL_DFU,
                                     (uint8_t)(STRING_AXIS + i)};
        memcpy(out, alternate, sizeof(alternate));
        out += sizeof(alternate);
    }
    const uint8_t functional[] = {9,
                                  DFU_DESC_FUNCTIONAL,
                                  DFU_ATTR_CAN_DOWNLOAD | DFU_ATTR_CAN_UPLOAD | DFU_ATTR_MANIFESTATION_TOLERANT,
                                  U16_TO_U8S_LE(1000),
                                  U16_TO_U8S_LE(CFG_TUD_DFU_XFER_BUFSIZE),
                                  U16_TO_U8S_LE(0x0101)};
    memcpy(out, functional, sizeof(functional));
}

uint8_t const *tud_descriptor_configuration_cb(uint8_t index) {
    return index == 0U ? configuration : NULL;
}

// -- strings ----------------------------------------------------------------------------------------------------

uint16_t const *tud_descriptor_string_cb(uint8_t index, uint16_t language) {
    (void)language;
    static uint16_t descriptor[1 + 32];
    char axis[] = "axis 0 table";
    const char *text = NULL;
    size_t length = 1;
    switch (index) {
    case STRING_LANGUAGE:
        descriptor[1] = 0x0409; // English, the only one
        break;
    case STRING_MANUFACTURER:
        text = TL_WIRE_USB_MANUFACTURER;
        break;
    case STRING_PRODUCT:
        text = "tautline board";
        break;
    case STRING_SERIAL:
        text = app->port->serial;
        break;
    case STRING_VENDOR:
        text = "tautline control";
        break;
    default:
        if (index < STRING_AXIS || index >= STRING_AXIS + alternates()) {
            return NULL;
        }
        axis[5] = (char)('0' + (index - STRING_AXIS));
        text = is_firmware((uint8_t)(index - STRING_AXIS)) ? "firmware" : axis;
        break;
    }
    if (text != NULL) {
        for (length = 0; length < 32U && text[length] != '\0'; length++) {
            descriptor[1 + length] = (uint16_t)text[length];
        }
    }
    descriptor[0] = (uint16_t)((TUSB_DESC_STRING << 8) | (2U * length + 2U));
    return descriptor;
}

// -- BOS and Microsoft OS 2.0: WinUSB for both interfaces, without an .inf file ------------------------------------

#define FUNCTION_SIZE (8 + 20 + 132)
#define MS_OS_SIZE    (10 + 8 + INTERFACES * FUNCTION_SIZE)
#define BOS_SIZE      (TUD_BOS_DESC_LEN + TUD_BOS_MICROSOFT_OS_DESC_LEN)

// {6C7A4C1E-3B1D-4E0C-9F35-7461757400nn}, nn the interface, in the REG_MULTI_SZ's UTF-16
#define GUID(nn)                                                                                                       \
    '{', 0, '6', 0, 'C', 0, '7', 0, 'A', 0, '4', 0, 'C', 0, '1', 0, 'E', 0, '-', 0, '3', 0, 'B', 0, '1', 0, 'D', 0,    \
        '-', 0, '4', 0, 'E', 0, '0', 0, 'C', 0, '-', 0, '9', 0, 'F', 0, '3', 0, '5', 0, '-', 0, '7', 0, '4', 0, '6',   \
        0, '1', 0, '7', 0, '5', 0, '7', 0, '4', 0, '0', 0, '0', 0, '0', 0, nn, 0, '}', 0, 0, 0, 0, 0

#define NAME                                                                                                           \
    'D', 0, 'e', 0, 'v', 0, 'i', 0, 'c', 0, 'e', 0, 'I', 0, 'n', 0, 't', 0, 'e', 0, 'r', 0, 'f', 0, 'a', 0, 'c', 0,    \
        'e', 0, 'G', 0, 'U', 0, 'I', 0, 'D', 0, 's', 0, 0, 0

#define FUNCTION(interface, nn)                                                                                        \
    U16_TO_U8S_LE(8), U16_TO_U8S_LE(MS_OS_20_SUBSET_HEADER_FUNCTION), interface, 0, U16_TO_U8S_LE(FUNCTION_SIZE),      \
        U16_TO_U8S_LE(20), U16_TO_U8S_LE(MS_OS_20_FEATURE_COMPATBLE_ID), 'W', 'I', 'N', 'U', 'S', 'B', 0, 0, 0, 0, 0,  \
        0, 0, 0, 0, 0, U16_TO_U8S_LE(132), U16_TO_U8S_LE(MS_OS_20_FEATURE_REG_PROPERTY), U16_TO_U8S_LE(7),             \
        U16_TO_U8S_LE(42), NAME, U16_TO_U8S_LE(80), GUID(nn)

static const uint8_t ms_os_descriptor[] = {
    U16_TO_U8S_LE(10),
    U16_TO_U8S_LE(MS_OS_20_SET_HEADER_DESCRIPTOR),
    U32_TO_U8S_LE(0x06030000), // Windows 8.1
    U16_TO_U8S_LE(MS_OS_SIZE),
    U16_TO_U8S_LE(8),
    U16_TO_U8S_LE(MS_OS_20_SUBSET_HEADER_CONFIGURATION),
    0,
    0,
    U16_TO_U8S_LE(8 + INTERFACES * FUNCTION_SIZE),
    FUNCTION(INTERFACE_VENDOR, '0'),
    FUNCTION(INTERFACE_DFU, '1'),
};
_Static_assert(sizeof(ms_os_descriptor) == MS_OS_SIZE, "lengths inside the descriptor");

static const uint8_t bos_descriptor[] = {
    TUD_BOS_DESCRIPTOR(BOS_SIZE, 1),
    TUD_BOS_MS_OS_20_DESCRIPTOR(MS_OS_SIZE, REQUEST_MS_OS),
};

uint8_t const *tud_descriptor_bos_cb(void) {
    return bos_descriptor;
}

bool tud_vendor_control_xfer_cb(uint8_t port, uint8_t stage, tusb_control_request_t const *request) {
    const bool ours = request->bmRequestType_bit.type == TUSB_REQ_TYPE_VENDOR &&
                      request->bmRequestType_bit.direction == TUSB_DIR_IN && request->bRequest == REQUEST_MS_OS &&
                      request->wIndex == MS_OS_INDEX;
    if (!ours) {
        return false;
    }
    return stage != CONTROL_STAGE_SETUP ||
           tud_control_xfer(port, request, (void *)(uintptr_t)ms_os_descriptor, sizeof(ms_os_descriptor));
}

// -- set-up packets -----------------------------------------------------------------------------------------------

// TinyUSB 0.18 believes a request's direction bit: GET_DESCRIPTOR sent as OUT has the host write into the descriptor,
// GET_STATUS into a stack frame that is gone. Every port links with --wrap=dcd_event_handler, so that such a packet
// comes here first and is turned into a type of request that does not exist: TinyUSB then stalls it.
void __real_dcd_event_handler(dcd_event_t const *event, bool in_isr);
void __wrap_dcd_event_handler(dcd_event_t const *event, bool in_isr);

static bool is_legal(const tusb_control_request_t *request) {
    const bool in = request->bmRequestType_bit.direction == TUSB_DIR_IN;
    bool reads = false;
    bool has_data = false; // of an OUT request
    switch (request->bmRequestType_bit.type) {
    case TUSB_REQ_TYPE_STANDARD:
        reads = request->bRequest == TUSB_REQ_GET_STATUS || request->bRequest == TUSB_REQ_GET_DESCRIPTOR ||
                request->bRequest == TUSB_REQ_GET_CONFIGURATION || request->bRequest == TUSB_REQ_GET_INTERFACE ||
                request->bRequest == TUSB_REQ_SYNCH_FRAME;
        break;
    case TUSB_REQ_TYPE_CLASS:
        reads = request->bRequest == DFU_REQUEST_UPLOAD || request->bRequest == DFU_REQUEST_GETSTATUS ||
                request->bRequest == DFU_REQUEST_GETSTATE;
        has_data = request->bRequest == DFU_REQUEST_DNLOAD;
        break;
    default:
        return true; // vendor: tud_vendor_control_xfer_cb looks itself
    }
    return in == reads && (in || has_data || request->wLength == 0U);
}

void __wrap_dcd_event_handler(dcd_event_t const *event, bool in_isr) {
    if (event->event_id == DCD_EVENT_SETUP_RECEIVED && !is_legal(&event->setup_received)) {
        dcd_event_t refused = *event;
        refused.setup_received.bmRequestType_bit.type = TUSB_REQ_TYPE_INVALID;
        __real_dcd_event_handler(&refused, in_isr);
        return;
    }
    __real_dcd_event_handler(event, in_isr);
}

// -- bus state --------------------------------------------------------------------------------------------------

void tud_mount_cb(void) {
    tl_app_bus(app, true);
}
void tud_umount_cb(void) {
    tl_app_bus(app, false);
}
void tud_resume_cb(void) {
    tl_app_bus(app, tud_mounted());
}

void tud_suspend_cb(bool remote_wakeup_allowed) {
    (void)remote_wakeup_allowed;
    tl_app_bus(app, false);
}

// -- DFU: alternate setting = axis, and firmware
// ------------------------------------------------------------------------------

uint32_t tud_dfu_get_timeout_cb(uint8_t alternate, uint8_t state) {
    if (state == DFU_MANIFEST) {
        return MANIFEST_MS;
    }
    return is_firmware(alternate) && app->update.come == app->update.next ? app->port->update->check_ms : 0U;
}

static uint8_t dfu_status(tl_upload_t result) {
    switch (result) {
    case TL_UPLOAD_OK:
        return DFU_STATUS_OK;
    case TL_UPLOAD_AXIS:
        return DFU_STATUS_ERR_TARGET;
    case TL_UPLOAD_SIZE:
        return DFU_STATUS_ERR_ADDRESS;
    case TL_UPLOAD_REFUSED:
        return DFU_STATUS_ERR_FILE;
    case TL_UPLOAD_NOT_OFF:
        return DFU_STATUS_ERR_VENDOR;
    case TL_UPLOAD_FLASH:
    default:
        return DFU_STATUS_ERR_PROG;
    }
}

static uint8_t firmware_status(uint8_t refused) {
    switch (refused) {
    case TL_WIRE_UPDATE_NONE:
        return DFU_STATUS_OK;
    case TL_WIRE_UPDATE_PORT:
        return DFU_STATUS_ERR_TARGET;
    case TL_WIRE_UPDATE_FLASH:
        return DFU_STATUS_ERR_PROG;
    case TL_WIRE_UPDATE_HASH:
    case TL_WIRE_UPDATE_SIGNATURE:
        return DFU_STATUS_ERR_VERIFY;
    case TL_WIRE_UPDATE_SIZE:
        return DFU_STATUS_ERR_ADDRESS;
    case TL_WIRE_UPDATE_NOT_OFF:
    case TL_WIRE_UPDATE_TRIAL:
        return DFU_STATUS_ERR_VENDOR;
    default:
        return DFU_STATUS_ERR_FILE;
    }
}

void tud_dfu_download_cb(uint8_t alternate, uint16_t block, uint8_t const *data, uint16_t length) {
    const uint32_t offset = (uint32_t)block * CFG_TUD_DFU_XFER_BUFSIZE;
    tud_dfu_finish_flashing(is_firmware(alternate)
                                ? firmware_status(tl_app_update_data(app, offset, data, length))
                                : dfu_status(tl_app_table_data(app, alternate, offset, data, length)));
}

void tud_dfu_manifest_cb(uint8_t alternate) {
    tud_dfu_finish_flashing(is_firmware(alternate) ? firmware_status(tl_app_update_end(app))
                                                   : dfu_status(tl_app_table_end(app, alternate)));
}

uint16_t tud_dfu_upload_cb(uint8_t alternate, uint16_t block, uint8_t *data, uint16_t length) {
    return (uint16_t)tl_app_table_read(app, alternate, (uint32_t)block * length, data, length);
}

void tud_dfu_abort_cb(uint8_t alternate) {
    (void)alternate;
    tl_app_table_abort(app);
}

// -- bulk -------------------------------------------------------------------------------------------------------

void tl_usb_init(tl_app_t *the_app) {
    app = the_app;
    make_configuration();
    const tusb_rhport_init_t device = {.role = TUSB_ROLE_DEVICE, .speed = TUSB_SPEED_FULL};
    tusb_init(0, &device);
}

void tl_usb_task(void) {
    tud_task();
    uint8_t bytes[TL_WIRE_USB_PACKET];
    uint32_t count;
    // Reading before a host has configured the device would start a transfer on endpoint 0.
    while (tud_vendor_mounted() && (count = tud_vendor_read(bytes, sizeof(bytes))) > 0U) {
        tl_app_receive(app, bytes, count);
    }
    // Only what fits is taken: the app's own queue holds whole frames and counts those that find no room.
    bool wrote = false;
    uint32_t room;
    while (tud_vendor_mounted() && (room = tud_vendor_write_available()) > 0U) {
        count = (uint32_t)tl_app_transmit(app, bytes, room < sizeof(bytes) ? room : sizeof(bytes));
        if (count == 0U) {
            break;
        }
        tud_vendor_write(bytes, count);
        wrote = true;
    }
    if (wrote) {
        tud_vendor_write_flush();
    }
}
