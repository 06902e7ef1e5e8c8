// The loops for GPUs. Compiled at run time by NVRTC, once with DELTAMIC_REAL=float and once with
// double (napari_deltamic/fourier/cuda); launch shapes come from there.
//
// A band is cut into segments: up to `width` neighbouring wavevectors of one row. Forward, a thread
// owns a segment and takes the faces one by one, the same for all threads of a block; backward, a
// thread owns a face and takes the segments. Either way sums stay in registers, in a fixed order.
// Along a segment the phases are linear and the exponential of the centroid is a power, so that the
// loop over small triangles holds nothing but multiplications and additions.
#include "cuda_faces.h"

namespace DELTAMIC_NAMESPACE {

constexpr bool single = is_single<Real>;
constexpr int width = DELTAMIC_WIDTH;      // wavevectors in a segment
constexpr int threads = DELTAMIC_THREADS;  // in a block
constexpr int tile = DELTAMIC_TILE;        // faces or segments that a block holds in shared memory
static_assert(tile <= threads, "one thread loads one entry of a tile");
// Segments of a row over which an exponential is continued before it is taken afresh.
constexpr int continued = 16 / width;
constexpr unsigned int everyone = 0xffffffffu;

struct alignas(8) Segment {
    int kz, ky, kx, length;
    long long offset;  // of its first wavevector
};

// Sixteen bytes: one load.
struct alignas(16) Quad {
    Real v[16 / sizeof(Real)];
};
constexpr int per_quad = 16 / (2 * sizeof(Real));  // complex numbers

// Of this thread among those of the first axis of the grid.
__device__ inline long long long_index() { return static_cast<long long>(blockIdx.x) * threads + threadIdx.x; }
__device__ inline int index() { return static_cast<int>(long_index()); }
// In (parts, 10, faces), of this block's part.
__device__ inline long long sum_place(int k, int count, int face) {
    return (static_cast<long long>(blockIdx.y) * sums_per_face + k) * count + face;
}

__device__ inline Complex<Real> exponential(const Face& f, const Segment& s) {
    using Signed = Turns<Real>::Signed;
    const Turn t = Turn(Signed(s.kz)) * f.turns[0] + Turn(Signed(s.ky)) * f.turns[1] + Turn(Signed(s.kx)) * f.turns[2];
    return cis(Real(Signed(t)) * Real(-Turns<Real>::radians));
}

__device__ inline Real at_start(const Real* slope, const Segment& s) {
    return Real(s.kz) * slope[0] + Real(s.ky) * slope[1] + Real(s.kx) * slope[2];
}

// k steps on. The compiler may not leave out a product with zero by itself.
__device__ inline Real along(Real first, Real slope, int k) { return k == 0 ? first : first + Real(k) * slope; }

// The largest edge phase: edge phases are the differences of the centred ones.
__device__ inline Real spread(Real alpha, Real beta) {
    const Real gamma = -(alpha + beta);
    const Real high = larger(larger(alpha, beta), gamma), low = -larger(larger(-alpha, -beta), -gamma);
    return high - low;
}

// Whether every lane has a small triangle all along its segment: the largest edge phase is convex.
__device__ inline bool all_small(const Face& f, Real alpha, Real beta) {
    bool small = f.reach < Real(tau);
    if (!small) {
        const Real k = Real(width - 1);
        small = larger(spread(alpha, beta), spread(alpha + k * f.alpha[2], beta + k * f.beta[2])) < Real(tau);
    }
    return __all_sync(everyone, small);
}

__device__ inline void rotate(Complex<Real>& e, const Face& f) { e = e * Complex<Real>{f.step_re, f.step_im}; }

// ------------------------------------------------------------------------------------- forward

__device__ inline void add(Complex<Real>& sum, Complex<Real> e, Value<Real> v) {
    // One product at a time, so that each is fused with its addition.
    sum.re += e.re * v.re;
    sum.re -= e.im * v.im;
    sum.im += e.re * v.im;
    sum.im += e.im * v.re;
}

__device__ inline void add_face(const Face& f, const Segment& s, Complex<Real>* sum) {
    const Real a = at_start(f.alpha, s), b = at_start(f.beta, s);
    Complex<Real> e = exponential(f, s);
    e = {f.weight * e.re, f.weight * e.im};
    if (all_small(f, a, b)) {
#pragma unroll
        for (int k = 0; k < width; ++k, rotate(e, f)) {
            add(sum[k], e, small_value(along(a, f.alpha[2], k), along(b, f.beta[2], k)));
        }
        return;
    }
    const Real d1 = at_start(f.edge[0], s), d2 = at_start(f.edge[1], s), d3 = at_start(f.edge[2], s);
#pragma unroll
    for (int k = 0; k < width; ++k, rotate(e, f)) {
        const Real x1 = d1 + Real(k) * f.edge[0][2], x2 = d2 + Real(k) * f.edge[1][2], x3 = d3 + Real(k) * f.edge[2][2];
        if (largest(x1, x2, x3) < Real(tau)) {
            add(sum[k], e, small_value(along(a, f.alpha[2], k), along(b, f.beta[2], k)));
        } else {
            add(sum[k], e, large_value(x1, x2, x3));
        }
    }
}

// ------------------------------------------------------------------------------------ backward

struct SegmentSums {
    Real v[4] = {}, k[3] = {};  // re, by_alpha, by_beta, im; the last three times the place

