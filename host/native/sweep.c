#include "sweep.h"

#include <math.h>
#include <string.h>

enum { WIDTH = SWEEP_ROW - 1 };

static const double ROOT_TWO_PI = 2.5066282746310002, ROOT_HALF = 0.70710678118654752;
static const double FAR = -6.0;       // tolerance: sigma: beyond, the tail is an exponential
static const double LEAST = 1e-12;    // tolerance: of a precision or a variance
static const double UNLIKELY = 1e-12; // loss: a reading is never less likely: a stray one decides nothing

typedef double band_t[SWEEP_ROW];

// A = L D L^T in place: [i, k] holds A[i, i - k], then L[i, i - k], D at [i, 0].
static int factorise(band_t *a, size_t size) {
    for (size_t i = 0; i < size; i++) {
        const int reach = i < WIDTH ? (int)i : WIDTH;
        for (int back = reach; back > 0; back--) {
            const double *other = a[i - (size_t)back];
            double sum = a[i][back];
            for (int further = 1; back + further <= reach; further++) {
                sum -= a[i][back + further] * other[further];
            }
            a[i][back] = sum;
        }
        double pivot = a[i][0];
        for (int back = 1; back <= reach; back++) {
            const double scaled = a[i][back] / a[i - (size_t)back][0];
            pivot -= scaled * a[i][back];
            a[i][back] = scaled;
        }
        if (!(pivot > 0.0)) {
            return 0;
        }
        a[i][0] = pivot;
    }
    return 1;
}

static void solve(band_t *a, double *x, size_t size) {
    for (size_t i = 0; i < size; i++) {
        for (size_t back = 1; back <= WIDTH && back <= i; back++) {
            x[i] -= a[i][back] * x[i - back];
        }
    }
    for (size_t i = size; i-- > 0;) {
        x[i] /= a[i][0];
        for (size_t on = 1; on <= WIDTH && i + on < size; on++) {
            x[i] -= a[i + on][on] * x[i + on];
        }
    }
}

// A^-1 within the band, laid out as A, by Takahashi's recursion. s: (size + WIDTH) rows.
static void invert(band_t *a, band_t *s, size_t size) {
    memset(s[size], 0, WIDTH * sizeof(band_t));
    for (size_t i = size; i-- > 0;) {
        double below[SWEEP_ROW] = {0.0};
        for (size_t k = 1; k <= WIDTH && i + k < size; k++) {
            below[k] = a[i + k][k];
        }
        double own = 1.0 / a[i][0];
        for (size_t on = 1; on <= WIDTH; on++) {
            double sum = 0.0;
            for (size_t k = 1; k <= on; k++) {
                sum -= below[k] * s[i + on][on - k];
            }
            for (size_t k = on + 1; k <= WIDTH; k++) {
                sum -= below[k] * s[i + k][k - on];
            }
            s[i + on][on] = sum;
            own -= below[on] * sum;
        }
        s[i][0] = own;
    }
}

// The change at a node, in a unit of time, is the sum of c[j] * state[node - 1 + j]: `order`! times the divided
// difference of order + 1 nodes.
typedef struct {
    double c[SWEEP_ROW];
} change_t;

static change_t change_at(const sweep_t *path, size_t node) {
    double at[SWEEP_ROW] = {0.0};
    for (size_t j = 1; j <= path->order; j++) {
        at[j] = at[j - 1] + path->step[node - 2 + j];
    }
    change_t change;
    for (size_t j = 0; j <= path->order; j++) {
        double product = path->order == 2 ? 0.5 : 1.0 / 6.0;
        for (size_t k = 0; k <= path->order; k++) {
            product *= k == j ? 1.0 : at[j] - at[k];
        }
        change.c[j] = 1.0 / product;
    }
    return change;
}

static double value_of(const sweep_t *path, const change_t *change, const double *first) {
    double sum = 0.0;
    for (size_t j = 0; j <= path->order; j++) {
        sum += change->c[j] * first[j];
    }
    return sum;
}

static void add(const sweep_t *path, const change_t *change, size_t node, band_t *a, double *b) {
    const double square = path->jumped[node], now = value_of(path, change, path->state + node - 1);
    const double weight = square < 0.0 ? 1.0 / path->jump : 2.0 / (path->jump + square);
    for (size_t i = 0; i <= path->order; i++) {
        b[node - 1 + i] -= weight * now * change->c[i];
        for (size_t j = 0; j <= i; j++) {
            a[node - 1 + i][i - j] += weight * change->c[i] * change->c[j];
        }
    }
}

static double mean_square(const sweep_t *path, const change_t *change, size_t node, band_t *s) {
    double variance = 0.0;
    for (size_t i = 0; i <= path->order; i++) {
        variance += change->c[i] * change->c[i] * s[node - 1 + i][0];
        for (size_t j = 0; j < i; j++) {
            variance += 2.0 * change->c[i] * change->c[j] * s[node - 1 + i][i - j];
        }
    }
    const double now = value_of(path, change, path->state + node - 1);
    return now * now + fmax(variance, 0.0);
}

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

int sweep(sweep_t *path, double *work) {
    const size_t size = path->nodes;
    band_t *a = (band_t *)work, *s = a + size;
    change_t *changes = (change_t *)(s + size + WIDTH);
    double *b = (double *)(changes + size);
    memset(a, 0, size * sizeof(band_t));
    for (size_t k = 0; k < size; k++) {
        a[k][0] = path->precision[k] + LEAST;
        b[k] = path->force[k] - path->precision[k] * path->state[k];
    }
    for (size_t k = 1; k + path->order <= size; k++) {
        changes[k] = change_at(path, k);
        add(path, &changes[k], k, a, b);
    }
    if (!factorise(a, size)) {
        return 0;
    }
    solve(a, b, size);
    invert(a, s, size);
    for (size_t k = 0; k < size; k++) {
        path->state[k] += b[k];
    }
    for (size_t k = 1; k + path->order <= size; k++) {
        path->jumped[k] = mean_square(path, &changes[k], k, s);
    }
    const double kept = 0.3; // tolerance: of what a reading said before: all are matched at once
    double errors = 0.0;
    size_t readings = 0;
    path->told = 0.0;
    for (size_t k = 0; k < size; k++) {
        path->variance[k] = s[k][0];
        if (!(path->variance[k] > 0.0)) {
            return 0;
        }
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
    return 1;
}
