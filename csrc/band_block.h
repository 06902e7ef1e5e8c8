// A block of triangles on a band: tables of exponentials, edge phases row by row, and where on a row
// each branch of the formula holds. Included by mesh_ft_cpu.cpp alone, once per instruction set.
#pragma once
#include <cmath>
#include <cstdlib>

#include "mesh_ft.h"
#include "triangle_ft.h"
#include "lanes.h"

#if defined(_MSC_VER)
#define RESTRICT __restrict
#else
#define RESTRICT __restrict__
#endif

namespace DELTAMIC_NAMESPACE {
namespace {

using deltamic_api::Band;
using deltamic_api::Triangles;
using std::size_t;

constexpr int block = 32;  // triangles handled together: their tables stay in the nearest cache

template <class T>
int padded(int n) {
    return (n + lanes<T> - 1) / lanes<T> * lanes<T>;
}

// One allocation, carved into aligned arrays.
class Scratch {
public:
    explicit Scratch(size_t bytes) : base_(static_cast<char*>(std::malloc(bytes + 64))), used_(0) {
        used_ = (64 - reinterpret_cast<std::uintptr_t>(base_) % 64) % 64;
    }
    ~Scratch() { std::free(base_); }
    Scratch(const Scratch&) = delete;
    Scratch& operator=(const Scratch&) = delete;
    bool ok() const { return base_ != nullptr; }
    template <class U>
    U* take(size_t n) {
        U* p = reinterpret_cast<U*>(base_ + used_);
        used_ += (n * sizeof(U) + 63) / 64 * 64;
        return p;
    }

private:
    char* base_;
    size_t used_;
};

// e^{-i k step}, k = first ... first+n-1: by rotation, started afresh every 16 steps so that rounding
// does not add up.
template <class T>
void exponentials(double step, int first, int n, T* RESTRICT re, T* RESTRICT im) {
    const double cs = std::cos(step), sn = -std::sin(step);
    for (int start = 0; start < n; start += 16) {
        const double phase = -(first + start) * step;
        double c = std::cos(phase), s = std::sin(phase);
        const int stop = start + 16 < n ? start + 16 : n;
        for (int k = start; k < stop; ++k) {
            re[k] = static_cast<T>(c);
            im[k] = static_cast<T>(s);
            const double t = c * cs - s * sn;
            s = c * sn + s * cs;
            c = t;
        }
    }
}

// Tables and slopes of a block of triangles, and what changes from row to row.
template <class T>
struct Block {
    int count, width;               // triangles in the block; padded length of a row
    T *x_re, *x_im;                 // (block, width)
    T *y_re, *y_im, *z_re, *z_im;   // (2*kmax+1, block)
    T slope[3][3][block];           // [edge][axis][triangle]: edge phase per step of k
    T weight[block];
    T c_re[block], c_im[block];     // weight * Z[kz] * Y[ky]
    T d[3][block];                  // edge phases at kx = 0
    T reach[block];                 // bound of the largest edge phase on the row

