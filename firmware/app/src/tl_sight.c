#include "tautline/tl_sight.h"

#include "tautline/tl_fast.h"

#define INERTIA_LEAST 500                   // of the gains: a motor ten times as quick as the default's
#define SLOWER        5                     // feed-forward of an inertia: a motor's lag is 2 ms, two steps, at least
#define SPEED_MOST    (64 * 65536)          // counts/ms Q16: beyond any motor's; nothing overflows
#define MARGIN        2621                  // duty by which a load grows at once: 8 %
#define TWO           (2 * TL_COUNT_ONE)    // counts, more than an encoder of which one line is dead goes to and fro
#define AHEAD_MOST    (32 * 65536)          // counts Q16
#define LOAD_MOST     65536                 // duty
#define UNSEEN_MOST   1000                  // ms that are told
#define MOVED_MOST    (2048 * TL_COUNT_ONE) // in a millisecond

void tl_sight_configure(tl_sight_t *sight, const tl_servo_gains_t *gains) {
    const int32_t inertia = gains->inertia > INERTIA_LEAST ? gains->inertia : INERTIA_LEAST;
    const bool known = gains->inertia > 0 && gains->feed_forward > 0 && gains->feed_forward <= SLOWER * inertia;
    sight->gain = known ? 1677722 / inertia : 0; // 2^24 100000 / 1000^2
    sight->feed = gains->feed_forward;
}

TL_FAST void tl_sight_reset(tl_sight_t *sight, tl_count_q8_t q) {
    sight->q = sight->seen_q = q;
    sight->duty = 0;
    sight->ahead = sight->speed = sight->load = 0;
    sight->least = sight->least_load = sight->must = sight->doubt = sight->unseen_ms = 0;
}

// Duty that speeds it up.
static inline int32_t pull_of(const tl_sight_t *sight, int32_t speed, int32_t duty) {
    return duty - ((speed >> 8) * sight->feed >> 8);
}

// Friction and load stop a motor, and do not turn it: at rest nothing is known of it any more.
static inline bool go_unseen(tl_sight_t *s, tl_duty_q15_t drove) {
    const int32_t before = s->least, less = MARGIN + s->doubt;
    const int32_t force = drove - s->least_load - (before > 0 ? less : -less);
    const int32_t after = before + (pull_of(s, before, force) * s->gain >> 8);
    if ((before ^ after) < 0) {
        s->least = 0;
        return true;
    }
    const int32_t must = s->must + (after < 0 ? -after >> 8 : after >> 8);
    s->least = after;
    s->must = must;
    if (must > TL_SIGHT_MOST * TL_COUNT_ONE) {
        s->least = 0;
        return false;
    }
    return true;
}

TL_FAST bool tl_sight_step(tl_sight_t *s, tl_count_q8_t q, tl_duty_q15_t duty) {
    const tl_duty_q15_t drove = s->duty;
    const tl_count_q8_t moved = tl_clamp(q - s->q, -MOVED_MOST, MOVED_MOST);
    s->duty = duty;
    s->q = q;
    // Three poles at 0.78 a millisecond, 40 Hz, hold it to the encoder: of what it is ahead by 5/8, 1/8 a millisecond,
    // and of the load 1/64 of full drive a count.
    const int32_t pull = pull_of(s, s->speed, drove - s->load);
    const int32_t speed = s->speed + (pull * s->gain >> 8);
    const int32_t ahead = tl_clamp(s->ahead + speed - moved * 256, -AHEAD_MOST, AHEAD_MOST);
    s->ahead = ahead - (ahead >> 1) - (ahead >> 3);
    s->load = tl_clamp(s->load + (ahead >> 7), -LOAD_MOST, LOAD_MOST);
    s->speed = tl_clamp(speed - (ahead >> 3), -SPEED_MOST, SPEED_MOST);
    const tl_count_q8_t way = q - s->seen_q;
    if (way > -TWO && way < TWO) {
        s->unseen_ms += s->unseen_ms < UNSEEN_MOST ? 1 : 0;
        return s->least == 0 || s->gain == 0 || go_unseen(s, drove);
    }
    const int32_t size = (pull < 0 ? -pull : pull), fades = s->doubt - (s->doubt >> 3);
    s->doubt = size > fades ? size : fades;
    s->seen_q = q;
    s->least = (way ^ s->speed) >= 0 ? s->speed : 0;
    s->least_load = s->load;
    s->must = 0;
    s->unseen_ms = 0;
    return true;
}
