#include "arrays.h"
#include "recursion.h"

#include <stdexcept>

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
    m.def(
        "regimes_forward",
        [](ArrayIn<double, 2> log_density, ArrayIn<bool> begins, ArrayIn<double, 2> transition,
           ArrayIn<double> initial) {
            const size_t n = log_density.shape(0), count = log_density.shape(1);
            if (count > REGIMES_MOST || begins.shape(0) != n || transition.shape(0) != count ||
                transition.shape(1) != count || initial.shape(0) != count) {
                throw std::invalid_argument("shapes of regimes do not fit each other");
            }
            auto found = new_array<double>(n);
            regimes_forward(log_density.data(), reinterpret_cast<const unsigned char *>(begins.data()), n, count,
                            transition.data(), initial.data(), found.data());
            return found;
        },
        "log_density"_a, "begins"_a, "transition"_a, "initial"_a,
        "Log-density (n) of each sample given those before it, of a hidden Markov chain. See recursion.h.");
}
