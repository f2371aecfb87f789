#include "simlink.h"

#include <errno.h>
#include <inttypes.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "board.h"
#include "tautline/tl_axis_watch.h"
#include "uart.h"
#include "usbip.h"

#define ADVANCE_MAX_US 10000000U
#define SLICE_US       1000U

net_connection_t simlink_connections[SIMLINK_CONNECTIONS];

static net_connection_t *advancing; // who waits for granted time to pass
static tl_us_t granted_us;          // world time up to which it may run
static uint64_t told;               // milliseconds of the log that were reported
static bool realtime;
static bool quit;
static bool cable = true;
static tl_us_t paced_us;  // world time at
static uint64_t paced_at; // this wall-clock time, us

static uint64_t wall_us(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000U + (uint64_t)now.tv_nsec / 1000U;
}

static void pace_from_here(void) {
    paced_us = board_state()->t_us;
    paced_at = wall_us();
}

static tl_us_t wall_limit(void) {
    return paced_us + (wall_us() - paced_at);
}

__attribute__((format(printf, 2, 3))) static void put(net_connection_t *connection, const char *format, ...) {
    char text[512];
    va_list arguments;
    va_start(arguments, format);
    const int size = vsnprintf(text, sizeof(text), format, arguments);
    va_end(arguments);
    net_put(connection, text, (size_t)size);
}

static void refuse(net_connection_t *connection, const char *why) {
    put(connection, "{\"error\": \"%s\"}\n", why);
}

// The milliseconds since the last report, as far as the log still holds them.
static void report_advance(net_connection_t *connection) {
    const board_state_t *board = board_state();
    const uint64_t oldest = board->log_end > BOARD_LOG ? board->log_end - BOARD_LOG : 0U;
    const uint64_t from = told > oldest ? told : oldest;
    const uint8_t axes = board_app()->port->axes;
    put(connection, "{\"t_us\": %" PRIu64 ", \"from_us\": %" PRIu64 ", \"dt_us\": 1000, \"q\": [", board->t_us,
        (from + 1U) * 1000U);
    for (uint8_t axis = 0; axis < axes; axis++) {
        put(connection, axis == 0 ? "[" : ", [");
        for (uint64_t i = from + 1U; i <= board->log_end; i++) {
            put(connection, i == from + 1U ? "%" PRId32 : ", %" PRId32, board_log(i, axis));
        }
        put(connection, "]");
    }
    put(connection, "]}\n");
    told = board->log_end;
}

static void report_state(net_connection_t *connection) {
    const board_state_t *board = board_state();
    const tl_app_t *app = board_app();
    put(connection,
        "{\"t_us\": %" PRIu64 ", \"board_us\": %" PRIu64 ", \"powered\": %s, \"bootloader\": %s, \"hung\": %s, "
        "\"attached\": %s, \"realtime\": %s, \"starts\": %" PRIu32 ", \"flash_operations\": %" PRIu32 ", \"q\": [",
        board->t_us, board->t_us - board->boot_us, board->powered ? "true" : "false",
        board->bootloader ? "true" : "false", board->hung ? "true" : "false",
        usbip_attached() || uart_attached() ? "true" : "false", realtime ? "true" : "false", board->starts,
        board->flash_operations);
    for (uint8_t i = 0; i < app->port->axes; i++) {
        put(connection, "%s%" PRId32, i == 0 ? "" : ", ", board_true_q8(i));
    }
    put(connection, "], \"axes\": [");
    for (uint8_t i = 0; i < app->port->axes; i++) {
        const tl_axis_t *axis = &app->axes[i];
        put(connection,
            "%s{\"q_q8\": %" PRId32 ", \"q_ref_q8\": %" PRId32 ", \"duty_q15\": %" PRId32
            ", \"mode\": %u, \"fault\": %u, \"flags\": %u}",
            i == 0 ? "" : ", ", axis->q, axis->path.q, axis->motor.duty, axis->mode, axis->fault, tl_axis_flags(axis));
    }
    put(connection, "]}\n");
}

static void ok(net_connection_t *connection) {
    put(connection, "{\"t_us\": %" PRIu64 "}\n", board_state()->t_us);
}

// A whole decimal number of at most `most`; false where there is none.
static bool number(const char *text, long long least, long long most, long long *value) {
    char *end;
    errno = 0;
    *value = strtoll(text, &end, 10);
    return end != text && *end == '\0' && errno == 0 && *value >= least && *value <= most;
}

static void advance(net_connection_t *connection, const char *argument) {
    long long us;
    if (!number(argument, 0, ADVANCE_MAX_US, &us)) {
        refuse(connection, "advance takes 0 to 10000000 microseconds");
    } else if (advancing != NULL) {
        refuse(connection, "another client is advancing");
    } else {
        const tl_us_t now_us = board_state()->t_us;
        granted_us = (granted_us > now_us ? granted_us : now_us) + (tl_us_t)us;
        advancing = connection;
    }
}

