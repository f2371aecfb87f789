// tautline._native: table blobs and loaded tables (common/tl_table.h, firmware/estimator/tl_lookup.h).
#include "arrays.h"
#include "fixed_table.h"

#include <algorithm>
#include <cstring>
#include <memory>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>
#include <optional>
#include <string>
#include <vector>

namespace nb = nanobind;

namespace {

// One list of names serves both directions between a table and a Python dict.
#define TABLE_FIELDS(X)                                                                                                \
    X(axis)                                                                                                            \
    X(kind)                                                                                                            \
    X(unit)                                                                                                            \
    X(step_log2)                                                                                                       \
    X(strength_q15)                                                                                                    \
    X(nano_units_per_count)                                                                                            \
    X(q0)                                                                                                              \
    X(q_min)                                                                                                           \
    X(q_max)                                                                                                           \
    X(coarse_c_min)                                                                                                    \
    X(coarse_c_max)                                                                                                    \
    X(speed_max_q8)                                                                                                    \
    X(takeup_speed_q8)                                                                                                 \
    X(takeup_accel)                                                                                                    \
    X(band)                                                                                                            \
    X(slope_min_q28)                                                                                                   \
    X(flat_speed_q8)                                                                                                   \
    X(delay_us)                                                                                                        \
    X(created_s)

std::string reason_name(tl_table_reason_t reason) {
    static const char *const names[] = {"OK",
#define NAME(name, text) #name,
                                        TL_TABLE_REASONS(NAME)
#undef NAME
    };
    return names[reason];
}

template <typename Field> void read_field(const nb::dict &fields, const char *name, Field &field) {
    if (!fields.contains(name)) {
        throw nb::key_error(name);
    }
    if (!nb::try_cast(fields[name], field)) {
        throw nb::value_error((std::string(name) + " is not of the kind or in the range that a table holds").c_str());
    }
}

template <typename Field> Field field_of(const nb::dict &fields, const char *name) {
    Field field;
    read_field(fields, name, field);
    return field;
}

// Section 1: the elements of the play.
void read_plays(const nb::dict &plays, tl_table_t &table) {
    const auto widths = field_of<std::vector<uint32_t>>(plays, "width_q28");
    const auto weights = field_of<std::vector<uint32_t>>(plays, "weight_q16");
    const auto centre = field_of<ArrayIn<int32_t>>(plays, "centre");
    if (widths.size() != weights.size() || widths.size() > TL_TABLE_PLAYS_MAX || centre.shape(0) != table.nodes) {
        throw nb::value_error("plays need at most 7 widths, as many weights, and a centre at each node");
    }
    read_field(plays, "period_log2", table.period_log2);
    read_field(plays, "narrow", table.narrow);
    table.plays = static_cast<uint8_t>(widths.size());
    std::copy(widths.begin(), widths.end(), table.play_width_q28);
    std::copy(weights.begin(), weights.end(), table.play_weight_q16);
    std::copy(centre.data(), centre.data() + table.nodes, table.centre);
}

nb::object plays_of(const tl_table_t &table) {
    if (table.plays == 0) {
        return nb::none();
    }
    nb::dict plays;
    plays["period_log2"] = table.period_log2;
    plays["narrow"] = table.narrow;
    plays["width_q28"] = std::vector<uint32_t>(table.play_width_q28, table.play_width_q28 + table.plays);
    plays["weight_q16"] = std::vector<uint32_t>(table.play_weight_q16, table.play_weight_q16 + table.plays);
    auto centre = new_array<int32_t>(table.nodes);
    std::copy(table.centre, table.centre + table.nodes, centre.data());
    plays["centre"] = centre;
    return plays;
}

// Sections 2 on, each a dict of its fields' names: {"encoder": {"period_q12": .., ..}, ..}.
void read_words(const nb::dict &from, const char *name, int32_t *to, size_t count) {
    const auto values = field_of<std::vector<int32_t>>(from, name);
    if (values.size() != count) {
        throw nb::value_error((std::string(name) + " of a section has another length").c_str());
    }
    std::copy(values.begin(), values.end(), to);
}

void read_sections(const nb::dict &sections, tl_table_t &table) {
    size_t known = 0;
#define READ_FIELD(field)        read_field(from, #field, into.field);
#define READ_ARRAY(field, count) read_words(from, #field, into.field, count);
#define READ(number, name, FIELDS)                                                                                     \
    if (sections.contains(#name)) {                                                                                    \
        const auto from = field_of<nb::dict>(sections, #name);                                                         \
        auto &into = table.name;                                                                                       \
        FIELDS(READ_FIELD, READ_ARRAY)                                                                                 \
        table.has |= static_cast<uint32_t>(TL_TABLE_HAS_##name);                                                       \
        known++;                                                                                                       \
    }
    TL_TABLE_SECTIONS(READ)
#undef READ
    if (known != sections.size()) {
        throw nb::value_error("a section's name is none of tl_table.h");
    }
}

nb::dict sections_of(const tl_table_t &table) {
    nb::dict sections;
#define WRITE_FIELD(field)        to[#field] = from.field;
#define WRITE_ARRAY(field, count) to[#field] = std::vector<int32_t>(from.field, from.field + (count));
#define WRITE(number, name, FIELDS)                                                                                    \
    if ((table.has & static_cast<uint32_t>(TL_TABLE_HAS_##name)) != 0) {                                               \
        const auto &from = table.name;                                                                                 \
        nb::dict to;                                                                                                   \
        FIELDS(WRITE_FIELD, WRITE_ARRAY)                                                                               \
        sections[#name] = to;                                                                                          \
    }
    TL_TABLE_SECTIONS(WRITE)
#undef WRITE
    return sections;
}

nb::bytes encode(const nb::dict &fields, ArrayIn<int32_t> width, ArrayIn<int32_t> angle, const nb::bytes &model_id,
                 const std::string &instrument, std::optional<nb::dict> plays, const nb::dict &sections) {
    tl_table_t table{};
    if (width.shape(0) != angle.shape(0) || width.shape(0) > TL_TABLE_NODES_MAX) {
        throw nb::value_error("width and angle need the same number of nodes, at most 257");
    }
    if (model_id.size() != sizeof table.model_id) {
        throw nb::value_error("a model id has 8 bytes");
    }
    if (instrument.size() > sizeof table.instrument) {
        throw nb::value_error("an instrument's serial has at most 8 characters");
    }
    memcpy(table.instrument, instrument.data(), instrument.size());
#define READ(name) read_field(fields, #name, table.name);
    TABLE_FIELDS(READ)
#undef READ
    table.nodes = static_cast<uint16_t>(width.shape(0));
    memcpy(table.model_id, model_id.c_str(), sizeof table.model_id);
    std::copy(width.data(), width.data() + table.nodes, table.width);
    std::copy(angle.data(), angle.data() + table.nodes, table.angle);
    if (plays) {
        read_plays(*plays, table);
    }
    read_sections(sections, table);
    std::vector<uint8_t> blob(TL_TABLE_SIZE_MAX);
    const size_t size = tl_table_encode(&table, blob.data(), blob.size());
    return nb::bytes(blob.data(), size);
}

nb::tuple check(const nb::bytes &blob, uint8_t axis) {
    const auto lookup = std::make_unique<tl_lookup_t>();
    const auto reason =
        tl_lookup_load(lookup.get(), reinterpret_cast<const uint8_t *>(blob.c_str()), blob.size(), axis);
    return nb::make_tuple(reason_name(reason), tl_table_reason_text(reason));
}

nb::dict fields_of(const FixedTable &self) {
    const tl_table_t &table = self.lookup.table;
    nb::dict fields;
#define WRITE(name) fields[#name] = table.name;
    TABLE_FIELDS(WRITE)
#undef WRITE
    fields["model_id"] = nb::bytes(table.model_id, sizeof table.model_id);
    fields["instrument"] = nb::str(table.instrument, strnlen(table.instrument, sizeof table.instrument));
    auto width = new_array<int32_t>(table.nodes), angle = new_array<int32_t>(table.nodes);
    std::copy(table.width, table.width + table.nodes, width.data());
    std::copy(table.angle, table.angle + table.nodes, angle.data());
    fields["width"] = width;
    fields["angle"] = angle;
    fields["plays"] = plays_of(table);
    fields["sections"] = sections_of(table);
    return fields;
}

using Lookup = int32_t (*)(const tl_lookup_t *, int32_t, uint32_t *);

template <Lookup function> nb::tuple batch(const FixedTable &self, ArrayIn<int32_t> x) {
    auto y = new_array<int32_t>(x.shape(0));
    auto flags = new_array<uint32_t>(x.shape(0));
    for (size_t i = 0; i < x.shape(0); i++) {
        flags.data()[i] = 0;
        y.data()[i] = function(&self.lookup, x.data()[i], &flags.data()[i]);
    }
    return nb::make_tuple(y, flags);
}

using Plain = int32_t (*)(const tl_lookup_t *, int32_t);

template <Plain function> ArrayOut<int32_t> batch_plain(const FixedTable &self, ArrayIn<int32_t> x) {
    if (self.lookup.plays == 0) {
        throw nb::value_error("the table has a single play");
    }
    auto y = new_array<int32_t>(x.shape(0));
    for (size_t i = 0; i < x.shape(0); i++) {
        y.data()[i] = function(&self.lookup, x.data()[i]);
    }
    return y;
}

// As the play asks: near is where the last one was.
using Inverse = int32_t (*)(const tl_lookup_t *, int32_t, int32_t, uint32_t *);

template <Inverse function> nb::tuple batch_near(const FixedTable &self, ArrayIn<int32_t> x) {
    auto y = new_array<int32_t>(x.shape(0));
    auto flags = new_array<uint32_t>(x.shape(0));
    int32_t near = 0;
    for (size_t i = 0; i < x.shape(0); i++) {
        flags.data()[i] = 0;
        near = y.data()[i] = function(&self.lookup, x.data()[i], near, &flags.data()[i]);
    }
    return nb::make_tuple(y, flags);
}

} // namespace

void bind_tables(nb::module_ &m) {
    m.def(
        "table_encode", &encode, nb::arg("fields"), nb::arg("width"), nb::arg("angle"), nb::arg("model_id"),
        nb::arg("instrument") = "", nb::arg("plays") = nb::none(), nb::arg("sections") = nb::dict(),
        "The blob of a table (fields as in tl_table.h, raw fixed-point values; plays: period_log2, narrow, width_q28, "
        "weight_q16 and centre of section 1; sections: the others' fields by their names); its content is not "
        "checked.");
    m.def("table_check", &check, nb::arg("blob"), nb::arg("axis") = TL_TABLE_ANY_AXIS,
          "(name, text) of the reason why the board would refuse the blob; name is 'OK' where it would not.");
    nb::dict reasons;
#define REASON(name, text) reasons[#name] = text;
    TL_TABLE_REASONS(REASON)
#undef REASON
    m.attr("TABLE_REASONS") = reasons;
    nb::dict kinds, units; // names as the host writes them
    kinds["bending"] = static_cast<int>(TL_AXIS_BENDING);
    kinds["translation"] = static_cast<int>(TL_AXIS_TRANSLATION);
    kinds["rotation"] = static_cast<int>(TL_AXIS_ROTATION);
    units["mm"] = static_cast<int>(TL_UNIT_MM);
    units["deg"] = static_cast<int>(TL_UNIT_DEG);
    m.attr("AXIS_KINDS") = kinds;
    m.attr("AXIS_UNITS") = units;
    m.attr("TABLE_PLAYS_MAX") = TL_TABLE_PLAYS_MAX;
    m.attr("TABLE_CENTRE_MAX") = TL_TABLE_CENTRE_MAX;
    m.attr("TABLE_STEPS") = TL_TABLE_STEPS;
    m.attr("TABLE_LATE_MAX") = TL_TABLE_LATE_MAX;
    m.attr("TABLE_JOINTS") = TL_TABLE_JOINTS;
    m.attr("TABLE_AXES") = TL_TABLE_AXES;
    m.attr("TABLE_ANY_AXIS") = TL_TABLE_ANY_AXIS;
    m.attr("TABLE_NODES_MAX") = TL_TABLE_NODES_MAX;
    m.attr("TABLE_STEP_LOG2_MAX") = TL_TABLE_STEP_LOG2_MAX;
    m.attr("TABLE_SIZE_MAX") = TL_TABLE_SIZE_MAX;
    m.attr("TABLE_VALUE_MAX") = TL_TABLE_VALUE_MAX;
    m.attr("TABLE_POSITION_MAX") = TL_TABLE_POSITION_MAX;
    m.attr("TABLE_WIDTH_MAX") = TL_TABLE_WIDTH_MAX;
    m.attr("COUNT_ONE") = TL_COUNT_ONE;
    m.attr("DEG_ONE") = TL_DEG_ONE;
    m.attr("RATIO_ONE") = TL_RATIO_ONE;

    nb::class_<FixedTable>(m, "FixedTable",
                           "A table as the board loads it; every function takes and returns int32 arrays.")
        .def(
            "__init__",
            [](FixedTable *self, const nb::bytes &blob, uint8_t axis) {
                new (self) FixedTable{};
                const auto reason =
                    tl_lookup_load(&self->lookup, reinterpret_cast<const uint8_t *>(blob.c_str()), blob.size(), axis);
                if (reason != TL_TABLE_OK) {
                    throw nb::value_error(tl_table_reason_text(reason));
                }
            },
            nb::arg("blob"), nb::arg("axis") = TL_TABLE_ANY_AXIS)
        .def_prop_ro("fields", &fields_of, "what the blob holds, raw")
        .def_prop_ro("has_flat", [](const FixedTable &self) { return self.lookup.has_flat != 0; })
        .def("width", &batch<tl_lookup_width>, nb::arg("p"), "B(p) and flags")
        .def("angle", &batch<tl_lookup_angle>, nb::arg("p"), "f(p) and flags")
        .def("angle_inverse", &batch<tl_lookup_angle_inverse>, nb::arg("c"), "p with f(p) = c, and flags")
        .def("p_low", &batch_near<tl_lookup_p_low>, nb::arg("q"), "p with p + B(p)/2 = q, and flags")
        .def("p_high", &batch_near<tl_lookup_p_high>, nb::arg("q"), "p with p - B(p)/2 = q, and flags")
        .def("centre", &batch_plain<tl_lookup_centre>, nb::arg("p"), "Y(p) of several plays")
        .def("centre_inverse", &batch_plain<tl_lookup_centre_inverse>, nb::arg("y"), "p with Y(p) = y")
        .def("coarse", &batch<tl_lookup_coarse>, nb::arg("q"), "the coarse kinematics and flags")
        .def("coarse_inverse", &batch<tl_lookup_coarse_inverse>, nb::arg("c"), "its inverse and flags");
}
