// The app on a Cortex-M4 or M33 with a serial port: Arm's MPS2 board as QEMU has it. The control step on a timer's
// interrupt, the task in the main loop, the host on UART 0, and in place of a motor driver the world of world.h.
#include "tautline/tl_app.h"
#include "tautline/tl_axis_watch.h"
#include "tautline/tl_serial.h"
#include "world.h"

#define WATCHDOG_MS 1000U
#define WORLD_BAUD  1562500U // QEMU takes any
#define PATIENCE    200U     // rounds with nothing to do before it sleeps: QEMU takes long to wake up

static struct {
    tl_app_t app;
    tl_port_t port;
    tl_serial_t line;
    uart_t uart;
    uint32_t period_us; // of the timer
    uint32_t fed;       // tick at which the watchdog was fed last
    uint8_t restart;    // asked for: 0 no, 1 restart, 2 boot loader
} board;

void fault_handler(void);
void control_interrupt(void);
void line_interrupt(void);
void line_sent_interrupt(void);
void world_interrupt(void);

static uint32_t now(void) {
    return *(volatile uint32_t *)&world.ticks;
}

// -- tl_port.h --------------------------------------------------------------------------------------------------

// In whole ticks: what the task does between two of them then takes no time, so that runs repeat exactly.
static tl_us_t port_time_us(void *context) {
    (void)context;
    return (tl_us_t)(now() - world.boot_ticks) * board.period_us;
}

static int32_t port_encoder(void *context, uint8_t axis) {
    (void)context;
    return plant_encoder(&world.plant, axis);
}

static bool port_edges_lost(void *context, uint8_t axis) {
    (void)context;
    (void)axis;
    return false; // it counts as fast as its motors turn
}

static void port_drive(void *context, uint8_t axis, tl_duty_q15_t duty) {
    (void)context;
    plant_drive(&world.plant, axis, duty);
}

static int32_t port_current_ma(void *context, uint8_t axis) {
    (void)context;
    return plant_current_ma(&world.plant, axis);
}

static uint16_t port_supply_mv(void *context) {
    (void)context;
    return world.plant.supply_mv;
}

static bool port_driver_fault(void *context, uint8_t axis) {
    (void)context;
    return plant_driver_fault(&world.plant, axis);
}

static bool port_estop_closed(void *context) {
    (void)context;
    return world.plant.estop_closed;
}

static void port_flash_read(void *context, uint32_t offset, uint8_t *out, size_t size) {
    (void)context;
    world_flash_read(offset, out, size);
}

static bool port_flash_erase(void *context, uint32_t offset) {
    (void)context;
    return world_flash_erase(offset);
}

static bool port_flash_program(void *context, uint32_t offset, const uint8_t *page) {
    (void)context;
    return world_flash_program(offset, page);
}

static void port_watchdog_feed(void *context) {
    (void)context;
    board.fed = world.ticks;
}

static uint32_t port_lock(void *context) {
    (void)context;
    return interrupts_off();
}

static void port_unlock(void *context, uint32_t state) {
    (void)context;
    interrupts_restore(state);
}

static void port_reboot(void *context, bool bootloader) {
    (void)context;
    board.restart = bootloader ? 2U : 1U;
}

static size_t line_read(void *context, uint8_t *out, size_t room) {
    (void)context;
    return uart_read(&board.uart, out, room);
}

static size_t line_write(void *context, const uint8_t *bytes, size_t size) {
    (void)context;
    const size_t sent = uart_write(&board.uart, bytes, size);
    world.line_out += (uint32_t)sent;
    return sent;
}

// -- interrupts -------------------------------------------------------------------------------------------------

void line_interrupt(void) {
    world.line_in += uart_interrupt(&board.uart);
}

void line_sent_interrupt(void) {
    uart_has_sent(&board.uart);
}

void world_interrupt(void) {
    uart_interrupt(&world_uart);
}