static void place(net_connection_t *connection, char *argument) {
    char *second = strchr(argument, ' ');
    long long axis;
    long long q;
    if (second != NULL) {
        *second++ = '\0';
    }
    if (second == NULL || !number(argument, 0, board_app()->port->axes - 1, &axis) ||
        !number(second, -1000000000, 1000000000, &q)) {
        refuse(connection, "place takes an axis and a position in counts Q8");
        return;
    }
    board_place((uint8_t)axis, (int32_t)q);
    ok(connection);
}

static void inject(net_connection_t *connection, char *argument) {
    char *second = strchr(argument, ' ');
    long long axis;
    plant_ill_t ill;
    if (second != NULL) {
        *second++ = '\0';
    }
    if (second == NULL || !number(argument, 0, board_app()->port->axes - 1, &axis) || !plant_ill_of(second, &ill)) {
        refuse(connection,
               "inject takes an axis and well, blocked, unplugged, reversed, coarse, jump, driver, supply or estop");
        return;
    }
    board_inject((uint8_t)axis, ill);
    put(connection, "{\"t_us\": %" PRIu64 ", \"ills\": [", board_state()->t_us);
    for (uint8_t i = 0; i < board_app()->port->axes; i++) {
        put(connection, "%s\"%s\"", i == 0 ? "" : ", ", board_ill(i));
    }
    put(connection, "]}\n");
}

static void request(net_connection_t *connection, char *line) {
    char *argument = strchr(line, ' ');
    if (argument != NULL) {
        *argument++ = '\0';
    } else {
        argument = line + strlen(line);
    }
    long long value;
    if (strcmp(line, "advance") == 0) {
        advance(connection, argument);
    } else if (strcmp(line, "state") == 0) {
        report_state(connection);
    } else if (strcmp(line, "realtime") == 0 && (strcmp(argument, "on") == 0 || strcmp(argument, "off") == 0)) {
        realtime = strcmp(argument, "on") == 0;
        pace_from_here();
        ok(connection);
    } else if (strcmp(line, "cut") == 0 && number(argument, 0, 1000000, &value)) {
        board_cut((uint32_t)value);
        ok(connection);
    } else if (strcmp(line, "place") == 0) {
        place(connection, argument);
    } else if (strcmp(line, "inject") == 0) {
        inject(connection, argument);
    } else if (strcmp(line, "unplug") == 0) {
        usbip_plug(false);
        uart_plug(false);
        cable = false;
        ok(connection);
    } else if (strcmp(line, "plug") == 0) {
        cable = true;
        uart_plug(true);
        ok(connection);
    } else if (strcmp(line, "reset") == 0) {
        board_start(TL_WIRE_BOOT_POWER);
        ok(connection);
    } else if (strcmp(line, "hang") == 0) {
        board_hang();
        ok(connection);
    } else if (strcmp(line, "quit") == 0) {
        quit = true;
        ok(connection);
    } else {
        refuse(connection, "not a request: advance US, state, realtime on|off, cut N, place AXIS Q8, "
                           "inject AXIS ILL, unplug, plug, "
                           "reset, hang, quit");
    }
}

void simlink_init(bool paced) {
    for (size_t i = 0; i < SIMLINK_CONNECTIONS; i++) {
        simlink_connections[i].fd = -1;
    }
    realtime = paced;
    pace_from_here();
}

void simlink_receive(void) {
    for (size_t i = 0; i < SIMLINK_CONNECTIONS; i++) {
        net_connection_t *connection = &simlink_connections[i];
        while (connection->fd >= 0 && !connection->closing && connection != advancing) {
            uint8_t *end = memchr(connection->in, '\n', connection->in_fill);
            if (end == NULL) {
                if (connection->in_fill == sizeof(connection->in)) {
                    connection->closing = true; // not lines
                }
                break;
            }
            const size_t size = (size_t)(end - connection->in) + 1U;
            *end = '\0';
            if (size > 1U && end[-1] == '\r') {
                end[-1] = '\0';
            }
            request(connection, (char *)connection->in);
            net_consume(connection, size);
        }
    }
}

bool simlink_run(void) {
    tl_us_t until = board_state()->t_us;
    if (realtime) {
        const tl_us_t limit = wall_limit();
        until = limit > until + SLICE_US ? until + SLICE_US : (limit > until ? limit : until);
    } else if (granted_us > until) {
        until = granted_us - until > SLICE_US ? until + SLICE_US : granted_us;
    }
    const bool ran = board_state()->t_us + MOTOR_STEP_US <= until;
    while (board_state()->t_us + MOTOR_STEP_US <= until) {
        board_step();
    }
    if (advancing != NULL && board_state()->t_us + MOTOR_STEP_US > granted_us) {
        net_connection_t *connection = advancing;
        advancing = NULL;
        report_advance(connection);
    }
    return ran;
}

int simlink_wait(void) {
    return realtime ? 1 : -1;
}

void simlink_closed(net_connection_t *connection) {
    net_close(connection);
    if (connection == advancing) {
        advancing = NULL;
        granted_us = board_state()->t_us;
    }
}

bool simlink_quit(void) {
    return quit;
}
bool simlink_cable(void) {
    return cable;
}
