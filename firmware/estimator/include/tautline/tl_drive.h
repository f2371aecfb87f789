/// The estimator in use: a table with a spare, and the inverse that goes by it. All that a controller needs for one
/// axis.
///
///     static tl_drive_t drive;                                        // all zero: no table yet
///     const tl_table_reason_t reason = tl_drive_load(&drive, blob, size, axis);
///     if (reason != TL_TABLE_OK) {
///         puts(tl_table_reason_text(reason));                         // what was in use still is
///     }
///     if (tl_drive_start(&drive, 5000, TL_MODE_FULL, position, command)) { // when the axis is switched on
///         goal = tl_drive_step(&drive, command);                      // every tick, at 5000 Hz
///     }
///
/// Positions are encoder counts Q8 on the table's zero, commands deg Q16 (tl_fixed.h). Load and start from the same
/// context as the step, or with it kept out: a table that is loaded while the axis runs is taken over at the end of the
/// load, and the axis does not jump. Memory: 10 kB. Cost: tl_lookup_load()'s and tl_compensator.h's.
#ifndef TAUTLINE_TL_DRIVE_H
#define TAUTLINE_TL_DRIVE_H

#include "tautline/tl_compensator.h"

#ifdef __cplusplus
extern "C" {
#endif

/// Fields are the module's own, but `compensator.flags` may be read.
typedef struct {
    tl_lookup_t tables[2];
    uint8_t used; ///< which of them is in use
    bool loaded;
    bool started;
    tl_compensator_t compensator;
} tl_drive_t;

/// Checks a blob of tl_table.h and takes it into use. On any reason but TL_TABLE_OK the table in use stays, or none.
static inline tl_table_reason_t tl_drive_load(tl_drive_t *drive, const uint8_t *blob, size_t size, uint8_t axis) {
    const uint8_t spare = (uint8_t)(1U - drive->used);
    const tl_table_reason_t reason = tl_lookup_load(&drive->tables[spare], blob, size, axis);
    if (reason != TL_TABLE_OK) {
        return reason;
    }
    drive->used = spare;
    drive->loaded = true;
    if (drive->started) {
        tl_compensator_set_table(&drive->compensator, &drive->tables[spare]);
    }
    return reason;
}

/// Switches on, with the motor at `q`; false without a table.
static inline bool tl_drive_start(tl_drive_t *drive, uint32_t rate_hz, tl_mode_t mode, tl_count_q8_t q,
                                  tl_deg_q16_t c) {
    if (!drive->loaded) {
        return false;
    }
    tl_compensator_start(&drive->compensator, &drive->tables[drive->used], rate_hz, mode, q, c);
    drive->started = true;
    return true;
}

/// Where the motor must be for the command `c`, one tick. Only after a start. What could not be done is in
/// compensator.flags: with TL_COMPENSATOR_BELOW or _ABOVE the command is beyond what was calibrated and the goal at the
/// end of the range.
static inline tl_count_q8_t tl_drive_step(tl_drive_t *drive, tl_deg_q16_t c) {
    return tl_compensator_step(&drive->compensator, c);
}

#ifdef __cplusplus
}
#endif

#endif
