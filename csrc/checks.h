// What the bindings ask of what they are given, once, before a loop reads it: loops trust their
// numbers. What does not hold is a std::invalid_argument, in Python a ValueError.
#pragma once
#include <nanobind/ndarray.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <vector>

namespace deltamic_checks {

template <class T>
using Array = nanobind::ndarray<T, nanobind::c_contig, nanobind::device::cpu>;

constexpr double farthest = 1e15;             // um: products of three such lengths are still numbers
constexpr std::int64_t most_rows = 1 << 30;   // indices of edges, three to a face, fit 32 bits
constexpr int most_threads = 1024;

inline void require(bool holds, const std::string& otherwise) {
    if (!holds) throw std::invalid_argument(otherwise);
}

// Number of rows of an array of so many columns.
template <class A>
std::size_t rows_of(const A& a, const char* name, std::size_t columns) {
    require(a.ndim() == 2 && a.shape(1) == columns, std::string(name) + ": an array of " + std::to_string(columns) + " columns");
    require(static_cast<std::int64_t>(a.shape(0)) < most_rows, std::string(name) + ": too many");
    return a.shape(0);
}

template <class A>
void has_shape(const A& a, const char* name, const std::vector<std::size_t>& shape) {
    bool same = a.ndim() == shape.size();
    for (std::size_t k = 0; same && k < shape.size(); ++k) same = a.shape(k) == shape[k];
    require(same, std::string(name) + ": an array of another shape is needed");
}

template <class A>
void within(const A& a, const char* name, double lowest, double highest) {
    for (std::size_t i = 0; i < a.size(); ++i)
        if (!(a.data()[i] >= lowest && a.data()[i] <= highest))
            throw std::invalid_argument(std::string(name) + " must be finite, " +
                                        (lowest < 0 ? "" : lowest > 0 ? "positive, " : "not negative, ") +
                                        "and no larger than can be computed with");
}

inline void within(double value, const char* name, double lowest, double highest) {
    require(value >= lowest && value <= highest, std::string(name) + ": a finite number in its range is needed");
}

// Places: how many there are.
template <class A>
std::size_t places_in(const A& a, const char* name = "vertices") {
    require(a.ndim() == 2 && a.shape(1) == 3, std::string(name) + ": (V, 3)");
    const std::size_t n = rows_of(a, name, 3);
    within(a, name, -farthest, farthest);
    return n;
}

template <class A>
void below(const A& indices, std::size_t count, const char* otherwise) {
    for (std::size_t i = 0; i < indices.size(); ++i)
        if (static_cast<std::uint64_t>(indices.data()[i]) >= count) throw std::invalid_argument(otherwise);
}

// Faces (3 columns) or edges (2) between so many places: how many there are.
template <class A>
std::size_t joined_in(const A& a, const char* name, std::size_t corners, std::size_t places) {
    const std::size_t n = rows_of(a, name, corners);
    below(a, places, corners == 3 ? "a face names a vertex that is not there" : "an edge names a vertex that is not there");
    return n;
}

inline void thread_count(int threads) { require(threads >= 1 && threads <= most_threads, "threads: 1 to 1024"); }

}  // namespace deltamic_checks
