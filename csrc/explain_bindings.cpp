// How well a rendered image explains a measured one: amplitude and background of the least squares,
// the squares that are left, and their gradient by the image, in two passes over the voxels. And
// weighted products of columns over voxels, for least squares of more than one image.
#include <nanobind/ndarray.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <memory>
#include <vector>

#include "checks.h"
#include "particle_mesh_bindings.h"
#include "team.h"

namespace nb = nanobind;
using namespace deltamic_api;
using std::size_t;

namespace {

using deltamic_checks::Array;

// Blocks do not depend on the threads; their sums are added up in their order.
constexpr size_t block = 4096;
constexpr size_t lanes = 4;
// Of the squares of an image, their part that varies: less is rounding.
constexpr double flat = 1e-14;

using Sums = std::array<double, 6>;  // w, w m, w y, w m m, w m y, w y y

template <size_t n>
std::array<double, n> added(const std::vector<std::array<double, n>>& parts) {
    std::array<double, n> sum{};
    for (const auto& part : parts)
        for (size_t k = 0; k < n; ++k) sum[k] += part[k];
    return sum;
}

template <class T>
nb::tuple explain(Array<const T> image, Array<const std::int64_t> index, Array<const float> measured,
                  Array<const float> weights, double least, int threads) {
    using namespace deltamic_checks;
    require(index.ndim() == 1 && index.shape(0) > 0, "voxels: (N,), at least one");
    const size_t n = index.shape(0), voxels = image.size();
    has_shape(measured, "measured values", {n});
    has_shape(weights, "weights", {n});
    require(threads >= 1 && threads <= most_threads, "a number of threads is needed");
    const T* m = image.data();
    const std::int64_t* at = index.data();
    const float *y = measured.data(), *w = weights.data();
    const double shift = y[0];
    const size_t blocks = (n + block - 1) / block;
    std::vector<Sums> sums(blocks);
    std::vector<std::array<double, 1>> left(blocks);
    std::unique_ptr<T[]> pull(new T[voxels]());
    std::atomic<bool> ordered{true};
    double amplitude = 0, background = 0, squares = 0, scatter = 0;
    bool bounded = false;
    {
        nb::gil_scoped_release others_may_run;
        Team team(worth(4.0 * n, threads));
        team.run([&](int) {
            team.each(blocks, [&](size_t b) {
                const size_t first = b * block, last = std::min(n, first + block);
                // Before anything is read there.
                bool good = at[first] >= 0 && at[last - 1] < static_cast<std::int64_t>(voxels);
                for (size_t i = std::max<size_t>(first, 1); i < last; ++i) good &= at[i] > at[i - 1];
                if (!good) {
                    ordered = false;
                    return;
                }
                Sums s{};
                for (size_t i = first; i < last; ++i) {
                    const double wi = w[i], mi = m[at[i]], yi = y[i] - shift, wm = wi * mi, wy = wi * yi;
                    s[0] += wi, s[1] += wm, s[2] += wy, s[3] += wm * mi, s[4] += wm * yi, s[5] += wy * yi;
                }
                sums[b] = s;
            });
            team.once([&] {
                if (!ordered) return;
                const Sums s = added(sums);
                const double whole = std::max(s[0], 1e-300), mean = s[1] / whole, level = s[2] / whole;
                const double power = s[3] - mean * s[1];
                scatter = std::max(s[5] - level * s[2], 0.0);
                if (power > flat * s[3]) {
                    const double lowest = least * std::sqrt(scatter / power);
                    amplitude = (s[4] - mean * s[2]) / power;
                    bounded = amplitude < lowest;
                    amplitude = std::max(amplitude, lowest);
                } else {
                    bounded = true;
                }
                background = level - amplitude * mean;
            });
            if (!ordered) return;
            team.each(blocks, [&](size_t b) {
                const size_t first = b * block, last = std::min(n, first + block);
                double sum = 0;
                for (size_t i = first; i < last; ++i) {
                    const double r = amplitude * m[at[i]] + (background - (y[i] - shift)), wr = w[i] * r;
                    sum += wr * r;
                    pull[static_cast<size_t>(at[i])] = static_cast<T>(2 * amplitude * wr);
                }
                left[b] = {sum};
            });
        });
        squares = added(left)[0];
    }
    require(ordered, "voxels of the image must be named once, in their order");
    T* own = pull.release();
    nb::capsule owner(own, [](void* p) noexcept { delete[] static_cast<T*>(p); });
    return nb::make_tuple(nb::ndarray<nb::numpy, T>(own, {voxels}, owner), squares, scatter, amplitude,
                          background + shift, bounded);
}

constexpr size_t most_columns = 64;  // of products; what is solved for at a time is far less

// Weighted products of columns less a number each, each with each, in double precision.
template <class T>
nb::ndarray<nb::numpy, double> products(const std::vector<Array<const T>>& columns, Array<const T> weights,
                                        const std::vector<double>& less, int threads) {
    using namespace deltamic_checks;
    const size_t k = columns.size(), n = weights.size();
    require(k >= 1 && k <= most_columns, "1 to 64 columns are needed");
    require(weights.ndim() == 1, "weights: (N,)");
    for (const auto& column : columns) has_shape(column, "a column", {n});
    require(less.size() == k, "one number per column is needed");
    thread_count(threads);
    const size_t blocks = (n + block - 1) / block;
    std::vector<double> parts(blocks * k * k);
    double* found = new double[k * k]();
    nb::capsule owner(found, [](void* p) noexcept { delete[] static_cast<double*>(p); });
    {
        nb::gil_scoped_release others_may_run;
        Team team(worth(0.5 * n * k * (k + 3), threads));
        // Made before the threads are, in which nothing can be told of memory that runs out.
        std::vector<double> of_workers(block * static_cast<size_t>(team.size()));
        team.run([&](int worker) {
            double* const weighted = of_workers.data() + block * static_cast<size_t>(worker);
            team.each(blocks, [&](size_t b) {
                const size_t first = b * block, count = std::min(n - first, block);
                double* own = parts.data() + b * k * k;
                for (size_t i = 0; i < k; ++i) {
                    const T *one = columns[i].data() + first, *w = weights.data() + first;
                    for (size_t at = 0; at < count; ++at) weighted[at] = w[at] * (one[at] - less[i]);
                    for (size_t j = i; j < k; ++j) {
                        const T* other = columns[j].data() + first;
                        const double its_level = less[j];
                        double sum[lanes] = {};  // side by side, or each addition waits for the one before
                        size_t at = 0;
                        for (; at + lanes <= count; at += lanes)
                            for (size_t l = 0; l < lanes; ++l) sum[l] += weighted[at + l] * (other[at + l] - its_level);
                        for (; at < count; ++at) sum[0] += weighted[at] * (other[at] - its_level);
                        own[i * k + j] = (sum[0] + sum[1]) + (sum[2] + sum[3]);
                    }
                }
            });
        });
    }
    for (size_t b = 0; b < blocks; ++b)
        for (size_t i = 0; i < k; ++i)
            for (size_t j = i; j < k; ++j) found[i * k + j] += parts[(b * k + i) * k + j];
    for (size_t i = 0; i < k; ++i)
        for (size_t j = 0; j < i; ++j) found[i * k + j] = found[j * k + i];
    return nb::ndarray<nb::numpy, double>(found, {k, k}, owner);
}

}  // namespace

void bind_explain(nb::module_& m) {
    m.def("products_f32", &products<float>);
    m.def("products_f64", &products<double>);
    m.def("explain_f32", &explain<float>);
    m.def("explain_f64", &explain<double>);
}
