// Real arrays to the low wavevectors of their Fourier transform and back: three-dimensional FFTs that
// leave out what is zero or not asked for. Plain data, owned by the caller.
#pragma once
#include <cstddef>
#include <cstdint>

namespace deltamic_api {

constexpr int most_factors = 32;

// How a length is transformed.
template <class T>
struct Fft {
    int size, factors;
    int factor[most_factors];
    const T* twiddles;             // of all passes: (left, factor - 1) complex numbers each
    const T* roots[most_factors];  // of factors above 5
};

// A real array (count[0], count[1], count[2]), which lies at the beginning of a periodic one, and the
// box of its wavevectors, (2 half[0] + 1, 2 half[1] + 1, half[2] + 1) complex numbers.
template <class T>
struct Spectrum {
    Fft<T> fft[3];
    int count[3], half[3];
    std::int64_t row;        // of the real array: from one row along x to the next
    const T* factor_z;       // (2 half[0] + 1): numbers of the box are multiplied by these
    const T* factor_yx;      // ((2 half[1] + 1) (half[2] + 1)): and these
    const T* weights;        // as many as the box has: and these, or null

    int height() const { return 2 * half[1] + 1; }
    int width() const { return half[2] + 1; }
    int columns() const { return height() * width(); }
};

// Between the box and planes (count[0]) of numbers transformed along z: in each the real parts of all
// columns, then the imaginary ones, `padded` of them.
template <class T>
struct SpectrumLoops {
    int lanes;
    // Numbers of scratch that a worker needs.
    std::size_t (*scratch)(const Spectrum<T>&);
    void (*box_to_planes)(const Spectrum<T>&, const T* box, int first, int last, T* planes, int padded, T* scratch);
    void (*planes_to_box)(const Spectrum<T>&, const T* planes, int padded, int first, int last, T* box, T* scratch);
    void (*plane_to_real)(const Spectrum<T>&, const T* plane, int padded, T* real, T* scratch);
    void (*real_to_plane)(const Spectrum<T>&, const T* real, T* plane, int padded, T* scratch);
};

}  // namespace deltamic_api
