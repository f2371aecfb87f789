#include "play.h"

#include <math.h>

int play_table_valid(const struct play_table *table) {
    const double *grid = table->grid;
    const double *width = table->width;
    if (table->n == 0) {
        return 0;
    }
    for (size_t i = 0; i < table->n; i++) {
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

size_t play_span(const double *rising, size_t n, size_t at, double x) {
    size_t low = at;
    size_t high = at + 1;
    for (size_t step = 1; low > 0 && x < rising[low]; step *= 2) {
        high = low;
        low = low > step ? low - step : 0;
    }
    for (size_t step = 1; high < n - 1 && x >= rising[high]; step *= 2) {
        low = high;
        high = high + step < n - 1 ? high + step : n - 1;
    }
    while (high - low > 1) {
        const size_t middle = low + (high - low) / 2;
        if (x < rising[middle]) {
            high = middle;
        } else {
            low = middle;
        }
    }
    return low;
}

struct play_place play_find(const struct play_table *table, double p, size_t from) {
    const double *grid = table->grid;
    const size_t last = table->n - 1;
    if (p <= grid[0]) {
        return (struct play_place){0, 0.0, 0.0};
    }
    if (p >= grid[last] || last == 0) { /* one node is all there is for NaN, too */
        return (struct play_place){last, 0.0, 0.0};
    }
    const size_t i = play_span(grid, table->n, from, p);
    return (struct play_place){i, p - grid[i], grid[i + 1] - grid[i]};
}

double play_width(const struct play_table *table, double p, size_t *at) {
    const struct play_place here = play_find(table, p, *at);
    if (here.step > 0.0) {
        *at = here.at;
    }
    return play_value(&here, table->width);
}

double play_mean_width(const struct play_table *table) {
    const size_t last = table->n - 1;
    double sum = 0.0;
    for (size_t i = 0; i < last; i++) {
        sum += 0.5 * (table->width[i] + table->width[i + 1]) * (table->grid[i + 1] - table->grid[i]);
    }
    return last > 0 ? sum / (table->grid[last] - table->grid[0]) : table->width[0];
}

struct play play_start(const struct play_table *table, double p) {
    size_t at = 0;
    return (struct play){.at = p, .half = 0.5 * play_width(table, p, &at)};
}

double play_end_far(const struct play_table *table, double q, double by, size_t *at, double *half) {
    const double *grid = table->grid;
    const double *width = table->width;
    const size_t last = table->n - 1;
    if (q <= grid[0] + by * width[0]) {
        *half = 0.5 * width[0];
        return q - by * width[0];
    }
    if (q >= grid[last] + by * width[last] || last == 0) {
        *half = 0.5 * width[last];
        return q - by * width[last];
    }
    size_t i = *at;
    while (i > 0 && q < grid[i] + by * width[i]) {
        i--;
    }
    while (q >= grid[i + 1] + by * width[i + 1]) {
        i++;
    }
    *at = i;
    const double left = grid[i] + by * width[i];
    const double right = grid[i + 1] + by * width[i + 1];
    const double share = (q - left) / (right - left);
    *half = 0.5 * (width[i] + share * (width[i + 1] - width[i]));
    return grid[i] + share * (grid[i + 1] - grid[i]);
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
