// Normal equations of fits whose rows have few entries, so that nothing as large as rows times unknowns is ever made:
// of two curves in cubic B-splines (eight entries a row) and a few columns that touch every row, or of any columns.
#ifndef TAUTLINE_NORMAL_H
#define TAUTLINE_NORMAL_H

#include "spline.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

// A frame has `seen` coordinates (1 or 2), each a row: d prediction = by_c dc + columns dx, where
// dc = by_width dB(p) + by_follow df(tip).
struct normal_rows {
    const double *p, *tip, *by_width, *by_follow; // (frames)
    const double *by_c;                           // (frames, seen)
    const double *columns;                        // (frames, seen, count)
    const double *residual;                       // (frames, seen)
    const double *weight;                         // (frames, seen), or NULL for ones
    size_t frames, seen, count;
};

enum { NORMAL_SEEN = 2 };

// Adds J'WJ to matrix (m, m) and J'Wr to gradient (m), m = width.size + follow.size + count, unknowns in that order:
// all of it with first 0, else only the rows (and their mirrored columns) of columns from `first` on. matrix must be
// symmetric before. About 0.3 us a frame with 8 columns.
void normal_add(const struct normal_rows *rows, const struct spline_basis *width, const struct spline_basis *follow,
                size_t first, double *matrix, double *gradient);

// Some columns of all rows, by their entries alone (compressed sparse rows): row r has the entries from first[r] up to
// first[r + 1], their columns rising.
struct normal_sparse {
    const int *first;    // (rows + 1)
    const int *column;   // (entries) 0 to size - 1
    const double *value; // (entries)
    size_t size;
};

// Adds J'WJ to matrix (m, m), symmetric before, and J'Wr to gradient (m), J being the blocks side by side and m the sum
// of their sizes; weight, residual: (rows). at, end, entry: room for the longest row of J. About 2 ns for each pair of
// entries of a row, a fifth of what scipy's product takes.
void normal_add_sparse(const struct normal_sparse *blocks, size_t count, const double *weight, const double *residual,
                       size_t rows, size_t *at, size_t *end, double *entry, double *matrix, double *gradient);

#ifdef __cplusplus
}
#endif
#endif
