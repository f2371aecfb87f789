#include "sweep.h"

#include <math.h>
#include <string.h>

static const double ROOT_TWO_PI = 2.5066282746310002, ROOT_HALF = 0.70710678118654752;
static const double FAR = -6.0;       // tolerance: sigma: beyond, the tail is an exponential
static const double LEAST = 1e-12;    // tolerance: of a precision or a variance
static const double UNLIKELY = 1e-12; // loss: a reading is never less likely: a stray one decides nothing

typedef struct {
    double mass, mean, variance;
} moments_t;

static double below(double z) {
    return 0.5 * erfc(-z * ROOT_HALF);
}

// Of a standard normal distribution between a and b.
static moments_t between(double a, double b) {
    const int mirrored = a + b > 0.0;
    if (mirrored) {
        const double swapped = a;
        a = -b;
        b = -swapped;
    }
    moments_t out;
    if (b < FAR) {
        const double wide = -b * (b - a), left = exp(-fmin(wide, 700.0)),
                     share = (b - a) * left / -expm1(-fmin(wide, 700.0));
        out.mass = exp(-0.5 * b * b) / (-b * ROOT_TWO_PI) * (1.0 - left);
        out.mean = b + 1.0 / b + share;
        out.variance = 1.0 / (b * b) - share * share / fmax(left, 1e-300);
    } else {
        const double at_a = exp(-0.5 * a * a) / ROOT_TWO_PI, at_b = exp(-0.5 * b * b) / ROOT_TWO_PI;
        out.mass = below(b) - below(a);
        out.mean = (at_a - at_b) / out.mass;
        out.variance = 1.0 + (a * at_a - b * at_b) / out.mass - out.mean * out.mean;
    }
    out.mean = mirrored ? -out.mean : out.mean;
    out.variance = fmin(fmax(out.variance, LEAST), 1.0);
    return out;
}

// What a reading says of the path, given what all others say of it: its mean and variance of the path without it.
static double match(const sweep_t *path, size_t k, double *precision, double *force, double *error) {
    const double mean = path->state[k], variance = path->variance[k];
    const double other = 1.0 / fmax(1.0 / variance - path->precision[k], 1e-10 / variance);
    const double without = other * (mean / variance - path->force[k]);
    const double white = path->noise * path->noise, all = other + white, spread = sqrt(all);
    double read = path->reading[k], scatter = 0.0, told;
    if (path->half > 0.0) {
        const moments_t m = between((read - path->half - without) / spread, (read + path->half - without) / spread);
        read = without + spread * m.mean;
        scatter = all * m.variance;
        told = m.mass;
    } else {
        const double z = (read - without) / spread;
        told = exp(-0.5 * z * z) / (ROOT_TWO_PI * spread);
    }
    const double share = other / all, rest = white / all;
    const double matched = fmax(other - share * share * (all - scatter), LEAST * other);
    *precision = 1.0 / matched - 1.0 / other;
    *force = (without + share * (read - without)) / matched - without / other;
    *error = rest * rest * ((read - without) * (read - without) + scatter) + rest * other;
    return log(fmax(told, UNLIKELY));
}

// A row of the system's matrix, L D L^T, and of its right side.
typedef struct {
    double l[SWEEP_ORDER + 1]; // [k] of L: k before the diagonal; [0] 1 / D
    double x;
} row_t;
_Static_assert(sizeof(row_t) == SWEEP_WORK * sizeof(double), "work has room for the rows");

// A change of the path, by its factors and the first of its nodes.
static double change_at(const double *c, const double *state, const size_t order) {
    double sum = 0.0;
    for (size_t j = 0; j <= order; j++) {
        sum += c[j] * state[j];
    }
    return sum;
}

// Factorises a row, and solves its right side, by those before it.
static inline int eliminate(row_t *row, const size_t order) {
    for (size_t back = order; back > 0; back--) {
        for (size_t further = back + 1; further <= order; further++) {
            row->l[back] -= row->l[further] * (row - back)->l[further - back];
        }
    }
    double pivot = row->l[0];
    for (size_t back = order; back > 0; back--) {
        const double scaled = row->l[back] * (row - back)->l[0];
        pivot -= scaled * row->l[back];
        row->x -= scaled * (row - back)->x;
        row->l[back] = scaled;
    }
    row->l[0] = 1.0 / pivot;
    return pivot > 0.0;
}

