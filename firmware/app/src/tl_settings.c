#include "tautline/tl_settings.h"

#include "tautline/tl_axis_ask.h"
#include "tautline/tl_store.h"

#define FRAME_SIZE (TL_WIRE_HEADER_SIZE + TL_WIRE_SIZE_SETTINGS + TL_WIRE_CRC_SIZE)

// Bytes at the end that settings of older firmware lack: of protocol 2.3 commissioned, of 2.2 group and estop, of 2.1
// hold_ms, too.
#define LACKS_2_3 1U
#define LACKS_2_2 (LACKS_2_3 + 2U)
#define LACKS_2_1 (LACKS_2_2 + 4U)

_Static_assert(TL_WIRE_AXES_MAX *FRAME_SIZE <= TL_TABLE_SIZE_MAX, "all settings must fit a slot");

static void use(const tl_port_t *port, tl_axis_t *axis, const tl_wire_settings_t *settings) {
    const uint32_t state = port->lock(port->context);
    tl_axis_use_settings(axis, settings);
    port->unlock(port->context, state);
}

// The settings of an axis in a slot; false where they are another firmware's, or not for this board.
static bool read_axis(const tl_port_t *port, const tl_slot_t *slot, uint8_t index, tl_wire_settings_t *settings) {
    const uint32_t size = slot->size / TL_WIRE_AXES_MAX, lacks = FRAME_SIZE - size;
    if (slot->size % TL_WIRE_AXES_MAX != 0U ||
        (lacks != 0U && lacks != LACKS_2_3 && lacks != LACKS_2_2 && lacks != LACKS_2_1)) {
        return false;
    }
    uint8_t frame[FRAME_SIZE];
    const tl_wire_settings_t defaults = tl_axis_default_settings(port, index);
    tl_wire_frame(frame, TL_WIRE_SETTINGS, 0, &defaults); // what they lack stays as it is there
    port->flash_read(port->context, slot->blob + index * size, frame, size - TL_WIRE_CRC_SIZE);
    if (frame[2] != TL_WIRE_SETTINGS ||
        !tl_wire_decode(TL_WIRE_SETTINGS, frame + TL_WIRE_HEADER_SIZE, TL_WIRE_SIZE_SETTINGS, settings)) {
        return false;
    }
    if (lacks != 0U) { // their range tells: commissioning sets it
        const bool ranged = settings->q_low_q8 != defaults.q_low_q8 || settings->q_high_q8 != defaults.q_high_q8;
        settings->commissioned = ranged ? 1U : 0U;
    }
    return settings->axis == index && tl_axis_check_settings(port, settings) == 0;
}

static bool load_slot(const tl_port_t *port, tl_axis_t *axes, const tl_slot_t *slot) {
    tl_wire_settings_t settings;
    for (uint8_t i = 0; i < port->axes; i++) {
        if (!slot->whole || !read_axis(port, slot, i, &settings)) {
            return false;
        }
    }
    for (uint8_t i = 0; i < port->axes; i++) {
        read_axis(port, slot, i, &settings);
        use(port, &axes[i], &settings);
    }
    return true;
}

uint8_t tl_settings_load(const tl_port_t *port, tl_axis_t *axes) {
    tl_slot_t slots[TL_STORE_SLOTS];
    tl_store_order(port, TL_STORE_SETTINGS, slots);
    if (load_slot(port, axes, &slots[0])) {
        const bool newest = slots[1].blank || slots[1].dated; // a damaged one of unknown age may have been newer
        return newest ? TL_WIRE_STORE_NEWEST : TL_WIRE_STORE_OLDER;
    }
    if (load_slot(port, axes, &slots[1])) {
        return TL_WIRE_STORE_OLDER;
    }
    return slots[0].blank && slots[1].blank ? TL_WIRE_STORE_DEFAULT : TL_WIRE_STORE_BAD;
}

uint8_t tl_settings_store(const tl_port_t *port, tl_axis_t *axes, const tl_wire_settings_t *settings,
                          uint8_t *scratch) {
    const uint8_t reason = tl_axis_check_settings(port, settings);
    if (reason != 0) {
        return reason;
    }
    for (uint8_t i = 0; i < TL_WIRE_AXES_MAX; i++) {
        tl_wire_settings_t of = i < port->axes ? axes[i].settings : tl_axis_default_settings(port, i);
        of = i == settings->axis ? *settings : of;
        of.key = 0;
        tl_wire_frame(scratch + i * FRAME_SIZE, TL_WIRE_SETTINGS, 0, &of);
    }
    if (!tl_store_write(port, TL_STORE_SETTINGS, 0U, scratch, TL_WIRE_AXES_MAX * FRAME_SIZE)) {
        return TL_WIRE_REASON_FLASH;
    }
    tl_wire_settings_t now = *settings;
    now.key = 0;
    use(port, &axes[settings->axis], &now);
    return 0;
}
