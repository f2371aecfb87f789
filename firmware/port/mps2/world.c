#include "world.h"

#include <stdarg.h>
#include <string.h>

#define MAGIC    0x574F524CU // "WORL"
#define FLASH    PSRAM
#define OPTIONS  (PSRAM + 0x00F00000U)
#define LINE_MAX 80U

__attribute__((section(".noinit"))) world_t world;
uart_t world_uart;

static char line[LINE_MAX];
static size_t line_size;

const world_options_t *world_options(void) {
    return (const world_options_t *)OPTIONS;
}

void world_start(void) {
    if (world.magic != MAGIC) {
        memset(&world, 0, sizeof(world));
        world.magic = MAGIC;
        world.boot = TL_WIRE_BOOT_POWER;
        plant_init(&world.plant, (uint8_t)world_options()->axes);
    }
    world.boot_ticks = world.ticks;
    world.powered = true;
    world.bootloader = world.hung = false;
    world.cut_in = 0;
    world.starts++;
    plant_start(&world.plant);
}

// -- flash ------------------------------------------------------------------------------------------------------

void world_flash_read(uint32_t offset, uint8_t *out, size_t size) {
    memcpy(out, FLASH + offset, size);
}

void world_lose_power(void) {
    world.powered = false;
    plant_release(&world.plant);
}

// Counts an operation; false when the power is cut in it.
static bool operate(void) {
    world.flash_operations++;
    return world.cut_in == 0U || --world.cut_in > 0U;
}

static bool is_place(uint32_t offset, uint32_t size) {
    return world.powered && offset % size == 0U && offset < TL_PORT_FLASH_REGION;
}

static bool done(bool whole) {
    if (!whole) {
        world_lose_power();
    }
    return whole;
}

bool world_flash_erase(uint32_t offset) {
    if (!is_place(offset, TL_PORT_FLASH_SECTOR)) {
        return false;
    }
    const bool whole = operate();
    memset(FLASH + offset, 0xFF, whole ? TL_PORT_FLASH_SECTOR : TL_PORT_FLASH_SECTOR / 2U);
    return done(whole);
}

bool world_flash_program(uint32_t offset, const uint8_t *page) {
    if (!is_place(offset, TL_PORT_FLASH_PAGE)) {
        return false;
    }
    const bool whole = operate();
    for (uint32_t i = 0; i < (whole ? TL_PORT_FLASH_PAGE : TL_PORT_FLASH_PAGE / 2U); i++) {
        FLASH[offset + i] &= page[i];
    }
    return done(whole);
}

// -- time -------------------------------------------------------------------------------------------------------

void world_tick(void) {
    const uint32_t period_us = 1000000U / world_options()->control_hz;
    for (uint32_t us = 0; us < period_us; us += MOTOR_STEP_US) {
        plant_step(&world.plant);
    }
    world.ticks = world.ticks + 1U;
    if (world.ticks % (world_options()->control_hz / 1000U) == 0U) {
        for (uint8_t i = 0; i < world.plant.axes; i++) {
            world.log_q8[world.logged % WORLD_LOG][i] = plant_true_q8(&world.plant, i);
        }
        world.logged = world.logged + 1U;
    }
    if (world.granted > 0U && --world.granted == 0U) {
        board_clock(false);
    }
}

// -- the sim link -----------------------------------------------------------------------------------------------

static void put_text(const char *text) {
    size_t size = strlen(text);
    while (size > 0U) {
        const size_t sent = uart_write(&world_uart, (const uint8_t *)text, size);
        text += sent;
        size -= sent;
    }
}

static void put_number(int32_t value) {
    char text[13];
    char *at = text + sizeof(text) - 1;
    uint32_t left = value < 0 ? 0U - (uint32_t)value : (uint32_t)value;
    *at = '\0';
    do {
        *--at = (char)('0' + left % 10U);
        left /= 10U;
    } while (left > 0U);
    if (value < 0) {
        *--at = '-';
    }
    *--at = ' ';
    put_text(at);
}

// After the word: how many numbers, the numbers.
static void answer(const char *word, unsigned count, ...) {
    put_text(word);
    va_list numbers;
    va_start(numbers, count);
    while (count-- > 0U) {
        put_number(va_arg(numbers, int32_t));
    }
    va_end(numbers);
}

