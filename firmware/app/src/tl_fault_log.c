#include "tautline/tl_fault_log.h"

#include <string.h>

#include "tautline/tl_fast.h"
#include "tautline/tl_tables.h"

#define PAGES      (TL_PORT_FLASH_LOG / TL_PORT_FLASH_PAGE)
#define OF_SECTOR  (TL_PORT_FLASH_SECTOR / TL_PORT_FLASH_PAGE)
#define AT_MOST_US 1000000U // between two: a host that makes faults wears no flash

static bool read_page(const tl_port_t *port, uint32_t number, tl_wire_logged_t *out) {
    uint8_t page[TL_PORT_FLASH_PAGE];
    const uint8_t *bytes = page;
    size_t size = sizeof(page);
    tl_wire_parser_t parser;
    tl_wire_frame_t frame;
    memset(&parser, 0, sizeof(parser));
    port->flash_read(port->context, TL_PORT_FLASH_REGION + number * TL_PORT_FLASH_PAGE, page, sizeof(page));
    return tl_wire_parse(&parser, &bytes, &size, &frame) && frame.type == TL_WIRE_LOGGED &&
           tl_wire_decode(frame.type, frame.payload, frame.size, out);
}

static bool is_blank(const tl_port_t *port, uint32_t number) {
    uint8_t page[TL_PORT_FLASH_PAGE];
    port->flash_read(port->context, TL_PORT_FLASH_REGION + number * TL_PORT_FLASH_PAGE, page, sizeof(page));
    for (uint32_t i = 0; i < sizeof(page); i++) {
        if (page[i] != 0xFFU) {
            return false;
        }
    }
    return true;
}

void tl_fault_log_init(tl_fault_log_t *log, const tl_port_t *port, const tl_axis_t *axes) {
    memset(log, 0, sizeof(*log));
    log->port = port;
    log->axes = axes;
    log->run = 1U;
    for (uint32_t i = 0; port->keeps_log && i < PAGES; i++) {
        tl_wire_logged_t found;
        if (!read_page(port, i, &found)) {
            continue;
        }
        log->kept++;
        if ((int32_t)(found.number - log->number) > 0) {
            log->number = found.number;
            log->run = found.run + 1U;
            log->next = (i + 1U) % PAGES;
        }
    }
}

// All of one moment.
static TL_FAST_LOCKED bool look(const tl_axis_t *axis, tl_wire_logged_t *out) {
    const tl_port_t *port = axis->port;
    const uint32_t state = port->lock(port->context);
    out->fault = axis->fault;
    out->value = axis->guard.fault_value;
    out->t_us = axis->guard.fault_us;
    out->q_q8 = axis->q;
    port->unlock(port->context, state);
    return out->fault != TL_WIRE_FAULT_NONE;
}

static void note(tl_fault_log_t *log) {
    for (uint8_t i = 0; i < log->port->axes; i++) {
        tl_wire_logged_t found = {.axis = i};
        if (!look(&log->axes[i], &found)) {
            log->seen[i] = false;
        } else if (!log->seen[i] || log->seen_us[i] != found.t_us) {
            log->seen[i] = true;
            log->seen_us[i] = found.t_us;
            found.run = log->run;
            found.number = log->number + log->waiting + 1U;
            if (log->waiting < TL_FAULT_LOG_PENDING) { // else: flash is behind by more than it can be
                log->pending[log->waiting++] = found;
            }
        }
    }
}

// A page that a cut of power has left half written is passed over.
static bool make_room(tl_fault_log_t *log) {
    const tl_port_t *port = log->port;
    while (log->next % OF_SECTOR != 0U && !is_blank(port, log->next)) {
        log->next = (log->next + 1U) % PAGES;
    }
    if (log->next % OF_SECTOR != 0U) {
        return true;
    }
    for (uint32_t i = 0; i < OF_SECTOR; i++) {
        tl_wire_logged_t lost;
        log->kept -= read_page(port, log->next + i, &lost) ? 1U : 0U;
    }
    port->watchdog_feed(port->context);
    return port->flash_erase(port->context, TL_PORT_FLASH_REGION + log->next * TL_PORT_FLASH_PAGE);
}

static void write(tl_fault_log_t *log) {
    const tl_port_t *port = log->port;
    uint8_t page[TL_PORT_FLASH_PAGE];
    tl_wire_logged_t back;
    memset(page, 0xFF, sizeof(page));
    tl_wire_frame(page, TL_WIRE_LOGGED, 0, &log->pending[0]);
    const bool done = make_room(log) &&
                      port->flash_program(port->context, TL_PORT_FLASH_REGION + log->next * TL_PORT_FLASH_PAGE, page);
    log->kept += done && read_page(port, log->next, &back) ? 1U : 0U;
    log->number = log->pending[0].number;
    log->next = (log->next + 1U) % PAGES;
    log->waiting--;
    memmove(&log->pending[0], &log->pending[1], log->waiting * sizeof(log->pending[0]));
}

void tl_fault_log_task(tl_fault_log_t *log, tl_us_t now_us, bool may_write) {
    if (!log->port->keeps_log) {
        return;
    }
    note(log);
    const bool due = !log->wrote || now_us - log->wrote_us >= AT_MOST_US;
    if (log->waiting > 0U && due && may_write && tl_tables_all_off(log->port, log->axes)) {
        write(log);
        log->wrote = true;
        log->wrote_us = now_us;
    }
}

void tl_fault_log_read(const tl_fault_log_t *log, uint8_t index, tl_wire_logged_t *out) {
    memset(out, 0, sizeof(*out));
    if (index < log->waiting) {
        *out = log->pending[log->waiting - 1U - index];
    } else if (index - log->waiting < log->kept) {
        const uint32_t wanted = log->number - (index - log->waiting);
        for (uint32_t i = 0; i < PAGES; i++) {
            if (read_page(log->port, i, out) && out->number == wanted) {
                break;
            }
            memset(out, 0, sizeof(*out));
        }
    }
    out->run_now = log->run;
}
