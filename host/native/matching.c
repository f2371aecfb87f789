#include "matching.h"

#include <math.h>

static const double ROOT_TWO_PI = 2.5066282746310002;
static const double FAR = -6.0;       // tolerance: sigma: beyond, the tail is an exponential
static const double LEAST = 1e-12;    // tolerance: of a precision or a variance
static const double UNLIKELY = 1e-12; // loss: a reading is never less likely: a stray one decides nothing

enum { BLOCK = 64, TERMS = 12, FACTORS = 16 }; // FACTORS: of a product that double precision holds, each UNLIKELY

// Readings, a row of each quantity: what is done to all of them is a loop without branches.
typedef struct {
    size_t count;
    size_t node[BLOCK];
    double read[BLOCK], precision[BLOCK], force[BLOCK]; // the reading, and what it said of the path before
    double mean[BLOCK], variance[BLOCK];                // of the path
    double without[BLOCK], other[BLOCK], tells[BLOCK];  // of the path without the reading: mean, variance, 1 / variance
    double root[BLOCK];                                 // 1 / sigma of path and noise together
    double off[BLOCK];                                  // the reading less `without`
    double near[BLOCK], far[BLOCK];       // ends of the reading in these sigmas, mirrored to where far + near <= 0
    double at_near[BLOCK], at_far[BLOCK]; // density there
    double told[BLOCK], error[BLOCK];     // probability of the reading, square of its noise
    double moved[BLOCK], spread[BLOCK];   // mean and variance of path and noise within the reading, in these sigmas
} block_t;

static inline double larger(double a, double b) {
    return a > b ? a : b;
}

// The normal distribution's tail beyond z >= 0 over its density there, by a polynomial of (z - 5.3) / (z + 5.3) as of
// Shepherd and Laframboise (1981), interpolated at Chebyshev's nodes: to 1e-15 of itself.
static inline double tail(double z) {
    static const double even[TERMS] = {1.0404921512779903,      -0.084245869436088,      -0.13608659831615386,
                                       -0.0612417955240418,     -0.00927679415592745,    0.0003244781979134521,
                                       4.335345427016952e-05,   -1.0329801579859736e-05, 1.608899672204673e-06,
                                       -2.3213365311321362e-07, 3.0000760038411735e-08,  -2.4631622355629077e-09},
                        odd[TERMS] = {-0.01862967165546921,   0.13620875748623415,     0.10291375314427237,
                                      0.028219132307689007,   0.001541569127395841,    -0.0002748050519624452,
                                      2.2437192345102914e-05, -1.1747724535099442e-06, -8.87158351697586e-09,
                                      1.2498813517298014e-08, -1.4052814187868384e-09, 0.0};
    const double grows = 1.0 + ROOT_TWO_PI * z, inverse = 1.0 / ((z + 5.3) * grows);
    const double t = (z - 5.3) * grows * inverse, square = t * t;
    double sum_even = even[TERMS - 1], sum_odd = odd[TERMS - 1];
    for (size_t i = TERMS - 1; i-- > 0;) {
        sum_even = sum_even * square + even[i];
        sum_odd = sum_odd * square + odd[i];
    }
    return ROOT_TWO_PI * (sum_even + t * sum_odd) * (z + 5.3) * inverse;
}

// What all other readings say of the path, and where the ends of each reading are in that distribution.
static void leave_out(block_t *b, double white, double half) {
    for (size_t i = 0; i < b->count; i++) {
        const double inverse = 1.0 / b->variance[i];
        const double tells = larger(inverse - b->precision[i], 1e-10 * inverse), other = 1.0 / tells;
        const double without = other * (b->mean[i] * inverse - b->force[i]), off = b->read[i] - without;
        const double root = sqrt(1.0 / (other + white)), away = fabs(off);
        b->tells[i] = tells;
        b->other[i] = other;
        b->without[i] = without;
        b->off[i] = off;
        b->root[i] = root;
        b->near[i] = (half - away) * root;
        b->far[i] = (-half - away) * root;
    }
}

// Moments of a standard normal distribution between two ends of its lower tail, `near` < FAR.
static void between_far(block_t *b, size_t i) {
    const double end = b->near[i], wide = fmin(-end * (end - b->far[i]), 700.0), left = exp(-wide);
    const double share = (end - b->far[i]) * left / -expm1(-wide);
    b->told[i] = b->at_near[i] / -end * (1.0 - left);
    b->moved[i] = end + 1.0 / end + share;
    b->spread[i] = 1.0 / (end * end) - share * share / fmax(left, 1e-300);
}

