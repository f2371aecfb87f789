/// The world of the emulated board: its motors and flash chip, and time, which goes on only as far as it is granted.
///
/// QEMU has no motors. They are here, moved by the timer's interrupt; a second serial port carries what the sim link of
/// other simulated boards says (tools/qemu/board.py). All of it outlives a reset of the chip, as a world does.
#ifndef TAUTLINE_MPS2_WORLD_H
#define TAUTLINE_MPS2_WORLD_H

#include "plant.h"
#include "uart.h"

#define WORLD_LOG 10240U ///< milliseconds of true motor positions kept

typedef struct {
    uint32_t magic;      ///< else the power has just come on
    uint32_t ticks;      ///< of the timer since then
    uint32_t boot_ticks; ///< when the board started last
    uint32_t starts;
    uint32_t flash_operations;
    uint32_t cut_in;            ///< flash operations until the power is cut; 0: never
    uint32_t line_in, line_out; ///< bytes of the host's line, so that the other end knows what is still on its way
    uint8_t boot;               ///< tl_wire_boot_t of the next start
    bool reset;                 ///< one was asked for, and is answered once it is over: bytes in between would be lost
    bool announced;             ///< time was granted, and is run once the host's bytes before it have come
    bool running;               ///< it is being run
    uint32_t granted;           ///< ticks left
    uint32_t expected_in;       ///< line_in by then
    uint32_t told;              ///< milliseconds of the log that were reported
    bool powered, bootloader, hung;
    plant_t plant;
    uint32_t logged; ///< milliseconds since the power came on
    int32_t log_q8[WORLD_LOG][TL_WIRE_AXES_MAX];
} world_t;

/// What the board was made as: tools/qemu/board.py writes it into the PSRAM above the flash chip.
typedef struct {
    uint32_t axes, control_hz;
    char serial[32];
} world_options_t;

extern world_t world;
extern uart_t world_uart;

const world_options_t *world_options(void);

/// First thing of every start.
void world_start(void);

/// The timer's tick, before the control step: motors and time.
void world_tick(void);

/// Requests of the sim link. `idle`: the board has nothing to do until time goes on.
void world_task(bool idle);

/// Flash: as tl_port.h has it.
void world_flash_read(uint32_t offset, uint8_t *out, size_t size);
bool world_flash_erase(uint32_t offset);
bool world_flash_program(uint32_t offset, const uint8_t *page);

/// The power of the board goes, its motors coast; the world goes on.
void world_lose_power(void);
static inline bool world_runs_board(void) {
    return world.powered && !world.bootloader && !world.hung;
}

// -- of main.c --------------------------------------------------------------------------------------------------

/// Lets time go on, or stand still.
void board_clock(bool on);
/// Starts the board again for this reason; does not return.
_Noreturn void board_restart(uint8_t reason);
/// An axis as the firmware sees it, for the sim link's `state`.
typedef struct {
    int32_t q_q8, q_ref_q8, duty_q15;
    uint32_t mode, fault, flags;
} board_axis_t;
board_axis_t board_axis(uint8_t axis);

#endif