    __device__ void add(const Contracted<Real>& c, int place) {
        const Real each[3] = {c.by_alpha, c.by_beta, c.im};
        // Places are known to the compiler: sums begin with what comes first, not with zero.
        v[0] = place == 0 ? c.re : v[0] + c.re;
#pragma unroll
        for (int i = 0; i < 3; ++i) {
            v[1 + i] = place == 0 ? each[i] : v[1 + i] + each[i];
            if (place > 0) k[i] = place == 1 ? each[i] : k[i] + Real(place) * each[i];
        }
    }
    __device__ void into(Real* sums, const Segment& s) const {
        sums[0] += v[0];
#pragma unroll
        for (int i = 0; i < 3; ++i) {
            sums[1 + 3 * i] += Real(s.kz) * v[1 + i];
            sums[2 + 3 * i] += Real(s.ky) * v[1 + i];
            sums[3 + 3 * i] += Real(s.kx) * v[1 + i] + k[i];
        }
    }
};

__device__ inline Complex<Real> conjugate_times(const Quad* grad, int k, Complex<Real> e) {
    const Quad& g = grad[k / per_quad];
    const Real re = g.v[2 * (k % per_quad)], im = g.v[2 * (k % per_quad) + 1];
    return {e.re * re + e.im * im, e.im * re - e.re * im};
}

// edges: slopes of the edge phases, which few segments ask for.
__device__ inline void add_segment(const Face& f, const Real (*edges)[3], const Segment& s, const Quad* grad,
                                   Complex<Real>& e, Real* sums) {
    const Real a = at_start(f.alpha, s), b = at_start(f.beta, s);
    SegmentSums sum;
    if (all_small(f, a, b)) {
#pragma unroll
        for (int k = 0; k < width; ++k, rotate(e, f)) {
            const Complex<Real> t = conjugate_times(grad, k, e);
            sum.add(small_contracted(along(a, f.alpha[2], k), along(b, f.beta[2], k), t), k);
        }
    } else {
        const Real d1 = at_start(edges[0], s), d2 = at_start(edges[1], s), d3 = at_start(edges[2], s);
#pragma unroll
        for (int k = 0; k < width; ++k, rotate(e, f)) {
            const Complex<Real> t = conjugate_times(grad, k, e);
            const Real x1 = d1 + Real(k) * edges[0][2], x2 = d2 + Real(k) * edges[1][2],
                       x3 = d3 + Real(k) * edges[2][2];
            if (largest(x1, x2, x3) < Real(tau)) {
                sum.add(small_contracted(along(a, f.alpha[2], k), along(b, f.beta[2], k), t), k);
            } else {
                sum.add(large_contracted(x1, x2, x3, t), k);
            }
        }
    }
    sum.into(sums, s);
}

// -------------------------------------------------------------------------- any wavevectors

struct Phases {
    Complex<Real> e;  // exp(-i phase of the centroid)
    Real d1, d2, d3;
};

__device__ inline double dot(const double* a, double z, double y, double x) { return a[0] * z + a[1] * y + a[2] * x; }

__device__ inline Phases phases_of(const Triangle& t, double z, double y, double x) {
    const double c = dot(t.centroid, z, y, x), turns = c * 0.15915494309189535;
    // Reduced before it is rounded to single precision.
    const double phase = single ? (turns - rint(turns)) * 6.283185307179586 : c;
    return {cis(static_cast<Real>(-phase)), static_cast<Real>(dot(t.edge[0], z, y, x)),
            static_cast<Real>(dot(t.edge[1], z, y, x)), static_cast<Real>(dot(t.edge[2], z, y, x))};
}

__device__ inline Contracted<Real> contracted(const Phases& p, Complex<Real> t) {
    const Real third = Real(1.0 / 3.0);
    if (largest(p.d1, p.d2, p.d3) < Real(tau)) return small_contracted((p.d2 - p.d3) * third, (p.d3 - p.d1) * third, t);
    return large_contracted(p.d1, p.d2, p.d3, t);
}

__device__ inline Value<Real> value(const Phases& p) {
    const Real third = Real(1.0 / 3.0);
    if (largest(p.d1, p.d2, p.d3) < Real(tau)) return small_value((p.d2 - p.d3) * third, (p.d3 - p.d1) * third);
    return large_value(p.d1, p.d2, p.d3);
}

}  // namespace DELTAMIC_NAMESPACE
using namespace DELTAMIC_NAMESPACE;

