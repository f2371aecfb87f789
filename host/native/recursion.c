#include "recursion.h"

void first_order_sums(double *value, size_t rows, size_t columns, double rho) {
    for (size_t i = columns; i < rows * columns; i++) {
        value[i] += rho * value[i - columns];
    }
}
