#include "arrays.h"
#include "reality.h"

#include <cmath>
#include <nanobind/stl/string.h>
#include <stdexcept>
#include <string>

namespace nb = nanobind;
using namespace nb::literals;

namespace {

nb::object transmission(const nb::dict &given, ArrayIn<double> grid, ArrayIn<double> width, ArrayIn<double> t_s,
                        ArrayIn<double> q, ArrayIn<double> width_factor, double start, uint64_t seed) {
    reality r = {};
    r.latch_travel = r.speed_scale = r.creep_time = r.bulge_travel = 1.0;
    for (auto [key, value] : given) {
        const std::string name = nb::cast<std::string>(key);
        bool known = false;
#define X(field, meaning)                                                                                              \
    if (name == #field) {                                                                                              \
        r.field = nb::cast<double>(value);                                                                             \
        known = true;                                                                                                  \
    }
        REALITY_FIELDS(X)
#undef X
        if (!known) {
            throw std::invalid_argument("the transmission has no '" + name + "'");
        }
    }
    const size_t n = t_s.shape(0);
    if (q.shape(0) != n || width_factor.shape(0) != n || grid.shape(0) != width.shape(0) || grid.shape(0) < 2) {
        throw std::invalid_argument("t_s, q and width_factor need one length, grid and width another");
    }
    auto p = new_array<double>(n);
    auto way = new_array<double>(n);
    const reality_tables tables = {grid.data(), width.data(), grid.shape(0)};
    reality_transmission(&r, &tables, t_s.data(), q.data(), width_factor.data(), n, start, seed, p.data(), way.data());
    return nb::make_tuple(p, way);
}

ArrayOut<double> rocking(ArrayIn<double> p, ArrayIn<double> way, double travel) {
    if (way.shape(0) != p.shape(0) || !(travel > 0.0)) {
        throw std::invalid_argument("p and way need one length, travel must be above 0");
    }
    auto lies = new_array<double>(p.shape(0));
    reality_rocking(p.data(), way.data(), p.shape(0), travel, lies.data());
    return lies;
}

} // namespace

void bind_reality(nb::module_ &m) {
    nb::list fields;
#define X(field, meaning) fields.append(nb::make_tuple(#field, meaning));
    REALITY_FIELDS(X)
#undef X
    m.attr("reality_fields") = fields; // (name, meaning)
    m.def("reality_transmission", &transmission, "parameters"_a, "grid"_a, "width"_a, "t_s"_a, "q"_a, "width_factor"_a,
          "start"_a = std::nan(""), "seed"_a = 0,
          "(p, way) of a transmission with other physics than simulate_effects' (reality.h), for blind tests.");
    m.def("reality_rocking", &rocking, "p"_a, "way"_a, "travel"_a,
          "Which way the instrument lies in its channel, -1 to 1 (reality.h).");
}
