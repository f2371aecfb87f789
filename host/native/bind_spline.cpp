#include "arrays.h"
#include "spline.h"

#include <stdexcept>

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using Values = ArrayIn<double>;

ArrayOut<double, 2> at(Values knots, ArrayIn<double, 2> coefficients, Values x) {
    const size_t size = coefficients.shape(0), channels = coefficients.shape(1);
    const size_t degree = knots.shape(0) > size ? knots.shape(0) - size - 1 : 0;
    if ((degree != SPLINE_CUBIC && degree != SPLINE_CUBIC - 1) || size <= degree) {
        throw std::invalid_argument("a spline has 3 or 4 knots more than coefficients, and is of degree 2 or 3");
    }
    const struct spline of = {static_cast<int>(degree), knots.data(), coefficients.data(), size, channels};
    auto value = new_array<double>(x.shape(0), channels);
    nb::gil_scoped_release unlocked;
    spline_at(&of, x.data(), x.shape(0), value.data());
    return value;
}

} // namespace

void bind_spline(nb::module_ &m) {
    m.def("spline", at, "knots"_a, "coefficients"_a, "x"_a,
          "(n, channels) splines with these coefficients (size, channels) at x (n). See spline.h.");
}
