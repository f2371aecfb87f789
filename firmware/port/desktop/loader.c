#include "loader.h"

#include <stdlib.h>
#include <string.h>

#include "flash.h"
#include "tautline/tl_boot.h"
#include "tautline/tl_trust.h"

static uint8_t key[32];
static tl_port_update_t update = {.slot = TL_BOOT_NONE, .room = LOADER_ROOM};
static bool gave_up;
static bool (*erase_at)(void *context, uint32_t offset);
static bool (*program_at)(void *context, uint32_t offset, const uint8_t *page);

static uint32_t place(uint8_t slot, uint32_t offset) {
    return TL_PORT_FLASH_REGION + TL_PORT_FLASH_LOG + slot * LOADER_ROOM + offset;
}

static void read(void *context, uint8_t slot, uint32_t offset, uint8_t *out, size_t size) {
    (void)context;
    memcpy(out, flash_bytes + place(slot, offset), size);
}

static bool erase(void *context, uint8_t slot, uint32_t offset) {
    return erase_at(context, place(slot, offset));
}

static bool program(void *context, uint8_t slot, uint32_t offset, const uint8_t *page) {
    return program_at(context, place(slot, offset), page);
}

static bool is_signed(void *context, const uint8_t *signature, const uint8_t *message, size_t size) {
    (void)context;
    return tl_trust_is_signed(key, signature, message, size);
}

static void hash(void *context, uint8_t slot, uint32_t size, uint8_t *out) {
    const tl_port_t port = {.context = context, .update = &update};
    tl_trust_hash(&port, slot, size, out);
}

static void trial_ends(void *context, bool confirmed) {
    (void)context;
    update.trial = update.trial && !confirmed;
    gave_up = !confirmed;
}

bool loader_key(const char *digits) {
    if (strlen(digits) != 2U * sizeof(key) || strspn(digits, "0123456789abcdefABCDEF") != 2U * sizeof(key)) {
        return false;
    }
    for (size_t i = 0; i < sizeof(key); i++) {
        const char pair[] = {digits[2U * i], digits[2U * i + 1U], '\0'};
        key[i] = (uint8_t)strtoul(pair, NULL, 16);
    }
    update.key = key;
    return true;
}

loader_image_t loader_start(tl_wire_boot_t reason) {
    const tl_boot_flash_t flash = {.read = read, .room = LOADER_ROOM};
    const uint8_t failed = reason == TL_WIRE_BOOT_WATCHDOG && update.trial ? update.slot : TL_BOOT_NONE;
    const tl_boot_choice_t choice = tl_boot_choose(&flash, failed);
    gave_up = false;
    update.slot = choice.slot;
    update.trial = choice.trial;
    update.failed = failed != TL_BOOT_NONE;
    if (choice.slot == TL_BOOT_NONE) {
        return LOADER_RUNS;
    }
    const uint8_t *image = flash_bytes + place(choice.slot, TL_BOOT_IMAGE);
    return memcmp(image, "hangs", 5) == 0 ? LOADER_HANGS : (memcmp(image, "mute", 4) == 0 ? LOADER_MUTE : LOADER_RUNS);
}

const tl_port_update_t *loader_update(bool (*own_erase)(void *context, uint32_t offset),
                                      bool (*own_program)(void *context, uint32_t offset, const uint8_t *page)) {
    erase_at = own_erase;
    program_at = own_program;
    update.read = read;
    update.erase = erase;
    update.program = program;
    update.is_signed = is_signed;
    update.hash = hash;
    update.trial_ends = trial_ends;
    return update.key == NULL ? NULL : &update;
}

bool loader_gave_up(void) {
    return gave_up;
}