// Moments of a standard normal distribution between each reading's ends.
static void between(block_t *b) {
    for (size_t i = 0; i < b->count; i++) {
        b->at_near[i] = exp(-0.5 * b->near[i] * b->near[i]) / ROOT_TWO_PI;
        b->at_far[i] = exp(-0.5 * b->far[i] * b->far[i]) / ROOT_TWO_PI;
    }
    for (size_t i = 0; i < b->count; i++) {
        const double z = b->near[i], beyond = b->at_near[i] * tail(fabs(z));
        const double told = (z > 0.0 ? 1.0 - beyond : beyond) - b->at_far[i] * tail(-b->far[i]), inverse = 1.0 / told;
        const double moved = (b->at_far[i] - b->at_near[i]) * inverse;
        b->told[i] = told;
        b->moved[i] = moved;
        b->spread[i] = 1.0 + (b->far[i] * b->at_far[i] - z * b->at_near[i]) * inverse - moved * moved;
    }
    for (size_t i = 0; i < b->count; i++) {
        if (b->near[i] < FAR) {
            between_far(b, i);
        }
    }
    for (size_t i = 0; i < b->count; i++) {
        const double least = larger(b->spread[i], LEAST);
        b->spread[i] = least < 1.0 ? least : 1.0;
        b->moved[i] = b->off[i] > 0.0 ? -b->moved[i] : b->moved[i];
    }
}

// Readings that are not rounded: each is where it is.
static void exactly(block_t *b) {
    for (size_t i = 0; i < b->count; i++) {
        const double z = b->off[i] * b->root[i];
        b->told[i] = exp(-0.5 * z * z) / ROOT_TWO_PI * b->root[i];
        b->moved[i] = z;
        b->spread[i] = 0.0;
    }
}

// What each reading says of the path, as precision and force, and the square of its noise.
static void say(block_t *b, double white) {
    const double kept = 0.3; // tolerance: of what a reading said before: all are matched at once
    for (size_t i = 0; i < b->count; i++) {
        const double other = b->other[i], all = other + white, inverse = b->root[i] * b->root[i];
        const double share = other * inverse, rest = white * inverse;
        const double off = b->moved[i] * all * b->root[i], scatter = all * b->spread[i];
        const double matched = 1.0 / larger(other - share * share * (all - scatter), LEAST * other);
        const double precision = matched - b->tells[i];
        const double force = (b->without[i] + share * off) * matched - b->without[i] * b->tells[i];
        const double known = b->precision[i], pulled = b->force[i];
        const double mixed = kept * known + (1.0 - kept) * precision, pull = kept * pulled + (1.0 - kept) * force;
        b->precision[i] = precision > 1e-9 ? mixed : known;
        b->force[i] = precision > 1e-9 ? pull : pulled;
        b->error[i] = rest * rest * (off * off + scatter) + rest * other;
    }
}

// Log probability of the readings.
static double log_told(const block_t *b) {
    double sum = 0.0;
    for (size_t first = 0; first < b->count; first += FACTORS) {
        double product = 1.0;
        for (size_t i = first; i < b->count && i < first + FACTORS; i++) {
            product *= larger(b->told[i], UNLIKELY);
        }
        sum += log(product);
    }
    return sum;
}

// The next readings, from node `first` on. Returns the node after the last one.
static size_t gather(const sweep_t *path, size_t first, block_t *b) {
    size_t k = first;
    for (b->count = 0; k < path->nodes && b->count < BLOCK; k++) {
        if (path->read[k]) {
            const size_t i = b->count++;
            b->node[i] = k;
            b->read[i] = path->reading[k];
            b->precision[i] = path->precision[k];
            b->force[i] = path->force[k];
            b->mean[i] = path->state[k];
            b->variance[i] = path->variance[k];
        }
    }
    return k;
}

void match_all(sweep_t *path) {
    const double white = path->noise * path->noise;
    double errors = 0.0;
    size_t readings = 0;
    path->told = 0.0;
    for (size_t k = 0; k < path->nodes;) {
        block_t b;
        k = gather(path, k, &b);
        leave_out(&b, white, path->half);
        if (path->half > 0.0) {
            between(&b);
        } else {
            exactly(&b);
        }
        say(&b, white);
        path->told += log_told(&b);
        readings += b.count;
        for (size_t i = 0; i < b.count; i++) {
            path->precision[b.node[i]] = b.precision[i];
            path->force[b.node[i]] = b.force[i];
            errors += b.error[i];
        }
    }
    path->noise = readings > 0 ? sqrt(errors / (double)readings) : path->noise;
}
