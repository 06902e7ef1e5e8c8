// The loops for CPUs. Compiled once per instruction set (CMakeLists.txt); bindings.cpp picks one.
//
// On a band the exponential of the centroid separates, e^{-i xi.c} = Z[kz] Y[ky] X[kx], and the edge
// phases are linear along a row, so the inner loop over kx holds no trigonometry for small triangles.
// The inner loops run on vector lanes along kx (lanes.h).
//
// Nothing here may instantiate a standard-library template: the linker could then pick the copy
// that was compiled for the widest instruction set and use it everywhere.
#define DELTAMIC_JOIN2(a, b) a##b
#define DELTAMIC_JOIN(a, b) DELTAMIC_JOIN2(a, b)
#define DELTAMIC_NAMESPACE DELTAMIC_JOIN(deltamic_, DELTAMIC_SIMD)
#include "band_block.h"

namespace DELTAMIC_NAMESPACE {
namespace {

using deltamic_api::Share;
using deltamic_api::sums_per_triangle;

// ---------------------------------------------------------------------------------- forward

// Edge phases and centred phases of one triangle along a row.
template <class T>
struct Lines {
    using L = Lanes<T>;
    L d[3], s[3], a0, a1, b0, b1, c_re, c_im;

    Lines(const Block<T>& b, int f) {
        const T third = T(1.0 / 3.0);
        for (int p = 0; p < 3; ++p) {
            d[p] = L(b.d[p][f]);
            s[p] = L(b.slope[p][2][f]);
        }
        a0 = L((b.d[1][f] - b.d[2][f]) * third);
        a1 = L((b.slope[1][2][f] - b.slope[2][2][f]) * third);
        b0 = L((b.d[2][f] - b.d[0][f]) * third);
        b1 = L((b.slope[2][2][f] - b.slope[0][2][f]) * third);
        c_re = L(b.c_re[f]);
        c_im = L(b.c_im[f]);
    }
};

template <class T, Branch branch>
inline void add_lanes(const Block<T>& b, int f, const Lines<T>& line, int first, int n, T* acc_re, T* acc_im) {
    using L = Lanes<T>;
    const T* xr = b.x_re + f * b.width;
    const T* xi = b.x_im + f * b.width;
    L k = L(static_cast<T>(first)) + L::ramp();
    for (int x = first; x < first + n; x += lanes<T>) {
        Value<L> v;
        if constexpr (branch == Branch::small) {
            v = small_value(line.a0 + k * line.a1, line.b0 + k * line.b1);
        } else {
            const L d1 = line.d[0] + k * line.s[0], d2 = line.d[1] + k * line.s[1], d3 = line.d[2] + k * line.s[2];
            v = branch == Branch::large ? large_value(d1, d2, d3) : triangle_value(d1, d2, d3);
        }
        const L ur = L::load(xr + x), ui = L::load(xi + x);
        const L er = line.c_re * ur - line.c_im * ui, ei = line.c_re * ui + line.c_im * ur;
        (L::load(acc_re + x) + er * v.re - ei * v.im).store(acc_re + x);
        (L::load(acc_im + x) + er * v.im + ei * v.re).store(acc_im + x);
        k += L(static_cast<T>(lanes<T>));
    }
}

template <class T>
void row_forward(const Block<T>& b, int width, T* RESTRICT acc_re, T* RESTRICT acc_im) {
    for (int f = 0; f < b.count; ++f) {
        const Lines<T> line(b, f);
        if (b.reach[f] < T(tau)) {
            add_lanes<T, Branch::small>(b, f, line, 0, width, acc_re, acc_im);
            continue;
        }
        const Interval<T> in = small_interval(b, f, width);
        for (int x = 0; x < width; x += lanes<T>) {
            switch (branch_of(in, x)) {
                case Branch::small: add_lanes<T, Branch::small>(b, f, line, x, lanes<T>, acc_re, acc_im); break;
                case Branch::large: add_lanes<T, Branch::large>(b, f, line, x, lanes<T>, acc_re, acc_im); break;
                default: add_lanes<T, Branch::both>(b, f, line, x, lanes<T>, acc_re, acc_im);
            }
        }
    }
}

// Rows go to workers in groups of eight, in turn: neighbouring rows cost about the same.
template <class T>
void band_forward(const Triangles& tri, const Band& band, T* out, const Share& share) {
    Block<T> b;
    Scratch scratch(Block<T>::bytes(band) + 2 * padded<T>(band.longest) * sizeof(T) + 4 * 64);
    if (!scratch.ok()) {
        *share.out_of_memory = true;
        return;
    }
    b.carve(scratch, band);
    T* acc_re = scratch.take<T>(b.width);
    T* acc_im = scratch.take<T>(b.width);
    for (size_t first = 0; first < tri.count; first += block) {
        fill(b, tri, band, first);
        for (size_t group = share.worker * 8; group < band.rows; group += share.workers * 8) {
            if (share.stop->load(std::memory_order_relaxed)) return;
            const size_t end = group + 8 < band.rows ? group + 8 : band.rows;
            for (size_t row = group; row < end; ++row) {
                const int n = band.length[row], width = padded<T>(n);
                for (int x = 0; x < width; ++x) acc_re[x] = acc_im[x] = 0;
                enter_row(b, band, row);
                row_forward(b, width, acc_re, acc_im);
                T* RESTRICT o = out + 2 * band.offset[row];
                for (int x = 0; x < n; ++x) {
                    o[2 * x] += acc_re[x];
                    o[2 * x + 1] += acc_im[x];
                }
            }
        }
    }
}

// ---------------------------------------------------------------------------------- backward

// Sums of one triangle along one row, lane by lane.
template <class T>
struct RowSums {
    Lanes<T> a, r1, r2, im, kr1, kr2, kim;  // the last three times kx
    RowSums() : a(T(0)), r1(T(0)), r2(T(0)), im(T(0)), kr1(T(0)), kr2(T(0)), kim(T(0)) {}
};

template <class T, Branch branch>
inline void sum_lanes(const Block<T>& b, int f, const Lines<T>& line, int first, int n, const T* g_re, const T* g_im,
                      RowSums<T>& acc) {
    using L = Lanes<T>;
    RowSums<T> s = acc;
    const T* xr = b.x_re + f * b.width;
    const T* xi = b.x_im + f * b.width;
    const L third = L(1.0 / 3.0);
    L k = L(static_cast<T>(first)) + L::ramp();
    for (int x = first; x < first + n; x += lanes<T>) {
        const L ur = L::load(xr + x), ui = L::load(xi + x), gr = L::load(g_re + x), gi = L::load(g_im + x);
        const L er = line.c_re * ur - line.c_im * ui, ei = line.c_re * ui + line.c_im * ur;
        const L tr = er * gr + ei * gi, ti = ei * gr - er * gi;  // E conj(G)
        L a, im, r1, r2;
        if constexpr (branch == Branch::small) {
            const SmallJet<L> j = small_jet(line.a0 + k * line.a1, line.b0 + k * line.b1);
            a = tr * j.s.re - ti * j.s.im;
            im = tr * j.s.im + ti * j.s.re;
            const L q = tr * j.sq.re - ti * j.sq.im, r = tr * j.sr.re - ti * j.sr.im;
            const L common = (im + j.inv.q * r) * third;
            r1 = common + j.inv.alpha * q + j.inv.beta * j.inv.gamma * r;
            r2 = common + j.inv.beta * q + j.inv.gamma * j.inv.alpha * r;
        } else {
            const L d1 = line.d[0] + k * line.s[0], d2 = line.d[1] + k * line.s[1], d3 = line.d[2] + k * line.s[2];
            const Gradient<L> g = branch == Branch::large ? large_full(d1, d2, d3) : triangle_full(d1, d2, d3);
            a = tr * g.value.re - ti * g.value.im;
            im = tr * g.value.im + ti * g.value.re;
            r1 = tr * g.g1.re - ti * g.g1.im;
            r2 = tr * g.g2.re - ti * g.g2.im;
        }
        s.a += a;
        s.r1 += r1;
        s.r2 += r2;
        s.im += im;
        s.kr1 += k * r1;
        s.kr2 += k * r2;
        s.kim += k * im;
        k += L(static_cast<T>(lanes<T>));
    }
    acc = s;
}

template <class T>
void row_backward(const Block<T>& b, int f, int width, const T* g_re, const T* g_im, RowSums<T>& acc) {
    const Lines<T> line(b, f);
    if (b.reach[f] < T(tau)) {
        sum_lanes<T, Branch::small>(b, f, line, 0, width, g_re, g_im, acc);
        return;
    }
    const Interval<T> in = small_interval(b, f, width);
    for (int x = 0; x < width; x += lanes<T>) {
        switch (branch_of(in, x)) {
            case Branch::small: sum_lanes<T, Branch::small>(b, f, line, x, lanes<T>, g_re, g_im, acc); break;
            case Branch::large: sum_lanes<T, Branch::large>(b, f, line, x, lanes<T>, g_re, g_im, acc); break;
            default: sum_lanes<T, Branch::both>(b, f, line, x, lanes<T>, g_re, g_im, acc);
        }
    }
}

// The ten sums of a triangle, lane by lane, over some rows.
template <class T>
struct LaneSums {
    Lanes<T> s[sums_per_triangle];