static void end_answer(void) {
    put_text("\n");
}

// What a run has left: how many ticks and bytes there were in all, and the true positions of each millisecond.
static void report_run(void) {
    answer("ran", 3, (int32_t)world.ticks, (int32_t)world.line_out, (int32_t)world.told);
    if (world.logged - world.told > WORLD_LOG) {
        world.told = world.logged - WORLD_LOG;
    }
    for (; world.told != world.logged; world.told++) {
        for (uint8_t i = 0; i < world.plant.axes; i++) {
            put_number(world.log_q8[world.told % WORLD_LOG][i]);
        }
    }
    end_answer();
}

static void report_state(void) {
    answer("state", 9, (int32_t)world.ticks, (int32_t)world.boot_ticks, (int32_t)world.powered,
           (int32_t)world.bootloader, (int32_t)world.hung, (int32_t)world.starts, (int32_t)world.flash_operations,
           (int32_t)world.line_in, (int32_t)world.line_out);
    for (uint8_t i = 0; i < world.plant.axes; i++) {
        const board_axis_t axis = board_axis(i);
        answer("", 7, plant_true_q8(&world.plant, i), axis.q_q8, axis.q_ref_q8, axis.duty_q15, (int32_t)axis.mode,
               (int32_t)axis.fault, (int32_t)axis.flags);
    }
    end_answer();
}

// The next word of the line as a number, or 0 without one.
static int32_t next_number(void) {
    const char *word = strtok(NULL, " ");
    if (word == NULL) {
        return 0;
    }
    const bool negative = *word == '-';
    uint32_t value = 0;
    for (word += negative ? 1 : 0; *word >= '0' && *word <= '9'; word++) {
        value = value * 10U + (uint32_t)(*word - '0');
    }
    return (int32_t)(negative ? 0U - value : value);
}

static void request(void) {
    const char *verb = strtok(line, " ");
    if (verb == NULL) {
        return;
    }
    if (strcmp(verb, "run") == 0) {
        world.granted = (uint32_t)next_number();
        world.expected_in = (uint32_t)next_number();
        world.announced = true;
        return;
    }
    if (strcmp(verb, "state") == 0) {
        report_state();
        return;
    }
    if (strcmp(verb, "place") == 0) {
        const uint8_t axis = (uint8_t)next_number();
        plant_place(&world.plant, axis, next_number());
    } else if (strcmp(verb, "inject") == 0) {
        const uint8_t axis = (uint8_t)next_number();
        const char *name = strtok(NULL, " ");
        plant_ill_t ill;
        if (name == NULL || !plant_ill_of(name, &ill)) {
            answer("refused", 0);
            end_answer();
            return;
        }
        plant_inject(&world.plant, axis, ill);
    } else if (strcmp(verb, "cut") == 0) {
        world.cut_in = (uint32_t)next_number();
    } else if (strcmp(verb, "hang") == 0) {
        world.hung = true;
    } else if (strcmp(verb, "reset") == 0) {
        world.reset = true;
        board_restart(TL_WIRE_BOOT_POWER);
    }
    answer("ok", 0);
    end_answer();
}

void world_task(bool idle) {
    if (world.reset) {
        world.reset = false;
        answer("ok", 0);
        end_answer();
    }
    uint8_t byte;
    while (uart_read(&world_uart, &byte, 1) == 1U) {
        if (byte != '\n') {
            line[line_size] = (char)byte;
            line_size += line_size < LINE_MAX - 1U ? 1U : 0U;
            continue;
        }
        line[line_size] = '\0';
        line_size = 0;
        request();
    }
    // Bytes that the host sent before are taken in first: what happens depends on their order alone.
    if (world.announced && (int32_t)(world.line_in - world.expected_in) >= 0 && (idle || !world_runs_board())) {
        world.announced = false;
        world.running = true;
        if (world.granted > 0U) {
            board_clock(true);
        }
    } else if (world.running && world.granted == 0U && (idle || !world_runs_board())) {
        world.running = false;
        report_run();
    }
}
