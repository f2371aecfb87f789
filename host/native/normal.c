#include "normal.h"

enum { CUBIC = SPLINE_CUBIC, CURVES = 2 * CUBIC };

// The four splines that are not zero at x: the first one's index and all values.
static size_t spline(const struct spline_basis *basis, double x, double *value) {
    double t;
    const size_t first = spline_span(basis, x, &t);
    spline_values(t, value);
    return first;
}

// What was written lies below the diagonal of matrix (m, m).
static void mirror(double *matrix, size_t m) {
    for (size_t j = 0; j < m; j++) {
        for (size_t i = j + 1; i < m; i++) {
            matrix[j * m + i] = matrix[i * m + j];
        }
    }
}

void normal_add(const struct normal_rows *rows, const struct spline_basis *width, const struct spline_basis *follow,
                size_t first, double *matrix, double *gradient) {
    const size_t curves = width->size + follow->size, m = curves + rows->count, count = rows->count;
    for (size_t n = 0; n < rows->frames; n++) {
        double c[CURVES]; // dc by the curves' coefficients
        size_t at[CURVES];
        const size_t in_width = spline(width, rows->p[n], c);
        const size_t in_follow = width->size + spline(follow, rows->tip[n], c + CUBIC);
        for (size_t i = 0; i < CUBIC; i++) {
            c[i] *= rows->by_width[n];
            c[CUBIC + i] *= rows->by_follow[n];
            at[i] = in_width + i;
            at[CUBIC + i] = in_follow + i;
        }
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
            for (size_t i = 0; cross != 0.0 && i < CURVES; i++) {
                by_column[at[i]] += cross * c[i];
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
            for (size_t i = 0; i < CURVES; i++) {
                gradient[at[i]] += force * c[i];
                double *into = matrix + at[i] * m;
                for (size_t j = 0; j <= i; j++) {
                    into[at[j]] += square * c[i] * c[j];
                }
            }
        }
    }
    mirror(matrix, m);
}

void normal_add_sparse(const struct normal_sparse *rows, double *matrix, double *gradient) {
    for (size_t r = 0; r < rows->rows; r++) {
        const size_t end = (size_t)rows->first[r + 1];
        for (size_t j = (size_t)rows->first[r], begin = j; j < end; j++) {
            const size_t at = (size_t)rows->column[j];
            const double part = rows->weight[r] * rows->value[j];
            double *into = matrix + at * rows->size;
            gradient[at] += part * rows->residual[r];
            for (size_t i = begin; i <= j; i++) {
                into[rows->column[i]] += part * rows->value[i];
            }
        }
    }
    mirror(matrix, rows->size);
}