    void clear() {
        for (Lanes<T>& v : s) v = Lanes<T>(T(0));
    }
    void add(const RowSums<T>& r, T xi_z, T xi_y, T spacing_x) {
        const Lanes<T> z(xi_z), y(xi_y), x(spacing_x);
        s[0] += r.a;
        s[1] += z * r.r1, s[2] += y * r.r1, s[3] += x * r.kr1;
        s[4] += z * r.r2, s[5] += y * r.r2, s[6] += x * r.kr2;
        s[7] += z * r.im, s[8] += y * r.im, s[9] += x * r.kim;
    }
    void flush(double* sums) {
        for (size_t i = 0; i < sums_per_triangle; ++i) {
            T v[lanes<T>];
            s[i].store(v);
            for (int l = 0; l < lanes<T>; ++l) sums[i] += static_cast<double>(v[l]);
        }
        clear();
    }
};
constexpr size_t rows_between_flushes = 64;  // keeps what a float has to hold small

// Real and imaginary parts of a row, padded with zeros; returns the padded length.
template <class T>
int load_row(const T* RESTRICT g, int n, T* RESTRICT g_re, T* RESTRICT g_im) {
    const int width = padded<T>(n);
    for (int x = 0; x < n; ++x) {
        g_re[x] = g[2 * x];
        g_im[x] = g[2 * x + 1];
    }
    for (int x = n; x < width; ++x) g_re[x] = g_im[x] = 0;
    return width;
}

// Blocks of triangles are handed out one by one; each is summed over all rows by one worker.
template <class T>
void band_backward(const Triangles& tri, const Band& band, const T* grad, double* sums, const Share& share) {
    Block<T> b;
    Scratch scratch(Block<T>::bytes(band) + 2 * padded<T>(band.longest) * sizeof(T) + sizeof(LaneSums<T>[block]) +
                    8 * 64);
    if (!scratch.ok()) {
        *share.out_of_memory = true;
        return;
    }
    b.carve(scratch, band);
    T* g_re = scratch.take<T>(b.width);
    T* g_im = scratch.take<T>(b.width);
    LaneSums<T>* lane_sums = scratch.take<LaneSums<T>>(block);
    for (;;) {
        const size_t first = share.next->fetch_add(1) * block;
        if (first >= tri.count) return;
        double* s = sums + first * sums_per_triangle;
        fill(b, tri, band, first);
        for (int f = 0; f < b.count; ++f) lane_sums[f].clear();
        for (size_t i = 0; i < b.count * sums_per_triangle; ++i) s[i] = 0;
        for (size_t row = 0; row < band.rows; ++row) {
            const int width = load_row(grad + 2 * band.offset[row], band.length[row], g_re, g_im);
            enter_row(b, band, row);
            const T xi_z = static_cast<T>(band.kz[row] * band.spacing[0]);
            const T xi_y = static_cast<T>(band.ky[row] * band.spacing[1]);
            for (int f = 0; f < b.count; ++f) {
                RowSums<T> acc;
                row_backward(b, f, width, g_re, g_im, acc);
                lane_sums[f].add(acc, xi_z, xi_y, static_cast<T>(band.spacing[2]));
            }
            if ((row + 1) % rows_between_flushes == 0 || row + 1 == band.rows) {
                if (share.stop->load(std::memory_order_relaxed)) return;
                for (int f = 0; f < b.count; ++f) lane_sums[f].flush(s + f * sums_per_triangle);
            }
        }
    }
}

// ---------------------------------------------------------------------- any wavevectors

// Phases are taken in double whatever T is: nothing separates here, and this loop is the one that
// the others are checked against.
struct Phases {
    double c, d1, d2, d3;
};

inline Phases phases_of(const Triangles& tri, size_t f, const double* xi) {
    const double* c = tri.centroid + 3 * f;
    const double* e = tri.edges + 9 * f;
    return {xi[0] * c[0] + xi[1] * c[1] + xi[2] * c[2], xi[0] * e[0] + xi[1] * e[1] + xi[2] * e[2],
            xi[0] * e[3] + xi[1] * e[4] + xi[2] * e[5], xi[0] * e[6] + xi[1] * e[7] + xi[2] * e[8]};
}

template <class T>
void list_forward(const Triangles& tri, size_t count, const double* xi, T* out, const Share& share) {
    constexpr size_t chunk = 64;
    for (;;) {
        const size_t first = share.next->fetch_add(1) * chunk;
        if (first >= count) return;
        const size_t n = count - first < chunk ? count - first : chunk;
        double re[chunk] = {}, im[chunk] = {};
        for (size_t f = 0; f < tri.count; ++f) {
            if (f % 1024 == 0 && share.stop->load(std::memory_order_relaxed)) return;
            const double w = tri.weight[f];
            for (size_t k = 0; k < n; ++k) {
                const Phases p = phases_of(tri, f, xi + 3 * (first + k));
                const Value<T> v = triangle_value(static_cast<T>(p.d1), static_cast<T>(p.d2), static_cast<T>(p.d3));
                const Complex<double> e = cis(-p.c);
                re[k] += w * (e.re * v.re - e.im * v.im);
                im[k] += w * (e.re * v.im + e.im * v.re);
            }
        }
        for (size_t k = 0; k < n; ++k) {
            out[2 * (first + k)] = static_cast<T>(re[k]);
            out[2 * (first + k) + 1] = static_cast<T>(im[k]);
        }
    }
}

template <class T>
void list_backward(const Triangles& tri, size_t count, const double* xi, const T* grad, double* sums,
                   const Share& share) {
    for (;;) {
        const size_t f = share.next->fetch_add(1);
        if (f >= tri.count || share.stop->load(std::memory_order_relaxed)) return;
        double* s = sums + f * sums_per_triangle;
        for (size_t i = 0; i < sums_per_triangle; ++i) s[i] = 0;
        for (size_t k = 0; k < count; ++k) {
            const double* x = xi + 3 * k;
            const Phases p = phases_of(tri, f, x);
            const Gradient<T> g = triangle_full(static_cast<T>(p.d1), static_cast<T>(p.d2), static_cast<T>(p.d3));
            const Complex<double> e = cis(-p.c), conj_g = {grad[2 * k], -static_cast<double>(grad[2 * k + 1])};
            const Complex<double> t = e * conj_g;
            s[0] += t.re * g.value.re - t.im * g.value.im;
            const double r[3] = {t.re * g.g1.re - t.im * g.g1.im, t.re * g.g2.re - t.im * g.g2.im,
                                 t.re * g.value.im + t.im * g.value.re};
            for (int q = 0; q < 3; ++q)
                for (int axis = 0; axis < 3; ++axis) s[1 + 3 * q + axis] += r[q] * x[axis];
        }
    }
}

}  // namespace

extern const deltamic_api::Loops<float> loops_f32 = {band_forward<float>, band_backward<float>, list_forward<float>,
                                                     list_backward<float>};
extern const deltamic_api::Loops<double> loops_f64 = {band_forward<double>, band_backward<double>,
                                                      list_forward<double>, list_backward<double>};

}  // namespace DELTAMIC_NAMESPACE
