// Spreading and gathering on CPUs. Compiled once per instruction set (CMakeLists.txt).
//
// Nothing here may instantiate a standard-library template; see mesh_ft_cpu.cpp.
#include "particle_mesh.h"

#include <cmath>
#include <cstring>

#define DELTAMIC_JOIN2(a, b) a##b
#define DELTAMIC_JOIN(a, b) DELTAMIC_JOIN2(a, b)
#define DELTAMIC_NAMESPACE DELTAMIC_JOIN(deltamic_, DELTAMIC_SIMD)

namespace DELTAMIC_NAMESPACE {
namespace {

using deltamic_api::Elements;
using deltamic_api::Grid;
using deltamic_api::Kernel;
using deltamic_api::Point;
using deltamic_api::widest_kernel;
using std::size_t;

// ------------------------------------------------------------------------------- rows of nodes

#if defined(__GNUC__) || defined(__clang__)

// L numbers side by side; the compiler cuts them into what the processor has.
template <class T, int L>
struct VectorOf {
    typedef T type __attribute__((vector_size(L * sizeof(T))));
};

template <class T, int L>
struct Row {
    typename VectorOf<T, L>::type v;
};
template <class T, int L>
inline Row<T, L> load(const T* p) {
    Row<T, L> r;
    std::memcpy(&r.v, p, sizeof r.v);
    return r;
}
template <class T, int L>
inline void store(T* p, Row<T, L> r) {
    std::memcpy(p, &r.v, sizeof r.v);
}
template <class T, int L>
inline Row<T, L> times_plus(Row<T, L> a, T b, Row<T, L> c) {
    return {a.v * b + c.v};
}
template <class T, int L>
inline Row<T, L> zeros() {
    return {typename VectorOf<T, L>::type{}};
}
template <class T, int L>
inline T dot(Row<T, L> a, Row<T, L> b) {
    const auto p = a.v * b.v;
    T pairs[L];
    std::memcpy(pairs, &p, sizeof p);
    for (int n = L / 2; n > 0; n /= 2)
        for (int i = 0; i < n; ++i) pairs[i] += pairs[i + n];
    return pairs[0];
}

#else

template <class T, int L>
struct Row {
    T v[L];
};
template <class T, int L>
inline Row<T, L> load(const T* p) {
    Row<T, L> r;
    for (int i = 0; i < L; ++i) r.v[i] = p[i];
    return r;
}
template <class T, int L>
inline void store(T* p, Row<T, L> r) {
    for (int i = 0; i < L; ++i) p[i] = r.v[i];
}
template <class T, int L>
inline Row<T, L> times_plus(Row<T, L> a, T b, Row<T, L> c) {
    for (int i = 0; i < L; ++i) c.v[i] += a.v[i] * b;
    return c;
}
template <class T, int L>
inline Row<T, L> zeros() {
    Row<T, L> r;
    for (int i = 0; i < L; ++i) r.v[i] = 0;
    return r;
}
template <class T, int L>
inline T dot(Row<T, L> a, Row<T, L> b) {
    T s = 0;
    for (int i = 0; i < L; ++i) s += a.v[i] * b.v[i];
    return s;
}

#endif

// ------------------------------------------------------------------------------------- kernels

template <class T, int L>
inline Row<T, L> values(const Kernel<T>& k, T f) {
    const T t = 2 * f - 1;
    Row<T, L> v = load<T, L>(k.coefficients);
    for (int d = 1; d <= k.degree; ++d) v = times_plus<T, L>(v, t, load<T, L>(k.coefficients + d * L));
    return v;
}

// The polynomials and their own derivatives with respect to t.
template <class T, int L>
inline void values_and_slopes(const Kernel<T>& k, T f, Row<T, L>& v, Row<T, L>& slope) {
    const T t = 2 * f - 1;
    v = load<T, L>(k.coefficients);
    slope = zeros<T, L>();
    for (int d = 1; d <= k.degree; ++d) {
        slope = times_plus<T, L>(slope, t, v);
        v = times_plus<T, L>(v, t, load<T, L>(k.coefficients + d * L));
    }
}

// Where a point (in nodes) meets the grid along an axis.
struct Place {
    double f;
    std::int32_t at;
};
template <class T>
inline Place place(const Grid<T>& g, int axis, double x) {
    const double edge = x - 0.5 * g.kernel[axis].width, n = static_cast<double>(g.shape[axis]);
    const double first = std::ceil(edge);
    return {first - edge, static_cast<std::int32_t>(first - n * std::floor(first / n))};
}

// Corners of an element in nodes.
template <class T>
inline void corners_of(const Elements& e, const Grid<T>& g, size_t element, double (&at)[3][3]) {
    for (int i = 0; i < e.corners; ++i) {
        const double* v = e.vertices + 3 * e.indices[element * e.corners + i];
        for (int k = 0; k < 3; ++k) at[i][k] = v[k] * g.scale[k];
    }
}

template <class T>
inline Place place_of(const Elements& e, const Grid<T>& g, const double (&corner)[3][3], const double* barycentric,
                      int axis) {
    double x = 0;
    for (int i = 0; i < e.corners; ++i) x += barycentric[i] * corner[i][axis];
    return place(g, axis, x);
}

// ------------------------------------------------------------------------------------ the loops

template <class T>
void locate(const Elements& e, const Grid<T>& g, size_t first, size_t last, Point<T>* out) {
    double corner[3][3];
    for (size_t element = first; element < last; ++element) {
        corners_of(e, g, element, corner);
        const std::int64_t end = e.rule_start[e.rule[element] + 1];
        for (std::int64_t p = e.rule_start[e.rule[element]]; p < end; ++p, ++out) {
            for (int k = 0; k < 3; ++k) {
                const Place at = place_of(e, g, corner, e.barycentric + p * e.corners, k);
                out->f[k] = static_cast<T>(at.f);
                out->at[k] = at.at;
            }
            out->strength = static_cast<T>(e.strengths[element] * e.weights[p]);
            out->element = static_cast<std::int32_t>(element);
        }
    }
}

// First elements of the rows that a point meets along z and y.
template <class T>
struct Rows {
    std::int64_t z[widest_kernel], y[widest_kernel];

