// The desktop board: the firmware's app on simulated motors, flash and watchdog, in virtual time.
#ifndef BOARD_H
#define BOARD_H

#include <stdbool.h>
#include <stdint.h>

#include "plant.h"
#include "tautline/tl_app.h"

#define BOARD_LOG 16384U // milliseconds of true motor positions kept

typedef struct {
    uint8_t axes;
    uint32_t control_hz;
    const char *serial;
    const char *flash_file; // NULL: lost with the process
    bool on_uart;           // the host is on the serial port, not on USB
} board_options_t;

typedef struct {
    tl_us_t t_us;    // of the world, never falls
    tl_us_t boot_us; // when the board last started: its own clock is t_us - boot_us
    bool powered;    // false after a power cut
    bool bootloader; // it waits there for firmware
    bool hung;       // the main loop stands still
    bool mute;       // its firmware does not come up on the bus
    uint32_t starts;
    uint32_t flash_operations; // since the process began
    uint32_t cut_in;           // flash operations until the power is cut; 0: never
    uint64_t log_end;          // milliseconds logged since the process began
} board_state_t;

// False: the flash file cannot be used, with a message on stderr.
bool board_open(const board_options_t *options);
const board_state_t *board_state(void);
const tl_app_t *board_app(void);

// Power on, with the reset's reason; motors and time go on where they are.
void board_start(tl_wire_boot_t reason);
void board_cut(uint32_t operations); // 0: take it back
void board_hang(void);

// Runs the world for one MOTOR_STEP_US, and in it what the board has to do.
void board_step(void);
// The board's main loop, once.
void board_task(void);
// True motor position at the end of millisecond `index` (counted from 1), counts Q8; of the last BOARD_LOG.
int32_t board_log(uint64_t index, uint8_t axis);
int32_t board_true_q8(uint8_t axis);
// Sets a motor, at rest, to a true position (counts Q8): where the instrument was put by hand.
void board_place(uint8_t axis, int32_t q_q8);
void board_inject(uint8_t axis, plant_ill_t ill);
const char *board_ill(uint8_t axis);

// Whether the device is on its USB bus.
bool board_on_bus(void);

#endif