// Registers for as many blocks at a time: enough for the loops to keep everything in registers, and
// enough threads, each with `width` chains of its own, to keep the arithmetic units busy.
#define KERNEL extern "C" __global__ void __launch_bounds__(threads, DELTAMIC_RESIDENT)

// ------------------------------------------------------------------------------ before and after

KERNEL prepare_band(const double* vertices, const long long* faces, const double* density, int count, double spacing_z,
                    double spacing_y, double spacing_x, int kmax_z, int kmax_y, int kmax_x, int backward, Face* out) {
    const int f = index();
    if (f >= count) return;
    const double spacing[3] = {spacing_z, spacing_y, spacing_x};
    const int kmax[3] = {kmax_z, kmax_y, kmax_x};
    const Geometry g = geometry_of(vertices, faces, f);
    out[f] = face_of(g, backward ? 1.0 : g.doubled_area * density[f], spacing, kmax);
}

KERNEL prepare_list(const double* vertices, const long long* faces, const double* density, int count, int backward,
                    Triangle* out) {
    const int f = index();
    if (f >= count) return;
    const Geometry g = geometry_of(vertices, faces, f);
    for (int i = 0; i < 3; ++i) {
        out[f].centroid[i] = g.centroid[i];
        for (int p = 0; p < 3; ++p) out[f].edge[p][i] = g.edge[p][i];
    }
    out[f].weight = backward ? 1.0 : g.doubled_area * density[f];
}

// Parts of sums, one after the other, are added in double precision.
KERNEL add_parts(const Real* parts, int count, long long size, Real* out) {
    const long long i = long_index();
    if (i >= size) return;
    double sum = 0;
    for (int p = 0; p < count; ++p) sum += static_cast<double>(parts[p * size + i]);
    out[i] = static_cast<Real>(sum);
}

