// The control step, in a file of its own so that a port can put everything that it reaches where no flash is read.
#include "tautline/tl_app.h"

#define LATE_FAULT 20000U // us without a control step that a driven motor may not see

void tl_app_control(tl_app_t *app) {
    const tl_port_t *port = app->port;
    const tl_us_t now_us = port->time_us(port->context);
    const uint32_t since_us = (uint32_t)(now_us - app->control_us);
    app->control_us = now_us;
    const bool late = since_us > LATE_FAULT;
    if (since_us > 2U * (1000000U / port->control_hz)) {
        app->counters.overruns++;
    }
    for (uint8_t i = 0; i < port->axes; i++) {
        if (late && app->axes[i].mode != TL_WIRE_MODE_OFF) {
            tl_axis_fail(&app->axes[i], TL_WIRE_FAULT_OVERRUN, now_us);
        }
        tl_axis_step(&app->axes[i]);
    }
    // Each axis after the last tick of its millisecond: tl_axis_init() begins axis i with a tick less than axis i - 1.
    const uint32_t ticks = app->axes[0].ticks, slot = app->slot + 1U;
    app->slot = slot < ticks ? slot : 0U;
    for (uint32_t i = app->slot; i < port->axes; i += ticks) {
        tl_axis_watch(&app->axes[i], now_us);
    }
    app->steps = app->steps + 1U;
}
