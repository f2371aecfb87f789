#include "arrays.h"
#include "spline.h"

#include <stdexcept>

namespace nb = nanobind;
using namespace nb::literals;

namespace {

nb::object at(ArrayIn<double> x, double low, double step, ArrayIn<double, 2> coefficients, bool slope) {
    const size_t n = x.shape(0), channels = coefficients.shape(1);
    const spline_basis basis = {low, step, coefficients.shape(0)};
    if (basis.size < 4 || !(step > 0.0)) {
        throw std::invalid_argument("a cubic spline has four coefficients or more, and a step above 0");
    }
    auto found = new_array<double>(n, channels);
    {
        nb::gil_scoped_release unlocked;
        for (size_t i = 0; i < n; i++) {
            double t, by[SPLINE_CUBIC];
            const double *first = coefficients.data() + spline_span(&basis, x.data()[i], &t) * channels;
            if (slope) {
                spline_slopes(t, by);
            } else {
                spline_values(t, by);
            }
            for (size_t k = 0; k < channels; k++) {
                double sum = 0.0;
                for (size_t j = 0; j < SPLINE_CUBIC; j++) {
                    sum += by[j] * first[j * channels + k];
                }
                found.data()[i * channels + k] = slope ? sum / step : sum;
            }
        }
    }
    return nb::cast(found);
}

} // namespace

void bind_splines(nb::module_ &m) {
    m.def("spline_at", at, "x"_a, "low"_a, "step"_a, "coefficients"_a, "slope"_a = false,
          "(n, channels) curves with coefficients (size, channels), or their slopes, at x (n). See spline.h.");
}
