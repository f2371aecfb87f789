// tautline._native.HostedBoard: the board's application over drives that the host speaks to.
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <new>
#include <string>
#include <tuple>
#include <vector>

#include "hosted/hosted.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using Measured = std::vector<hosted_measured_t>;

Measured measured_of(const std::vector<std::tuple<int32_t, int32_t, bool>> &rows, size_t axes) {
    if (rows.size() != axes) {
        throw nb::value_error("one measurement for each axis");
    }
    Measured measured;
    for (const auto &[q, current, fault] : rows) {
        measured.push_back({q, current, fault});
    }
    return measured;
}

struct HostedBoard {
    HostedBoard(const std::string &name, const std::string &serial, uint16_t driver_ma, nb::bytes flash,
                const std::vector<std::tuple<int32_t, int32_t, bool>> &first)
        : axes(first.size()) {
        if (axes < 1 || axes > HOSTED_AXES) {
            throw nb::value_error("1 to 4 axes");
        }
        if (flash.size() != 0 && flash.size() != hosted_flash_size()) {
            throw nb::value_error("the flash has another size");
        }
        const Measured at = measured_of(first, axes);
        const auto *bytes = flash.size() != 0 ? reinterpret_cast<const uint8_t *>(flash.c_str()) : nullptr;
        board = hosted_open(name.c_str(), serial.c_str(), static_cast<uint8_t>(axes), driver_ma, bytes, at.data());
        if (board == nullptr) {
            throw std::bad_alloc();
        }
    }
    HostedBoard(const HostedBoard &) = delete;
    HostedBoard &operator=(const HostedBoard &) = delete;
    ~HostedBoard() { hosted_close(board); }

    void run(uint64_t us, const std::vector<std::tuple<int32_t, int32_t, bool>> &measured, uint16_t supply_mv) {
        hosted_run(board, us, measured_of(measured, axes).data(), supply_mv);
    }
    uint8_t checked(size_t axis) const {
        if (axis >= axes) {
            throw nb::index_error("no such axis");
        }
        return static_cast<uint8_t>(axis);
    }
    nb::tuple goal(size_t axis) const {
        const hosted_goal_t goal = hosted_goal(board, checked(axis));
        return nb::make_tuple(goal.goal_q8, goal.speed_q8_s, goal.on, goal.moves);
    }
    void receive(nb::bytes data, uint64_t us) {
        hosted_receive(board, us, reinterpret_cast<const uint8_t *>(data.c_str()), data.size());
    }
    nb::bytes transmit() {
        std::string all;
        uint8_t part[4096];
        while (const size_t got = hosted_transmit(board, part, sizeof(part))) {
            all.append(reinterpret_cast<const char *>(part), got);
        }
        return nb::bytes(all.data(), all.size());
    }

    size_t axes;
    hosted_t *board;
};

} // namespace

void bind_hosted(nb::module_ &m) {
    m.attr("HOSTED_SPEED_MAX") = hosted_speed_max;
    m.attr("HOSTED_ACCELERATION_MAX") = hosted_acceleration_max;
    nb::class_<HostedBoard>(m, "HostedBoard", "The board's application over drives on a bus; positions are counts Q8.")
        .def(nb::init<const std::string &, const std::string &, uint16_t, nb::bytes,
                      const std::vector<std::tuple<int32_t, int32_t, bool>> &>(),
             "name"_a, "serial"_a, "driver_ma"_a, "flash"_a, "first"_a)
        .def("run", &HostedBoard::run, "us"_a, "measured"_a, "supply_mv"_a,
             "control steps until `us`, when each axis was at (q, current in mA, whether its drive has a fault)")
        .def(
            "wait", [](HostedBoard &self, uint64_t us) { hosted_wait(self.board, us); }, "us"_a,
            "a drive was switched on until `us`: no axis was driven meanwhile")
        .def("goal", &HostedBoard::goal, "axis"_a,
             "(q where its drive is to be, speed of the path there, whether it is on, whether in closed loop)")
        .def(
            "lead",
            [](HostedBoard &self, size_t axis, uint32_t us) { hosted_lead(self.board, self.checked(axis), us); },
            "axis"_a, "us"_a, "set-points are planned so much ahead of their time")
        .def("receive", &HostedBoard::receive, "data"_a, "us"_a, "whole frames, at `us`")
        .def("transmit", &HostedBoard::transmit)
        .def_prop_ro("flash",
                     [](const HostedBoard &self) {
                         return nb::bytes(reinterpret_cast<const char *>(hosted_flash(self.board)),
                                          hosted_flash_size());
                     })
        .def_prop_ro("flash_writes", [](const HostedBoard &self) { return hosted_flash_writes(self.board); });
}
