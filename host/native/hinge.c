#include "hinge.h"

#include <math.h>
#include <string.h>

typedef double square_t[HINGE_COLUMNS][HINGE_COLUMNS]; // below the diagonal, and on it
typedef double seen_t[HINGE_COLUMNS][HINGE_SEEN];

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
    piece_t piece[HINGE_COLUMNS] = {0};
    memset(gram, 0, sizeof(square_t));
    memset(right, 0, sizeof(seen_t));
    for (size_t n = 0; n < hinge->frames; n++) {
        const double beyond = (hinge->x[n] - knot) / reach, *y = hinge->y + n * hinge->seen;
        if (!(beyond > 0.0)) {
            gram[0][0] += 1.0;
            for (size_t k = 0; k < hinge->seen; k++) {
                right[0][k] += y[k];
            }
            continue;
        }
        const double pieces = (double)hinge->pieces, at = beyond * pieces;
        const size_t m = at < pieces ? (size_t)at : hinge->pieces - 1;
        const double within = beyond - (double)m / pieces;
        double power = 1.0;
        for (size_t p = 0; p < 2 * POWERS - 1; p++, power *= within) {
            piece[m].power[p] += power;
            for (size_t k = 0; p < POWERS && k < hinge->seen; k++) {
                piece[m].seen[p][k] += power * y[k];
            }
        }
    }
    for (size_t m = 0; m < hinge->pieces; m++) {
        if (piece[m].power[0] > 0.0) {
            add_piece(hinge, &piece[m], m, gram, right);
        }
    }
}

// A = L L^T in place, with 1 / L[i][i] on the diagonal.
static int factorise(square_t a, size_t size) {
    for (size_t i = 0; i < size; i++) {
        for (size_t j = 0; j < i; j++) {
            double sum = a[i][j];
            for (size_t k = 0; k < j; k++) {
                sum -= a[i][k] * a[j][k];
            }
            a[i][j] = sum * a[j][j];
        }
        double pivot = a[i][i];
        for (size_t k = 0; k < i; k++) {
            pivot -= a[i][k] * a[i][k];
        }
        if (!(pivot > 0.0)) {
            return 0;
        }
        a[i][i] = 1.0 / sqrt(pivot);
    }
    return 1;
}

static void solve(square_t l, size_t size, seen_t x) {
    for (size_t i = 0; i < size; i++) {
        for (size_t j = 0; j < i; j++) {
            for (size_t k = 0; k < HINGE_SEEN; k++) {
                x[i][k] -= l[i][j] * x[j][k];
            }
        }
        for (size_t k = 0; k < HINGE_SEEN; k++) {
            x[i][k] *= l[i][i];
        }
    }
    for (size_t i = size; i-- > 0;) {
        for (size_t k = 0; k < HINGE_SEEN; k++) {
            x[i][k] *= l[i][i];
        }
        for (size_t j = 0; j < i; j++) {
            for (size_t k = 0; k < HINGE_SEEN; k++) {
                x[j][k] -= l[i][j] * x[i][k];
            }
        }
    }
}

// Trace of A^-1 diag(weight), by L^-1 column after column.
static double trace_of(square_t l, size_t size, const double *weight) {
    double trace = 0.0;
    for (size_t j = 0; j < size; j++) {
        double column[HINGE_COLUMNS], squares = 0.0;
        for (size_t i = j; i < size; i++) {
            double sum = i == j ? 1.0 : 0.0;
            for (size_t k = j; k < i; k++) {
                sum -= l[i][k] * column[k];
            }
            column[i] = sum * l[i][i];
            squares += column[i] * column[i];
        }
        trace += weight[j] * squares;
    }
    return trace;
}

static int fit_one(const hinge_t *hinge, const double *precision, square_t gram, seen_t right, const double *furthest,
                   double all, const hinge_fit_t *fit, size_t at) {
    const size_t columns = hinge_columns(hinge), path = 2 + hinge->pieces, seen = hinge->seen;
    square_t system;
    seen_t found;
    memcpy(system, gram, sizeof(square_t));
    memcpy(found, right, sizeof(seen_t));
    for (size_t i = 0; i < columns; i++) {
        system[i][i] += precision[i];
    }
    if (!factorise(system, columns)) {
        return 0;
    }
    solve(system, columns, found);
    double volume = 0.0, explained = 0.0, held = 0.0, *way = fit->way + at * seen;
    for (size_t i = 0; i < path; i++) {
        volume -= log(system[i][i] * system[i][i] * precision[i]);
    }
    for (size_t k = 0; k < seen; k++) {
        way[k] = 0.0;
        for (size_t i = 0; i < columns; i++) {
            explained += found[i][k] * right[i][k];
            held += precision[i] * found[i][k] * found[i][k];
            way[k] += i > 0 && i < path ? furthest[i] * found[i][k] : 0.0;
            fit->coefficients[(at * columns + i) * seen + k] = found[i][k];
        }
    }
    fit->squares[at] = fmax(all - explained, 0.0);
    fit->residual[at] = fmax(all - explained - held, 0.0);
    fit->volume[at] = volume;
    if (fit->used) {
        fit->used[at] = (double)columns - trace_of(system, columns, precision);
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
        square_t gram;
        seen_t right;
        double furthest[HINGE_COLUMNS] = {0.0};
        gather(hinge, hinge->knot[k], reach, gram, right);
        if (reach > hinge->knot[k]) {
            path_at(hinge->pieces, (reach - hinge->knot[k]) / reach, furthest);
        }
        for (size_t v = 0; v < hinge->bends; v++) {
            if (!fit_one(hinge, hinge->precision + v * hinge_columns(hinge), gram, right, furthest, all, fit,
                         k * hinge->bends + v)) {
                return 0;
            }
        }
    }
    return 1;
}