// The watchdog is the timer's: it goes on while the main loop stands still.
void control_interrupt(void) {
    TIMER0->interrupt = 1U;
    world_tick();
    if (!world.powered || world.bootloader) {
        return;
    }
    tl_app_control(&board.app);
    if (world.ticks - board.fed > WATCHDOG_MS * board.port.control_hz / 1000U) {
        board_restart(TL_WIRE_BOOT_WATCHDOG);
    }
}

// First the motors, then a start that tells of it.
void fault_handler(void) {
    plant_release(&world.plant);
    board_restart(TL_WIRE_BOOT_WATCHDOG);
}

// -- what the world asks for ------------------------------------------------------------------------------------

void board_clock(bool on) {
    TIMER0->control = on ? TIMER_ENABLE | TIMER_INTERRUPT_ENABLE : 0U;
}

_Noreturn void board_restart(uint8_t reason) {
    world.boot = reason;
    chip_reset();
}

board_axis_t board_axis(uint8_t index) {
    const tl_axis_t *axis = &board.app.axes[index];
    return (board_axis_t){
        .q_q8 = axis->q,
        .q_ref_q8 = axis->path.q,
        .duty_q15 = axis->motor.duty,
        .mode = axis->mode,
        .fault = axis->fault,
        .flags = tl_axis_flags(axis),
    };
}

// ---------------------------------------------------------------------------------------------------------------

static void start(void) {
    const world_options_t *options = world_options();
    board.period_us = 1000000U / options->control_hz;
    board.fed = world.ticks;
    board.port = (tl_port_t){
        .name = MACHINE_NAME,
        .serial = options->serial,
        .axes = (uint8_t)options->axes,
        .boot = world.boot,
        .control_hz = options->control_hz,
        .driver_ma = PLANT_DRIVER_MA,
        .supply_low_mv = PLANT_LEAST_MV,
        .time_us = port_time_us,
        .encoder = port_encoder,
        .edges_lost = port_edges_lost,
        .drive = port_drive,
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
    };
    TIMER0->reload = TIMER0->value = MPS2_CLOCK_HZ / options->control_hz;
    board.line = (tl_serial_t){.read = line_read, .write = line_write};
    tl_app_init(&board.app, &board.port);
    tl_serial_init(&board.app, &board.line);
}

// Whether there was anything to do.
static bool work(void) {
    if (!world_runs_board()) {
        return false;
    }
    const bool came = tl_serial_task();
    tl_app_task(&board.app);
    const bool went = tl_serial_task();
    if (board.restart == 1U) {
        board_restart(TL_WIRE_BOOT_REQUEST);
    } else if (board.restart == 2U) { // there is none: it waits for a reset
        world.bootloader = true;
        plant_release(&world.plant);
    }
    return came || went;
}

int main(void) {
    world_start();
    uart_init(&board.uart, UART0, TL_WIRE_SERIAL_BAUD);
    uart_init(&world_uart, UART1, WORLD_BAUD);
    start();
    interrupt_enable(IRQ_TIMER0, 0x00U); // the control step comes first
    interrupt_enable(IRQ_UART0_RX, 0x40U);
    interrupt_enable(IRQ_UART0_TX, 0x40U);
    interrupt_enable(IRQ_UART1_RX, 0x40U);
    if (world.running && world.granted > 0U) { // the board has restarted in the middle of it
        board_clock(true);
    }
    uint32_t patience = PATIENCE;
    uint32_t rests = 0; // rounds in a row with nothing to do
    for (;;) {
        const bool idle = !work();
        rests = idle ? rests + 1U : 0U;
        world_task(rests > 1U);
        if (world.running && world.granted > 0U) { // then there is nothing to do before the next tick
            for (const uint32_t tick = now(); rests > 1U && now() == tick;) {
            }
            patience = PATIENCE;
            continue;
        }
        patience = !idle ? PATIENCE : patience > 0U ? patience - 1U : 0U;
        const uint32_t state = interrupts_off();
        if (patience == 0U && uart_rests(&board.uart) && uart_rests(&world_uart)) {
            wait_for_interrupt();
        }
        interrupts_restore(state);
    }
}
