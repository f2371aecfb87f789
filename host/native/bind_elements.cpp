#include "arrays.h"
#include "play.h"
#include "plays.h"

#include <algorithm>
#include <cmath>
#include <nanobind/stl/pair.h>
#include <stdexcept>

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using Values = ArrayIn<double>;

void refuse_friction(const struct friction &of) {
    const bool known = of.kind == FRICTION_BOUC_WEN || of.kind == FRICTION_DAHL;
    const double *v = of.value;
    if (!known || !(v[FRICTION_EXPONENT] > 0.0) || !(v[FRICTION_BETA] >= 0.0) || !(v[FRICTION_BETA] <= 1.0) ||
        !std::isfinite(v[FRICTION_LENGTH]) || !std::isfinite(v[FRICTION_SHARE])) {
        throw std::invalid_argument("friction: Bouc-Wen's or Dahl's, lengths finite, exponent > 0, beta 0 to 1");
    }
}

void refuse(const char *why) {
    throw std::invalid_argument(why);
}

bool rises(const std::vector<double> &values) {
    return std::all_of(values.begin(), values.end(), [](double v) { return std::isfinite(v); }) &&
           std::adjacent_find(values.begin(), values.end(), [](double a, double b) { return !(a < b); }) ==
               values.end();
}

// As given, or refused before there is an object that would own it.
Plays checked(Plays self) {
    const struct play_table table = self.view().table;
    if (self.grid.size() != self.width.size() || !play_table_valid(&table)) {
        refuse("play: not a backlash table (grid rising, width >= 0, |width'| < 2, all finite)");
    }
    if (self.warp_q.empty() && self.warp_x.empty() && self.r.empty() && self.w.empty()) {
        return self;
    }
    if (self.warp_q.size() < 2 || self.warp_q.size() != self.warp_x.size() || !rises(self.warp_q) ||
        !rises(self.warp_x)) {
        refuse("elements: a warp needs two rising columns of one length, 2 or more");
    }
    double weight = 0.0, mean = 0.0;
    for (size_t i = 0; i < self.r.size() && i < self.w.size(); i++) {
        weight += self.w[i] > 0.0 ? self.w[i] : NAN;
        mean += self.w[i] * self.r[i];
    }
    if (self.r.empty() || self.r.size() > ELEMENTS_MAX || self.r.size() != self.w.size() || !rises(self.r) ||
        self.r[0] < 0.0 || !(std::fabs(weight - 1.0) < 1e-9) || !(std::fabs(mean - 0.5) < 1e-9)) {
        refuse("elements: 1 to 12, 0 <= r rising, w > 0, sum w = 1, sum w r = 1/2");
    }
    if (!(self.narrow >= 0.0)) {
        refuse("elements: narrow is negative");
    }
    return self;
}

} // namespace

void bind_elements(nb::module_ &m) {
    m.attr("FRICTION_BOUC_WEN") = static_cast<int>(FRICTION_BOUC_WEN);
    m.attr("FRICTION_DAHL") = static_cast<int>(FRICTION_DAHL);
    m.attr("ELEMENTS_MAX") = static_cast<int>(ELEMENTS_MAX);
    nb::class_<Plays>(m, "Plays", "Play elements on one backlash table. See elements.h.")
        .def(
            "__init__",
            [](Plays *self, Values grid, Values width) {
                new (self) Plays(checked({copied(grid), copied(width), {}, {}, {}, {}, 0.0, {}, {}}));
            },
            "grid"_a, "width"_a, "A single play.")
        .def(
            "__init__",
            [](Plays *self, Values grid, Values width, int kind, double length, double share, double exponent,
               double beta) {
                struct friction of = {kind, {length, share, exponent, beta}, 0.0, nullptr};
                refuse_friction(of);
                Plays plays = checked({copied(grid), copied(width), {}, {}, {}, {}, 0.0, of, {}});
                const struct play_table table = plays.view().table;
                plays.friction.least = of.least = friction_least(&of, &table);
                plays.travel.resize(3 * table.n);
                friction_travel(&of, &table, plays.travel.data());
                new (self) Plays(std::move(plays));
            },
            "grid"_a, "width"_a, "kind"_a, "length"_a, "share"_a, "exponent"_a, "beta"_a, "Friction. See friction.h.")
        .def(
            "__init__",
            [](Plays *self, Values grid, Values width, Values warp_q, Values warp_x, Values r, Values w,
               double narrow) {
                new (self) Plays(checked({copied(grid),
                                          copied(width),
                                          copied(warp_q),
                                          copied(warp_x),
                                          copied(r),
                                          copied(w),
                                          narrow,
                                          {},
                                          {}}));
            },
            "grid"_a, "width"_a, "warp_q"_a, "warp_x"_a, "r"_a, "w"_a, "narrow"_a)
        .def(
            "forward",
            [](const Plays &self, Values q, double p0) {
                auto p = new_array<double>(q.shape(0));
                auto side = new_array<int8_t>(q.shape(0));
                const auto e = self.view();
                {
                    nb::gil_scoped_release unlocked;
                    elements_forward(&e, q.data(), q.shape(0), p0, p.data(), side.data(), nullptr, nullptr, nullptr);
                }
                return std::make_pair(p, side);
            },
            "q"_a, "p0"_a,
            "(p, side) at motor positions q (n,); p0 NaN: on the centre, p = q[0]; side: the envelope that last held "
            "all.")
        .def(
            "trace",
            [](const Plays &self, Values q, double p0) {
                auto p = new_array<double>(q.shape(0));
                auto side = new_array<int8_t>(q.shape(0));
                auto lean = new_array<double>(q.shape(0));
                auto share = new_array<double>(q.shape(0));
                const auto e = self.view();
                {
                    nb::gil_scoped_release unlocked;
                    elements_forward(&e, q.data(), q.shape(0), p0, p.data(), side.data(), lean.data(), share.data(),
                                     nullptr);
                }
                return nb::make_tuple(p, side, lean, share);
            },
            "q"_a, "p0"_a, "(p, side, lean, share): also dp/dB = -lean / 2 and dp/dq = share.")
        .def(
            "slopes",
            [](const Plays &self, Values q, double p0) {
                const size_t n = q.shape(0);
                auto p = new_array<double>(n);
                auto by = new_array<double>(n * FRICTION_VALUES);
                const auto e = self.view();
                {
                    nb::gil_scoped_release unlocked;
                    elements_forward(&e, q.data(), n, p0, p.data(), nullptr, nullptr, nullptr, by.data());
                }
                return by;
            },
            "q"_a, "p0"_a, "Of friction: p's derivatives by length, share, exponent, beta, one row after the other.")
        .def(
            "inverse",
            [](const Plays &self, Values p, double q0, double p0) {
                auto q = new_array<double>(p.shape(0));
                const auto e = self.view();
                {
                    nb::gil_scoped_release unlocked;
                    elements_inverse(&e, p.data(), p.shape(0), q0, p0, q.data());
                }
                return q;
            },
            "p"_a, "q0"_a, "p0"_a, "Motor positions that lead the centre coordinate along p (n,).");
}
