#include "arrays.h"
#include "lines.h"

#include <stdexcept>

namespace nb = nanobind;
using namespace nb::literals;

namespace {

nb::object at(ArrayIn<double> x, ArrayIn<double> knots, ArrayIn<double> values) {
    const size_t n = x.shape(0);
    if (knots.shape(0) == 0 || values.shape(0) != knots.shape(0)) {
        throw std::invalid_argument("lines have a value at each of their knots, and one of these at least");
    }
    const lines all = lines_of(knots.data(), values.data(), knots.shape(0));
    auto found = new_array<double>(n);
    {
        nb::gil_scoped_release unlocked;
        for (size_t i = 0, from = 0; i < n; i++) {
            found.data()[i] = lines_at(&all, x.data()[i], &from);
        }
    }
    return nb::cast(found);
}

} // namespace

void bind_lines(nb::module_ &m) {
    m.def("lines_at", at, "x"_a, "knots"_a, "values"_a,
          "(n) straight lines between rising knots, held beyond them, at x (n). See lines.h.");
}
