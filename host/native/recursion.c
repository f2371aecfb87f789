#include "recursion.h"

#include <math.h>

void first_order_sums(double *value, size_t rows, size_t columns, double rho) {
    for (size_t i = columns; i < rows * columns; i++) {
        value[i] += rho * value[i - columns];
    }
}

void regimes_forward(const double *log_density, const unsigned char *begins, size_t n, size_t count,
                     const double *transition, const double *initial, double *found) {
    double share[REGIMES_MOST] = {0.0}; // probability of each regime after the sample before
    for (size_t i = 0; i < n; i++) {
        const double *density = log_density + i * count;
        double before[REGIMES_MOST], largest = -INFINITY, sum = 0.0;
        for (size_t to = 0; to < count; to++) {
            before[to] = begins[i] ? initial[to] : 0.0;
            for (size_t from = 0; from < count && !begins[i]; from++) {
                before[to] += share[from] * transition[from * count + to];
            }
            if (before[to] > 0.0) {
                largest = fmax(largest, density[to]);
            }
        }
        for (size_t to = 0; to < count; to++) {
            share[to] = before[to] > 0.0 ? before[to] * exp(density[to] - largest) : 0.0;
            sum += share[to];
        }
        found[i] = largest + log(sum);
        for (size_t to = 0; to < count; to++) {
            share[to] /= sum;
        }
    }
}
