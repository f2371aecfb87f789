#include "arrays.h"
#include "recursion.h"

namespace nb = nanobind;
using namespace nb::literals;

void bind_recursion(nb::module_ &m) {
    m.def(
        "first_order_sums",
        [](ArrayInOut<double, 2> value, double rho) {
            first_order_sums(value.data(), value.shape(0), value.shape(1), rho);
        },
        "value"_a.noconvert(), "rho"_a,
        "value[k] becomes value[k] + rho value[k - 1] as it became, in place. See recursion.h.");
}
