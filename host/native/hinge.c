#include "hinge.h"

#include <math.h>
#include <string.h>

enum { COLUMNS = HINGE_PIECES + 3, PATH = 2 }; // the path's second derivatives are from PATH on
enum { NARROWED = 6 };                         // tolerance: how often candidates come closer together, at most
static const double REACH = 6.0;               // tolerance: of the knot's standard deviation: the next candidates'

typedef double square_t[COLUMNS][COLUMNS]; // below the diagonal, and on it
typedef double seen_t[COLUMNS][HINGE_SEEN];

// Several bends are solved together: each waits for its own roots and quotients most of the time.
enum { TOGETHER = HINGE_BENDS };
typedef double many_t[TOGETHER];
typedef many_t many_square_t[COLUMNS][COLUMNS]; // below the diagonal, and on it

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

static inline void add(double *restrict to, double by, const double *restrict a) {
    for (size_t v = 0; v < TOGETHER; v++) {
        to[v] += by * a[v];
    }
}

static inline void multiply(double *restrict by, const double *restrict a) {
    for (size_t v = 0; v < TOGETHER; v++) {
        by[v] *= a[v];
    }
}

typedef struct {
    size_t columns;
    square_t gram; // its first PATH columns factorised, with 1 / L[i][i] on the diagonal, the others less their part
    seen_t right;  // likewise
    double furthest[COLUMNS]; // row of the furthest frame
    double ahead;             // of the window, up to the furthest frame
} knot_t;

// The path's row at x beyond the knot, the window being 1 long.
static void path_at(size_t pieces, double x, double *row) {
    const double root = sqrt((double)pieces), length = 1.0 / (double)pieces;
    row[0] = 1.0;
    row[1] = x;
    double bent = 0.5 * x * x;
    for (size_t k = 0; k < pieces; k++) {
        const double past = fmax(x - (double)(k + 1) * length, 0.0), next = 0.5 * past * past;
        row[PATH + k] = (bent - next) * root;
        bent = next;
    }
}

double hinge_sum(const double *x, const double *y, size_t frames, size_t seen, hinge_sums_t *upto) {
    double all = 0.0;
    memset(upto, 0, sizeof *upto);
    for (size_t n = 0; n < frames; n++) {
        upto[n + 1] = upto[n];
        double power = 1.0;
        for (size_t p = 0; p < 2 * HINGE_POWERS - 1; p++, power *= x[n]) {
            upto[n + 1].power[p] += power;
            for (size_t k = 0; k < seen && p < HINGE_POWERS; k++) {
                upto[n + 1].seen[p][k] += power * y[n * seen + k];
            }
        }
        for (size_t k = 0; k < seen; k++) {
            all += y[n * seen + k] * y[n * seen + k];
        }
    }
    return all;
}

// How many frames are before x, at least `from`.
static size_t before(const hinge_t *hinge, double x, size_t from) {
    size_t to = hinge->frames;
    while (from < to) {
        const size_t middle = from + (to - from) / 2;
        if (hinge->x[middle] <= x) {
            from = middle + 1;
        } else {
            to = middle;
        }
    }
    return from;
}

// The frames from one on to before another, by their travel from x on.
static hinge_sums_t between(const hinge_t *hinge, size_t from, size_t to, double x) {
    const hinge_sums_t *a = &hinge->upto[from], *b = &hinge->upto[to];
    double p[2 * HINGE_POWERS - 1];
    hinge_sums_t sums;
    for (size_t k = 0; k < 2 * HINGE_POWERS - 1; k++) {
        p[k] = b->power[k] - a->power[k];
    }
    sums.power[0] = p[0];
    sums.power[1] = p[1] - x * p[0];
    sums.power[2] = p[2] - x * (2.0 * p[1] - x * p[0]);
    sums.power[3] = p[3] - x * (3.0 * p[2] - x * (3.0 * p[1] - x * p[0]));
    sums.power[4] = p[4] - x * (4.0 * p[3] - x * (6.0 * p[2] - x * (4.0 * p[1] - x * p[0])));
    for (size_t c = 0; c < HINGE_SEEN; c++) {
        const double s0 = b->seen[0][c] - a->seen[0][c], s1 = b->seen[1][c] - a->seen[1][c];
        sums.seen[0][c] = s0;
        sums.seen[1][c] = s1 - x * s0;
        sums.seen[2][c] = b->seen[2][c] - a->seen[2][c] - x * (2.0 * s1 - x * s0);
    }
    return sums;
}

