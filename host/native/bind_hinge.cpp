#include "arrays.h"
#include "hinge.h"

#include <initializer_list>
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <stdexcept>

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using Rows = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

nb::object shaped(const ArrayOut<double> &values, std::initializer_list<size_t> shape) {
    nb::list sizes;
    for (size_t size : shape) {
        sizes.append(size);
    }
    return nb::cast(values).attr("reshape")(nb::tuple(sizes));
}

nb::tuple fit(ArrayIn<double> x, Rows y, ArrayIn<double> knots, Rows precision, bool jump, bool used_too) {
    const size_t columns = precision.shape(1), least = jump ? 4 : 3, seen = y.shape(1);
    if (columns < least || columns > HINGE_COLUMNS || seen < 1 || seen > HINGE_SEEN || y.shape(0) != x.shape(0)) {
        throw std::invalid_argument("a hinge has a level, a slope and pieces, one or two channels, an x of each y");
    }
    const hinge_t hinge = {x.shape(0),   seen,     knots.shape(0), precision.shape(0), columns - least + 1,
                           jump ? 1 : 0, x.data(), y.data(),       knots.data(),       precision.data()};
    const size_t each = hinge.knots * hinge.bends;
    auto squares = new_array<double>(each), residual = new_array<double>(each), volume = new_array<double>(each),
         used = new_array<double>(used_too ? each : 0), way = new_array<double>(each * seen),
         coefficients = new_array<double>(each * columns * seen);
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
    const auto of = {hinge.knots, hinge.bends};
    const nb::object columns_used = used_too ? shaped(used, of) : nb::none();
    return nb::make_tuple(shaped(squares, of), shaped(residual, of), shaped(volume, of), columns_used,
                          shaped(way, {hinge.knots, hinge.bends, seen}),
                          shaped(coefficients, {hinge.knots, hinge.bends, columns, seen}));
}

} // namespace

void bind_hinge(nb::module_ &m) {
    m.def("hinge", fit, "x"_a, "y"_a, "knots"_a, "precision"_a, "jump"_a, "used_too"_a = true,
          "(squares, residual, volume, used, way, coefficients) for each knot and each row of precisions, `used` None"
          " unless asked for. See hinge.h.");
}
