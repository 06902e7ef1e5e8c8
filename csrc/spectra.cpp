// Passes of the three-dimensional FFT. Compiled once per instruction set (CMakeLists.txt).
//
// Along z and y the columns of a vector lie side by side in memory. Along x they are pairs of rows, one
// as the real part and one as the imaginary part of one complex transform.
//
// Nothing here may instantiate a standard-library template; see mesh_ft_cpu.cpp.
#define DELTAMIC_JOIN2(a, b) a##b
#define DELTAMIC_JOIN(a, b) DELTAMIC_JOIN2(a, b)
#define DELTAMIC_NAMESPACE DELTAMIC_JOIN(deltamic_, DELTAMIC_SIMD)
#define DELTAMIC_FN inline
#include <cstddef>

namespace DELTAMIC_NAMESPACE {
template <class T>
struct Scalar {
    using type = T;
};
}  // namespace DELTAMIC_NAMESPACE

#include "fft.h"
#include "transpose.h"

namespace DELTAMIC_NAMESPACE {
namespace {

using deltamic_api::Spectrum;
using std::size_t;

template <class T>
int longest(const Spectrum<T>& s) {
    int n = 0;
    for (int axis = 0; axis < 3; ++axis) n = s.fft[axis].size > n ? s.fft[axis].size : n;
    return n;
}

template <class T>
int row_width(const Spectrum<T>& s) {
    return (s.width() + lanes<T> - 1) / lanes<T> * lanes<T>;
}

// Blocks of columns that are read and written together along z, where one number and the next lie far
// apart in memory.
constexpr int together = 4;

template <class T>
size_t column(const Spectrum<T>& s) {
    return 2 * static_cast<size_t>(longest(s)) * lanes<T>;
}

// Columns before and after, and a plane of rows along x (real parts, then imaginary ones).
template <class T>
size_t scratch(const Spectrum<T>& s) {
    const size_t rows = s.count[1] > s.height() ? s.count[1] : s.height(), planes = 2 * rows * row_width(s);
    return 2 * column(s) + (planes > (2 * together - 2) * column(s) ? planes : (2 * together - 2) * column(s));
}

// Blocks of columns: the last one is moved back to end where the columns do, so that none is cut; a
// single one that is too short is.
struct Block {
    int first, count;
};
template <class T>
inline Block block_of(int i, int first, int last) {
    const int at = first + i * lanes<T>;
    if (at + lanes<T> <= last) return {at, lanes<T>};
    if (last - lanes<T> >= first) return {last - lanes<T>, lanes<T>};
    return {first, last - first};
}
template <class T>
inline int blocks(int first, int last) {
    return (last - first + lanes<T> - 1) / lanes<T>;
}

template <class T>
inline Lanes<T> load_some(const T* p, int count) {
    if (count == lanes<T>) return Lanes<T>::load(p);
    T v[lanes<T>] = {};
    for (int i = 0; i < count; ++i) v[i] = p[i];
    return Lanes<T>::load(v);
}
template <class T>
inline void store_some(Lanes<T> v, T* p, int count) {
    if (count == lanes<T>) return v.store(p);
    T parts[lanes<T>];
    v.store(parts);
    for (int i = 0; i < count; ++i) p[i] = parts[i];
}

template <class T>
inline Number<T> load_complex(const T* p, int count) {
    T re[lanes<T>], im[lanes<T>];
    if (count == lanes<T>) {
        for (int i = 0; i < lanes<T>; ++i) {
            re[i] = p[2 * i];
            im[i] = p[2 * i + 1];
        }
    } else {
        for (int i = 0; i < lanes<T>; ++i) {
            re[i] = i < count ? p[2 * i] : T(0);
            im[i] = i < count ? p[2 * i + 1] : T(0);
        }
    }
    return {Lanes<T>::load(re), Lanes<T>::load(im)};
}
template <class T>
inline void store_complex(Number<T> v, T* p, int count) {
    T re[lanes<T>], im[lanes<T>];
    v.re.store(re);
    v.im.store(im);
    if (count == lanes<T>) {
        for (int i = 0; i < lanes<T>; ++i) {
            p[2 * i] = re[i];
            p[2 * i + 1] = im[i];
        }
    } else {
        for (int i = 0; i < count; ++i) {
            p[2 * i] = re[i];
            p[2 * i + 1] = im[i];
        }
    }
}

// Where an index from -half to half lies among n.
inline int wrapped(int k, int n) { return k < 0 ? k + n : k < n ? k : k - n; }

template <class T>
inline void clear(T* a, int first, int last) {
    for (int i = first; i < last; ++i) put<T>(a, i, {Lanes<T>(T(0)), Lanes<T>(T(0))});
}

// For the inverse transform, numbers are held with their parts swapped.
template <class T>
inline Number<T> swapped(Number<T> v) {
    return {v.im, v.re};
}

// Puts numbers -half..half, which `of` gives, where an FFT of n takes them; +n/2 and -n/2 are one.
template <class T, class F>
inline void place_all(T* a, int half, int n, F of) {
    for (int k = 0; k <= half && k < n; ++k) put<T>(a, k, of(k + half));
    clear(a, half + 1, n - half);
    for (int k = -half; k < 0; ++k) {
        const int at = k + n;
        if (at > half) put<T>(a, at, of(k + half));
        else put<T>(a, at, number_at(a, at) + of(k + half));
    }
}

// ------------------------------------------------------------------------------------- along z

// Real numbers that those of one block at one z are multiplied by.
template <class T>
inline Lanes<T> factor(const Spectrum<T>& s, int z, Block at) {
    const Lanes<T> f = load_some(s.factor_yx + at.first, at.count) * Lanes<T>(s.factor_z[z]);
    return s.weights ? f * load_some(s.weights + static_cast<size_t>(z) * s.columns() + at.first, at.count) : f;
}

template <class T>
void box_to_planes(const Spectrum<T>& s, const T* box, int first, int last, T* planes, int padded, T* work) {
    const int n = s.fft[0].size, half = s.half[0], columns = s.columns(), all = blocks<T>(first, last);
    for (int b = 0; b < all; b += together) {
        const int some = all - b < together ? all - b : together;
        Block at[together];
        T *to[together], *found[together];
        for (int i = 0; i < some; ++i) {
            at[i] = block_of<T>(b + i, first, last);
            to[i] = work + 2 * i * column(s);
            clear(to[i], half + 1, n - half);
        }
        // +n/2 and -n/2 are one number, and added.
        for (int z = 0; z <= 2 * half; ++z) {
            const int where = wrapped(z - half, n);
            const bool added = z > 0 && 2 * half == n && z == 2 * half;
            for (int i = 0; i < some; ++i) {
                const Number<T> v = load_complex(box + 2 * (static_cast<size_t>(z) * columns + at[i].first), at[i].count);
                const Lanes<T> f = factor(s, z, at[i]);
                const Number<T> own{v.im * f, v.re * f};
                put<T>(to[i], where, added ? number_at(to[i], where) + own : own);
            }
        }
        for (int i = 0; i < some; ++i) found[i] = transform(s.fft[0], to[i], to[i] + column(s));
        for (int z = 0; z < s.count[0]; ++z) {
            for (int i = 0; i < some; ++i) {
                const Number<T> v = number_at(found[i], z);
                T* plane = planes + 2 * static_cast<size_t>(z) * padded + at[i].first;
                store_some(v.im, plane, at[i].count);
                store_some(v.re, plane + padded, at[i].count);
            }
        }
    }
}

template <class T>
void planes_to_box(const Spectrum<T>& s, const T* planes, int padded, int first, int last, T* box, T* work) {
    const int n = s.fft[0].size, half = s.half[0], columns = s.columns(), all = blocks<T>(first, last);
    for (int b = 0; b < all; b += together) {
        const int some = all - b < together ? all - b : together;
        Block at[together];
        T *to[together], *found[together];
        for (int i = 0; i < some; ++i) {
            at[i] = block_of<T>(b + i, first, last);
            to[i] = work + 2 * i * column(s);
            clear(to[i], s.count[0], n);
        }
        for (int z = 0; z < s.count[0]; ++z) {
            for (int i = 0; i < some; ++i) {
                const T* plane = planes + 2 * static_cast<size_t>(z) * padded + at[i].first;
                put<T>(to[i], z, {load_some(plane, at[i].count), load_some(plane + padded, at[i].count)});
            }
        }
        for (int i = 0; i < some; ++i) found[i] = transform(s.fft[0], to[i], to[i] + column(s));
        for (int z = 0; z <= 2 * half; ++z) {
            for (int i = 0; i < some; ++i) {
                const Lanes<T> f = factor(s, z, at[i]);
                const Number<T> v = number_at(found[i], wrapped(z - half, n));
                T* to_box = box + 2 * (static_cast<size_t>(z) * columns + at[i].first);
                store_complex<T>({v.re * f, v.im * f}, to_box, at[i].count);
            }
        }
    }
}

// --------------------------------------------------------------------------------- along y and x

// Rows of a plane in pairs: the first half of a group is the real part, the second the imaginary one.
// Where rows are missing, the last one stands in for them.
template <class T>
struct Pairs {
    int first, rows;

