#include "sweep.h"

#include "matching.h"

#include <string.h>

static const double LEAST = 1e-12; // tolerance: of a precision

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

// Factorises a row, and solves its right side, by those before it: before[k - 1] is k before.
static inline void eliminate(row_t *row, const row_t before[SWEEP_ORDER], const size_t order) {
    for (size_t back = order; back > 0; back--) {
        for (size_t further = back + 1; further <= order; further++) {
            row->l[back] -= row->l[further] * before[back - 1].l[further - back];
        }
    }
    double pivot = row->l[0];
    for (size_t back = order; back > 0; back--) {
        const double scaled = row->l[back] * before[back - 1].l[0];
        pivot -= scaled * row->l[back];
        row->x -= scaled * before[back - 1].x;
        row->l[back] = scaled;
    }
    row->l[0] = 1.0 / pivot;
}

// A row of what a node's reading tells.
static inline row_t row_of(const sweep_t *path, size_t i) {
    const double precision = path->precision[i];
    return (row_t){.l = {precision + LEAST}, .x = path->force[i] - precision * path->state[i]};
}

// Adds what the change that begins at node i tells to the rows from that node on.
static inline void add_change(const sweep_t *path, size_t i, row_t rows[SWEEP_ORDER + 1], const size_t order) {
    const double *c = path->change + i * (order + 1), square = path->jumped[i];
    const double weight = square < 0.0 ? 1.0 / path->jump : 2.0 / (path->jump + square);
    const double force = weight * change_at(c, path->state + i, order);
    for (size_t j = 0; j <= order; j++) {
        rows[j].x -= force * c[j];
        for (size_t k = 0; k <= j; k++) {
            rows[j].l[j - k] += weight * c[j] * c[k];
        }
    }
}

// From the first node to the last: the Gaussian path that readings and changes tell, as a system for how much it is
// off. The rows around the one that is eliminated are local: in registers.
static inline int forward(const sweep_t *path, const size_t order, row_t *rows) {
    row_t before[SWEEP_ORDER] = {{.x = 0.0}}, next[SWEEP_ORDER + 1];
    for (size_t j = 0; j < order; j++) {
        next[j] = row_of(path, j);
    }
    for (size_t i = 0; i < path->nodes; i++) {
        if (i + order < path->nodes) {
            next[order] = row_of(path, i + order);
            add_change(path, i, next, order);
        }
        eliminate(next, before, order);
        if (!(next[0].l[0] > 0.0)) {
            return 0;
        }
        rows[i] = next[0];
        for (size_t k = order - 1; k > 0; k--) {
            before[k] = before[k - 1];
        }
        before[0] = next[0];
        for (size_t j = 0; j < order; j++) {
            next[j] = next[j + 1];
        }
    }
    return 1;
}

// From the last node to the first: the path, its covariances by Takahashi's recursion, and its changes.
static inline int backward(sweep_t *path, const size_t order, const row_t *rows) {
    double s[SWEEP_ORDER + 1][SWEEP_ORDER + 1] = {{0.0}}; // [j][k]: of nodes i + j and i + k, where j <= k
    double x[SWEEP_ORDER + 1] = {0.0};                    // [k]: by how much node i + k is off
    for (size_t i = path->nodes; i-- > 0;) {
        const row_t *row = rows + i;
        for (size_t k = order; k > 0; k--) {
            x[k] = x[k - 1];
            for (size_t j = k; j > 0; j--) {
                s[j][k] = s[j - 1][k - 1];
            }
        }
        double off = row->x * row->l[0], own = row->l[0];
        for (size_t on = order; on > 0; on--) {
            const double below = (row + on)->l[on];
            off -= below * x[on];
            double sum = 0.0;
            for (size_t k = order; k > 0; k--) {
                sum -= (row + k)->l[k] * (k < on ? s[k][on] : s[on][k]);
            }
            s[0][on] = sum;
            own -= below * sum;
        }
        s[0][0] = own;
        x[0] = off;
        path->state[i] += off;
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
            path->jumped[i] = mean * mean + (variance > 0.0 ? variance : 0.0);
        }
    }
    return 1;
}

// The order is a constant in each: the loops along a row are none.
static int once(sweep_t *path, const size_t order, double *work) {
    row_t *rows = (row_t *)work;
    memset(rows + path->nodes, 0, SWEEP_ORDER * sizeof(row_t)); // none behind the last
    if (!forward(path, order, rows) || !backward(path, order, rows)) {
        return 0;
    }
    match_all(path);
    return 1;
}

int sweep(sweep_t *path, double *work) {
    return path->order == 2 ? once(path, 2, work) : once(path, 3, work);
}
