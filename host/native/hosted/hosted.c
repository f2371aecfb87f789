#include "hosted.h"

#include <stdlib.h>
#include <string.h>

#include "tautline/tl_app.h"

#define TICK_US (1000000U / HOSTED_RATE_HZ)

const int32_t hosted_speed_max = TL_REFERENCE_SPEED_MAX / TL_COUNT_ONE;
const int32_t hosted_acceleration_max = TL_REFERENCE_ACCELERATION_MAX / TL_COUNT_ONE;

struct hosted {
    tl_app_t app;
    tl_port_t port;
    char name[HOSTED_NAME], serial[HOSTED_SERIAL];
    tl_us_t t_us;       // of the last control step
    tl_us_t between_us; // while a frame is taken in: its time, later than that
    hosted_measured_t measured[HOSTED_AXES];
    tl_us_t measured_us;
    int32_t q_q8[HOSTED_AXES]; // at t_us
    uint32_t lead_us[HOSTED_AXES];
    uint16_t supply_mv;
    uint32_t flash_writes;
    uint8_t flash[TL_PORT_FLASH_REGION];
};

// -- the port ---------------------------------------------------------------------------------------------------

static tl_us_t port_time(void *context) {
    const hosted_t *hosted = context;
    return hosted->between_us > hosted->t_us ? hosted->between_us : hosted->t_us;
}

static int32_t port_encoder(void *context, uint8_t axis) {
    return ((hosted_t *)context)->q_q8[axis];
}

static bool port_edges_lost(void *context, uint8_t axis) {
    (void)context;
    (void)axis;
    return false;
}

static void port_drive(void *context, uint8_t axis, tl_duty_q15_t duty) {
    (void)context;
    (void)axis;
    (void)duty;
}

static int32_t port_current(void *context, uint8_t axis) {
    return ((hosted_t *)context)->measured[axis].current_ma;
}

static uint16_t port_supply(void *context) {
    return ((hosted_t *)context)->supply_mv;
}

static bool port_driver_fault(void *context, uint8_t axis) {
    return ((hosted_t *)context)->measured[axis].fault;
}

static void port_read(void *context, uint32_t offset, uint8_t *out, size_t size) {
    memcpy(out, ((hosted_t *)context)->flash + offset, size);
}

static bool port_erase(void *context, uint32_t offset) {
    hosted_t *hosted = context;
    memset(hosted->flash + offset, 0xFF, TL_PORT_FLASH_SECTOR);
    hosted->flash_writes++;
    return true;
}

static bool port_program(void *context, uint32_t offset, const uint8_t *page) {
    hosted_t *hosted = context;
    memcpy(hosted->flash + offset, page, TL_PORT_FLASH_PAGE);
    hosted->flash_writes++;
    return true;
}

static void port_feed(void *context) {
    (void)context;
}

static uint32_t port_lock(void *context) {
    (void)context;
    return 0;
}

static void port_unlock(void *context, uint32_t locked) {
    (void)context;
    (void)locked;
}

// There is no chip to restart: the host opens the drives anew.
static void port_reboot(void *context, bool bootloader) {
    (void)bootloader;
    ((hosted_t *)context)->app.reboot = 0;
}

// ---------------------------------------------------------------------------------------------------------------