KERNEL face_gradient(const double* vertices, const long long* faces, const double* density, int count,
                     const Real* parts, int part_count, double spacing_z, double spacing_y, double spacing_x,
                     double* corners, double* grad_density) {
    const int f = index();
    if (f >= count) return;
    const double spacing[3] = {spacing_z, spacing_y, spacing_x};
    face_gradient_of(vertices, faces, density, count, parts, part_count, spacing, f, corners, grad_density);
}

KERNEL list_face_gradient(const double* vertices, const long long* faces, const double* density, int count,
                          const double* parts, int part_count, double* corners, double* grad_density) {
    const int f = index();
    if (f >= count) return;
    const double ones[3] = {1, 1, 1};
    face_gradient_of(vertices, faces, density, count, parts, part_count, ones, f, corners, grad_density);
}

// Each vertex adds up its corners, listed from start[v] on: no atomics, so the bits never change.
KERNEL vertex_gradient(const double* corners, const long long* order, const long long* start, int count, double* out) {
    const int v = index();
    if (v >= count) return;
    double sum[3] = {};
    for (long long i = start[v]; i < start[v + 1]; ++i)
        for (int axis = 0; axis < 3; ++axis) sum[axis] += corners[3 * order[i] + axis];
    for (int axis = 0; axis < 3; ++axis) out[3LL * v + axis] = sum[axis];
}

// ---------------------------------------------------------------------------------------- bands

// Grid (segments / threads, parts of the faces); out (parts, wavevectors).
KERNEL band_forward(const Face* faces, int count, int per_part, const Segment* segments, int segment_count,
                    long long wavevectors, Real* out) {
    __shared__ Face held[tile];
    const int me = threadIdx.x, i = index();
    const Segment s = segments[i < segment_count ? i : segment_count - 1];  // idle threads go along
    const int first = blockIdx.y * per_part, last = first + per_part < count ? first + per_part : count;
    Complex<Real> sum[width] = {};
    for (int at = first; at < last; at += tile) {
        const int n = last - at < tile ? last - at : tile;
        __syncthreads();
        if (me < n) held[me] = faces[at + me];
        __syncthreads();
        Complex<Real> part[width] = {};
        for (int f = 0; f < n; ++f) add_face(held[f], s, part);
#pragma unroll
        for (int k = 0; k < width; ++k) {
            sum[k].re += part[k].re;
            sum[k].im += part[k].im;
        }
    }
    if (i >= segment_count) return;
    Real* o = out + 2 * (blockIdx.y * wavevectors + s.offset);
#pragma unroll
    for (int k = 0; k < width; ++k) {
        if (k < s.length) {
            o[2 * k] = sum[k].re;
            o[2 * k + 1] = sum[k].im;
        }
    }
}

// Grid (faces / threads, parts of the segments); out (parts, 10, faces).
KERNEL band_backward(const Face* faces, int count, const Segment* segments, int segment_count, int per_part,
                     const Real* grad, Real* out) {
    __shared__ Segment held[tile];
    __shared__ Quad held_grad[tile * width / per_quad];
    const int me = threadIdx.x, i = index();
    const Face* own = faces + (i < count ? i : count - 1);
    const Face f = *own;
    const int first = blockIdx.y * per_part, last = first + per_part < segment_count ? first + per_part : segment_count;
    Real sums[sums_per_face] = {};
    Complex<Real> e = {};
    for (int at = first; at < last; at += tile) {
        const int n = last - at < tile ? last - at : tile;
        __syncthreads();
        if (me < n) held[me] = segments[at + me];
        for (int j = me; j < n * width; j += threads) {
            const Segment& s = segments[at + j / width];
            const int k = j % width;
            const bool there = k < s.length;  // beyond the end of a row the gradient is zero
            Real* g = held_grad[j / per_quad].v + 2 * (j % per_quad);
            g[0] = there ? grad[2 * (s.offset + k)] : Real(0);
            g[1] = there ? grad[2 * (s.offset + k) + 1] : Real(0);
        }
        __syncthreads();
        Real part[sums_per_face] = {};
        for (int j = 0; j < n; ++j) {
            const Segment s = held[j];
            if (j == 0 || s.kx / width % continued == 0) e = exponential(f, s);
            add_segment(f, own->edge, s, held_grad + j * width / per_quad, e, part);
        }
#pragma unroll
        for (int k = 0; k < sums_per_face; ++k) sums[k] += part[k];
    }
    if (i >= count) return;
#pragma unroll
    for (int k = 0; k < sums_per_face; ++k) out[sum_place(k, count, i)] = sums[k];
}