    int a(int lane) const { return first + lane < rows ? first + lane : rows - 1; }
    int b(int lane) const { return a(lane + lanes<T>); }
    bool has_a(int lane) const { return first + lane < rows; }
    bool has_b(int lane) const { return first + lane + lanes<T> < rows; }
};
template <class T>
inline int groups(int rows) {
    return (rows + 2 * lanes<T> - 1) / (2 * lanes<T>);
}

// Rows side by side: number x of each lies in vector 2 x.
template <class T, class F>
inline void pack_rows(T* to, int count, F row) {
    int x = 0;
    for (; x + lanes<T> <= count; x += lanes<T>) {
        Lanes<T> v[lanes<T>];
        for (int lane = 0; lane < lanes<T>; ++lane) v[lane] = Lanes<T>::load(row(lane) + x);
        transpose<T>(v);
        for (int i = 0; i < lanes<T>; ++i) v[i].store(to + 2 * (x + i) * lanes<T>);
    }
    for (int lane = 0; lane < lanes<T>; ++lane)
        for (int i = x; i < count; ++i) to[2 * i * lanes<T> + lane] = row(lane)[i];
}
template <class T, class F>
inline void unpack_rows(const T* from, int count, F row) {
    int x = 0;
    for (; x + lanes<T> <= count; x += lanes<T>) {
        Lanes<T> v[lanes<T>];
        for (int i = 0; i < lanes<T>; ++i) v[i] = Lanes<T>::load(from + 2 * (x + i) * lanes<T>);
        transpose<T>(v);
        for (int lane = 0; lane < lanes<T>; ++lane)
            if (T* const to = row(lane)) v[lane].store(to + x);
    }
    for (int lane = 0; lane < lanes<T>; ++lane)
        if (T* const to = row(lane))
            for (int i = x; i < count; ++i) to[i] = from[2 * i * lanes<T> + lane];
}

// Half spectra of pairs of rows, from number `first` on, as one whole spectrum with its parts swapped.
template <class T>
inline void pack(const Pairs<T>& pairs, const T* rows, const T* rows_im, int stride, int first, int width, int nx, T* to) {
    Lanes<T> a_re[lanes<T>], a_im[lanes<T>], b_re[lanes<T>], b_im[lanes<T>];
    for (int lane = 0; lane < lanes<T>; ++lane) {
        const int a = pairs.a(lane) * stride + first, b = pairs.b(lane) * stride + first;
        a_re[lane] = Lanes<T>::load(rows + a);
        a_im[lane] = Lanes<T>::load(rows_im + a);
        b_re[lane] = Lanes<T>::load(rows + b);
        b_im[lane] = Lanes<T>::load(rows_im + b);
    }
    transpose<T>(a_re);
    transpose<T>(a_im);
    transpose<T>(b_re);
    transpose<T>(b_im);
    const int end = width - first < lanes<T> ? width - first : lanes<T>;
    for (int i = 0; i < end; ++i) {
        const int k = first + i;
        if (k == 0 || 2 * k == nx) {
            put<T>(to, k, {b_re[i], a_re[i]});
            continue;
        }
        put<T>(to, k, {a_im[i] + b_re[i], a_re[i] - b_im[i]});
        put<T>(to, nx - k, {b_re[i] - a_im[i], a_re[i] + b_im[i]});
    }
}

// The inverse, parts as they are.
template <class T>
inline void unpack(const Pairs<T>& pairs, const T* from, int nx, int first, int width, T* rows, T* rows_im, int stride) {
    Lanes<T> a_re[lanes<T>], a_im[lanes<T>], b_re[lanes<T>], b_im[lanes<T>];
    const Lanes<T> half(T(0.5));
    for (int i = 0; i < lanes<T>; ++i) {
        const int k = first + i < width ? first + i : 0;
        const Number<T> up = number_at(from, k), down = number_at(from, wrapped(-k, nx));
        a_re[i] = half * (up.re + down.re);
        a_im[i] = half * (up.im - down.im);
        b_re[i] = half * (up.im + down.im);
        b_im[i] = half * (down.re - up.re);
    }
    transpose<T>(a_re);
    transpose<T>(a_im);
    transpose<T>(b_re);
    transpose<T>(b_im);
    for (int lane = 0; lane < lanes<T>; ++lane) {
        if (pairs.has_a(lane)) {
            a_re[lane].store(rows + pairs.a(lane) * stride + first);
            a_im[lane].store(rows_im + pairs.a(lane) * stride + first);
        }
        if (pairs.has_b(lane)) {
            b_re[lane].store(rows + pairs.b(lane) * stride + first);
            b_im[lane].store(rows_im + pairs.b(lane) * stride + first);
        }
    }
}

template <class T>
void plane_to_real(const Spectrum<T>& s, const T* plane, int padded, T* real, T* work) {
    const int ny = s.fft[1].size, nx = s.fft[2].size, width = s.width(), stride = row_width(s);
    T *const other = work + column(s), *const rows = other + column(s), *const rows_im = rows + s.count[1] * stride;
    for (int b = 0; b < blocks<T>(0, width); ++b) {
        const Block at = block_of<T>(b, 0, width);
        place_all<T>(work, s.half[1], ny, [&](int i) {
            const T* p = plane + static_cast<size_t>(i) * width + at.first;
            return Number<T>{load_some(p + padded, at.count), load_some(p, at.count)};
        });
        const T* found = transform(s.fft[1], work, other);
        for (int y = 0; y < s.count[1]; ++y) {
            const Number<T> v = swapped(number_at(found, y));
            store_some(v.re, rows + y * stride + at.first, at.count);
            store_some(v.im, rows_im + y * stride + at.first, at.count);
        }
    }
    for (int group = 0; group < groups<T>(s.count[1]); ++group) {
        const Pairs<T> pairs{2 * group * lanes<T>, s.count[1]};
        clear(work, width, nx - width + 1);
        for (int first = 0; first < width; first += lanes<T>) pack(pairs, rows, rows_im, stride, first, width, nx, work);
        const T* found = transform(s.fft[2], work, other);
        // Parts are swapped: the real one, which is the first rows, comes second.
        unpack_rows(found + lanes<T>, s.count[2], [&](int lane) { return pairs.has_a(lane) ? real + pairs.a(lane) * s.row : nullptr; });
        unpack_rows(found, s.count[2], [&](int lane) { return pairs.has_b(lane) ? real + pairs.b(lane) * s.row : nullptr; });
    }
}

template <class T>
void real_to_plane(const Spectrum<T>& s, const T* real, T* plane, int padded, T* work) {
    const int ny = s.fft[1].size, nx = s.fft[2].size, width = s.width(), stride = row_width(s);
    T *const other = work + column(s), *const rows = other + column(s), *const rows_im = rows + s.count[1] * stride;
    for (int group = 0; group < groups<T>(s.count[1]); ++group) {
        const Pairs<T> pairs{2 * group * lanes<T>, s.count[1]};
        pack_rows(work, s.count[2], [&](int lane) { return real + pairs.a(lane) * s.row; });
        pack_rows(work + lanes<T>, s.count[2], [&](int lane) { return real + pairs.b(lane) * s.row; });
        clear(work, s.count[2], nx);
        const T* found = transform(s.fft[2], work, other);
        for (int first = 0; first < width; first += lanes<T>)
            unpack(pairs, found, nx, first, width, rows, rows_im, stride);
    }
    for (int b = 0; b < blocks<T>(0, width); ++b) {
        const Block at = block_of<T>(b, 0, width);
        for (int y = 0; y < s.count[1]; ++y)
            put<T>(work, y, {load_some(rows + y * stride + at.first, at.count),
                             load_some(rows_im + y * stride + at.first, at.count)});
        clear(work, s.count[1], ny);
        const T* found = transform(s.fft[1], work, other);
        for (int i = 0; i < s.height(); ++i) {
            const Number<T> v = number_at(found, wrapped(i - s.half[1], ny));
            T* p = plane + static_cast<size_t>(i) * width + at.first;
            store_some(v.re, p, at.count);
            store_some(v.im, p + padded, at.count);
        }
    }
}

}  // namespace

extern const deltamic_api::SpectrumLoops<float> spectrum_f32 = {lanes<float>,          scratch<float>,
                                                                box_to_planes<float>,  planes_to_box<float>,
                                                                plane_to_real<float>,  real_to_plane<float>};
extern const deltamic_api::SpectrumLoops<double> spectrum_f64 = {lanes<double>,         scratch<double>,
                                                                 box_to_planes<double>, planes_to_box<double>,
                                                                 plane_to_real<double>, real_to_plane<double>};

}  // namespace DELTAMIC_NAMESPACE
