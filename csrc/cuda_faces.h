// What the GPU kernels keep of a triangle, made in double precision once per call.
#pragma once
#include "triangle_ft.h"

namespace DELTAMIC_NAMESPACE {

// Type of the inner loops, float or double: the source is compiled once for each.
using Real = DELTAMIC_REAL;

// Phases in turns, as fractions of 2^32 (float) or 2^64 (double). Unsigned arithmetic wraps, so the
// phase at (kz, ky, kx) is a sum of three products, exact modulo one turn however far from the
// origin a triangle lies.
template <class T>
struct Turns {
    using Unsigned = unsigned int;
    using Signed = int;
    static constexpr double radians = 1.4629180792671596e-09;  // 2 pi / 2^32
};
template <>
struct Turns<double> {
    using Unsigned = unsigned long long;
    using Signed = long long;
    static constexpr double radians = 3.4061215800865545e-19;  // 2 pi / 2^64
};
using Turn = Turns<Real>::Unsigned;

struct alignas(16) Face {
    Real alpha[3], beta[3];   // slopes of the centred phases per step of kz, ky, kx
    Turn turns[3];            // phase of the centroid per step
    Real weight;              // 2 * area * density going forward, 1 going backward
    Real step_re, step_im;    // exp(-i phase of the centroid per step of kx)
    Real edge[3][3];          // [edge][axis]: slopes of the edge phases
    Real reach;               // no edge phase in the band exceeds it
};

// The same for any wavevectors, whose phases are taken in double precision.
struct Triangle {
    double centroid[3], edge[3][3], weight;
};

static_assert(sizeof(Face) == (is_single<Real> ? 96 : 176) && sizeof(Triangle) == 104,
              "napari_deltamic/fourier/cuda/transform.py allocates them");

// ----------------------------------------------------------------------------------- geometry

struct Geometry {
    double centroid[3], edge[3][3], normal[3], doubled_area;
};

// Multiplications that the compiler must not fuse: a rounding error would be left where a cross
// product is exactly zero, and its direction would pass for the normal of a degenerate face.
__device__ inline void cross(const double* a, const double* b, double* c) {
    for (int i = 0; i < 3; ++i) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        c[i] = __dsub_rn(__dmul_rn(a[j], b[k]), __dmul_rn(a[k], b[j]));
    }
}

__device__ inline Geometry geometry_of(const double* vertices, const long long* faces, int f) {
    Geometry g;
    const double *p = vertices + 3 * faces[3 * f], *q = vertices + 3 * faces[3 * f + 1],
                 *r = vertices + 3 * faces[3 * f + 2];
    for (int i = 0; i < 3; ++i) {
        g.centroid[i] = (p[i] + q[i] + r[i]) / 3.0;
        g.edge[0][i] = r[i] - q[i];
        g.edge[1][i] = p[i] - r[i];
        g.edge[2][i] = q[i] - p[i];
    }
    double c[3];
    cross(g.edge[2], g.edge[0], c);
    const double most = fmax(fabs(c[0]), fmax(fabs(c[1]), fabs(c[2])));
    const double inv = most > 0 ? 1.0 / most : 0.0;  // squares of tiny numbers would vanish
    for (int i = 0; i < 3; ++i) c[i] *= inv;
    const double size = sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2]);
    g.doubled_area = most * size;
    for (int i = 0; i < 3; ++i) g.normal[i] = size > 0 ? c[i] / size : 0.0;
    return g;
}

// ------------------------------------------------------------------------------ phases in turns

// x in [-1/2, 1/2] as a fraction of 2^64.
__device__ inline unsigned long long fixed_point(double x) {
    const double a = fabs(x) * 4294967296.0, high = floor(a);
    const unsigned long long f = (static_cast<unsigned long long>(high) << 32) +
                                 static_cast<unsigned long long>((a - high) * 4294967296.0);
    return x < 0 ? 0ull - f : f;
}

