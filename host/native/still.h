// Where an image stands still: when it leaves its level, and with which delay it stops as the motor turns.
#ifndef TAUTLINE_STILL_H
#define TAUTLINE_STILL_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { STILL_ORDERS = 2, STILL_SEEN = 2 }; // of a path's polynomial, and channels: at most

// The first frame at which z (n, seen; unit variance) has left the level that it started from by 5.5 sigma of it (by
// chance once in 3 million) and by 2 % of its whole swing (less is a wobble inside the backlash), as the mean of 1, 2,
// 4, .. 32 frames sees it, of 1 twice in a row (one alone may be an outlier); n where it has not. total: room for
// (n + 1, seen). O(n).
size_t still_until(const double *z, size_t n, size_t seen, double *total);

// Frames around a turn of the motor.
struct still_stop {
    size_t frames, seen, readings;
    int order, direction;    // of the path's polynomial, 1 or 2; before the turn, 1 or -1
    const double *arrival_s; // (frames) in order
    const double *z;         // (frames, seen) of unit variance
    const double *motor_s;   // (readings) rising, at least 1
    const double *motor_q;
    double turn_s, q1; // where the motor turns
};

// What is left, sums of squares (count), of level + polynomial of the way that is left to the turn, if the image is
// late by each of `delays`: the image stands still from the turn on. A ridge of 1e-11 a frame keeps it solvable. ramp:
// room for (frames). 0.02 us a frame and delay.
void still_squares(const struct still_stop *stop, const double *delays, size_t count, double *ramp, double *squares);

#ifdef __cplusplus
}
#endif

#endif
