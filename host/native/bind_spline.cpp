#include "arrays.h"
#include "spline.h"

#include <stdexcept>

namespace nb = nanobind;
using namespace nb::literals;

namespace {

nb::object curve(double low, double step, ArrayIn<double, 2> coefficients, ArrayIn<double> x, bool slope) {
    const spline_basis basis = {low, step, coefficients.shape(0)};
    if (basis.size < SPLINE_CUBIC) {
        throw std::invalid_argument("a cubic spline has four coefficients or more");
    }
    auto found = new_array<double>(x.shape(0), coefficients.shape(1));
    {
        nb::gil_scoped_release unlocked;
        spline_curve(&basis, coefficients.data(), coefficients.shape(1), x.data(), x.shape(0), slope, found.data());
    }
    return nb::cast(found);
}

} // namespace

void bind_spline(nb::module_ &m) {
    m.def("spline_curve", curve, "low"_a, "step"_a, "coefficients"_a, "x"_a, "slope"_a = false,
          "(n, channels) a curve of coefficients (size, channels), or its derivative, at x (n). See spline.h.");
}
