#include "hinge.h"

#include <math.h>
#include <string.h>

typedef double square_t[HINGE_COLUMNS][HINGE_COLUMNS]; // below the diagonal, and on it
typedef double seen_t[HINGE_COLUMNS][HINGE_SEEN];

// Several bends are solved together: each waits for its own roots and quotients most of the time.
enum { TOGETHER = 8 };
typedef double many_t[TOGETHER];
typedef many_t many_square_t[HINGE_COLUMNS][HINGE_COLUMNS]; // below the diagonal, and on it

static inline void fill(many_t of, double value) {
    for (size_t v = 0; v < TOGETHER; v++) {
        of[v] = value;
    }
}

static inline void take_off(double *restrict from, const double *restrict a, const double *restrict b) {
    for (size_t v = 0; v < TOGETHER; v++) {
        from[v] -= a[v] * b[v];
    }
}

static inline void multiply(double *restrict by, const double *restrict a) {
    for (size_t v = 0; v < TOGETHER; v++) {
        by[v] *= a[v];
    }
}

typedef struct {
    square_t gram;
    seen_t right;
    double furthest[HINGE_COLUMNS]; // row of the furthest frame
    double all;                     // squares of all that was seen
    double ahead;                   // of the window, up to the furthest frame
} knot_t;

// Row of the path's columns at x beyond the knot, the window being 1 long. Returns how many, from the first on, may
// differ from 0.
static size_t path_at(size_t pieces, double x, double *row) {
    const double root = sqrt((double)pieces), length = 1.0 / (double)pieces;
    row[0] = 1.0;
    row[1] = x;
    double bent = 0.5 * x * x;
    size_t piece = 0;
    for (; piece < pieces && bent > 0.0; piece++) {
        const double past = fmax(x - (double)(piece + 1) * length, 0.0), next = 0.5 * past * past;
        row[2 + piece] = (bent - next) * root;
        bent = next;
    }
    return 2 + piece;
}

enum { POWERS = 3 }; // of the travel within a piece, in which every column is a parabola

// The frames of one piece: sums of the powers of their travel in it, and of those times what was seen.
typedef struct {
    double power[2 * POWERS - 1], seen[POWERS][HINGE_SEEN];
} piece_t;

// Adds the normal equations of the frames in piece m.
static void add_piece(const hinge_t *hinge, const piece_t *piece, size_t m, square_t gram, seen_t right) {
    const double root = sqrt((double)hinge->pieces), length = 1.0 / (double)hinge->pieces;
    const size_t path = 3 + m, last = hinge_columns(hinge) - 1;
    double column[HINGE_COLUMNS][POWERS] = {{1.0}, {(double)m * length, 1.0}};
    for (size_t k = 0; k < m; k++) {
        column[2 + k][0] = root * length * length * ((double)(m - k) - 0.5);
        column[2 + k][1] = root * length;
    }
    column[2 + m][2] = 0.5 * root;
    for (size_t i = 0; i < path; i++) {
        double sums[POWERS] = {0.0};
        for (size_t p = 0; p < POWERS; p++) {
            for (size_t q = 0; q < POWERS; q++) {
                sums[q] += column[i][p] * piece->power[p + q];
            }
            for (size_t k = 0; k < hinge->seen; k++) {
                right[i][k] += column[i][p] * piece->seen[p][k];
            }
        }
        for (size_t j = 0; j <= i; j++) {
            gram[i][j] += sums[0] * column[j][0] + sums[1] * column[j][1] + sums[2] * column[j][2];
        }
        if (hinge->jump) {
            gram[last][i] += sums[0];
        }
    }
    if (hinge->jump) {
        gram[last][last] += piece->power[0];
        for (size_t k = 0; k < hinge->seen; k++) {
            right[last][k] += piece->seen[0][k];
        }
    }
}

