#include "arrays.h"
#include "normal.h"

#include <algorithm>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>
#include <optional>
#include <stdexcept>
#include <tuple>
#include <vector>

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using Values = ArrayIn<double>;
using Rows = ArrayIn<double, 2>;
using Columns = ArrayIn<double, 3>;
using Square = ArrayInOut<double, 2>;
using Vector = ArrayInOut<double>;

void add(Values p, Values tip, Values by_width, Values by_follow, Rows by_c, Columns columns, Rows residual,
         std::optional<Rows> weight, nb::tuple width, nb::tuple follow, Square matrix, Vector gradient, size_t first) {
    const auto basis = [](const nb::tuple &of) {
        return spline_basis{nb::cast<double>(of[0]), nb::cast<double>(of[1]), nb::cast<size_t>(of[2])};
    };
    const spline_basis b = basis(width), f = basis(follow);
    const size_t frames = p.shape(0), seen = by_c.shape(1), count = columns.shape(2), m = b.size + f.size + count;
    const auto right = [&](const Rows &rows) { return rows.shape(0) == frames && rows.shape(1) == seen; };
    if (seen > NORMAL_SEEN || tip.shape(0) != frames || by_width.shape(0) != frames || by_follow.shape(0) != frames ||
        !right(by_c) || !right(residual) || (weight && !right(*weight)) || columns.shape(0) != frames ||
        columns.shape(1) != seen || matrix.shape(0) != m || matrix.shape(1) != m || gradient.shape(0) != m ||
        first > count || b.size < 4 || f.size < 4) {
        throw std::invalid_argument("shapes of a linearisation do not fit each other");
    }
    const normal_rows rows = {p.data(),
                              tip.data(),
                              by_width.data(),
                              by_follow.data(),
                              by_c.data(),
                              columns.data(),
                              residual.data(),
                              weight ? weight->data() : nullptr,
                              frames,
                              seen,
                              count};
    nb::gil_scoped_release unlocked;
    normal_add(&rows, &b, &f, first, matrix.data(), gradient.data());
}

// Whether the rows of a block are within its entries, and their columns rising and within its size.
bool right(const ArrayIn<int> &first, const ArrayIn<int> &column, const Values &value, size_t rows, size_t size) {
    const size_t entries = column.shape(0);
    bool holds = first.shape(0) == rows + 1 && value.shape(0) == entries && first.data()[0] == 0 &&
                 static_cast<size_t>(first.data()[rows]) == entries;
    for (size_t r = 0; holds && r < rows; r++) {
        holds = first.data()[r] <= first.data()[r + 1] && static_cast<size_t>(first.data()[r + 1]) <= entries;
        for (int j = first.data()[r]; holds && j < first.data()[r + 1]; j++) {
            const int at = column.data()[j];
            holds = at >= 0 && static_cast<size_t>(at) < size && (j == first.data()[r] || at > column.data()[j - 1]);
        }
    }
    return holds;
}

using Block = std::tuple<ArrayIn<int>, ArrayIn<int>, Values, size_t>;

void add_sparse(const std::vector<Block> &blocks, Values weight, Values residual, Square matrix, Vector gradient) {
    const size_t rows = weight.shape(0), size = gradient.shape(0);
    std::vector<normal_sparse> all;
    size_t columns = 0, longest = 0;
    bool holds = residual.shape(0) == rows && matrix.shape(0) == size && matrix.shape(1) == size;
    for (const auto &[first, column, value, own] : blocks) {
        holds = holds && right(first, column, value, rows, own);
        all.push_back({first.data(), column.data(), value.data(), own});
        columns += own;
        longest += std::min(own, column.shape(0));
    }
    if (!holds || columns != size) {
        throw std::invalid_argument("sparse rows, their columns rising, do not fit the matrix");
    }
    std::vector<size_t> at(longest), end(longest);
    std::vector<double> entry(longest);
    nb::gil_scoped_release unlocked;
    normal_add_sparse(all.data(), all.size(), weight.data(), residual.data(), rows, at.data(), end.data(), entry.data(),
                      matrix.data(), gradient.data());
}

} // namespace

void bind_normal(nb::module_ &m) {
    m.def("normal_add", add, "p"_a, "tip"_a, "by_width"_a, "by_follow"_a, "by_c"_a, "columns"_a, "residual"_a,
          "weight"_a.none(), "width"_a, "follow"_a, "matrix"_a.noconvert(), "gradient"_a.noconvert(), "first"_a = 0,
          "Adds J'WJ and J'Wr to matrix and gradient. width, follow: (low, step, size) of the splines. See normal.h.");
    m.def("normal_add_sparse", add_sparse, "blocks"_a, "weight"_a, "residual"_a, "matrix"_a.noconvert(),
          "gradient"_a.noconvert(),
          "Adds J'WJ and J'Wr of sparse rows to matrix and gradient. blocks, side by side: (first, column, value, size)"
          " of each. See normal.h.");
}
