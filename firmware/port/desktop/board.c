#include "board.h"

#include <stdio.h>
#include <string.h>
#include <tusb.h>

#include "flash.h"
#include "loader.h"
#include "tautline/tl_usb.h"
#include "uart.h"

#define WATCHDOG_US 1000000U

static tl_app_t app;
static tl_port_t port;
static board_state_t state = {.powered = true};
static plant_t plant;
static int32_t log_q8[BOARD_LOG][TL_WIRE_AXES_MAX];
static tl_us_t next_control_us;
static tl_us_t fed_us;
static bool on_uart;
static int restart; // asked for: 0 no, 1 restart, 2 boot loader

// -- the port ---------------------------------------------------------------------------------------------------

static tl_us_t port_time(void *context) {
    (void)context;
    return state.t_us - state.boot_us;
}

static int32_t port_encoder(void *context, uint8_t axis) {
    (void)context;
    return plant_encoder(&plant, axis);
}

static void port_drive(void *context, uint8_t axis, tl_duty_q15_t duty) {
    (void)context;
    plant_drive(&plant, axis, duty);
}

static int32_t port_current(void *context, uint8_t axis) {
    (void)context;
    return plant_current_ma(&plant, axis);
}

static uint16_t port_supply(void *context) {
    (void)context;
    return plant.supply_mv;
}

static bool port_driver_fault(void *context, uint8_t axis) {
    (void)context;
    return plant_driver_fault(&plant, axis);
}

static bool port_estop_closed(void *context) {
    (void)context;
    return plant.estop_closed;
}

// Counts an operation; false when the power is cut in it.
static bool operate(void) {
    state.flash_operations++;
    return state.cut_in == 0U || --state.cut_in > 0U;
}

static void lose_power(void) {
    state.powered = false;
    plant_release(&plant);
}

static bool port_edges_lost(void *context, uint8_t axis) {
    (void)context;
    (void)axis;
    return false; // it counts as fast as its motors turn
}

static void port_read(void *context, uint32_t offset, uint8_t *out, size_t size) {
    (void)context;
    memcpy(out, flash_bytes + offset, size);
}

static bool port_erase(void *context, uint32_t offset) {
    (void)context;
    if (!state.powered) {
        return false;
    }
    const bool whole = operate();
    const bool done = flash_do_erase(offset, whole);
    if (!whole) {
        lose_power();
    }
    return done && whole;
}

static bool port_program(void *context, uint32_t offset, const uint8_t *page) {
    (void)context;
    if (!state.powered) {
        return false;
    }
    const bool whole = operate();
    const bool done = flash_do_program(offset, page, whole);
    if (!whole) {
        lose_power();
    }
    return done && whole;
}

static void port_feed(void *context) {
    (void)context;
    fed_us = state.t_us;
}

// One thread: nothing to keep out.
static uint32_t port_lock(void *context) {
    (void)context;
    return 0;
}

static void port_unlock(void *context, uint32_t locked) {
    (void)context;
    (void)locked;
}

static void port_reboot(void *context, bool bootloader) {
    (void)context;
    restart = bootloader ? 2 : 1;
}

uint32_t tusb_time_millis_api(void) {
    return (uint32_t)(state.t_us / 1000U);
}

// -- power and time ---------------------------------------------------------------------------------------------

bool board_open(const board_options_t *options) {
    if (!flash_open(options->flash_file)) {
        fprintf(stderr, "tautline-board: %s cannot be used as the flash: name a file that can be written\n",
                options->flash_file);
        return false;
    }
    on_uart = options->on_uart;
    plant_init(&plant, options->axes);
    port = (tl_port_t){
        .name = "desktop",
        .serial = options->serial,
        .axes = options->axes,
        .control_hz = options->control_hz,
        .keeps_log = true,
        .driver_ma = PLANT_DRIVER_MA,
        .supply_low_mv = PLANT_LEAST_MV,
        .time_us = port_time,
        .encoder = port_encoder,
        .edges_lost = port_edges_lost,
        .drive = port_drive,
        .current_ma = port_current,
        .supply_mv = port_supply,
        .driver_fault = port_driver_fault,
        .estop_closed = port_estop_closed,
        .flash_read = port_read,
        .flash_erase = port_erase,
        .flash_program = port_program,
        .watchdog_feed = port_feed,
        .lock = port_lock,
        .unlock = port_unlock,
        .reboot = port_reboot,
        .update = loader_update(port_erase, port_program),
    };
    board_start(TL_WIRE_BOOT_POWER);
    return true;
}

const board_state_t *board_state(void) {
    return &state;
}
const tl_app_t *board_app(void) {
    return &app;
}
bool board_on_bus(void) {
    return state.powered && !state.bootloader && !state.mute;
}

void board_start(tl_wire_boot_t reason) {
    const loader_image_t image = loader_start(reason);
    port.boot = (uint8_t)reason;
    state.boot_us = state.t_us;
    state.powered = true;
    state.bootloader = false;
    state.hung = image == LOADER_HANGS;
    state.mute = image == LOADER_MUTE;
    state.cut_in = 0;
    state.starts++;
    restart = 0;
    fed_us = state.t_us;
    next_control_us = state.t_us;
    plant_start(&plant);
    tl_app_init(&app, &port);
    if (on_uart) {
        tl_serial_init(&app, uart_line());
        return;
    }
    if (tud_inited()) {
        tud_deinit(0);
    }
    tl_usb_init(&app);
}

static void host_task(void) {
    if (on_uart) {
        tl_serial_task();
    } else {
        tl_usb_task();
    }
}

void board_cut(uint32_t operations) {
    state.cut_in = operations;
}
void board_hang(void) {
    state.hung = true;
}

void board_task(void) {
    if (!state.powered || state.bootloader || state.hung) {
        return;
    }
    host_task();
    tl_app_task(&app);
    host_task();
    if (restart == 1) {
        board_start(TL_WIRE_BOOT_REQUEST);
    } else if (loader_gave_up()) {
        board_start(TL_WIRE_BOOT_WATCHDOG);
    } else if (restart == 2) {
        state.bootloader = true;
        lose_power();
        state.powered = true; // only the motors
    }
}

void board_step(void) {
    const bool runs = state.powered && !state.bootloader;
    if (runs && state.t_us >= next_control_us) {
        next_control_us += 1000000U / port.control_hz;
        tl_app_control(&app);
        board_task();
        if (state.t_us - fed_us > WATCHDOG_US) {
            board_start(TL_WIRE_BOOT_WATCHDOG);
        }
    }
    plant_step(&plant);
    state.t_us += MOTOR_STEP_US;
    if (state.t_us % 1000U == 0U) {
        for (uint8_t i = 0; i < port.axes; i++) {
            log_q8[state.log_end % BOARD_LOG][i] = board_true_q8(i);
        }
        state.log_end++;
    }
}

int32_t board_log(uint64_t index, uint8_t axis) {
    return log_q8[(index - 1U) % BOARD_LOG][axis];
}

int32_t board_true_q8(uint8_t axis) {
    return plant_true_q8(&plant, axis);
}
void board_inject(uint8_t axis, plant_ill_t ill) {
    plant_inject(&plant, axis, ill);
}
const char *board_ill(uint8_t axis) {
    return plant_ill_name(&plant, axis);
}
void board_place(uint8_t axis, int32_t q_q8) {
    plant_place(&plant, axis, q_q8);
}
