// What the loops take and give: plain data, owned by the caller.
//
// A loop is called once per worker; worker w of n does its share. Shares depend on the problem
// alone, and sums run in a fixed order, so that a result has the same bits for any number of workers.
#pragma once
#include <atomic>
#include <cstddef>
#include <cstdint>

namespace deltamic_api {

// Triangles in double precision: centroid and the three edge vectors (e_p opposite vertex p).
struct Triangles {
    std::size_t count;
    const double* centroid;  // (count, 3)
    const double* edges;     // (count, 3, 3): e1 = v3-v2, e2 = v1-v3, e3 = v2-v1
    const double* weight;    // (count): 2 * area * density going forward, 1 going backward
};

// Wavevectors (kz, ky, kx) * spacing in rows along the last axis: row r holds kx = 0 ... length[r]-1
// and is stored from offset[r] on.
struct Band {
    std::size_t rows;
    const std::int32_t *kz, *ky, *length;
    const std::int64_t* offset;
    double spacing[3];
    std::int32_t longest, kmax_z, kmax_y;  // longest row; largest |kz|, |ky|
};

// Sums over wavevectors that make up the gradient of one triangle, G being the incoming gradient:
//   [0]    sum Re(conj(G) F)
//   [1:4]  sum Re(conj(G) dF/dphase_1) xi,  [4:7] the same for phase_2,  [7:10] sum Im(conj(G) F) xi
constexpr std::size_t sums_per_triangle = 10;

struct Share {
    std::size_t worker, workers;
    std::atomic<std::size_t>* next;  // for loops whose pieces are handed out one by one
    const std::atomic<bool>* stop;   // set when the user interrupts
    std::atomic<bool>* out_of_memory;  // set by a worker that gets no working space
};

template <class T>
struct Loops {
    void (*band_forward)(const Triangles&, const Band&, T* out, const Share&);
    void (*band_backward)(const Triangles&, const Band&, const T* grad, double* sums, const Share&);
    // Any wavevectors: xi is (count, 3) in rad/um.
    void (*list_forward)(const Triangles&, std::size_t count, const double* xi, T* out, const Share&);
    void (*list_backward)(const Triangles&, std::size_t count, const double* xi, const T* grad,
                          double* sums, const Share&);
};

}  // namespace deltamic_api
