// The board's application on the host, for drives on a field bus: its axes, plan, compensation, guards, calibration
// motion and messages, as they are compiled for a board. Time is what it is given; its flash is memory.
#ifndef TAUTLINE_NATIVE_HOSTED_H
#define TAUTLINE_NATIVE_HOSTED_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define HOSTED_AXES    4U
#define HOSTED_RATE_HZ 5000U
#define HOSTED_NAME    16U
#define HOSTED_SERIAL  32U
#define HOSTED_LATE_US 100000U // a longer pause is no time that a motor was looked after: the board's rule for it holds

extern const int32_t hosted_speed_max, hosted_acceleration_max; // that it plans, counts/s and counts/s2

typedef struct hosted hosted_t;

typedef struct {
    int32_t q_q8; // counts, as the drive says
    int32_t current_ma;
    bool fault; // the drive reports one
} hosted_measured_t;

typedef struct {
    int32_t goal_q8;    // counts, in the drive's own positions
    int32_t speed_q8_s; // of the path there
    bool on;
    bool moves; // it follows its path in closed loop
} hosted_goal_t;

/// `name` and `serial`: cut to what an identity holds. `flash`: hosted_flash_size() bytes, or NULL for a blank one.
/// driver_ma: at which the drives limit the current; 0: not known. `first`: where they are, one for each axis. NULL
/// where memory is short.
hosted_t *hosted_open(const char *name, const char *serial, uint8_t axes, uint16_t driver_ma, const uint8_t *flash,
                      const hosted_measured_t *first);
void hosted_close(hosted_t *hosted);

size_t hosted_flash_size(void);
const uint8_t *hosted_flash(const hosted_t *hosted);
uint32_t hosted_flash_writes(const hosted_t *hosted);

/// Where the drives are and what they say now, at `us`: the control steps since the last call, the drives on straight
/// lines meanwhile. supply_mv: 0, not measured.
void hosted_run(hosted_t *hosted, uint64_t us, const hosted_measured_t *measured, uint16_t supply_mv);

/// A drive was switched on until `us`, which took it a while: no axis was driven meanwhile, none is late.
void hosted_wait(hosted_t *hosted, uint64_t us);

/// What the drive of an axis is to do now.
hosted_goal_t hosted_goal(const hosted_t *hosted, uint8_t axis);

/// Set-points are planned so much ahead of their time: what the drive of an axis and its bus are late.
void hosted_lead(hosted_t *hosted, uint8_t axis, uint32_t us);

/// Whole frames from the host, at `us`: what is answered with a time is answered with that one.
void hosted_receive(hosted_t *hosted, uint64_t us, const uint8_t *bytes, size_t size);
size_t hosted_transmit(hosted_t *hosted, uint8_t *out, size_t room);

#ifdef __cplusplus
}
#endif
#endif
