#include "arrays.h"
#include "hinge.h"

#include <stdexcept>

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using Values = ArrayIn<double>;
using Rows = ArrayIn<double, 2>;

/// The frames of one stroke, and the priors of a path through them.
struct Hinge {
    Values x, bend;
    Rows y;
    hinge_t hinge;

    Hinge(const Values &travel, const Rows &seen, size_t pieces, bool jump, double flat, double steep,
          const Values &bends, double spread, double least_rise)
        : x(travel), bend(bends), y(seen),
          hinge{x.shape(0), y.shape(1), pieces, bend.shape(0), jump ? 1 : 0, x.data(),
                y.data(),   flat,       steep,  bend.data(),   spread,       least_rise} {
        if (pieces < 1 || pieces > HINGE_PIECES || hinge.bends < 1 || hinge.bends > HINGE_BENDS || hinge.seen < 1 ||
            hinge.seen > HINGE_SEEN || y.shape(0) != x.shape(0)) {
            throw std::invalid_argument("a hinge has pieces and bends, one or two channels, an x of each y");
        }
    }

    static void expect(int holds) {
        if (!holds) {
            throw std::invalid_argument("a hinge's values are finite and its precisions above 0");
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