// Normal equations of a knot at x. What a piece does is a parabola in it, and beyond it a line through its middle.
static void gather(const hinge_t *hinge, double knot, knot_t *of) {
    hinge_sums_t after = {{0.0}, {{0.0}}}; // by the travel beyond the knot
    size_t end[HINGE_PIECES + 1];
    const double length = 1.0 / (double)hinge->pieces, half = 0.5 * sqrt((double)hinge->pieces);
    const double line = 2.0 * half * length;
    const size_t last = of->columns - 1;
    end[0] = before(hinge, knot, 0);
    for (size_t k = 1; k <= hinge->pieces; k++) {
        end[k] = k < hinge->pieces ? before(hinge, knot + (double)k * length, end[k - 1]) : hinge->frames;
    }
    for (size_t k = hinge->pieces; k-- > 0;) {
        const hinge_sums_t sums = between(hinge, end[k], end[k + 1], knot + (double)k * length), *own = &sums;
        const double from = (double)k * length, middle = from + 0.5 * length, *power = after.power;
        double *row = of->gram[PATH + k];
        row[0] = line * (power[1] - middle * power[0]) + half * own->power[2];
        row[1] = line * (power[2] - middle * power[1]) + half * (own->power[3] + from * own->power[2]);
        for (size_t j = 0; j < k; j++) {
            const double other = ((double)j + 0.5) * length;
            row[PATH + j] = line * line * (power[2] - (middle + other) * power[1] + middle * other * power[0]) +
                            half * line * (own->power[3] + (from - other) * own->power[2]);
        }
        row[PATH + k] = line * line * (power[2] - 2.0 * middle * power[1] + middle * middle * power[0]) +
                        half * half * own->power[4];
        for (size_t c = 0; c < hinge->seen; c++) {
            of->right[PATH + k][c] = line * (after.seen[1][c] - middle * after.seen[0][c]) + half * own->seen[2][c];
            after.seen[1][c] += own->seen[1][c] + from * own->seen[0][c];
            after.seen[0][c] += own->seen[0][c];
        }
        after.power[2] += own->power[2] + 2.0 * from * own->power[1] + from * from * own->power[0];
        after.power[1] += own->power[1] + from * own->power[0];
        after.power[0] += own->power[0];
        if (hinge->jump) {
            of->gram[last][PATH + k] = row[0];
        }
    }
    of->gram[0][0] = (double)hinge->frames;
    of->gram[1][0] = after.power[1];
    of->gram[1][1] = after.power[2];
    for (size_t c = 0; c < hinge->seen; c++) {
        of->right[0][c] = hinge->upto[hinge->frames].seen[0][c];
        of->right[1][c] = after.seen[1][c];
    }
    if (hinge->jump) {
        of->gram[last][0] = of->gram[last][last] = after.power[0];
        of->gram[last][1] = after.power[1];
        memcpy(of->right[last], after.seen[0], sizeof of->right[last]);
    }
}

