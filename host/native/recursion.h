// Recursions, which numpy does not have.
#ifndef TAUTLINE_RECURSION_H
#define TAUTLINE_RECURSION_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

// value[k] becomes value[k] + rho value[k - 1] as it became, in each column of value (rows, columns). 5 ns a value.
void first_order_sums(double *value, size_t rows, size_t columns, double rho);

enum { REGIMES_MOST = 4 };

// The forward recursion of a hidden Markov chain of `count` (at most REGIMES_MOST) regimes: found[n] is the log-density
// of sample n given all before it since the last one at which `begins` is not 0. log_density (n, count): of each sample
// in each regime; begins[0] is not 0. transition (count, count): probabilities from row to column; initial (count). 20
// ns an exponential.
void regimes_forward(const double *log_density, const unsigned char *begins, size_t n, size_t count,
                     const double *transition, const double *initial, double *found);

#ifdef __cplusplus
}
#endif

#endif
