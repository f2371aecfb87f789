#include "play.h"

#include <math.h>

int play_table_valid(const double *grid, const double *width, size_t n) {
    if (n == 0) {
        return 0;
    }
    for (size_t i = 0; i < n; i++) {
        if (!isfinite(grid[i]) || !isfinite(width[i]) || width[i] < 0.0) {
            return 0;
        }
        if (i > 0) {
            const double step = grid[i] - grid[i - 1];
            if (!(step > 0.0) || !(fabs(width[i] - width[i - 1]) < 2.0 * step)) {
                return 0;
            }
        }
    }
    return 1;
}

double play_envelope(double q, double side, const double *grid, const double *width, size_t n, size_t *at) {
    const double half = 0.5 * side;
    if (q <= grid[0] + half * width[0]) {
        return q - half * width[0];
    }
    if (q >= grid[n - 1] + half * width[n - 1]) {
        return q - half * width[n - 1];
    }
    size_t i = *at;
    while (i > 0 && q < grid[i] + half * width[i]) {
        i--;
    }
    while (q >= grid[i + 1] + half * width[i + 1]) {
        i++;
    }
    *at = i;
    const double left = grid[i] + half * width[i];
    const double right = grid[i + 1] + half * width[i + 1];
    return grid[i] + (q - left) * (grid[i + 1] - grid[i]) / (right - left);
}

void play_forward(const double *q, size_t count, const double *grid, const double *width, size_t n, double p0,
                  double *p, int8_t *side, int32_t *anchor) {
    size_t low_at = 0;
    size_t high_at = 0;
    int8_t held_by = PLAY_INSIDE;
    int32_t moved_at = -1;
    double state = (isnan(p0) && count > 0) ? q[0] : p0;
    for (size_t k = 0; k < count; k++) {
        const double low = play_envelope(q[k], 1.0, grid, width, n, &low_at);
        const double high = play_envelope(q[k], -1.0, grid, width, n, &high_at);
        if (state < low) {
            state = low;
            held_by = PLAY_RISING;
            moved_at = (int32_t)k;
        } else if (state > high) {
            state = high;
            held_by = PLAY_FALLING;
            moved_at = (int32_t)k;
        }
        p[k] = state;
        if (side) {
            side[k] = held_by;
        }
        if (anchor) {
            anchor[k] = moved_at;
        }
    }
}

size_t play_turns(const double *q, size_t count, double hysteresis, int32_t *turns) {
    size_t found = 0;
    size_t highest = 0;
    size_t lowest = 0;
    int direction = 0;
    for (size_t k = 1; k < count; k++) {
        if (q[k] > q[highest]) {
            highest = k;
        }
        if (q[k] < q[lowest]) {
            lowest = k;
        }
        if (direction <= 0 && q[k] - q[lowest] > hysteresis) {
            if (direction < 0) {
                turns[found++] = (int32_t)lowest;
            }
            direction = 1;
            highest = k;
        } else if (direction >= 0 && q[highest] - q[k] > hysteresis) {
            if (direction > 0) {
                turns[found++] = (int32_t)highest;
            }
            direction = -1;
            lowest = k;
        }
    }
    return found;
}
