// Play elements as a Python object: its own copy of all that struct elements points at. No warp: a single play.
#ifndef TAUTLINE_NATIVE_PLAYS_H
#define TAUTLINE_NATIVE_PLAYS_H

#include "elements.h"

#include <vector>

struct Plays {
    std::vector<double> grid, width, warp_q, warp_x, r, w;
    double narrow;
    struct friction friction;
    std::vector<double> travel; // friction's

    struct elements view() const {
        return {{grid.data(), width.data(), grid.size()},
                {warp_q.data(), warp_x.data(), warp_q.size()},
                r.data(),
                w.data(),
                r.size(),
                narrow,
                {friction.kind,
                 {friction.value[0], friction.value[1], friction.value[2], friction.value[3]},
                 friction.least,
                 travel.data()}};
    }
};

#endif
