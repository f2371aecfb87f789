#include "arrays.h"
#include "effects.h"
#include "plays.h"
#include "projection.h"
#include "thin.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <optional>
#include <stdexcept>
#include <string>
#include <unordered_map>
#include <vector>

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using Values = ArrayIn<double>;
using Marks = ArrayIn<unsigned char>;

struct Field {
    const char *name;
    double projection_parameters::*member;
};
const Field SIGHTS[] = {
#define X(name, unit, meaning) {#name, &projection_parameters::name},
    PROJECTION_PARAMETERS(X)
#undef X
};

[[noreturn]] void unknown(const std::string &name) {
    throw std::invalid_argument("no effect has a parameter '" + name + "'");
}

// Of all effects' parameters, those that are not named absent.
std::vector<double> all_values(const nb::dict &named) {
    static const auto index = [] {
        std::unordered_map<std::string, size_t> found;
        for (size_t i = 0; i < effects_parameter_count(); i++) {
            found[effects_parameter(i)->name] = i;
        }
        return found;
    }();
    std::vector<double> values(effects_parameter_count());
    for (size_t i = 0; i < values.size(); i++) {
        values[i] = effects_parameter(i)->absent;
    }
    for (auto [key, value] : named) {
        const auto at = index.find(nb::cast<std::string>(key));
        if (at == index.end()) {
            unknown(nb::cast<std::string>(key));
        }
        values[at->second] = nb::cast<double>(value);
    }
    return values;
}

void fill(projection_parameters &into, const nb::dict &values) {
    for (auto [key, value] : values) {
        const std::string name = nb::cast<std::string>(key);
        const auto *at =
            std::find_if(std::begin(SIGHTS), std::end(SIGHTS), [&](const Field &field) { return name == field.name; });
        if (at == std::end(SIGHTS)) {
            unknown(name);
        }
        into.*at->member = nb::cast<double>(value);
    }
}

nb::tuple lots(const nb::dict &named) {
    double spread[EFFECT_LOTS], share[EFFECT_LOTS];
    const size_t count = effects_lots(all_values(named).data(), spread, share);
    auto spreads = new_array<double>(count), shares = new_array<double>(count);
    std::copy(spread, spread + count, spreads.data());
    std::copy(share, share + count, shares.data());
    return nb::make_tuple(spreads, shares);
}

template <typename T> const T *column(const std::optional<ArrayIn<T>> &values, size_t n, const char *name) {
    if (!values) {
        return nullptr;
    }
    if (values->shape(0) != n) {
        throw std::invalid_argument(std::string(name) + " has a wrong length");
    }
    return values->data();
}

nb::object simulate(const nb::dict &parameters, const Plays &plays, Values c_deg, Values t_s, Values q, Values at_s,
                    std::optional<Values> translation, std::optional<Values> rotation, std::optional<Values> load,
                    std::optional<Values> other, double session_s, double p0) {
    const std::vector<double> values = all_values(parameters);
    const size_t knots = t_s.shape(0), n = at_s.shape(0);
    if (plays.grid.size() < 2 || c_deg.shape(0) != plays.grid.size()) {
        throw std::invalid_argument("c_deg must be as long as the plays' grid, 2 or more");
    }
    if (knots < 1 || q.shape(0) != knots) {
        throw std::invalid_argument("q must be as long as t_s, 1 or more");
    }
    if (std::any_of(at_s.data(), at_s.data() + n, [](double t) { return std::isinf(t); })) {
        throw std::invalid_argument("at_s must not be infinite");
    }
    const elements view = plays.view();
    const effect_tables tables = {&view, c_deg.data()};
    const effect_motion motion = {t_s.data(),
                                  q.data(),
                                  column(load, knots, "load"),
                                  column(other, knots, "other"),
                                  column(translation, knots, "translation"),
                                  column(rotation, knots, "rotation"),
                                  knots};
    const effect_times times = {at_s.data(), n, session_s};
    auto c = new_array<double>(n), p = new_array<double>(n), tip = new_array<double>(n), gain = new_array<double>(n),
         way = new_array<double>(n), lean = new_array<double>(n);
    auto moved = new_array<double>(translation ? n : 0), turned = new_array<double>(rotation ? n : 0);
    auto side = new_array<signed char>(n);
    const effect_path path = {c.data(),
                              p.data(),
                              tip.data(),
                              gain.data(),
                              way.data(),
                              lean.data(),
                              translation ? moved.data() : nullptr,
                              rotation ? turned.data() : nullptr,
                              side.data()};
    {
        nb::gil_scoped_release unlocked;
        effects_simulate(values.data(), &tables, &motion, &times, p0, &path);
    }
    return nb::make_tuple(translation ? nb::cast(moved) : nb::none(), rotation ? nb::cast(turned) : nb::none(), c, p,
                          tip, gain, way, lean, side);
}

