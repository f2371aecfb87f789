#include "recursion.h"

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

namespace nb = nanobind;
using namespace nb::literals;

void bind_recursion(nb::module_ &m) {
    m.def(
        "first_order_sums",
        [](nb::ndarray<double, nb::ndim<2>, nb::c_contig, nb::device::cpu> value, double rho) {
            first_order_sums(value.data(), value.shape(0), value.shape(1), rho);
        },
        "value"_a, "rho"_a, "value[k] becomes value[k] + rho value[k - 1] as it became, in place. See recursion.h.");
}
