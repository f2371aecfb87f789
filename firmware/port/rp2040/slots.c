#include "slots.h"

#include <string.h>

#include "hardware/regs/addressmap.h"
#include "hardware/watchdog.h"
#include "tautline/tl_boot.h"
#include "tautline/tl_trust.h"

enum {
    CHECK_MS = 500, // of a signature: 170 with a flash that has no cache misses
    WATCHDOG_CHECK_MS = 4000,
};

static struct {
    tl_port_update_t update;
    const tl_port_t *port;
} slots;

static const uint8_t update_key[] = {TAUTLINE_UPDATE_KEY};

static void port_slot_read(void *context, uint8_t slot, uint32_t offset, uint8_t *out, size_t size) {
    (void)context;
    memcpy(out, (const uint8_t *)(XIP_BASE + SLOTS_BEGIN(slot)) + offset, size);
}

static bool may_write(uint8_t slot, uint32_t offset) {
    return slot < TL_BOOT_SLOTS && offset < SLOT_ROOM;
}

static bool port_slot_erase(void *context, uint8_t slot, uint32_t offset) {
    (void)context;
    return may_write(slot, offset) && board_flash_safely(SLOTS_BEGIN(slot) + offset, NULL);
}

static bool port_slot_program(void *context, uint8_t slot, uint32_t offset, const uint8_t *page) {
    (void)context;
    return may_write(slot, offset) && board_flash_safely(SLOTS_BEGIN(slot) + offset, page);
}

static bool port_is_signed(void *context, const uint8_t *signature, const uint8_t *message, size_t size) {
    (void)context;
    board_watch(WATCHDOG_CHECK_MS);
    const bool is_signed = tl_trust_is_signed(update_key, signature, message, size);
    board_watch(0U);
    return is_signed;
}

static void port_hash(void *context, uint8_t slot, uint32_t size, uint8_t *out) {
    (void)context;
    board_watch(WATCHDOG_CHECK_MS);
    tl_trust_hash(slots.port, slot, size, out);
    board_watch(0U);
}

static void port_trial_ends(void *context, bool confirmed) {
    (void)context;
    if (confirmed) {
        slots_end_trial();
    } else {
        hw_set_bits(&watchdog_hw->ctrl, WATCHDOG_CTRL_TRIGGER_BITS); // the loader finds a trial that did not end well
    }
}

void slots_end_trial(void) {
    SLOTS_TRIAL_OF = 0U;
}

const tl_port_update_t *slots_update(const tl_port_t *port) {
    const uint8_t slot = (uintptr_t)update_key < XIP_BASE + SLOTS_BEGIN(1U) ? 0U : 1U; // by where this is linked
    slots.port = port;
    slots.update = (tl_port_update_t){
        .key = update_key,
        .room = SLOT_ROOM,
        .slot = slot,
        .trial = SLOTS_TRIAL_OF == (SLOTS_TRIAL | slot),
        .failed = SLOTS_FAILED_OF == (SLOTS_FAILED | (slot ^ 1U)),
        .check_ms = CHECK_MS,
        .read = port_slot_read,
        .erase = port_slot_erase,
        .program = port_slot_program,
        .is_signed = port_is_signed,
        .hash = port_hash,
        .trial_ends = port_trial_ends,
    };
    return &slots.update;
}