ArrayOut<unsigned char> thin(Values t_s, Values values, Values tolerance, double rest_s) {
    const size_t samples = t_s.shape(0), channels = tolerance.shape(0);
    if (channels < 1 || channels > THIN_CHANNELS || values.shape(0) != channels * samples) {
        throw std::invalid_argument("values must be 1 to 12 channels, each as long as t_s");
    }
    auto keep = new_array<unsigned char>(samples);
    nb::gil_scoped_release unlocked;
    thin_motion(t_s.data(), samples, values.data(), tolerance.data(), channels, rest_s, keep.data());
    return keep;
}

nb::object see(const nb::dict &parameters, Values rig, Values c_deg, std::optional<Values> translation,
               std::optional<Values> rotation, std::optional<Values> way, std::optional<Marks> shifted, bool slopes) {
    projection_parameters e = {};
    fill(e, parameters);
    projection_rig r;
    if (rig.shape(0) * sizeof(double) != sizeof r) {
        throw std::invalid_argument("rig must be the numbers of projection_rig");
    }
    std::memcpy(&r, rig.data(), sizeof r);
    const size_t n = c_deg.shape(0);
    const projection_pose pose = {
        c_deg.data(),          column(translation, n, "translation"), column(rotation, n, "rotation"),
        column(way, n, "way"), column(shifted, n, "shifted"),         n};
    const size_t sloped = slopes ? n : 0;
    auto image = new_array<double>(n, 2), by_c = new_array<double>(sloped, 2);
    auto by_static = new_array<double>(sloped, 2, PROJECTION_STATIC);
    {
        nb::gil_scoped_release unlocked;
        projection_image(&e, &r, &pose, image.data(), slopes ? by_c.data() : nullptr,
                         slopes ? by_static.data() : nullptr);
    }
    if (!slopes) {
        return nb::cast(image);
    }
    return nb::make_tuple(image, by_c, by_static);
}

} // namespace

void bind_effects(nb::module_ &m) {
    nb::list path, projection;
    for (size_t i = 0; i < effects_parameter_count(); i++) {
        const effect_parameter *p = effects_parameter(i);
        path.append(nb::make_tuple(p->name, p->absent, p->unit, std::string(effects_owner(i)) + ": " + p->meaning));
    }
#define X(name, unit, meaning) projection.append(nb::make_tuple(#name, 0.0, unit, meaning));
    PROJECTION_PARAMETERS(X)
#undef X
    m.attr("effect_parameters") = path;           // (name, value when absent, unit, meaning): what moves the tip
    m.attr("projection_parameters") = projection; // and what changes where it is seen
    m.attr("projection_places") = static_cast<int>(PROJECTION_PLACES);
    m.def(
        "renewed_s", [](const nb::dict &values) { return effects_renewed_s(all_values(values).data()); },
        nb::arg("values"),
        "The rest, s, after which a side that these effects' parameters hold back begins anew; inf: it never does");
    m.def("onset_lots", &lots, nb::arg("values"),
          "(spread, share) of the lots of a play's thresholds, as these effects' parameters spread them");
    m.def("simulate_effects", simulate, "parameters"_a, "plays"_a, "c_deg"_a, "t_s"_a, "q"_a, "at_s"_a,
          "translation"_a = nb::none(), "rotation"_a = nb::none(), "load"_a = nb::none(), "other"_a = nb::none(),
          "session_s"_a = 0.0, "p0"_a = NAN,
          "translation and rotation (None where they are not given), c (deg), p, tip, gain, way, lean and side at "
          "rising times at_s; c_deg is on the plays' grid; t_s and what else moves are knots. See effects.h.");
    m.def("thin", thin, "t_s"_a, "values"_a, "tolerance"_a, "rest_s"_a,
          "1 where a sample must stay for straight lines to be within tolerance. See thin.h.");
    m.def("see", see, "parameters"_a, "rig"_a, "c_deg"_a, "translation"_a = nb::none(), "rotation"_a = nb::none(),
          "way"_a = nb::none(), "shifted"_a = nb::none(), "slopes"_a = false,
          "The image (n, 2) px; with slopes also its derivatives by c (n, 2) and by a static registration (n, 2, 6). "
          "rig: the numbers of struct projection_rig in order. See projection.h.");
}