__device__ inline unsigned long long rounded(unsigned long long turns, unsigned long long) { return turns; }
__device__ inline unsigned int rounded(unsigned long long turns, unsigned int) {
    return static_cast<unsigned int>((turns + (1ull << 31)) >> 32);
}

// spacing * c / (2 pi) modulo 1 as a fraction of 2^64: products with their rounding errors.
__device__ inline unsigned long long turns_per_step(double spacing, double c) {
    constexpr double inv = 0.15915494309189535, inv_rest = -9.839338337591243e-18;  // 1 / (2 pi)
    const double phase = __dmul_rn(spacing, c), phase_rest = fma(spacing, c, -phase);
    const double t = __dmul_rn(phase, inv);
    const double rest = fma(phase, inv, -t) + (phase * inv_rest + phase_rest * inv);
    return fixed_point(t - rint(t)) + fixed_point(rest - rint(rest));
}

__device__ inline Face face_of(const Geometry& g, double weight, const double* spacing, const int* kmax) {
    Face out;
    double reach = 0;
    for (int p = 0; p < 3; ++p) {
        double most = 0;
        for (int i = 0; i < 3; ++i) {
            const double slope = g.edge[p][i] * spacing[i];
            out.edge[p][i] = static_cast<Real>(slope);
            most += fabs(slope) * kmax[i];
        }
        reach = fmax(reach, most);
    }
    for (int i = 0; i < 3; ++i) {
        out.alpha[i] = static_cast<Real>((g.edge[1][i] - g.edge[2][i]) * spacing[i] / 3.0);
        out.beta[i] = static_cast<Real>((g.edge[2][i] - g.edge[0][i]) * spacing[i] / 3.0);
        const unsigned long long turns = turns_per_step(spacing[i], g.centroid[i]);
        out.turns[i] = rounded(turns, Turn());
        if (i == 2) {
            const double phase = -static_cast<double>(static_cast<long long>(turns)) * Turns<double>::radians;
            const Complex<double> step = cis(phase);
            out.step_re = static_cast<Real>(step.re);
            out.step_im = static_cast<Real>(step.im);
        }
    }
    out.weight = static_cast<Real>(weight);
    out.reach = static_cast<Real>(reach);
    return out;
}

// ----------------------------------------------------------------------------------- gradients

// Sums over the wavevectors of Re(t S), and of (by_alpha, by_beta, Im(t S)) times (kz, ky, kx).
constexpr int sums_per_face = 10;

// Gradients of the corners of each face and of its density, from sums (parts, 10, faces):
// grad_{v_p} u = density * ( -F w_p + 2A dF/dphase_p xi ),  w_p = e_p x N.
template <class Part>
__device__ inline void face_gradient_of(const double* vertices, const long long* faces, const double* density,
                                        int count, const Part* parts, int part_count, const double* spacing, int f,
                                        double* corners, double* grad_density) {
    double s[sums_per_face] = {};
    for (int p = 0; p < part_count; ++p) {
        const long long first = static_cast<long long>(p) * sums_per_face;
#pragma unroll
        for (int i = 0; i < sums_per_face; ++i) s[i] += static_cast<double>(parts[(first + i) * count + f]);
    }
    const Geometry g = geometry_of(vertices, faces, f);
    grad_density[f] = g.doubled_area * s[0];
#pragma unroll
    for (int p = 0; p < 3; ++p) {
        double w[3];
        cross(g.edge[p], g.normal, w);
#pragma unroll
        for (int i = 0; i < 3; ++i) {
            const double a = s[1 + i], b = s[4 + i], im = s[7 + i];
            const double along = p == 0 ? 2 * a - b : p == 1 ? 2 * b - a : -a - b;
            const double h = (im + along) / 3.0 * spacing[i];
            corners[9LL * f + 3 * p + i] = density[f] * (g.doubled_area * h - s[0] * w[i]);
        }
    }
}

}  // namespace DELTAMIC_NAMESPACE