// Normal equations of one knot.
static void gather(const hinge_t *hinge, double knot, double reach, square_t gram, seen_t right) {
    piece_t pieces[HINGE_COLUMNS] = {0};
    const double count = (double)hinge->pieces, over_reach = 1.0 / reach;
    for (size_t n = 0; n < hinge->frames; n++) {
        const double beyond = (hinge->x[n] - knot) * over_reach, *y = hinge->y + n * hinge->seen;
        if (!(beyond > 0.0)) {
            gram[0][0] += 1.0;
            for (size_t k = 0; k < hinge->seen; k++) {
                right[0][k] += y[k];
            }
            continue;
        }
        const double at = beyond * count;
        const size_t m = at < count ? (size_t)at : hinge->pieces - 1;
        const double within = beyond - (double)m / count, square = within * within;
        piece_t *piece = &pieces[m];
        piece->power[0] += 1.0;
        piece->power[1] += within;
        piece->power[2] += square;
        piece->power[3] += square * within;
        piece->power[4] += square * square;
        for (size_t k = 0; k < hinge->seen; k++) {
            piece->seen[0][k] += y[k];
            piece->seen[1][k] += within * y[k];
            piece->seen[2][k] += square * y[k];
        }
    }
    for (size_t m = 0; m < hinge->pieces; m++) {
        if (pieces[m].power[0] > 0.0) {
            add_piece(hinge, &pieces[m], m, gram, right);
        }
    }
}

// A = L L^T in place, with 1 / L[i][i] on the diagonal.
static int factorise(many_square_t a, size_t size) {
    for (size_t i = 0; i < size; i++) {
        for (size_t j = 0; j < i; j++) {
            for (size_t k = 0; k < j; k++) {
                take_off(a[i][j], a[i][k], a[j][k]);
            }
            multiply(a[i][j], a[j][j]);
        }
        many_t pivot;
        memcpy(pivot, a[i][i], sizeof pivot);
        for (size_t k = 0; k < i; k++) {
            take_off(pivot, a[i][k], a[i][k]);
        }
        for (size_t v = 0; v < TOGETHER; v++) {
            if (!(pivot[v] > 0.0)) {
                return 0;
            }
        }
        for (size_t v = 0; v < TOGETHER; v++) {
            a[i][i][v] = 1.0 / sqrt(pivot[v]);
        }
    }
    return 1;
}

static void solve(many_square_t l, size_t size, many_t *x) {
    for (size_t i = 0; i < size; i++) {
        for (size_t j = 0; j < i; j++) {
            take_off(x[i], l[i][j], x[j]);
        }
        multiply(x[i], l[i][i]);
    }
    for (size_t i = size; i-- > 0;) {
        multiply(x[i], l[i][i]);
        for (size_t j = 0; j < i; j++) {
            take_off(x[j], l[i][j], x[i]);
        }
    }
}

// Trace of A^-1 diag(weight) of one of those together, by L^-1 column after column.
static double trace_of(many_square_t l, size_t size, size_t v, const double *weight) {
    double trace = 0.0;
    for (size_t j = 0; j < size; j++) {
        double column[HINGE_COLUMNS], squares = 0.0;
        for (size_t i = j; i < size; i++) {
            double sum = i == j ? 1.0 : 0.0;
            for (size_t k = j; k < i; k++) {
                sum -= l[i][k][v] * column[k];
            }
            column[i] = sum * l[i][i][v];
            squares += column[i] * column[i];
        }
        trace += weight[j] * squares;
    }
    return trace;
}

// -2 log density of a path's first slope, for its way to the furthest frame, which is `reach` beyond the knot; both
// (seen).
static double of_start(const hinge_t *hinge, const double *slope, const double *way, double reach) {
    double along = 0.0, square = 0.0;
    for (size_t k = 0; k < hinge->seen; k++) {
        const double mean = way[k] / reach;
        along += slope[k] * mean;
        square += mean * mean;
    }
    const double apart = log(fmax(along / fmax(square, 1e-12), hinge->least)) / hinge->spread;
    return apart * apart;
}

