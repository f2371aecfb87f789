// The app on a Pimoroni Motor 2040, or on a Pico 2 with its circuit: tl_port.h on real registers, the control step on a
// hardware timer, the task in the main loop.
#include <string.h>

#include "bridge.h"
#include "hardware/flash.h"
#include "hardware/irq.h"
#include "hardware/pwm.h"
#include "hardware/sync.h"
#include "hardware/timer.h"
#include "hardware/watchdog.h"
#include "pico/bootrom.h"
#include "pico/flash.h"
#include "pico/stdlib.h"
#include "pico/unique_id.h"
#include "quadrature.h"
#include "slots.h"
#include "tautline/tl_app.h"
#include "tautline/tl_usb.h"
#include "usb_halt.h"

#ifndef TAUTLINE_CONTROL_HZ
#define TAUTLINE_CONTROL_HZ 5000
#endif
#ifndef TAUTLINE_HALT_KEEPS_DRIVING // for who debugs, with nothing on the motors
#define TAUTLINE_HALT_KEEPS_DRIVING 0
#endif
#ifndef TAUTLINE_AXES
#define TAUTLINE_AXES MOTOR2040_NUM_MOTORS
#endif
#if TAUTLINE_CONTROL_HZ < 1000 || TAUTLINE_CONTROL_HZ > 10000 || 20000 % TAUTLINE_CONTROL_HZ != 0 ||                   \
    TAUTLINE_CONTROL_HZ % 1000 != 0
#error "TAUTLINE_CONTROL_HZ: 1000, 2000, 4000, 5000 or 10000, so that a period is whole PWM periods"
#endif
#if TAUTLINE_AXES < 1 || TAUTLINE_AXES > MOTOR2040_NUM_MOTORS
#error "TAUTLINE_AXES: 1 to 4"
#endif

enum {
    CONTROL_PERIOD_US = 1000000 / TAUTLINE_CONTROL_HZ,
    CONTROL_ALARM = 0,
    INTERRUPT_CYCLES = 50, // from the alarm to bridge_sense_start
    STORE_OFFSET = PICO_FLASH_SIZE_BYTES - TL_PORT_FLASH_REGION,
    LOG_OFFSET = STORE_OFFSET - TL_PORT_FLASH_LOG,
    DRIVER_MA = 425,      // DRV8833: 200 mV over 0.47 ohm
    SUPPLY_LOW_MV = 4000, // of motors for 5 V and more; the driver itself gives up at 2.6 V
    WATCHDOG_MS = 250,
    WATCHDOG_FLASH_MS = 800, // an erase takes 0.4 s at worst
    FLASH_TIMEOUT_MS = 100,
    ESTOP_PIN = MOTOR2040_TX_PIN, // GP16 on the board's connector, beside a ground
};

static struct {
    tl_app_t app;
    tl_port_t port;
    char serial[2 * PICO_UNIQUE_BOARD_ID_SIZE_BYTES + 1];
    int32_t sensed[BRIDGE_FAULT + 1]; // currents, supply, fault
} board;

static const uint8_t encoder_pins[] = {MOTOR2040_ENCODER_A_A_PIN, MOTOR2040_ENCODER_B_A_PIN, MOTOR2040_ENCODER_C_A_PIN,
                                       MOTOR2040_ENCODER_D_A_PIN};

// -- tl_port.h --------------------------------------------------------------------------------------------------

static tl_us_t __not_in_flash_func(port_time_us)(void *context) {
    (void)context;
    uint32_t high = timer_hw->timerawh;
    for (;;) { // until the high word stands still
        const uint32_t low = timer_hw->timerawl;
        const uint32_t again = timer_hw->timerawh;
        if (again == high) {
            return (tl_us_t)high << 32 | low;
        }
        high = again;
    }
}

static int32_t __not_in_flash_func(port_encoder)(void *context, uint8_t axis) {
    (void)context;
    return quadrature_count(axis);
}

static bool port_edges_lost(void *context, uint8_t axis) {
    (void)context;
    return quadrature_slipped(axis);
}

static void __not_in_flash_func(port_drive)(void *context, uint8_t axis, tl_duty_q15_t duty) {
    (void)context;
    bridge_drive(axis, duty);
}

static int32_t __not_in_flash_func(port_current_ma)(void *context, uint8_t axis) {
    (void)context;
    return board.sensed[axis];
}

