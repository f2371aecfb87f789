// A compensator that leads through whatever is changed meanwhile, with all that tables undo. Whoever includes this says
// where its numbers come from: int32_t between(int32_t low, int32_t high), both ends included.
#ifndef RIDE_H
#define RIDE_H

#include "table_fixture.h"
#include "tautline/tl_drive.h"

#include <stdlib.h>

#define COUNTS(x) ((tl_count_q8_t)((x) * TL_COUNT_ONE))
#define RATE      1000U
#define SPEED     5 // counts a tick, of the feed and of the take-up each
#define TABLES    12
// Both at once, what several plays lead by as fast as a take-up, the encoder's slope of a half at most on top, and half
// a count a tick that a table is moved by.
#define STEP_MOST (COUNTS(3 * SPEED) * 3 / 2 + COUNTS(1))

static inline void falling(int32_t values[TL_TABLE_LAST + 1U], int32_t first) {
    for (uint32_t i = 0; i <= TL_TABLE_LAST; i++) {
        values[i] = first * (int32_t)(TL_TABLE_LAST - i) / (int32_t)TL_TABLE_LAST;
    }
}

static inline tl_table_t any_table(void) {
    tl_table_t table;
    do {
        const int sign = between(0, 1) == 0 ? 1 : -1;
        table = between(0, 1) == 0 ? table_fixture(sign) : table_fixture_several(sign);
        table.speed_max_q8 = COUNTS(SPEED * (int32_t)RATE);
        table.takeup_speed_q8 = COUNTS(SPEED * (int32_t)RATE);
        table.takeup_accel = between(20000, 200000);
        table.band = between(0, 1) == 0 ? 0 : COUNTS(between(0, 20));
        if (between(0, 3) == 0) {
            table.q_min = COUNTS(between(-4900, 0));
            table.q_max = table.q_min + (between(0, 2) == 0 ? between(1, 1000) : COUNTS(between(1, 4900)));
        }
        table.has = (uint32_t)between(0, 511) << 2;    // sections 2 to 10
        if ((table.has & TL_TABLE_HAS_encoder) != 0) { // 2 pi (a + 2 a2) / period is 1/2 at most
            const int32_t period = between(100, 2000), most = COUNTS(period) / 14;
            table.encoder = (tl_table_encoder_t){.period_q12 = period * 4096,
                                                 .sine = between(-most / 2, most / 2),
                                                 .cosine2 = between(-most / 6, most / 6)};
        }
        if ((table.has & TL_TABLE_HAS_sides) != 0) {
            table.sides = (tl_table_sides_t){.side = between(0, 1) == 0 ? 1 : -1, .step_log2 = 10};
            falling(table.sides.late, COUNTS(between(1, 40)));
            table.anew.rest_us = (table.has & TL_TABLE_HAS_anew) != 0 ? between(1, 20000) : 0;
        } else {
            table.has &= ~(uint32_t)TL_TABLE_HAS_anew;
        }
        if ((table.has & TL_TABLE_HAS_speed) != 0) {
            table.speed = (tl_table_speed_t){.step_log2 = 14, .time_us = between(20000, 80000), .held = between(0, 1)};
            for (uint32_t i = 0; i <= TL_TABLE_LAST; i++) {
                table.speed.extra[i] = COUNTS((int32_t)i);
            }
        }
        if ((table.has & TL_TABLE_HAS_pressed) != 0) {
            table.pressed = (tl_table_pressed_t){.mean = COUNTS(between(50, 500))};
            table.pressed.sides_q16 = (table.has & TL_TABLE_HAS_sides) != 0 ? between(0, 1 << 16) : 0;
            table.pressed.speed_q16 = (table.has & TL_TABLE_HAS_speed) != 0 ? between(0, 1 << 16) : 0;
        }
        if ((table.has & TL_TABLE_HAS_late) != 0) {
            table.late = (tl_table_late_t){.gain_q16 = {between(0, 65536)}, .time_us = {between(20000, 400000)}};
        }
        if ((table.has & TL_TABLE_HAS_load) != 0) {
            table.load = (tl_table_load_t){.width = between(0, 1 << 16), .offset = between(0, 1 << 16)};
        }
        table.has &= ~(uint32_t)TL_TABLE_HAS_joints;
        if ((table.has & TL_TABLE_HAS_adapt) != 0) {
            table.adapt = (tl_table_adapt_t){
                .offset = COUNTS(200), .width_least_q15 = TL_RATIO_ONE / 2, .width_most_q15 = TL_RATIO_ONE * 3 / 2};
        }
    } while (tl_table_check(&table, 0) != TL_TABLE_OK);
    return table;
}