// Takes level and slope, whose priors are the same for all bends, out of the others' equations.
static int eliminate(const hinge_t *hinge, knot_t *knot) {
    double (*gram)[COLUMNS] = knot->gram;
    gram[0][0] += hinge->flat;
    gram[1][1] += hinge->steep;
    if (hinge->jump) {
        gram[knot->columns - 1][knot->columns - 1] += hinge->flat;
    }
    for (size_t j = 0; j < PATH; j++) {
        if (!(gram[j][j] > 0.0)) {
            return 0;
        }
        gram[j][j] = 1.0 / sqrt(gram[j][j]);
        for (size_t c = 0; c < hinge->seen; c++) {
            knot->right[j][c] *= gram[j][j];
        }
        for (size_t i = j + 1; i < knot->columns; i++) {
            gram[i][j] *= gram[j][j];
            for (size_t k = j + 1; k <= i; k++) {
                gram[i][k] -= gram[i][j] * gram[k][j];
            }
            for (size_t c = 0; c < hinge->seen; c++) {
                knot->right[i][c] -= gram[i][j] * knot->right[j][c];
            }
        }
    }
    return 1;
}

// A = L L^T in place from PATH on, with 1 / L[i][i] on the diagonal.
static int factorise(many_square_t a, size_t size) {
    for (size_t i = PATH; i < size; i++) {
        for (size_t j = PATH; j < i; j++) {
            for (size_t k = PATH; k < j; k++) {
                take_off(a[i][j], a[i][k], a[j][k]);
            }
            multiply(a[i][j], a[j][j]);
        }
        many_t pivot;
        memcpy(pivot, a[i][i], sizeof pivot);
        for (size_t k = PATH; k < i; k++) {
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

// What was seen once more, and how much of its squares is explained.
static void solve(const knot_t *knot, many_square_t l, size_t c, many_t *x, many_t explained) {
    const size_t size = knot->columns;
    for (size_t i = 0; i < size; i++) {
        fill(x[i], knot->right[i][c]);
        for (size_t j = PATH; j < i; j++) {
            take_off(x[i], l[i][j], x[j]);
        }
        if (i >= PATH) {
            multiply(x[i], l[i][i]);
        }
        for (size_t v = 0; v < TOGETHER; v++) {
            explained[v] += x[i][v] * x[i][v];
        }
    }
    for (size_t i = size; i-- > PATH;) {
        multiply(x[i], l[i][i]);
        for (size_t j = PATH; j < i; j++) {
            take_off(x[j], l[i][j], x[i]);
        }
    }
    for (size_t j = PATH; j-- > 0;) {
        for (size_t i = j + 1; i < size; i++) {
            add(x[j], -knot->gram[i][j], x[i]);
        }
        for (size_t v = 0; v < TOGETHER; v++) {
            x[j][v] *= knot->gram[j][j];
        }
    }
}

static double precision_of(const hinge_t *hinge, size_t column, size_t v) {
    const int bent = column >= PATH && column < PATH + hinge->pieces;
    return bent ? hinge->bend[v] : column == 1 ? hinge->steep : hinge->flat;
}

// Trace of A^-1 diag(precision) of one of those together, by L^-1 column after column.
static double trace_of(const hinge_t *hinge, const knot_t *knot, many_square_t l, size_t v) {
    double trace = 0.0;
    for (size_t j = 0; j < knot->columns; j++) {
        double column[COLUMNS], squares = 0.0;
        for (size_t i = j; i < knot->columns; i++) {
            double sum = i == j ? 1.0 : 0.0;
            for (size_t k = j; k < i; k++) {
                sum -= (k < PATH ? knot->gram[i][k] : l[i][k][v]) * column[k];
            }
            column[i] = sum * (i < PATH ? knot->gram[i][i] : l[i][i][v]);
            squares += column[i] * column[i];
        }
        trace += precision_of(hinge, j, v) * squares;
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
    const double apart = log(fmax(along / fmax(square, 1e-12), hinge->least_rise)) / hinge->spread;
    return apart * apart;
}

// The fits of one knot under all bends; at: where they go.
static int fit_knot(const hinge_t *hinge, knot_t *knot, const hinge_fit_t *fit, size_t at) {
    const size_t columns = knot->columns, path = PATH + hinge->pieces, seen = hinge->seen;
    const double count = ((double)hinge->frames - 2.0) * (double)seen;
    many_square_t system;
    many_t found[HINGE_SEEN][COLUMNS], share, explained = {0.0}, held = {0.0}, way[HINGE_SEEN] = {{0.0}};
    if (!eliminate(hinge, knot)) {
        return 0;
    }
    for (size_t i = PATH; i < columns; i++) {
        for (size_t j = PATH; j <= i; j++) {
            fill(system[i][j], knot->gram[i][j]);
        }
        for (size_t v = 0; v < TOGETHER && i < path; v++) { // the last bend once more for those that are too many
            system[i][i][v] += hinge->bend[v < hinge->bends ? v : hinge->bends - 1];
        }
    }
    if (!factorise(system, columns)) {
        return 0;
    }
    const double level = knot->gram[0][0], slope = knot->gram[1][1];
    fill(share, level * level * hinge->flat * slope * slope * hinge->steep);
    for (size_t i = PATH; i < path; i++) {
        multiply(share, system[i][i]);
        multiply(share, system[i][i]);
        for (size_t v = 0; v < hinge->bends; v++) {
            share[v] *= hinge->bend[v];
        }
    }
    for (size_t k = 0; k < seen; k++) {
        solve(knot, system, k, found[k], explained);
        for (size_t i = 1; i < path; i++) {
            add(way[k], knot->furthest[i], found[k][i]);
        }
        for (size_t i = 0; i < columns; i++) {
            for (size_t v = 0; v < hinge->bends; v++) {
                held[v] += precision_of(hinge, i, v) * found[k][i][v] * found[k][i][v];
            }
        }
    }
    for (size_t v = 0; v < hinge->bends; v++) {
        const size_t here = at + v;
        double ways[HINGE_SEEN], *slopes = fit->slope + here * seen;
        for (size_t k = 0; k < seen; k++) {
            ways[k] = way[k][v];
            slopes[k] = found[k][1][v];
            if (hinge->jump) {
                fit->jump[here * seen + k] = found[k][columns - 1][v];
            }
        }
        const double squares = fmax(hinge->all - explained[v], 0.0), noise = fmax(squares / count, 1.0);
        fit->residual[here] = fmax(hinge->all - explained[v] - held[v], 0.0);
        fit->deviance[here] = count * log(noise) + squares / noise - (double)seen * log(share[v]) +
                              of_start(hinge, slopes, ways, knot->ahead);
        if (fit->used) {
            fit->used[here] = (double)columns - trace_of(hinge, knot, system, v);
        }
    }
    return 1;
}

int hinge_fit(const hinge_t *hinge, const double *knot, size_t knots, const hinge_fit_t *fit) {
    for (size_t k = 0; k < knots; k++) {
        const double at = knot[k] / hinge->reach;
        knot_t knot_at = {.columns = PATH + hinge->pieces + (hinge->jump ? 1 : 0), .ahead = fmax(1.0 - at, 1e-9)};
        gather(hinge, at - 0.5, &knot_at);
        if (at < 1.0) {
            path_at(hinge->pieces, 1.0 - at, knot_at.furthest);
        }
        if (!fit_knot(hinge, &knot_at, fit, k * hinge->bends)) {
            return 0;
        }
    }
    return 1;
}

// Mean and standard deviation of the knot, and the best of all (knots, bends): its index.
static size_t moments(const double *knot, const double *deviance, size_t bends, double *mean, double *spread) {
    double weight[HINGE_KNOTS] = {0.0}, whole = 0.0, square = 0.0;
    size_t best = 0;
    for (size_t i = 1; i < HINGE_KNOTS * bends; i++) {
        best = deviance[i] < deviance[best] ? i : best;
    }
    *mean = 0.0;
    for (size_t i = 0; i < HINGE_KNOTS * bends; i++) {
        weight[i / bends] += exp(-0.5 * (deviance[i] - deviance[best]));
    }
    for (size_t k = 0; k < HINGE_KNOTS; k++) {
        whole += weight[k];
        *mean += weight[k] * knot[k];
    }
    *mean /= whole;
    for (size_t k = 0; k < HINGE_KNOTS; k++) {
        square += weight[k] * (knot[k] - *mean) * (knot[k] - *mean);
    }
    *spread = sqrt(square / whole);
    return best;
}

int hinge_knot(const hinge_t *hinge, double high, hinge_knot_t *found) {
    enum { ALL = HINGE_KNOTS * HINGE_BENDS };
    double knot[HINGE_KNOTS], deviance[ALL], residual[ALL], slope[ALL * HINGE_SEEN], jump[ALL * HINGE_SEEN];
    const hinge_fit_t fit = {deviance, residual, NULL, slope, jump};
    double from = 0.0, to = high;
    size_t best = 0;
    for (size_t narrowed = 0; narrowed <= NARROWED; narrowed++) { // towards the likelihood's bulk, whatever its width
        const double pitch = (to - from) / (HINGE_KNOTS - 1);
        for (size_t k = 0; k < HINGE_KNOTS; k++) {
            knot[k] = from + (double)k * pitch;
        }
        if (!hinge_fit(hinge, knot, HINGE_KNOTS, &fit)) {
            return 0;
        }
        best = moments(knot, deviance, hinge->bends, &found->knot, &found->sigma);
        const double reach = fmax(REACH * found->sigma, 3.0 * pitch);
        from = fmax(0.0, found->knot - reach);
        to = fmin(high, found->knot + reach);
        if (found->sigma > 2.0 * pitch || to - from < 1e-9 * (high + 1e-12)) {
            break;
        }
    }
    hinge_t one = *hinge;
    one.bends = 1;
    one.bend = hinge->bend + best % hinge->bends;
    const hinge_fit_t at_best = {&found->deviance, &found->residual, &found->used, found->slope, jump};
    return hinge_fit(&one, &knot[best / hinge->bends], 1, &at_best);
}

// Marks those that are to be tried next, by -INFINITY, in what the jumps that were tried left: all about the near ones.
static int mark(double *left, size_t n, size_t stride, double near) {
    int marked = 0;
    for (size_t k = 0; k < n; k++) {
        for (size_t j = k >= stride ? k - stride + 1 : 0; left[k] == INFINITY && j <= k + stride && j < n; j++) {
            if (isfinite(left[j]) && left[j] < near) {
                left[k] = -INFINITY;
                marked = 1;
            }
        }
    }
    return marked;
}

int hinge_jumps(const hinge_t *hinge, const double *edges, size_t n, size_t first, double credible, double *left,
                double *size) {
    double deviance[HINGE_BENDS], residual[HINGE_BENDS], slope[HINGE_BENDS * HINGE_SEEN],
        jump[HINGE_BENDS * HINGE_SEEN];
    const hinge_fit_t fit = {deviance, residual, NULL, slope, jump};
    const size_t stride = n > HINGE_KNOTS ? n / HINGE_KNOTS : 1;
    double least = INFINITY;
    for (size_t k = 0; k < n; k++) {
        left[k] = k % stride == 0 || k == first || k == first + 1 ? -INFINITY : INFINITY;
    }
    do {
        for (size_t k = 0; k < n; k++) {
            if (left[k] == -INFINITY) {
                const double knot = 0.5 * (edges[k] + edges[k + 1]);
                if (!hinge_fit(hinge, &knot, 1, &fit)) {
                    return 0;
                }
                size_t best = 0;
                for (size_t v = 1; v < hinge->bends; v++) {
                    best = deviance[v] < deviance[best] ? v : best;
                }
                left[k] = deviance[best];
                size[k] = 0.0;
                for (size_t c = 0; c < hinge->seen; c++) {
                    size[k] = hypot(size[k], jump[best * hinge->seen + c]);
                }
                least = fmin(least, left[k]);
            }
        }
    } while (mark(left, n, stride, least + credible));
    return 1;
}
