#include "normal.h"

enum { CUBIC = SPLINE_CUBIC };

// One of the two curves at a frame: the first of its splines that are not zero there, and dc by their coefficients.
struct curve {
    size_t at;
    double by[CUBIC];
};

static struct curve curve_at(const struct spline_basis *basis, size_t before, double x, double by_value) {
    struct curve curve;
    double t;
    curve.at = before + spline_span(basis, x, &t);
    spline_values(t, curve.by);
    for (size_t i = 0; i < CUBIC; i++) {
        curve.by[i] *= by_value;
    }
    return curve;
}

// matrix (m, m) += square a' b
static void add_block(const struct curve *restrict a, const struct curve *restrict b, double square,
                      double *restrict matrix, size_t m) {
    for (size_t i = 0; i < CUBIC; i++) {
        double *into = matrix + (a->at + i) * m + b->at;
        const double by = square * a->by[i];
        for (size_t j = 0; j < CUBIC; j++) {
            into[j] += by * b->by[j];
        }
    }
}

static void add_along(const struct curve *restrict curve, double by, double *restrict into) {
    for (size_t i = 0; i < CUBIC; i++) {
        into[curve->at + i] += by * curve->by[i];
    }
}

enum { TILE = 16 }; // of a matrix, whose rows and columns stay in the fastest cache

// What was written lies below the diagonal of matrix (m, m).
static void mirror(double *matrix, size_t m) {
    for (size_t top = 0; top < m; top += TILE) {
        for (size_t left = 0; left <= top; left += TILE) {
            for (size_t i = top; i < top + TILE && i < m; i++) {
                for (size_t j = left; j < left + TILE && j < i; j++) {
                    matrix[j * m + i] = matrix[i * m + j];
                }
            }
        }
    }
}

void normal_add(const struct normal_rows *rows, const struct spline_basis *width, const struct spline_basis *follow,
                size_t first, double *matrix, double *gradient) {
    const size_t curves = width->size + follow->size, m = curves + rows->count, count = rows->count;
    for (size_t n = 0; n < rows->frames; n++) {
        const struct curve of_width = curve_at(width, 0, rows->p[n], rows->by_width[n]);
        const struct curve of_follow = curve_at(follow, width->size, rows->tip[n], rows->by_follow[n]);
        for (size_t j = first; j < count; j++) {
            double cross = 0.0; // a column of another recording's own is zero throughout
            double *by_column = matrix + (curves + j) * m;
            for (size_t k = 0; k < rows->seen; k++) {
                const size_t row = n * rows->seen + k;
                const double *columns = rows->columns + row * count;
                const double part = (rows->weight ? rows->weight[row] : 1.0) * columns[j];
                if (part != 0.0) {
                    cross += part * rows->by_c[row];
                    gradient[curves + j] += part * rows->residual[row];
                    for (size_t i = 0; i <= j; i++) {
                        by_column[curves + i] += part * columns[i];
                    }
                }
            }
            if (cross != 0.0) {
                add_along(&of_width, cross, by_column);
                add_along(&of_follow, cross, by_column);
            }
        }
        if (first == 0) {
            double square = 0.0, force = 0.0;
            for (size_t k = 0; k < rows->seen; k++) {
                const size_t row = n * rows->seen + k;
                const double by_c = (rows->weight ? rows->weight[row] : 1.0) * rows->by_c[row];
                square += by_c * rows->by_c[row];
                force += by_c * rows->residual[row];
            }
            add_along(&of_width, force, gradient);
            add_along(&of_follow, force, gradient);
            add_block(&of_width, &of_width, square, matrix, m);
            add_block(&of_follow, &of_width, square, matrix, m);
            add_block(&of_follow, &of_follow, square, matrix, m);
        }
    }
    mirror(matrix, m);
}

// Entries of neighbouring columns.
static inline void add_run(double part, const double *restrict entry, size_t count, double *restrict into) {
    for (size_t k = 0; k < count; k++) {
        into[k] += part * entry[k];
    }
}

void normal_add_sparse(const struct normal_sparse *blocks, size_t count, const double *weight, const double *residual,
                       size_t rows, size_t *at, size_t *end, double *entry, double *matrix, double *gradient) {
    size_t m = 0;
    for (size_t b = 0; b < count; b++) {
        m += blocks[b].size;
    }
    for (size_t r = 0; r < rows; r++) {
        size_t entries = 0, before = 0;
        for (size_t b = 0; b < count; b++) {
            for (int k = blocks[b].first[r]; k < blocks[b].first[r + 1]; k++, entries++) {
                at[entries] = before + (size_t)blocks[b].column[k];
                entry[entries] = blocks[b].value[k];
            }
            before += blocks[b].size;
        }
        for (size_t i = entries; i-- > 0;) {
            end[i] = i + 1 < entries && at[i + 1] == at[i] + 1 ? end[i + 1] : i + 1;
        }
        for (size_t j = 0; j < entries; j++) {
            const double part = weight[r] * entry[j];
            double *into = matrix + at[j] * m;
            gradient[at[j]] += part * residual[r];
            for (size_t i = 0; i <= j; i = end[i]) {
                add_run(part, entry + i, (end[i] <= j ? end[i] : j + 1) - i, into + at[i]);
            }
        }
    }
    mirror(matrix, m);
}
