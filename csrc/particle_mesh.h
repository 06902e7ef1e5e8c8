// Particle-mesh: weighted points on vertices, segments or triangles, spread on a periodic grid and
// read back from one. Plain data, owned by the caller.
//
// The leaves below know nothing of threads. What they are called on - chunks of elements, tiles of
// the grid - depends on the problem alone, and so does the order of every sum.
#pragma once
#include <cstddef>
#include <cstdint>

namespace deltamic_api {

constexpr int widest_kernel = 16;

// A kernel that reaches over `width` nodes: on the l-th of them a polynomial in t = 2 f - 1, with f
// how far the first node lies behind the kernel's lower edge, in 0..1.
template <class T>
struct Kernel {
    int width, degree;
    const T* coefficients;  // (degree + 1, lanes), highest power first; zero from `width` on
};

// Kernels of the three axes share one vector length, the first of 4, 8, 16 that holds the widest.
template <class T>
struct Grid {
    std::int64_t shape[3];
    std::int64_t row;  // from one row along x to the next: shape[2] + lanes, so that nothing wraps there
    double scale[3];   // nodes per um
    int lanes;
    Kernel<T> kernel[3];
};

// Points at fixed barycentric places of each element, by the element's rule.
struct Elements {
    std::size_t count;
    int corners;                    // 1: points, 2: segments, 3: triangles
    const double* vertices;         // (V, 3) um
    const std::int64_t* indices;    // (count, corners)
    const double* strengths;        // (count): of all points of an element together
    const std::int32_t* rule;       // (count)
    const std::int64_t* rule_start; // (rules + 1): first point of each rule
    const double* barycentric;      // (points of all rules, corners)
    const double* weights;          // (points of all rules)
};

template <class T>
struct Point {
    T f[3];               // how far the first node lies behind the kernel's lower edge
    T strength;           // that of the element times the rule's weight
    std::int32_t at[3];   // the first node, within the grid
    std::int32_t element;
};

template <class T>
struct MeshLoops {
    // Points of elements first .. last-1, one after the other.
    void (*locate)(const Elements&, const Grid<T>&, std::size_t first, std::size_t last, Point<T>* out);
    // Adds points to a grid; with `vectors` (elements, 3), dipoles: the kernel's gradient (per um) along
    // the vector.
    void (*spread)(const Point<T>* points, std::size_t count, const Grid<T>&, const double* vectors, T* grid);
    // For each element and corner, the sum over points of weight times barycentric coordinate times
    // the field (and its three derivatives, per um): sums is (elements, corners, 1 or 4).
    void (*gather)(const Elements&, const Grid<T>&, std::size_t first, std::size_t last, const T* field,
                   bool derivatives, double* sums);
};

}  // namespace deltamic_api
