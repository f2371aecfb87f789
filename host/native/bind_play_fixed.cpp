// tautline._native: the play operator and the compensator that the board runs (tl_play.h, tl_compensator.h).
#include "arrays.h"
#include "fixed_table.h"

#include "tautline/tl_compensator.h"
#include "tautline/tl_play.h"

namespace nb = nanobind;

namespace {

tl_mode_t mode_of(int mode) {
    if (mode < TL_MODE_OFF || mode > TL_MODE_FULL) {
        throw nb::value_error("mode is 0 (off), 1 (backlash) or 2 (full)");
    }
    return static_cast<tl_mode_t>(mode);
}

nb::tuple play_run(tl_play_t &self, ArrayIn<int32_t> q) {
    const size_t size = q.shape(0);
    auto p = new_array<int32_t>(size), c = new_array<int32_t>(size);
    auto flags = new_array<uint32_t>(size);
    for (size_t i = 0; i < size; i++) {
        p.data()[i] = tl_play_step(&self, q.data()[i]);
        c.data()[i] = tl_play_angle(&self);
        flags.data()[i] = self.flags;
    }
    return nb::make_tuple(p, c, flags);
}

nb::tuple compensator_run(tl_compensator_t &self, ArrayIn<int32_t> c) {
    const size_t size = c.shape(0);
    auto q = new_array<int32_t>(size), p = new_array<int32_t>(size), side = new_array<int32_t>(size);
    auto flags = new_array<uint32_t>(size);
    for (size_t i = 0; i < size; i++) {
        q.data()[i] = tl_compensator_step(&self, c.data()[i]);
        p.data()[i] = self.p;
        side.data()[i] = self.side;
        flags.data()[i] = self.flags;
    }
    return nb::make_tuple(q, p, side, flags);
}

} // namespace

void bind_play_fixed(nb::module_ &m) {
    nb::class_<tl_play_t>(m, "FixedPlay", "The play operator of the board, one sample after the other.")
        .def(
            "__init__",
            [](tl_play_t *self, const FixedTable &table, int32_t p) {
                new (self) tl_play_t{};
                tl_play_start(self, &table.lookup, p);
            },
            nb::arg("table"), nb::arg("p"), nb::keep_alive<1, 2>())
        .def("run", &play_run, nb::arg("q"), "(p, c, flags) for motor positions q");

    nb::class_<tl_compensator_t> compensator(m, "FixedCompensator", "The compensator of the board, one tick a sample.");
    compensator
        .def(
            "__init__",
            [](tl_compensator_t *self, const FixedTable &table, uint32_t rate_hz, int mode, int32_t q, int32_t c) {
                new (self) tl_compensator_t{};
                tl_compensator_start(self, &table.lookup, rate_hz, mode_of(mode), q, c);
            },
            nb::arg("table"), nb::arg("rate_hz"), nb::arg("mode"), nb::arg("q"), nb::arg("c"), nb::keep_alive<1, 2>())
        .def("run", &compensator_run, nb::arg("c"), "(q, p, side, flags) for commands c")
        .def(
            "set_mode", [](tl_compensator_t &self, int mode) { tl_compensator_set_mode(&self, mode_of(mode)); },
            nb::arg("mode"))
        .def("set_strength", &tl_compensator_set_strength, nb::arg("strength_q15"))
        .def(
            "set_table",
            [](tl_compensator_t &self, const FixedTable &table) { tl_compensator_set_table(&self, &table.lookup); },
            nb::arg("table"), nb::keep_alive<1, 2>())
        .def("adapt", &tl_compensator_adapt, nb::arg("offset"), nb::arg("scale_q15"), nb::arg("ticks"),
             "moves the table by an offset and its width by a scale; whether its limits allow that")
        .def("load", &tl_compensator_load, nb::arg("load"), nb::arg("ticks"), "the load, mNm Q8")
        .def(
            "joint",
            [](tl_compensator_t &self, size_t i, int32_t at) {
                if (i >= TL_TABLE_JOINTS) {
                    throw nb::index_error("no such joint");
                }
                self.undo.moved.joint[i] = at;
                tl_undo_join(&self.undo, self.lookup);
            },
            nb::arg("i"), nb::arg("at"), "where the i-th other axis of section 7 is")
        .def(
            "pushing",
            [](const tl_compensator_t &self, int32_t reading) {
                return tl_undo_pushing(&self.undo, self.lookup, reading, TL_UNDO_ROUNDS);
            },
            nb::arg("reading"), "from where the motor pushes whose encoder reads that")
        .def_prop_ro("q", [](const tl_compensator_t &self) { return self.undoes ? self.reading : self.q; })
        .def_prop_ro("p", [](const tl_compensator_t &self) { return self.p; })
        .def_prop_ro("side", [](const tl_compensator_t &self) { return static_cast<int>(self.side); })
        .def_prop_ro("rest", [](const tl_compensator_t &self) { return tl_compensator_rest(&self); });
    m.attr("MODE_OFF") = static_cast<int>(TL_MODE_OFF);
    m.attr("MODE_BACKLASH") = static_cast<int>(TL_MODE_BACKLASH);
    m.attr("MODE_FULL") = static_cast<int>(TL_MODE_FULL);
    nb::dict flags;
    flags["BELOW"] = TL_COMPENSATOR_BELOW;
    flags["ABOVE"] = TL_COMPENSATOR_ABOVE;
    flags["CLIPPED"] = TL_COMPENSATOR_CLIPPED;
    flags["TAKE_UP"] = TL_COMPENSATOR_TAKE_UP;
    flags["LIMITED"] = TL_COMPENSATOR_LIMITED;
    flags["FLAT"] = TL_COMPENSATOR_FLAT;
    flags["NO_SIDE"] = TL_COMPENSATOR_NO_SIDE;
    m.attr("COMPENSATOR_FLAGS") = flags;
}