// What one of those that were solved together left; at: where it goes.
static void tell(const hinge_t *hinge, const knot_t *knot, const double *precision, many_square_t system,
                 many_t found[HINGE_SEEN][HINGE_COLUMNS], size_t v, const hinge_fit_t *fit, size_t at) {
    const size_t columns = hinge_columns(hinge), path = 2 + hinge->pieces, seen = hinge->seen;
    double share = 1.0, explained = 0.0, held = 0.0, way[HINGE_SEEN] = {0.0}, *slope = fit->slope + at * seen;
    for (size_t i = 0; i < path; i++) {
        share *= system[i][i][v] * system[i][i][v] * precision[i];
    }
    for (size_t k = 0; k < seen; k++) {
        for (size_t i = 0; i < columns; i++) {
            const double each = found[k][i][v];
            explained += each * knot->right[i][k];
            held += precision[i] * each * each;
            way[k] += i > 0 && i < path ? knot->furthest[i] * each : 0.0;
        }
        slope[k] = found[k][1][v];
        if (hinge->jump) {
            fit->jump[at * seen + k] = found[k][columns - 1][v];
        }
    }
    const double squares = fmax(knot->all - explained, 0.0), count = ((double)hinge->frames - 2.0) * (double)seen;
    const double noise = fmax(squares / count, 1.0);
    fit->residual[at] = fmax(knot->all - explained - held, 0.0);
    fit->deviance[at] =
        count * log(noise) + squares / noise - (double)seen * log(share) + of_start(hinge, slope, way, knot->ahead);
    if (fit->used) {
        fit->used[at] = (double)columns - trace_of(system, columns, v, precision);
    }
}

// The fits of one knot under the bends from `first` on, as many as go together.
static int fit_together(const hinge_t *hinge, knot_t *knot, size_t first, const hinge_fit_t *fit, size_t at) {
    const size_t columns = hinge_columns(hinge), last = hinge->bends - 1;
    many_square_t system;
    many_t found[HINGE_SEEN][HINGE_COLUMNS];
    for (size_t i = 0; i < columns; i++) {
        for (size_t j = 0; j <= i; j++) {
            fill(system[i][j], knot->gram[i][j]);
        }
        for (size_t v = 0; v < TOGETHER; v++) { // the last once more for those that are too many
            system[i][i][v] += hinge->precision[(first + v < last ? first + v : last) * columns + i];
        }
        for (size_t k = 0; k < hinge->seen; k++) {
            fill(found[k][i], knot->right[i][k]);
        }
    }
    if (!factorise(system, columns)) {
        return 0;
    }
    for (size_t k = 0; k < hinge->seen; k++) {
        solve(system, columns, found[k]);
    }
    for (size_t v = 0; v < TOGETHER && first + v < hinge->bends; v++) {
        tell(hinge, knot, hinge->precision + (first + v) * columns, system, found, v, fit, at + first + v);
    }
    return 1;
}

int hinge_fit(const hinge_t *hinge, const hinge_fit_t *fit) {
    double reach = 1e-12, all = 0.0;
    for (size_t n = 0; n < hinge->frames; n++) {
        if (!isfinite(hinge->x[n])) {
            return 0;
        }
        reach = fmax(reach, hinge->x[n]);
    }
    for (size_t n = 0; n < hinge->frames * hinge->seen; n++) {
        all += hinge->y[n] * hinge->y[n];
    }
    if (!isfinite(all)) { // else what is left of it would be 0, a perfect fit
        return 0;
    }
    for (size_t k = 0; k < hinge->knots; k++) {
        knot_t knot = {.all = all, .ahead = fmax(1.0 - hinge->knot[k] / reach, 1e-9)};
        gather(hinge, hinge->knot[k], reach, knot.gram, knot.right);
        if (reach > hinge->knot[k]) {
            path_at(hinge->pieces, (reach - hinge->knot[k]) / reach, knot.furthest);
        }
        for (size_t v = 0; v < hinge->bends; v += TOGETHER) {
            if (!fit_together(hinge, &knot, v, fit, k * hinge->bends)) {
                return 0;
            }
        }
    }
    return 1;
}
