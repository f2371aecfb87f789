#include "tl_takeup.h"

#include "tautline/tl_fast.h"

static TL_FAST int64_t at_least_1(int64_t value) {
    return value > 0 ? value : 1;
}

void tl_takeup_start(tl_takeup_t *takeup) {
    *takeup = (tl_takeup_t){.heading = 1};
}

void tl_takeup_set_limits(tl_takeup_t *takeup, const tl_table_t *table, uint32_t rate_hz) {
    const int64_t rate = (int64_t)rate_hz;
    const int64_t speed = at_least_1(((int64_t)table->takeup_speed_q8 << TL_TAKEUP_FRACTION_BITS) / rate);
    // counts/s^2 to Q36 are 36 bits, some of them before each division: 2^31 has just room for 32.
    const int64_t accel = at_least_1((((int64_t)table->takeup_accel << 32) / rate << 4) / rate);
    takeup->next_speed_max_q36 = speed;
    takeup->next_accel_q36 = accel < speed ? accel : speed;
    takeup->limits_pending = 1;
}

TL_FAST void tl_takeup_set(tl_takeup_t *takeup, int32_t rest_q8) {
    const int64_t rest = (int64_t)(takeup->heading > 0 ? rest_q8 : -rest_q8) * ((int64_t)1 << TL_TAKEUP_FRACTION_BITS);
    takeup->ahead_q36 = takeup->spare_q36 = rest;
    takeup->speed_q36 = 0;
}

// From rest: new limits, and the way to what is left. False if nothing is.
static TL_FAST bool set_off(tl_takeup_t *takeup) {
    if (takeup->limits_pending) {
        takeup->speed_max_q36 = takeup->next_speed_max_q36;
        takeup->accel_q36 = takeup->next_accel_q36;
        takeup->limits_pending = 0;
    }
    if (takeup->ahead_q36 < 0) {
        takeup->ahead_q36 = takeup->spare_q36 = -takeup->ahead_q36;
        takeup->heading = -takeup->heading;
    }
    if (takeup->ahead_q36 < takeup->accel_q36) { // the last part, less than one tick's acceleration, at once
        takeup->ahead_q36 = takeup->spare_q36 = 0;
        return false;
    }
    return true;
}

// The speed is n accel. One more tick at it and then braking take accel n (n + 1) / 2: what is ahead beyond that is
// spare, and is kept up to date by sums alone.
TL_FAST void tl_takeup_step(tl_takeup_t *takeup) {
    int64_t speed = takeup->speed_q36;
    if (speed == 0 && !set_off(takeup)) {
        return;
    }
    const int64_t accel = takeup->accel_q36;
    int64_t spare = takeup->spare_q36;
    if (spare < 0 || takeup->limits_pending) {
        speed -= accel;
        spare += accel;
    } else {
        const int64_t faster = speed + accel;
        if (faster <= spare && faster <= takeup->speed_max_q36) {
            speed = faster;
            spare -= faster;
        }
        spare -= speed;
    }
    takeup->speed_q36 = speed;
    takeup->spare_q36 = spare;
    takeup->ahead_q36 -= speed;
}