// From the first node to the last: the Gaussian path that readings and changes tell, as a system for how much it is
// off.
static inline int forward(const sweep_t *path, const size_t order, row_t *rows) {
    for (size_t i = 0; i < path->nodes; i++) {
        const double precision = path->precision[i];
        rows[i] = (row_t){.l = {precision + LEAST}, .x = path->force[i] - precision * path->state[i]};
    }
    for (size_t i = 0; i < path->nodes; i++) {
        row_t *row = rows + i;
        if (i + order < path->nodes) {
            const double *c = path->change + i * (order + 1), square = path->jumped[i];
            const double weight = square < 0.0 ? 1.0 / path->jump : 2.0 / (path->jump + square);
            const double force = weight * change_at(c, path->state + i, order);
            for (size_t j = 0; j <= order; j++) {
                row[j].x -= force * c[j];
                for (size_t k = 0; k <= j; k++) {
                    row[j].l[j - k] += weight * c[j] * c[k];
                }
            }
        }
        if (!eliminate(row, order)) {
            return 0;
        }
    }
    return 1;
}

// From the last node to the first: the path, its covariances by Takahashi's recursion, and its changes.
static inline int backward(sweep_t *path, const size_t order, row_t *rows) {
    double s[SWEEP_ORDER + 1][SWEEP_ORDER + 1] = {{0.0}}; // [j][k]: of nodes i + j and i + k, where j <= k
    for (size_t i = path->nodes; i-- > 0;) {
        row_t *row = rows + i;
        for (size_t k = order; k > 0; k--) {
            for (size_t j = k; j > 0; j--) {
                s[j][k] = s[j - 1][k - 1];
            }
        }
        double x = row->x * row->l[0], own = row->l[0];
        for (size_t on = order; on > 0; on--) {
            const double below = (row + on)->l[on];
            x -= below * (row + on)->x;
            double sum = 0.0;
            for (size_t k = order; k > 0; k--) {
                sum -= (row + k)->l[k] * (k < on ? s[k][on] : s[on][k]);
            }
            s[0][on] = sum;
            own -= below * sum;
        }
        s[0][0] = own;
        row->x = x;
        path->state[i] += x;
        path->variance[i] = own;
        if (!(own > 0.0)) {
            return 0;
        }
        if (i + order < path->nodes) {
            const double *c = path->change + i * (order + 1), mean = change_at(c, path->state + i, order);
            double variance = 0.0;
            for (size_t j = 0; j <= order; j++) {
                variance += c[j] * c[j] * s[j][j];
                for (size_t k = j + 1; k <= order; k++) {
                    variance += 2.0 * c[j] * c[k] * s[j][k];
                }
            }
            path->jumped[i] = mean * mean + fmax(variance, 0.0);
        }
    }
    return 1;
}

// What all readings say of the path, given the path.
static void match_all(sweep_t *path) {
    const double kept = 0.3; // tolerance: of what a reading said before: all are matched at once
    double errors = 0.0;
    size_t readings = 0;
    path->told = 0.0;
    for (size_t k = 0; k < path->nodes; k++) {
        if (path->read[k]) {
            double precision, force, error;
            path->told += match(path, k, &precision, &force, &error);
            if (precision > 1e-9) {
                path->precision[k] = kept * path->precision[k] + (1.0 - kept) * precision;
                path->force[k] = kept * path->force[k] + (1.0 - kept) * force;
            }
            errors += error;
            readings++;
        }
    }
    path->noise = readings > 0 ? sqrt(errors / (double)readings) : path->noise;
}

// The order is a constant in each: the loops along a row are none.
static int once(sweep_t *path, const size_t order, double *work) {
    memset(work, 0, SWEEP_ORDER * sizeof(row_t)); // no row before the first, none behind the last
    row_t *rows = (row_t *)work + SWEEP_ORDER;
    memset(rows + path->nodes, 0, SWEEP_ORDER * sizeof(row_t));
    if (!forward(path, order, rows) || !backward(path, order, rows)) {
        return 0;
    }
    match_all(path);
    return 1;
}

int sweep(sweep_t *path, double *work) {
    return path->order == 2 ? once(path, 2, work) : once(path, 3, work);
}