static tl_drive_t drive;
static tl_count_q8_t ride_q;
static tl_deg_q16_t ride_c;
static int32_t ride_way;

// How far beyond the range of the table in use, which the motor may be where that table is new.
static inline int32_t outside(tl_count_q8_t q) {
    const tl_table_t *table = &drive.tables[drive.used].table;
    return q < table->q_min ? table->q_min - q : (q > table->q_max ? q - table->q_max : 0);
}

static uint8_t blobs[TABLES][TL_TABLE_SIZE_MAX];
static size_t sizes[TABLES];

static inline void ride_load(int which) {
    if (tl_drive_load(&drive, blobs[which], sizes[which], 0) != TL_TABLE_OK) {
        abort(); // it was checked
    }
}

static inline void change(void) {
    tl_compensator_t *k = &drive.compensator;
    const int which = between(0, TABLES - 1);
    switch (between(0, 4)) {
    case 0:
        tl_compensator_set_mode(k, (tl_mode_t)between(0, 2));
        break;
    case 1:
        tl_compensator_set_strength(k, between(0, TL_RATIO_ONE));
        break;
    case 2:
        tl_compensator_adapt(k, COUNTS(between(-200, 200)), between(TL_RATIO_ONE / 2, TL_RATIO_ONE),
                             (uint32_t)between(1, 500));
        break;
    case 3:
        tl_compensator_load(k, between(-2000, 2000), (uint32_t)between(1, 500));
        break;
    default:
        ride_load(which);
        break;
    }
}

static inline void ride_start(int tables) {
    for (int i = 0; i < TABLES; i++) { // some of them the same
        const tl_table_t table = i < tables ? any_table() : (tl_table_t){.nodes = 0};
        sizes[i] = i < tables ? tl_table_encode(&table, blobs[i], sizeof(blobs[i])) : sizes[i % tables];
        if (i >= tables) {
            memcpy(blobs[i], blobs[i % tables], sizes[i]);
        }
    }
    drive = (tl_drive_t){.loaded = false};
    ride_load(0);
    ride_q = 0;
    ride_c = 0;
    ride_way = 0;
    if (!tl_drive_start(&drive, RATE, TL_MODE_FULL, ride_q, ride_c)) {
        abort();
    }
}

typedef struct {
    int32_t step; // of the goal, Q8 counts
    bool inside;  // no farther beyond the range than it was
} ride_tick_t;

static inline ride_tick_t ride_tick(void) {
    if (between(0, 150) == 0) {
        change();
    }
    if (between(0, 200) == 0) {
        ride_way = between(0, 2) == 0 ? 0 : between(-3000, 3000); // 0.05 deg a tick: four counts
    }
    ride_c += ride_c > 40 * TL_DEG_ONE ? -TL_DEG_ONE / 50 : (ride_c < -40 * TL_DEG_ONE ? TL_DEG_ONE / 50 : ride_way);
    const tl_count_q8_t next = tl_drive_step(&drive, ride_c);
    const ride_tick_t tick = {.step = next > ride_q ? next - ride_q : ride_q - next,
                              .inside = outside(next) <= outside(ride_q)};
    ride_q = next;
    return tick;
}

#endif
