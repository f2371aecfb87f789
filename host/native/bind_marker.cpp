#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <stdexcept>
#include <vector>

#include "marker.h"

namespace nb = nanobind;
using Picture = nb::ndarray<const uint8_t, nb::shape<-1, -1, 3>, nb::device::cpu>;
using Four = nb::ndarray<const float, nb::shape<4>, nb::c_contig, nb::device::cpu>;

void bind_marker(nb::module_ &m) {
    nb::class_<marker_expected_t>(m, "MarkerExpected")
        .def(
            "__init__",
            [](marker_expected_t *expected, double diameter) {
                if (!(diameter > 0 && diameter < 1e6)) {
                    throw std::invalid_argument("marker: diameter out of range");
                }
                marker_expect(diameter, new (expected) marker_expected_t);
            },
            nb::arg("diameter"), "What is known of a marker of about `diameter` px that was not seen yet.");
    nb::class_<marker_outline_t>(m, "MarkerOutline")
        .def_ro("u", &marker_outline_t::u)
        .def_ro("v", &marker_outline_t::v)
        .def_ro("sigma", &marker_outline_t::sigma)
        .def_ro("diameter", &marker_outline_t::diameter)
        .def_ro("within", &marker_outline_t::within)
        .def_ro("around", &marker_outline_t::around)
        .def_ro("scatter", &marker_outline_t::scatter)
        .def_ro("kept", &marker_outline_t::kept)
        .def_ro("lit_u", &marker_outline_t::lit_u)
        .def_ro("lit_v", &marker_outline_t::lit_v)
        .def_prop_ro("after", [](const marker_outline_t &outline) { return outline.after; })
        .def_prop_ro("colour", [](const marker_outline_t &outline) {
            return nb::make_tuple(outline.colour[0], outline.colour[1], outline.colour[2]);
        });
    m.attr("MARKER_FOUND") = static_cast<int>(MARKER_FOUND);
    m.attr("MARKER_NONE") = static_cast<int>(MARKER_NONE);
    m.attr("MARKER_CLIPPED") = static_cast<int>(MARKER_CLIPPED);
    m.attr("MARKER_CUT_OFF") = static_cast<int>(MARKER_CUT_OFF);
    m.def(
        "marker_measure",
        [](Picture picture, Four weights, double cut, double u, double v, double diameter, int half,
           const marker_expected_t &before) {
            if (picture.stride(1) != 3 || picture.stride(2) != 1) {
                throw std::invalid_argument("marker: the picture's pixels must lie side by side, B, G, R");
            }
            const int height = static_cast<int>(picture.shape(0)), width = static_cast<int>(picture.shape(1));
            if (!(u > -1e6 && u < 1e6 && v > -1e6 && v < 1e6 && half >= 0 && half < 100000 && diameter > 0)) {
                throw std::invalid_argument("marker: place or size out of range");
            }
            const int column = static_cast<int>(u), row = static_cast<int>(v);
            const marker_view_t view = {picture.data(),
                                        static_cast<ptrdiff_t>(picture.stride(0)),
                                        width,
                                        height,
                                        std::max(0, column - half),
                                        std::max(0, row - half),
                                        std::min(width, column + half + 1),
                                        std::min(height, row + half + 1)};
            marker_outline_t outline{};
            if (view.x1 - view.x0 < 3 || view.y1 - view.y0 < 3) {
                return nb::make_tuple(static_cast<int>(MARKER_NONE), outline);
            }
            static thread_local std::vector<float> scratch;
            const size_t pixels = static_cast<size_t>(view.x1 - view.x0) * static_cast<size_t>(view.y1 - view.y0);
            scratch.resize(marker_scratch_size(pixels) / sizeof(float) + 1);
            const int status =
                marker_measure(&view, weights.data(), cut, u, v, diameter, &before, scratch.data(), &outline);
            return nb::make_tuple(status, outline);
        },
        nb::arg("picture").noconvert(), nb::arg("weights"), nb::arg("cut"), nb::arg("u"), nb::arg("v"),
        nb::arg("diameter"), nb::arg("half"), nb::arg("before"),
        "(status, MarkerOutline) of the blob near (u, v) px, `half` px around it to every side: see native/marker.h.");
}
