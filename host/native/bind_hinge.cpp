#include "arrays.h"
#include "hinge.h"

#include <stdexcept>

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using Rows = ArrayIn<double, 2>;

nb::tuple fit(ArrayIn<double> x, Rows y, ArrayIn<double> knots, Rows precision, bool jump, bool used_too) {
    const size_t columns = precision.shape(1), least = jump ? 4 : 3, seen = y.shape(1);
    if (columns < least || columns > HINGE_COLUMNS || seen < 1 || seen > HINGE_SEEN || y.shape(0) != x.shape(0)) {
        throw std::invalid_argument("a hinge has a level, a slope and pieces, one or two channels, an x of each y");
    }
    const hinge_t hinge = {x.shape(0),   seen,     knots.shape(0), precision.shape(0), columns - least + 1,
                           jump ? 1 : 0, x.data(), y.data(),       knots.data(),       precision.data()};
    const size_t k = hinge.knots, v = hinge.bends;
    auto squares = new_array<double>(k, v), residual = new_array<double>(k, v), volume = new_array<double>(k, v),
         used = new_array<double>(used_too ? k : 0, v);
    auto way = new_array<double>(k, v, seen);
    auto coefficients = new_array<double>(k, v, columns, seen);
    const hinge_fit_t fit = {squares.data(), residual.data(),    volume.data(), used_too ? used.data() : nullptr,
                             way.data(),     coefficients.data()};
    int holds = 0;
    {
        nb::gil_scoped_release unlocked;
        holds = hinge_fit(&hinge, &fit);
    }
    if (!holds) {
        throw std::invalid_argument("a hinge's values are finite and its precisions above 0");
    }
    const nb::object columns_used = used_too ? nb::cast(used) : nb::none();
    return nb::make_tuple(squares, residual, volume, columns_used, way, coefficients);
}

} // namespace

void bind_hinge(nb::module_ &m) {
    m.def("hinge", fit, "x"_a, "y"_a, "knots"_a, "precision"_a, "jump"_a, "used_too"_a = true,
          "(squares, residual, volume, used, way, coefficients) for each knot and each row of precisions, `used` None"
          " unless asked for. See hinge.h.");
}
