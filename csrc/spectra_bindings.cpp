// Python bindings of the three-dimensional FFTs: checks, tables, threads.
#include "particle_mesh_bindings.h"

#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "checks.h"
#include "simd_levels.h"
#include "team.h"

namespace nb = nanobind;
using namespace deltamic_api;
using std::size_t;

namespace {

using deltamic_checks::Array;

constexpr int longest_axis = 1 << 16, largest_prime = 1 << 13;  // a factor costs its square

// Factors of a length and all roots of unity that its passes take.
template <class T>
class Tables {
public:
    explicit Tables(int n) {
        deltamic_checks::require(n >= 1 && n <= longest_axis, "a period is empty, or too long");
        fft.size = n;
        fft.factors = 0;
        int left = n;
        for (const int p : {4, 2, 3, 5})
            while (left % p == 0) left = take(p, left);
        for (int p = 7; left > 1; p += 2)
            while (left % p == 0) left = take(p, left);
        for (int i = 0; i < fft.factors; ++i)
            deltamic_checks::require(fft.factor[i] <= largest_prime, "a period has too large a prime factor");
        left = n;
        std::vector<size_t> roots(fft.factors);
        for (int i = 0; i < fft.factors; ++i) {
            const int radix = fft.factor[i];
            left /= radix;
            for (int p = 0; p < left; ++p)
                for (int j = 1; j < radix; ++j) add(static_cast<double>(p) * j / (radix * left));
        }
        for (int i = 0; i < fft.factors; ++i) {
            roots[i] = numbers_.size();
            if (fft.factor[i] > 5)
                for (int k = 0; k < fft.factor[i]; ++k) add(static_cast<double>(k) / fft.factor[i]);
        }
        fft.twiddles = numbers_.data();
        for (int i = 0; i < fft.factors; ++i) fft.roots[i] = numbers_.data() + roots[i];
    }
    Tables(const Tables&) = delete;
    Tables& operator=(const Tables&) = delete;

    Fft<T> fft;

private:
    int take(int p, int left) {
        fft.factor[fft.factors++] = p;
        return left / p;
    }
    void add(double turns) {
        constexpr double two_pi = 6.283185307179586476925;
        numbers_.push_back(static_cast<T>(std::cos(two_pi * turns)));
        numbers_.push_back(static_cast<T>(-std::sin(two_pi * turns)));
    }

    std::vector<T> numbers_;
};

template <class T>
struct Given {
    Tables<T> z, y, x;
    Spectrum<T> spectrum;

