// Spreading and gathering on GPUs: what particle_mesh.cpp does, a thread for each point (when
// spreading, for each point and plane of its nodes). Compiled at run time by NVRTC, once with DELTAMIC_REAL=float and once with double; launched by
// napari_deltamic/fourier/cuda/point_transform.py.
//
// Polynomials are evaluated anew at every node: that costs less than keeping their values would.
// Spreading adds with atomics, so that the last bits depend on which thread comes first.
#include "measure.h"

namespace deltamic {

using Real = DELTAMIC_REAL;
using deltamic_api::Measure;
using deltamic_api::measure;
constexpr int threads = DELTAMIC_THREADS;  // in a block

// Z, Y, X. Coefficients of an axis are (degree + 1, width) from `first` on, highest power first.
struct Grid {
    int shape[3], width[3], degree[3], first[3];
    double scale[3];  // nodes per um
};

struct Point {
    Real f[3];          // how far the first node lies behind the kernel's lower edge
    Real strength[3];   // the first alone; of a dipole, by axis and per node
    int at[3];          // the first node, within the grid
};

// Rules of all points: where they lie on their elements, and weights.
struct Rules {
    const double *barycentric, *weights;  // (places, corners), (places)
    int corners;
};

static_assert(sizeof(Grid) == 72 && sizeof(Point) == (sizeof(Real) == 4 ? 36 : 64) && sizeof(Rules) == 24,
              "napari_deltamic/fourier/cuda/point_transform.py has the same");

__device__ inline int index() { return static_cast<int>(blockIdx.x * threads + threadIdx.x); }

__device__ inline Measure measure_of(const double* vertices, const long long* elements, int corners, long long e) {
    const double* p[3];
#pragma unroll
    for (int i = 0; i < 3; ++i) p[i] = vertices + 3 * elements[e * corners + (i < corners ? i : 0)];
    return measure(corners, p);
}

// Of the l-th node; t = 2 f - 1.
__device__ inline Real value_at(const Grid& g, const Real* coefficients, int axis, int l, Real t) {
    const Real* c = coefficients + g.first[axis] + l;
    Real v = *c;
    for (int d = g.degree[axis]; d > 0; --d) {
        c += g.width[axis];
        v = v * t + *c;
    }
    return v;
}

// With its slope per node: t falls by 2 where a point moves on by one.
__device__ inline Real value_and_slope_at(const Grid& g, const Real* coefficients, int axis, int l, Real t, Real& slope) {
    const Real* c = coefficients + g.first[axis] + l;
    Real v = *c, s = 0;
    for (int d = g.degree[axis]; d > 0; --d) {
        c += g.width[axis];
        s = s * t + v;
        v = v * t + *c;
    }
    slope = -2 * s;
    return v;
}

// The l-th node that a point meets along an axis.
__device__ inline int node(const Grid& g, const Point& p, int axis, int l) {
    const int n = p.at[axis] + l;
    return n < g.shape[axis] ? n : n - g.shape[axis];
}

#define KERNEL extern "C" __global__ void __launch_bounds__(threads)

// Points, each with its element and its place among the rules. With vectors (elements, 3), dipoles.
KERNEL locate(const double* vertices, const long long* elements, const double* density, const double* vectors,
              const int* element, const int* place, Rules rules, int count, Grid g, Point* out) {
    const int i = index();
    if (i >= count) return;
    const long long e = element[i];
    const int corners = rules.corners;
    const double* share = rules.barycentric + static_cast<long long>(place[i]) * corners;
    Point p;
    bool somewhere = true;
#pragma unroll
    for (int axis = 0; axis < 3; ++axis) {
        double x = 0;
#pragma unroll
        for (int c = 0; c < 3; ++c)
            if (c < corners) x += share[c] * (vertices[3 * elements[e * corners + c] + axis] * g.scale[axis]);
        const double edge = x - 0.5 * g.width[axis], first = ceil(edge), n = g.shape[axis];
        somewhere = somewhere && fabs(first) < 1e15;
        p.f[axis] = static_cast<Real>(first - edge);
        p.at[axis] = somewhere ? static_cast<int>(first - n * floor(first / n)) : 0;
    }
    double strength = density[e] * rules.weights[place[i]];
    if (!somewhere) strength *= __longlong_as_double(0x7ff8000000000000ll);  // a point that lies nowhere finite makes the result NaN
    if (vectors) {
        // By the place of the point; the kernel is seen from the grid.
#pragma unroll
        for (int axis = 0; axis < 3; ++axis)
            p.strength[axis] = static_cast<Real>(-strength * vectors[3 * e + axis] * g.scale[axis]);
    } else {
        p.strength[0] = static_cast<Real>(strength * measure_of(vertices, elements, corners, e).value);
        p.strength[1] = p.strength[2] = 0;
    }
    out[i] = p;
}

// Grid (points / threads, nodes of the kernel along Z).
KERNEL spread(const Point* points, int count, Grid g, const Real* coefficients, Real* out) {
    const int i = index(), a = blockIdx.y;
    if (i >= count) return;
    const Point p = points[i];
    const Real ty = 2 * p.f[1] - 1, tx = 2 * p.f[2] - 1;
    const Real z = p.strength[0] * value_at(g, coefficients, 0, a, 2 * p.f[0] - 1);
    const long long plane = static_cast<long long>(node(g, p, 0, a)) * g.shape[1];
    for (int b = 0; b < g.width[1]; ++b) {
        const Real zy = z * value_at(g, coefficients, 1, b, ty);
        Real* row = out + (plane + node(g, p, 1, b)) * g.shape[2];
        for (int c = 0; c < g.width[2]; ++c)
            atomicAdd(row + node(g, p, 2, c), zy * value_at(g, coefficients, 2, c, tx));
    }
}

// The same for dipoles.
KERNEL spread_dipoles(const Point* points, int count, Grid g, const Real* coefficients, Real* out) {
    const int i = index(), a = blockIdx.y;
    if (i >= count) return;
    const Point p = points[i];
    const Real ty = 2 * p.f[1] - 1, tx = 2 * p.f[2] - 1;
    Real sz, sy, sx;
    const Real z = value_and_slope_at(g, coefficients, 0, a, 2 * p.f[0] - 1, sz);
    const long long plane = static_cast<long long>(node(g, p, 0, a)) * g.shape[1];
    for (int b = 0; b < g.width[1]; ++b) {
        const Real y = value_and_slope_at(g, coefficients, 1, b, ty, sy);
        const Real across = p.strength[0] * sz * y + p.strength[1] * z * sy, along = p.strength[2] * z * y;
        Real* row = out + (plane + node(g, p, 1, b)) * g.shape[2];
        for (int c = 0; c < g.width[2]; ++c) {
            const Real x = value_and_slope_at(g, coefficients, 2, c, tx, sx);
            atomicAdd(row + node(g, p, 2, c), across * x + along * sx);
        }
    }
}

// The field at each point, (points).
KERNEL gather(const Point* points, int count, Grid g, const Real* coefficients, const Real* field, Real* out) {
    const int i = index();
    if (i >= count) return;
    const Point p = points[i];
    const Real tz = 2 * p.f[0] - 1, ty = 2 * p.f[1] - 1, tx = 2 * p.f[2] - 1;
    Real all = 0;
    for (int a = 0; a < g.width[0]; ++a) {
        const long long plane = static_cast<long long>(node(g, p, 0, a)) * g.shape[1];
        Real sum = 0;
        for (int b = 0; b < g.width[1]; ++b) {
            const Real* row = field + (plane + node(g, p, 1, b)) * g.shape[2];
            Real line = 0;
            for (int c = 0; c < g.width[2]; ++c) line += row[node(g, p, 2, c)] * value_at(g, coefficients, 2, c, tx);
            sum += line * value_at(g, coefficients, 1, b, ty);
        }
        all += sum * value_at(g, coefficients, 0, a, tz);
    }
    out[i] = all;
}

// The field and its derivatives per node, (points, 4).
KERNEL gather_slopes(const Point* points, int count, Grid g, const Real* coefficients, const Real* field, Real* out) {
    const int i = index();
    if (i >= count) return;
    const Point p = points[i];
    const Real tz = 2 * p.f[0] - 1, ty = 2 * p.f[1] - 1, tx = 2 * p.f[2] - 1;
    Real all = 0, along_z = 0, along_y = 0, along_x = 0, sz, sy, sx;
    for (int a = 0; a < g.width[0]; ++a) {
        const long long plane = static_cast<long long>(node(g, p, 0, a)) * g.shape[1];
        Real sum = 0, sum_y = 0, sum_x = 0;
        for (int b = 0; b < g.width[1]; ++b) {
            const Real* row = field + (plane + node(g, p, 1, b)) * g.shape[2];
            Real line = 0, tilted = 0;
            for (int c = 0; c < g.width[2]; ++c) {
                const Real x = value_and_slope_at(g, coefficients, 2, c, tx, sx), v = row[node(g, p, 2, c)];
                line += v * x;
                tilted += v * sx;
            }
            const Real y = value_and_slope_at(g, coefficients, 1, b, ty, sy);
            sum += line * y;
            sum_y += line * sy;
            sum_x += tilted * y;
        }
        const Real z = value_and_slope_at(g, coefficients, 0, a, tz, sz);
        all += sum * z;
        along_z += sum * sz;
        along_y += sum_y * z;
        along_x += sum_x * z;
    }
    Real* found = out + 4LL * i;
    found[0] = all;
    found[1] = along_z;
    found[2] = along_y;
    found[3] = along_x;
}

// Sum over an element's points of weight times barycentric coordinate times what was gathered, of
// one corner; slopes per um.
template <int parts>
__device__ inline void corner_sum(const Real* values, const int* start, const int* place, const Rules& rules,
                                  const Grid& g, int e, int corner, double* sum) {
#pragma unroll
    for (int k = 0; k < parts; ++k) sum[k] = 0;
    for (int i = start[e]; i < start[e + 1]; ++i) {
        const long long q = place[i];
        const double share = rules.weights[q] * rules.barycentric[q * rules.corners + corner];
#pragma unroll
        for (int k = 0; k < parts; ++k) sum[k] += share * static_cast<double>(values[static_cast<long long>(parts) * i + k]);
    }
#pragma unroll
    for (int k = 1; k < parts; ++k) sum[k] *= g.scale[k - 1];
}

// (elements, corners, 1); start (elements + 1) says where the points of each begin. Grid (elements /
// threads, corners).
KERNEL sum_values(const Real* values, const int* start, const int* place, Rules rules, int count, Grid g, double* out) {
    const int e = index(), corner = blockIdx.y;
    if (e < count) corner_sum<1>(values, start, place, rules, g, e, corner, out + static_cast<long long>(e) * rules.corners + corner);
}

// (elements, corners, 4)
KERNEL sum_slopes(const Real* values, const int* start, const int* place, Rules rules, int count, Grid g, double* out) {
    const int e = index(), corner = blockIdx.y;
    if (e >= count) return;
    double sum[4];
    corner_sum<4>(values, start, place, rules, g, e, corner, sum);
    double* found = out + 4 * (static_cast<long long>(e) * rules.corners + corner);
#pragma unroll
    for (int k = 0; k < 4; ++k) found[k] = sum[k];
}

// From sums (elements, corners, 4) to gradients: by corner, and by the density of each element.
KERNEL pull(const double* vertices, const long long* elements, const double* density, int corners, int count,
            const double* sums, double* by_corner, double* by_density) {
    const int e = index();
    if (e >= count) return;
    const Measure m = measure_of(vertices, elements, corners, e);
    const double* s = sums + 4LL * e * corners;
    double all = 0;
    for (int i = 0; i < corners; ++i) all += s[4 * i];
    by_density[e] = m.value * all;
#pragma unroll
    for (int i = 0; i < 3; ++i)
        if (i < corners)
#pragma unroll
            for (int k = 0; k < 3; ++k)
                by_corner[3 * (static_cast<long long>(e) * corners + i) + k] =
                    density[e] * (m.value * s[4 * i + 1 + k] + all * m.gradient[i][k]);
}

}  // namespace deltamic
