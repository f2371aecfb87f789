#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <limits>
#include <memory>
#include <stdexcept>

#include "play.h"

namespace nb = nanobind;
using Input = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

template <typename T> static nb::ndarray<nb::numpy, T, nb::ndim<1>> owned(std::unique_ptr<T[]> data, size_t n) {
    T *raw = data.release();
    nb::capsule owner(raw, [](void *p) noexcept { delete[] static_cast<T *>(p); });
    return {raw, {n}, owner};
}

static void check(const Input &q, const Input &grid, const Input &width) {
    if (grid.size() != width.size()) {
        throw std::invalid_argument("play: grid and width differ in length");
    }
    if (!play_table_valid(grid.data(), width.data(), grid.size())) {
        throw std::invalid_argument("play: not a backlash table (grid rising, width >= 0, |width'| < 2, all finite)");
    }
    if (q.size() > static_cast<size_t>(std::numeric_limits<int32_t>::max())) {
        throw std::invalid_argument("play: too many samples");
    }
}

void bind_play(nb::module_ &m) {
    m.def(
        "play_forward",
        [](Input q, Input grid, Input width, double p0) {
            check(q, grid, width);
            auto p = std::make_unique<double[]>(q.size());
            play_forward(q.data(), q.size(), grid.data(), width.data(), grid.size(), p0, p.get(), nullptr, nullptr);
            return owned(std::move(p), q.size());
        },
        nb::arg("q"), nb::arg("grid_q"), nb::arg("width"), nb::arg("p0"),
        "Centre coordinate p (n,) float64 of the motor positions q (n,); p0 NaN: on the centre, p = q[0].");
    m.def(
        "play_trace",
        [](Input q, Input grid, Input width, double p0) {
            check(q, grid, width);
            const size_t n = q.size();
            auto p = std::make_unique<double[]>(n);
            auto side = std::make_unique<int8_t[]>(n);
            auto anchor = std::make_unique<int32_t[]>(n);
            play_forward(q.data(), n, grid.data(), width.data(), grid.size(), p0, p.get(), side.get(), anchor.get());
            return nb::make_tuple(owned(std::move(p), n), owned(std::move(side), n), owned(std::move(anchor), n));
        },
        nb::arg("q"), nb::arg("grid_q"), nb::arg("width"), nb::arg("p0"),
        "(p, side, anchor): also the envelope (+1 rising, -1 falling, 0 none yet) and the sample that last moved p.");
    m.def(
        "turns",
        [](Input q, double hysteresis) {
            auto turns = std::make_unique<int32_t[]>(q.size() + 1);
            const size_t found = play_turns(q.data(), q.size(), hysteresis, turns.get());
            return owned(std::move(turns), found);
        },
        nb::arg("q"), nb::arg("hysteresis"),
        "Indices (int32) of the samples at which q turns; going back by no more than the hysteresis is no turn.");
}
