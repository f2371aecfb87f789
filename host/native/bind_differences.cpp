#include "arrays.h"
#include "differences.h"

#include <stdexcept>

namespace nb = nanobind;
using namespace nb::literals;

namespace {

size_t count_of(const ArrayIn<double> &t, const ArrayIn<double> &q) {
    const size_t n = t.shape(0);
    if (q.shape(0) != n) {
        throw std::invalid_argument("readings have a time each");
    }
    return n > 3 ? n - 3 : 0;
}

nb::object values(ArrayIn<double> t, ArrayIn<double> q) {
    auto found = new_array<double>(count_of(t, q));
    third_differences(t.data(), q.data(), t.shape(0), nullptr, found.data());
    return nb::cast(found);
}

nb::tuple with_factors(ArrayIn<double> t, ArrayIn<double> q) {
    const size_t count = count_of(t, q);
    auto factors = new_array<double>(count, 4);
    auto found = new_array<double>(count);
    third_differences(t.data(), q.data(), t.shape(0), factors.data(), found.data());
    return nb::make_tuple(factors, found);
}

} // namespace

void bind_differences(nb::module_ &m) {
    m.def("third_differences", values, "t"_a, "q"_a,
          "(n - 3) third differences of readings q (n) at rising times t (n). See differences.h.");
    m.def("third_differences_with_factors", with_factors, "t"_a, "q"_a,
          "(n - 3, 4) factors of the third differences, and (n - 3) these. See differences.h.");
}
