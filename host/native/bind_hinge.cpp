#include "arrays.h"
#include "hinge.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>
#include <vector>

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using Values = ArrayIn<double>;
using Rows = ArrayIn<double, 2>;

/// The frames of one stroke, and the priors of a path through them.
struct Hinge {
    Values bend;
    std::vector<double> x;
    std::vector<hinge_sums_t> upto;
    hinge_t hinge;

    Hinge(const Values &travel, const Rows &y, size_t pieces, bool jump, double flat, double steep, const Values &bends,
          double spread, double least_rise)
        : bend(bends), x(travel.shape(0)), upto(x.size() + 1),
          hinge{x.size(), y.shape(1), pieces, bend.shape(0), jump ? 1 : 0, x.data(), upto.data(),
                1e-12,    0.0,        flat,   steep,         bend.data(),  spread,   least_rise} {
        const size_t frames = x.size(), seen = hinge.seen;
        if (pieces < 1 || pieces > HINGE_PIECES || hinge.bends < 1 || hinge.bends > HINGE_BENDS || seen < 1 ||
            seen > HINGE_SEEN || y.shape(0) != frames) {
            throw std::invalid_argument("a hinge has pieces and bends, one or two channels, an x of each y");
        }
        const auto finite = [](double value) { return std::isfinite(value); };
        if (!std::all_of(travel.data(), travel.data() + frames, finite) ||
            !std::all_of(y.data(), y.data() + frames * seen,
                         finite)) { // else nothing would be left of it: a perfect fit
            throw std::invalid_argument("a hinge's values are finite");
        }
        std::vector<size_t> order(frames);
        std::iota(order.begin(), order.end(), size_t{0});
        std::stable_sort(order.begin(), order.end(),
                         [&](size_t a, size_t b) { return travel.data()[a] < travel.data()[b]; });
        std::vector<double> rising(frames * seen);
        if (frames) {
            hinge.reach = std::max(hinge.reach, travel.data()[order.back()]);
        }
        for (size_t n = 0; n < frames; n++) {
            x[n] = travel.data()[order[n]] / hinge.reach - 0.5;
            std::copy_n(y.data() + order[n] * seen, seen, rising.begin() + static_cast<std::ptrdiff_t>(n * seen));
        }
        hinge.all = hinge_sum(x.data(), rising.data(), frames, seen, upto.data());
    }
    Hinge(const Hinge &) = delete; // its pointers are into itself
    Hinge &operator=(const Hinge &) = delete;

    static void expect(int holds) {
        if (!holds) {
            throw std::invalid_argument("a hinge's precisions are above 0");
        }
    }

    nb::tuple fit(Values knots) const {
        const size_t k = knots.shape(0), v = hinge.bends, seen = hinge.seen;
        auto deviance = new_array<double>(k, v), residual = new_array<double>(k, v), used = new_array<double>(k, v);
        auto slope = new_array<double>(k, v, seen), jump = new_array<double>(hinge.jump ? k : 0, v, seen);
        const hinge_fit_t found = {deviance.data(), residual.data(), used.data(), slope.data(), jump.data()};
        expect(hinge_fit(&hinge, knots.data(), k, &found));
        return nb::make_tuple(deviance, residual, used, slope, jump);
    }

    nb::tuple knot(double high) const {
        hinge_knot_t found;
        expect(hinge_knot(&hinge, high, &found));
        auto slope = new_array<double>(hinge.seen);
        std::copy(found.slope, found.slope + hinge.seen, slope.data());
        return nb::make_tuple(found.knot, found.sigma, found.deviance, found.residual, found.used, slope);
    }

    nb::tuple jumps(Values edges, size_t first, double credible) const {
        if (!hinge.jump || edges.shape(0) < 2) {
            throw std::invalid_argument("a jump is between two edges, of a hinge with one");
        }
        const size_t n = edges.shape(0) - 1;
        auto left = new_array<double>(n), size = new_array<double>(n);
        expect(hinge_jumps(&hinge, edges.data(), n, first, credible, left.data(), size.data()));
        return nb::make_tuple(left, size);
    }
};

} // namespace

void bind_hinge(nb::module_ &m) {
    nb::class_<Hinge>(m, "Hinge", "hinge.h: travel x (n) and y (n, channels) of one stroke, priors of its path.")
        .def(nb::init<const Values &, const Rows &, size_t, bool, double, double, const Values &, double, double>(),
             "x"_a, "y"_a, "pieces"_a, "jump"_a, "flat"_a, "steep"_a, "bend"_a, "spread"_a, "least_rise"_a)
        .def("fit", &Hinge::fit, "knots"_a,
             "(deviance, residual, used, slope, jump) for each knot and bend; `jump` of no knot without one.")
        .def("knot", &Hinge::knot, "high"_a,
             "(knot, sigma, deviance, residual, used, slope): the posterior of a knot within [0, high].")
        .def("jumps", &Hinge::jumps, "edges"_a, "first"_a, "credible"_a,
             "(deviance, size) of jumps between neighbouring edges; infinite and none where they were not tried.");
}