// ------------------------------------------------------------------------------ any wavevectors

// Grid (wavevectors / threads, parts of the faces); out (parts, wavevectors).
KERNEL list_forward(const Triangle* faces, int count, int per_part, const double* wavevectors, long long number,
                    Real* out) {
    __shared__ Triangle held[tile];
    const int me = threadIdx.x;
    const long long i = long_index();
    const double* xi = wavevectors + 3 * (i < number ? i : number - 1);
    const double z = xi[0], y = xi[1], x = xi[2];
    const int first = blockIdx.y * per_part, last = first + per_part < count ? first + per_part : count;
    double re = 0, im = 0;
    for (int at = first; at < last; at += tile) {
        const int n = last - at < tile ? last - at : tile;
        __syncthreads();
        if (me < n) held[me] = faces[at + me];
        __syncthreads();
        for (int f = 0; f < n; ++f) {
            const Phases p = phases_of(held[f], z, y, x);
            const Value<Real> v = value(p);
            re += held[f].weight * static_cast<double>(p.e.re * v.re - p.e.im * v.im);
            im += held[f].weight * static_cast<double>(p.e.re * v.im + p.e.im * v.re);
        }
    }
    if (i >= number) return;
    out[2 * (blockIdx.y * number + i)] = static_cast<Real>(re);
    out[2 * (blockIdx.y * number + i) + 1] = static_cast<Real>(im);
}

// Grid (faces / threads, parts of the wavevectors); out (parts, 10, faces).
KERNEL list_backward(const Triangle* faces, int count, const double* wavevectors, long long number, int per_part,
                     const Real* grad, double* out) {
    __shared__ double held[tile][3];
    __shared__ Complex<Real> held_grad[tile];
    const int me = threadIdx.x, i = index();
    const Triangle f = faces[i < count ? i : count - 1];
    const long long first = static_cast<long long>(blockIdx.y) * per_part,
                    last = first + per_part < number ? first + per_part : number;
    double sums[sums_per_face] = {};
    for (long long at = first; at < last; at += tile) {
        const int n = last - at < tile ? static_cast<int>(last - at) : tile;
        __syncthreads();
        if (me < n) {
            const long long k = at + me;
            for (int axis = 0; axis < 3; ++axis) held[me][axis] = wavevectors[3 * k + axis];
            held_grad[me] = {grad[2 * k], grad[2 * k + 1]};
        }
        __syncthreads();
        for (int k = 0; k < n; ++k) {
            const Phases p = phases_of(f, held[k][0], held[k][1], held[k][2]);
            const Complex<Real> g = held_grad[k];
            const Complex<Real> t = {p.e.re * g.re + p.e.im * g.im, p.e.im * g.re - p.e.re * g.im};
            const Contracted<Real> c = contracted(p, t);
            const double each[3] = {static_cast<double>(c.by_alpha), static_cast<double>(c.by_beta),
                                    static_cast<double>(c.im)};
            sums[0] += static_cast<double>(c.re);
#pragma unroll
            for (int q = 0; q < 3; ++q)
#pragma unroll
                for (int axis = 0; axis < 3; ++axis) sums[1 + 3 * q + axis] += each[q] * held[k][axis];
        }
    }
    if (i >= count) return;
#pragma unroll
    for (int k = 0; k < sums_per_face; ++k) out[sum_place(k, count, i)] = sums[k];
}