hosted_t *hosted_open(const char *name, const char *serial, uint8_t axes, uint16_t driver_ma, const uint8_t *flash,
                      const hosted_measured_t *first) {
    hosted_t *hosted = calloc(1, sizeof(*hosted));
    if (hosted == NULL) {
        return NULL;
    }
    strncpy(hosted->name, name, sizeof(hosted->name) - 1U);
    strncpy(hosted->serial, serial, sizeof(hosted->serial) - 1U);
    memset(hosted->flash, 0xFF, sizeof(hosted->flash));
    if (flash != NULL) {
        memcpy(hosted->flash, flash, sizeof(hosted->flash));
    }
    for (uint8_t i = 0; i < axes; i++) {
        hosted->measured[i] = first[i];
        hosted->q_q8[i] = first[i].q_q8;
    }
    hosted->port = (tl_port_t){
        .context = hosted,
        .name = hosted->name,
        .serial = hosted->serial,
        .axes = axes,
        .control_hz = HOSTED_RATE_HZ,
        .driver_ma = driver_ma,
        .time_us = port_time,
        .encoder = port_encoder,
        .edges_lost = port_edges_lost,
        .drive = port_drive,
        .current_ma = port_current,
        .supply_mv = port_supply,
        .driver_fault = port_driver_fault,
        .flash_read = port_read,
        .flash_erase = port_erase,
        .flash_program = port_program,
        .watchdog_feed = port_feed,
        .lock = port_lock,
        .unlock = port_unlock,
        .reboot = port_reboot,
    };
    tl_app_init(&hosted->app, &hosted->port);
    tl_app_line(&hosted->app);
    for (uint8_t i = 0; i < axes; i++) {
        hosted->lead_us[i] = hosted->app.axes[i].plan.lead_us;
    }
    return hosted;
}

void hosted_close(hosted_t *hosted) {
    free(hosted);
}

size_t hosted_flash_size(void) {
    return TL_PORT_FLASH_REGION;
}

const uint8_t *hosted_flash(const hosted_t *hosted) {
    return hosted->flash;
}

uint32_t hosted_flash_writes(const hosted_t *hosted) {
    return hosted->flash_writes;
}

void hosted_run(hosted_t *hosted, uint64_t us, const hosted_measured_t *measured, uint16_t supply_mv) {
    int32_t from[HOSTED_AXES];
    const tl_us_t from_us = hosted->measured_us;
    const uint8_t axes = hosted->port.axes;
    for (uint8_t i = 0; i < axes; i++) {
        from[i] = hosted->measured[i].q_q8;
        hosted->measured[i] = measured[i];
    }
    hosted->supply_mv = supply_mv;
    hosted->measured_us = us;
    if (us > hosted->t_us + HOSTED_LATE_US) {
        hosted->t_us = us - TICK_US;
    }
    while (hosted->t_us + TICK_US <= us) {
        hosted->t_us += TICK_US;
        for (uint8_t i = 0; i < axes; i++) {
            const int64_t way = (int64_t)measured[i].q_q8 - from[i], since = (int64_t)(hosted->t_us - from_us);
            hosted->q_q8[i] = from[i] + (int32_t)(us > from_us ? way * since / (int64_t)(us - from_us) : way);
        }
        tl_app_control(&hosted->app);
        tl_app_task(&hosted->app);
    }
}

void hosted_wait(hosted_t *hosted, uint64_t us) {
    if (us >= hosted->t_us + TICK_US) {
        hosted->t_us = us - TICK_US;
        hosted->app.control_us = hosted->t_us;
        hosted->measured_us = hosted->t_us;
    }
}

hosted_goal_t hosted_goal(const hosted_t *hosted, uint8_t axis) {
    const tl_axis_t *of = &hosted->app.axes[axis];
    const int32_t apart = of->q - of->motor.encoder; // of the axis' positions and the drive's
    const int32_t speed = of->closed ? of->path.speed : 0;
    return (hosted_goal_t){
        .goal_q8 = of->motor.goal - apart,
        .speed_q8_s = (int32_t)((int64_t)speed * (int32_t)HOSTED_RATE_HZ >> 16),
        .on = of->motor.on,
        .moves = of->closed,
    };
}

void hosted_lead(hosted_t *hosted, uint8_t axis, uint32_t us) {
    hosted->app.axes[axis].plan.lead_us = hosted->lead_us[axis] + us;
}

void hosted_receive(hosted_t *hosted, uint64_t us, const uint8_t *bytes, size_t size) {
    hosted->between_us = us;
    tl_app_receive(&hosted->app, bytes, size);
    hosted->between_us = 0;
}

size_t hosted_transmit(hosted_t *hosted, uint8_t *out, size_t room) {
    return tl_app_transmit(&hosted->app, out, room);
}