    Rows(const Grid<T>& g, std::int32_t at_z, std::int32_t at_y) {
        for (int a = 0; a < g.kernel[0].width; ++a) {
            const std::int64_t i = at_z + a;
            z[a] = (i < g.shape[0] ? i : i - g.shape[0]) * g.shape[1] * g.row;
        }
        for (int b = 0; b < g.kernel[1].width; ++b) {
            const std::int64_t i = at_y + b;
            y[b] = (i < g.shape[1] ? i : i - g.shape[1]) * g.row;
        }
    }
};

template <class T, int L, bool dipoles>
void spread_rows(const Point<T>* points, size_t count, const Grid<T>& g, const double* vectors, T* grid) {
    const int depth = g.kernel[0].width, height = g.kernel[1].width;
    for (size_t p = 0; p < count; ++p) {
        const Point<T>& point = points[p];
        if (point.strength == 0) continue;  // most are zero where a part of a surface shines alone
        Row<T, L> k[3], s[3];
        for (int axis = 0; axis < 3; ++axis) {
            if constexpr (dipoles) values_and_slopes<T, L>(g.kernel[axis], point.f[axis], k[axis], s[axis]);
            else k[axis] = values<T, L>(g.kernel[axis], point.f[axis]);
        }
        T z[L], y[L], sz[L], sy[L], along[3];
        store<T, L>(z, k[0]);
        store<T, L>(y, k[1]);
        if constexpr (dipoles) {
            store<T, L>(sz, s[0]);
            store<T, L>(sy, s[1]);
            // t rises by 2 from a node to the next
            for (int i = 0; i < 3; ++i)
                along[i] = static_cast<T>(2 * g.scale[i] * point.strength * vectors[3 * point.element + i]);
        }
        const Rows<T> rows(g, point.at[0], point.at[1]);
        T* base = grid + point.at[2];
        for (int a = 0; a < depth; ++a) {
            const T share = point.strength * z[a];
            for (int b = 0; b < height; ++b) {
                T* row = base + rows.z[a] + rows.y[b];
                if constexpr (dipoles) {
                    const T across = along[0] * sz[a] * y[b] + along[1] * z[a] * sy[b];
                    const Row<T, L> sum = times_plus<T, L>(s[2], along[2] * z[a] * y[b], load<T, L>(row));
                    store<T, L>(row, times_plus<T, L>(k[2], across, sum));
                } else {
                    store<T, L>(row, times_plus<T, L>(k[2], share * y[b], load<T, L>(row)));
                }
            }
        }
    }
}

template <class T>
struct Field {
    T value, slope[3];
};

template <class T, int L, bool derivatives>
inline Field<T> field_at(const Grid<T>& g, const Place (&at)[3], const T* field) {
    const int depth = g.kernel[0].width, height = g.kernel[1].width;
    Row<T, L> k[3], s[3];
    for (int axis = 0; axis < 3; ++axis) {
        if constexpr (derivatives) values_and_slopes<T, L>(g.kernel[axis], static_cast<T>(at[axis].f), k[axis], s[axis]);
        else k[axis] = values<T, L>(g.kernel[axis], static_cast<T>(at[axis].f));
    }
    T z[L], y[L], sz[L], sy[L];
    store<T, L>(z, k[0]);
    store<T, L>(y, k[1]);
    if constexpr (derivatives) {
        store<T, L>(sz, s[0]);
        store<T, L>(sy, s[1]);
    }
    const Rows<T> rows(g, at[0].at, at[1].at);
    const T* base = field + at[2].at;
    Row<T, L> all = zeros<T, L>(), along_z = zeros<T, L>(), along_y = zeros<T, L>();
    for (int a = 0; a < depth; ++a) {
        Row<T, L> plane = zeros<T, L>(), tilted = zeros<T, L>();
        for (int b = 0; b < height; ++b) {
            const Row<T, L> row = load<T, L>(base + rows.z[a] + rows.y[b]);
            plane = times_plus<T, L>(row, y[b], plane);
            if constexpr (derivatives) tilted = times_plus<T, L>(row, sy[b], tilted);
        }
        all = times_plus<T, L>(plane, z[a], all);
        if constexpr (derivatives) {
            along_z = times_plus<T, L>(plane, sz[a], along_z);
            along_y = times_plus<T, L>(tilted, z[a], along_y);
        }
    }
    Field<T> found{dot<T, L>(all, k[2]), {0, 0, 0}};
    if constexpr (derivatives) {
        found.slope[0] = dot<T, L>(along_z, k[2]);
        found.slope[1] = dot<T, L>(along_y, k[2]);
        found.slope[2] = dot<T, L>(all, s[2]);
    }
    return found;
}

template <class T, int L, bool derivatives>
void gather_elements(const Elements& e, const Grid<T>& g, size_t first, size_t last, const T* field, double* sums) {
    constexpr int each = derivatives ? 4 : 1;
    double corner[3][3];
    for (size_t element = first; element < last; ++element) {
        corners_of(e, g, element, corner);
        double sum[3][each] = {};
        const std::int64_t end = e.rule_start[e.rule[element] + 1];
        for (std::int64_t p = e.rule_start[e.rule[element]]; p < end; ++p) {
            const double* barycentric = e.barycentric + p * e.corners;
            Place at[3];
            for (int k = 0; k < 3; ++k) at[k] = place_of(e, g, corner, barycentric, k);
            const Field<T> found = field_at<T, L, derivatives>(g, at, field);
            for (int i = 0; i < e.corners; ++i) {
                const double share = e.weights[p] * barycentric[i];
                sum[i][0] += share * static_cast<double>(found.value);
                if constexpr (derivatives)
                    for (int k = 0; k < 3; ++k) sum[i][1 + k] += share * static_cast<double>(found.slope[k]);
            }
        }
        double* out = sums + element * e.corners * each;
        for (int i = 0; i < e.corners; ++i) {
            out[i * each] = sum[i][0];
            // t falls by 2 where a point moves on by a node
            if constexpr (derivatives)
                for (int k = 0; k < 3; ++k) out[i * each + 1 + k] = -2 * g.scale[k] * sum[i][1 + k];
        }
    }
}

// ---------------------------------------------------------------------------- for every length

template <class T, bool dipoles>
void spread_lanes(const Point<T>* points, size_t count, const Grid<T>& g, const double* vectors, T* grid) {
    switch (g.lanes) {
        case 4: return spread_rows<T, 4, dipoles>(points, count, g, vectors, grid);
        case 8: return spread_rows<T, 8, dipoles>(points, count, g, vectors, grid);
        default: return spread_rows<T, 16, dipoles>(points, count, g, vectors, grid);
    }
}

template <class T>
void spread(const Point<T>* points, size_t count, const Grid<T>& g, const double* vectors, T* grid) {
    if (vectors) spread_lanes<T, true>(points, count, g, vectors, grid);
    else spread_lanes<T, false>(points, count, g, vectors, grid);
}

template <class T, bool derivatives>
void gather_lanes(const Elements& e, const Grid<T>& g, size_t first, size_t last, const T* field, double* sums) {
    switch (g.lanes) {
        case 4: return gather_elements<T, 4, derivatives>(e, g, first, last, field, sums);
        case 8: return gather_elements<T, 8, derivatives>(e, g, first, last, field, sums);
        default: return gather_elements<T, 16, derivatives>(e, g, first, last, field, sums);
    }
}

template <class T>
void gather(const Elements& e, const Grid<T>& g, size_t first, size_t last, const T* field, bool derivatives,
            double* sums) {
    if (derivatives) gather_lanes<T, true>(e, g, first, last, field, sums);
    else gather_lanes<T, false>(e, g, first, last, field, sums);
}

}  // namespace

extern const deltamic_api::MeshLoops<float> mesh_f32 = {locate<float>, spread<float>, gather<float>};
extern const deltamic_api::MeshLoops<double> mesh_f64 = {locate<double>, spread<double>, gather<double>};

}  // namespace DELTAMIC_NAMESPACE
