#include "arrays.h"
#include "hinge.h"

#include <stdexcept>

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using Rows = ArrayIn<double, 2>;

nb::tuple fit(ArrayIn<double> x, Rows y, ArrayIn<double> knots, Rows precision, bool jump, double spread, double least,
              bool used_too) {
    const size_t columns = precision.shape(1), fewest = jump ? 4 : 3, seen = y.shape(1);
    if (columns < fewest || columns > HINGE_COLUMNS || seen < 1 || seen > HINGE_SEEN || y.shape(0) != x.shape(0)) {
        throw std::invalid_argument("a hinge has a level, a slope and pieces, one or two channels, an x of each y");
    }
    const hinge_t hinge = {x.shape(0),   seen,     knots.shape(0), precision.shape(0), columns - fewest + 1,
                           jump ? 1 : 0, x.data(), y.data(),       knots.data(),       precision.data(),
                           spread,       least};
    const size_t k = hinge.knots, v = hinge.bends;
    auto deviance = new_array<double>(k, v), residual = new_array<double>(k, v),
         used = new_array<double>(used_too ? k : 0, v);
    auto slope = new_array<double>(k, v, seen), jumped = new_array<double>(jump ? k : 0, v, seen);
    const hinge_fit_t fit = {deviance.data(), residual.data(), used_too ? used.data() : nullptr, slope.data(),
                             jumped.data()};
    int holds = 0;
    {
        nb::gil_scoped_release unlocked;
        holds = hinge_fit(&hinge, &fit);
    }
    if (!holds) {
        throw std::invalid_argument("a hinge's values are finite and its precisions above 0");
    }
    return nb::make_tuple(deviance, residual, used, slope, jumped);
}

} // namespace

void bind_hinge(nb::module_ &m) {
    m.def("hinge", fit, "x"_a, "y"_a, "knots"_a, "precision"_a, "jump"_a, "spread"_a, "least"_a, "used_too"_a = false,
          "(deviance, residual, used, slope, jump) for each knot and each row of precisions; `used` and `jump` of no"
          " knot unless asked for. See hinge.h.");
}
