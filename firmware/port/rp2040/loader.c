// What runs first: it picks one of two slots (tl_boot.h) and jumps into its image, or into the boot ROM's USB drive
// where there is none. It writes no flash and is never written over, so that nothing it does can be cut short. The
// clock is still the ring oscillator's, some 6.5 MHz: the checksum of an image takes a third of a second.
#include "hardware/regs/addressmap.h"
#include "hardware/regs/m0plus.h"
#include "hardware/structs/psm.h"
#include "hardware/structs/watchdog.h"
#include "pico/bootrom.h"
#include "slots.h"
#include "tautline/tl_boot.h"

enum {
    TICK_CYCLES = 6,         // of the ring oscillator, about a microsecond
    TRIAL_US = 2000000,      // until the image has its own watchdog: it needs 30 ms
    DECREMENTS_PER_TICK = 2, // erratum RP2040-E1
    STACK_TOP = SRAM_END,
};

void loader_main(void);

__attribute__((section(".vectors"), used)) static const uintptr_t vectors[] = {STACK_TOP, (uintptr_t)loader_main};

static void read(void *context, uint8_t slot, uint32_t offset, uint8_t *out, size_t size) {
    (void)context;
    const uint8_t *from = (const uint8_t *)(XIP_BASE + SLOTS_BEGIN(slot) + offset);
    for (size_t i = 0; i < size; i++) {
        out[i] = from[i];
    }
}

// From now on the image has this long to come up; its own watchdog takes over.
static void watch_trial(uint8_t slot) {
    SLOTS_TRIAL_OF = SLOTS_TRIAL | slot;
    watchdog_hw->scratch[4] = SLOTS_WATCHDOG_MAGIC;
    psm_hw->wdsel = PSM_WDSEL_BITS & ~(PSM_WDSEL_ROSC_BITS | PSM_WDSEL_XOSC_BITS);
    watchdog_hw->tick = WATCHDOG_TICK_ENABLE_BITS | TICK_CYCLES;
    watchdog_hw->load = TRIAL_US * DECREMENTS_PER_TICK;
    watchdog_hw->ctrl = WATCHDOG_CTRL_ENABLE_BITS;
}

static _Noreturn void run(uint8_t slot) {
    const uintptr_t *image = (const uintptr_t *)(XIP_BASE + SLOTS_BEGIN(slot) + TL_BOOT_IMAGE + SLOTS_VECTORS);
    *(volatile uintptr_t *)(PPB_BASE + M0PLUS_VTOR_OFFSET) = (uintptr_t)image;
    __asm volatile("msr msp, %0\n bx %1" ::"r"(image[0]), "r"(image[1]));
    __builtin_unreachable();
}

void loader_main(void) {
    const tl_boot_flash_t flash = {.read = read, .room = SLOT_ROOM};
    const uint32_t tried = SLOTS_TRIAL_OF & ~1U;
    const bool bitten = watchdog_hw->reason != 0U && tried == SLOTS_TRIAL;
    const uint8_t failed = bitten ? (uint8_t)(SLOTS_TRIAL_OF & 1U) : TL_BOOT_NONE;
    const tl_boot_choice_t choice = tl_boot_choose(&flash, failed);
    SLOTS_TRIAL_OF = 0U;
    SLOTS_FAILED_OF = bitten ? SLOTS_FAILED | failed : 0U;
    if (choice.slot == TL_BOOT_NONE) {
        ((rom_reset_usb_boot_fn)rom_func_lookup_inline(ROM_FUNC_RESET_USB_BOOT))(0, 0);
        __builtin_unreachable();
    }
    if (choice.trial) {
        watch_trial(choice.slot);
    }
    run(choice.slot);
}