static uint16_t __not_in_flash_func(port_supply_mv)(void *context) {
    (void)context;
    return (uint16_t)board.sensed[BRIDGE_SUPPLY];
}

static bool __not_in_flash_func(port_driver_fault)(void *context, uint8_t axis) {
    (void)context;
    (void)axis; // one line for all drivers
    return board.sensed[BRIDGE_FAULT] != 0;
}

static bool __not_in_flash_func(port_estop_closed)(void *context) {
    (void)context;
    return (sio_hw->gpio_in & 1u << ESTOP_PIN) == 0;
}

typedef struct {
    uint32_t offset;
    const uint8_t *page; // NULL: erase the sector
} flash_operation_t;

static void __not_in_flash_func(flash_operation)(void *parameter) {
    const flash_operation_t *operation = parameter;
    if (operation->page == NULL) {
        flash_range_erase(operation->offset, FLASH_SECTOR_SIZE);
    } else {
        flash_range_program(operation->offset, operation->page, FLASH_PAGE_SIZE);
    }
}

// PWM goes on while a debugger holds the core: the watchdog does too, and its restart lets every bridge coast.
void board_watch(uint32_t ms) {
    watchdog_enable(ms == 0U ? WATCHDOG_MS : ms, TAUTLINE_HALT_KEEPS_DRIVING);
}

// `offset`: in flash. The SDK's safe path: interrupts off, and so the control step stands still; the app has the motors
// off.
bool board_flash_safely(uint32_t offset, const uint8_t *page) {
    flash_operation_t operation = {offset, page};
    board_watch(WATCHDOG_FLASH_MS);
    const bool done = flash_safe_execute(flash_operation, &operation, FLASH_TIMEOUT_MS) == PICO_OK;
    board_watch(0U);
    return done;
}

// The log came later than tables and settings: it is before them.
static uint32_t store_at(uint32_t offset) {
    return offset < TL_PORT_FLASH_REGION ? STORE_OFFSET + offset : LOG_OFFSET + (offset - TL_PORT_FLASH_REGION);
}

static void port_flash_read(void *context, uint32_t offset, uint8_t *out, size_t size) {
    (void)context;
    memcpy(out, (const uint8_t *)(XIP_BASE + store_at(offset)), size);
}

static bool port_flash_erase(void *context, uint32_t offset) {
    (void)context;
    return offset < TL_PORT_FLASH_REGION + TL_PORT_FLASH_LOG && board_flash_safely(store_at(offset), NULL);
}

static bool port_flash_program(void *context, uint32_t offset, const uint8_t *page) {
    (void)context;
    return offset < TL_PORT_FLASH_REGION + TL_PORT_FLASH_LOG && board_flash_safely(store_at(offset), page);
}

static void port_watchdog_feed(void *context) {
    (void)context;
    watchdog_update();
}

static uint32_t __not_in_flash_func(port_lock)(void *context) {
    (void)context;
    return save_and_disable_interrupts();
}

static void __not_in_flash_func(port_unlock)(void *context, uint32_t state) {
    (void)context;
    restore_interrupts(state);
}

static void port_reboot(void *context, bool bootloader) {
    (void)context;
    slots_end_trial();
    if (bootloader) {
        rom_reset_usb_boot(0, 0);
    }
    watchdog_reboot(0, 0, 0);
}

// -- control step -----------------------------------------------------------------------------------------------

// An alarm goes off where the timer equals it: one that has passed while it was set would be 71 minutes late. Whole
// periods later, as the current is measured where the PWM of every period has its bridge driving.
static void __not_in_flash_func(set_alarm)(uint32_t due) {
    timer_hw->alarm[CONTROL_ALARM] = due;
    for (;;) {
        const uint32_t late_us = timer_hw->timerawl - due;
        if ((int32_t)late_us < 0 || (timer_hw->armed & 1u << CONTROL_ALARM) == 0) {
            return;
        }
        due += (late_us / CONTROL_PERIOD_US + 1u) * CONTROL_PERIOD_US;
        timer_hw->alarm[CONTROL_ALARM] = due;
    }
}

static void __not_in_flash_func(control_interrupt)(void) {
    hw_clear_bits(&timer_hw->intr, 1u << CONTROL_ALARM);
    // From the time it was due, not from now: no drift. After a flash operation that may lie behind.
    set_alarm(timer_hw->alarm[CONTROL_ALARM] + CONTROL_PERIOD_US);

    bridge_sense_start();
    tl_app_control(&board.app);
    unsigned what;
    const int32_t value = bridge_sense_finish(&what);
    board.sensed[what] = value;
}