    Given(const std::vector<int>& shape, const std::vector<int>& half, const std::vector<int>& count,
          std::int64_t row, const Array<const T>& factor_z, const Array<const T>& factor_yx,
          const std::optional<Array<const T>>& weights)
        : z(of_three(shape, half, count)[0]), y(shape[1]), x(shape[2]) {
        spectrum.fft[0] = z.fft;
        spectrum.fft[1] = y.fft;
        spectrum.fft[2] = x.fft;
        for (int axis = 0; axis < 3; ++axis) {
            spectrum.half[axis] = half[axis];
            spectrum.count[axis] = count[axis];
            if (half[axis] < 0 || half[axis] > shape[axis] / 2 || count[axis] < 1 || count[axis] > shape[axis])
                throw std::invalid_argument("a band or an array is larger than its period");
        }
        spectrum.row = row;
        if (row < count[2] || row > 2 * longest_axis) throw std::invalid_argument("rows are too short or too long");
        // Columns are counted in 32 bits.
        deltamic_checks::require(static_cast<double>(2 * half[1] + 1) * (half[2] + 1) < 1e8, "the band is too large");
        if (factor_z.size() != static_cast<size_t>(2 * half[0] + 1) ||
            factor_yx.size() != static_cast<size_t>(spectrum.columns()))
            throw std::invalid_argument("one factor per wavevector of each axis is needed");
        spectrum.factor_z = factor_z.data();
        spectrum.factor_yx = factor_yx.data();
        if (weights && weights->size() != static_cast<size_t>(spectrum.columns()) * (2 * half[0] + 1))
            throw std::invalid_argument("one weight per wavevector is needed");
        spectrum.weights = weights ? weights->data() : nullptr;
    }

private:
    static const std::vector<int>& of_three(const std::vector<int>& shape, const std::vector<int>& half,
                                            const std::vector<int>& count) {
        deltamic_checks::require(shape.size() == 3 && half.size() == 3 && count.size() == 3,
                                 "numbers of three axes are needed");
        return shape;
    }
};

constexpr int together = 4;  // vectors of columns that are handed out at a time

template <class T>
void transform(const Spectrum<T>& s, const SpectrumLoops<T>& loops, T* box, T* real, bool to_real, int threads) {
    const int columns = s.columns(), planes = s.count[0], piece = together * loops.lanes;
    const int padded = (columns + loops.lanes - 1) / loops.lanes * loops.lanes;
    const size_t pieces = (columns + piece - 1) / piece, work = (loops.scratch(s) / 16 + 1) * 16;
    const std::unique_ptr<T[]> between(new T[2 * static_cast<size_t>(padded) * planes]);
    const size_t plane_of_real = static_cast<size_t>(s.count[1]) * s.row;
    const double points = static_cast<double>(s.fft[0].size) * s.fft[1].size * s.fft[2].size;
    Team team(deltamic_api::worth(0.3 * sizeof(T) * points, threads));
    // For all workers: threads that come and go would each ask the system for theirs.
    const std::unique_ptr<T[]> memory(new T[work * (team.size() + 1)]());
    T* const aligned = memory.get() + (64 - reinterpret_cast<std::uintptr_t>(memory.get()) % 64) / sizeof(T);
    team.run([&](int worker) {
        T* const scratch = aligned + worker * work;
        const auto along_z = [&](size_t i) {
            const int first = static_cast<int>(i) * piece, last = std::min(columns, first + piece);
            if (to_real) loops.box_to_planes(s, box, first, last, between.get(), padded, scratch);
            else loops.planes_to_box(s, between.get(), padded, first, last, box, scratch);
        };
        const auto across = [&](size_t z) {
            T* const plane = between.get() + 2 * z * padded;
            if (to_real) loops.plane_to_real(s, plane, padded, real + z * plane_of_real, scratch);
            else loops.real_to_plane(s, real + z * plane_of_real, plane, padded, scratch);
        };
        if (to_real) team.each(pieces, along_z);
        team.each(planes, across);
        if (!to_real) team.each(pieces, along_z);
    });
}

template <class T>
void bind(nb::module_& m, const char* suffix) {
    const std::string s(suffix);
    for (const bool to_real : {true, false}) {
        m.def(((to_real ? "to_real_" : "to_box_") + s).c_str(),
              [to_real](Array<T> box, Array<T> real, const std::vector<int>& shape, const std::vector<int>& half,
                        const std::vector<int>& count, Array<const T> factor_z, Array<const T> factor_yx,
                        std::optional<Array<const T>> weights, int threads, const std::string& simd) {
                  deltamic_checks::require(real.ndim() == 3, "a real array of three axes is needed");
                  deltamic_checks::thread_count(threads);
                  const Given<T> g(shape, half, count, static_cast<std::int64_t>(real.shape(2)), factor_z, factor_yx, weights);
                  const Spectrum<T>& s = g.spectrum;
                  if (box.size() != 2 * static_cast<size_t>(s.columns()) * (2 * half[0] + 1) ||
                      real.size() != static_cast<size_t>(s.row) * count[0] * count[1])
                      throw std::invalid_argument("a box or an array has another size");
                  const SpectrumLoops<T>& loops = spectrum_loops_of<T>(simd);
                  nb::gil_scoped_release release;
                  transform(s, loops, box.data(), real.data(), to_real, threads);
              },
              nb::arg("box").noconvert(), nb::arg("real").noconvert(), nb::arg("shape"), nb::arg("half"), nb::arg("count"),
              nb::arg("factor_z"), nb::arg("factor_yx"), nb::arg("weights").none(), nb::arg("threads"),
              nb::arg("simd"));
    }
}

}  // namespace

void bind_spectra(nb::module_& m) {
    bind<float>(m, "f32");
    bind<double>(m, "f64");
}
