#include "effects.h"

#include <cmath>
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <optional>
#include <stdexcept>
#include <string>

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using Values = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

template <typename T> nb::ndarray<nb::numpy, T, nb::ndim<1>> owned(T *data, size_t n) {
    nb::capsule owner(data, [](void *p) noexcept { delete[] static_cast<T *>(p); });
    return nb::ndarray<nb::numpy, T, nb::ndim<1>>(data, {n}, owner);
}

const double *column(const std::optional<Values> &values, size_t n, const char *name) {
    if (!values) {
        return nullptr;
    }
    if (values->shape(0) != n) {
        throw std::invalid_argument(std::string(name) + " must be as long as t_s");
    }
    return values->data();
}

nb::object simulate(const nb::dict &parameters, Values grid, Values width, Values c_deg, Values t_s, Values q,
                    std::optional<Values> translation, std::optional<Values> rotation, std::optional<Values> load,
                    double p0) {
    effect_parameters e = {
#define X(name, absent, unit, meaning) absent,
        EFFECT_PARAMETERS(X)
#undef X
    };
    for (auto [key, value] : parameters) {
        const std::string name = nb::cast<std::string>(key);
        bool known = false;
#define X(field, absent, unit, meaning)                                                                                \
    if (name == #field) {                                                                                              \
        e.field = nb::cast<double>(value);                                                                             \
        known = true;                                                                                                  \
    }
        EFFECT_PARAMETERS(X)
#undef X
        if (!known) {
            throw std::invalid_argument("no effect has a parameter '" + name + "'");
        }
    }
    const size_t nodes = grid.shape(0);
    const size_t n = t_s.shape(0);
    if (nodes < 2 || width.shape(0) != nodes || c_deg.shape(0) != nodes) {
        throw std::invalid_argument("grid, width and c_deg must have one length, 2 or more");
    }
    if (q.shape(0) != n) {
        throw std::invalid_argument("q must be as long as t_s");
    }
    const effect_tables tables = {grid.data(), width.data(), c_deg.data(), nodes};
    const effect_motion motion = {t_s.data(),
                                  q.data(),
                                  column(translation, n, "translation"),
                                  column(rotation, n, "rotation"),
                                  column(load, n, "load"),
                                  n};
    auto *c_out = new double[n];
    auto *p_out = new double[n];
    auto *side_out = new signed char[n];
    {
        nb::gil_scoped_release unlocked;
        effects_simulate(&e, &tables, &motion, p0, c_out, p_out, side_out);
    }
    return nb::make_tuple(owned(c_out, n), owned(p_out, n), owned(side_out, n));
}

} // namespace

void bind_effects(nb::module_ &m) {
    nb::list table;
#define X(name, absent, unit, meaning) table.append(nb::make_tuple(#name, double(absent), unit, meaning));
    EFFECT_PARAMETERS(X)
#undef X
    m.attr("effect_parameters") = table; // (name, value when absent, unit, meaning)
    m.def("simulate_effects", &simulate, "parameters"_a, "grid"_a, "width"_a, "c_deg"_a, "t_s"_a, "q"_a,
          "translation"_a = nb::none(), "rotation"_a = nb::none(), "load"_a = nb::none(), "p0"_a = std::nan(""),
          "(c_deg, p, side) of every motor sample: the transmission with the named effects (effects.h).");
}