// In RAM, and not a part of its caller: from flash it would take as long as the cache makes it.
static void __no_inline_not_in_flash_func(start_in_time)(uint32_t bridges) {
    const uint32_t now = timer_hw->timerawl;
    while (timer_hw->timerawl == now) {
    }
    pwm_hw->en = bridges;
    timer_hw->alarm[CONTROL_ALARM] = now + 1 + CONTROL_PERIOD_US;
}

static void start_control(void) {
    hardware_alarm_claim(CONTROL_ALARM);
    const unsigned interrupt = TIMER_ALARM_IRQ_NUM(timer_hw, CONTROL_ALARM);
    irq_set_exclusive_handler(interrupt, control_interrupt);
    irq_set_priority(interrupt, PICO_HIGHEST_IRQ_PRIORITY);
    hw_set_bits(&timer_hw->inte, 1u << CONTROL_ALARM);
    irq_set_enabled(interrupt, true);
    const uint32_t bridges = bridge_align(CONTROL_PERIOD_US * (SYS_CLK_HZ / 1000000) + INTERRUPT_CYCLES);
    const uint32_t state = save_and_disable_interrupts();
    start_in_time(bridges);
    restore_interrupts(state);
}

// -- what must never happen -------------------------------------------------------------------------------------

// PWM goes on without the core: first the motors. Then a debugger is told, until the watchdog restarts the board.
static _Noreturn void __not_in_flash_func(coast_and_wait)(void) {
    bridge_coast_all();
    for (;;) {
        __breakpoint();
    }
}

void isr_hardfault(void); // of the SDK's vector table
void isr_nmi(void);
void __not_in_flash_func(isr_hardfault)(void) {
    coast_and_wait();
}
void __not_in_flash_func(isr_nmi)(void) {
    coast_and_wait();
}

// What the SDK's panic() becomes (PICO_PANIC_FUNCTION): it says nothing, there is nobody to read it.
_Noreturn void board_panic(const char *format, ...);
_Noreturn void __not_in_flash_func(board_panic)(const char *format, ...) {
    (void)format;
    coast_and_wait();
}

// ---------------------------------------------------------------------------------------------------------------

static tl_wire_boot_t boot_reason(void) {
    if (!watchdog_caused_reboot()) {
        return TL_WIRE_BOOT_POWER;
    }
    return watchdog_enable_caused_reboot() ? TL_WIRE_BOOT_WATCHDOG : TL_WIRE_BOOT_REQUEST;
}

int main(void) {
    const tl_wire_boot_t boot = boot_reason();
    bridge_init();
    gpio_init(ESTOP_PIN);
    gpio_pull_up(ESTOP_PIN);
    quadrature_init(encoder_pins, TAUTLINE_AXES); // waits until its pull-ups have settled, too
    pico_get_unique_board_id_string(board.serial, sizeof(board.serial));
    board.port = (tl_port_t){
        .name = TAUTLINE_PORT,
        .serial = board.serial,
        .axes = TAUTLINE_AXES,
        .boot = (uint8_t)boot,
        .keeps_log = true,
        .control_hz = TAUTLINE_CONTROL_HZ,
        .time_us = port_time_us,
        .encoder = port_encoder,
        .edges_lost = port_edges_lost,
        .drive = port_drive,
        .driver_ma = DRIVER_MA,
        .supply_low_mv = SUPPLY_LOW_MV,
        .current_ma = port_current_ma,
        .supply_mv = port_supply_mv,
        .driver_fault = port_driver_fault,
        .estop_closed = port_estop_closed,
        .flash_read = port_flash_read,
        .flash_erase = port_flash_erase,
        .flash_program = port_flash_program,
        .watchdog_feed = port_watchdog_feed,
        .lock = port_lock,
        .unlock = port_unlock,
        .reboot = port_reboot,
        .update = slots_update(&board.port),
    };
    tl_app_init(&board.app, &board.port);
    tl_usb_init(&board.app);
    board_watch(0U);
    start_control();
    for (;;) {
        tl_app_task(&board.app);
        tl_usb_task();
        usb_halt_task();
        __wfi();
    }
}
