// Whole numpy arrays in and out: how every binding passes its batches.
#ifndef TAUTLINE_NATIVE_ARRAYS_H
#define TAUTLINE_NATIVE_ARRAYS_H

#include <cstddef>
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

template <typename T>
using ArrayIn = nanobind::ndarray<const T, nanobind::ndim<1>, nanobind::c_contig, nanobind::device::cpu>;
template <typename T> using ArrayOut = nanobind::ndarray<nanobind::numpy, T, nanobind::ndim<1>>;

// A new numpy array of `size` elements, not initialised; write through .data().
template <typename T> ArrayOut<T> new_array(std::size_t size) {
    T *data = new T[size];
    nanobind::capsule owner(data, [](void *p) noexcept { delete[] static_cast<T *>(p); });
    return ArrayOut<T>(data, {size}, owner);
}

#endif
