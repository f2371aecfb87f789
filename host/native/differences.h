// Third differences of readings at uneven times: linear combinations of four neighbours that are 0 on any parabola.
#ifndef TAUTLINE_DIFFERENCES_H
#define TAUTLINE_DIFFERENCES_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

// By readings q (n) at rising times t (n): the factors (n - 3, 4) of each, whose squares sum to 1, and their values
// (n - 3). factors NULL: not asked for.
void third_differences(const double *t, const double *q, size_t n, double *factors, double *values);

#ifdef __cplusplus
}
#endif

#endif