    static size_t bytes(const Band& b) {
        const size_t w = padded<T>(b.longest);
        const size_t tall = 2 * (b.kmax_y + 1 + b.kmax_z + 1) + 4;
        return (2 * block * w + 4 * tall * block) * sizeof(T) + 16 * 64;
    }
    void carve(Scratch& s, const Band& b) {
        width = padded<T>(b.longest);
        x_re = s.take<T>(block * width);
        x_im = s.take<T>(block * width);
        y_re = s.take<T>((2 * b.kmax_y + 1) * block);
        y_im = s.take<T>((2 * b.kmax_y + 1) * block);
        z_re = s.take<T>((2 * b.kmax_z + 1) * block);
        z_im = s.take<T>((2 * b.kmax_z + 1) * block);
    }
};

template <class T>
void column_table(double step, int kmax, int f, T* RESTRICT re, T* RESTRICT im) {
    T r[64], i[64];
    for (int start = -kmax; start <= kmax; start += 64) {
        const int n = kmax + 1 - start < 64 ? kmax + 1 - start : 64;
        exponentials(step, start, n, r, i);
        for (int k = 0; k < n; ++k) {
            re[(start + kmax + k) * block + f] = r[k];
            im[(start + kmax + k) * block + f] = i[k];
        }
    }
}

template <class T>
void fill(Block<T>& b, const Triangles& tri, const Band& band, size_t first) {
    const size_t left = tri.count - first;
    b.count = static_cast<int>(left < block ? left : block);
    for (int f = 0; f < b.count; ++f) {
        const double* c = tri.centroid + 3 * (first + f);
        exponentials(band.spacing[2] * c[2], 0, b.width, b.x_re + f * b.width, b.x_im + f * b.width);
        column_table(band.spacing[1] * c[1], band.kmax_y, f, b.y_re, b.y_im);
        column_table(band.spacing[0] * c[0], band.kmax_z, f, b.z_re, b.z_im);
        for (int p = 0; p < 3; ++p)
            for (int axis = 0; axis < 3; ++axis)
                b.slope[p][axis][f] = static_cast<T>(tri.edges[9 * (first + f) + 3 * p + axis] * band.spacing[axis]);
        b.weight[f] = static_cast<T>(tri.weight[first + f]);
    }
    for (int f = b.count; f < block; ++f) {  // idle lanes of the last block
        for (int p = 0; p < 3; ++p)
            for (int axis = 0; axis < 3; ++axis) b.slope[p][axis][f] = 0;
        b.weight[f] = 0;
    }
}

template <class T>
void enter_row(Block<T>& b, const Band& band, size_t row) {
    const T kz = static_cast<T>(band.kz[row]), ky = static_cast<T>(band.ky[row]);
    const T last = static_cast<T>(band.length[row] - 1);
    const T* RESTRICT yr = b.y_re + (band.ky[row] + band.kmax_y) * block;
    const T* RESTRICT yi = b.y_im + (band.ky[row] + band.kmax_y) * block;
    const T* RESTRICT zr = b.z_re + (band.kz[row] + band.kmax_z) * block;
    const T* RESTRICT zi = b.z_im + (band.kz[row] + band.kmax_z) * block;
    for (int f = 0; f < block; ++f) {
        b.c_re[f] = b.weight[f] * (zr[f] * yr[f] - zi[f] * yi[f]);
        b.c_im[f] = b.weight[f] * (zr[f] * yi[f] + zi[f] * yr[f]);
        T reach = 0;
        for (int p = 0; p < 3; ++p) {
            const T d = kz * b.slope[p][0][f] + ky * b.slope[p][1][f];
            const T end = d + last * b.slope[p][2][f];
            const T lo = d < 0 ? -d : d, hi = end < 0 ? -end : end;  // |d| is convex along the row
            b.d[p][f] = d;
            reach = reach < lo ? lo : reach;
            reach = reach < hi ? hi : reach;
        }
        b.reach[f] = reach;
    }
}

// Where on a row every edge phase is below tau: the largest |phase| is convex in kx, so it is an
// interval. Chunks inside take the small branch, chunks outside the large one, the others both.
template <class T>
struct Interval {
    T lo, hi;
};

template <class T>
Interval<T> small_interval(const Block<T>& b, int f, int width) {
    const T t = T(tau);
    Interval<T> r = {0, static_cast<T>(width)};
    for (int p = 0; p < 3; ++p) {
        const T d = b.d[p][f], s = b.slope[p][2][f];
        if (s == 0) {
            if (!(d < t && d > -t)) return {T(1), T(0)};
            continue;
        }
        const T p1 = (-t - d) / s, p2 = (t - d) / s;
        const T u = p1 < p2 ? p1 : p2, v = p1 < p2 ? p2 : p1;
        // One step of slack: a lane at the edge is then judged exactly, in the branch for both.
        r.lo = r.lo < u + 1 ? u + 1 : r.lo;
        r.hi = r.hi > v - 1 ? v - 1 : r.hi;
    }
    return r;
}

enum class Branch { small, large, both };

template <class T>
Branch branch_of(const Interval<T>& in, int first) {
    const T lo = static_cast<T>(first), hi = static_cast<T>(first + lanes<T> - 1);
    if (lo >= in.lo && hi <= in.hi) return Branch::small;
    if (hi < in.lo - 2 || lo > in.hi + 2) return Branch::large;
    return Branch::both;
}

}  // namespace
}  // namespace DELTAMIC_NAMESPACE
