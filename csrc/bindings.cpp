// Python bindings: geometry of the triangles in double precision, choice of the instruction set,
// worker threads. Compiled for the oldest processor of the platform.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>
#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <new>
#include <stdexcept>
#include <string>
#include <system_error>
#include <thread>
#include <vector>

#if defined(_MSC_VER) && (defined(_M_X64) || defined(_M_IX86))
#include <intrin.h>
#endif

#include "checks.h"
#include "mesh_ft.h"
#include "particle_mesh_bindings.h"
#include "simd_levels.h"

namespace nb = nanobind;
using namespace deltamic_api;

namespace {

using deltamic_checks::Array;

// ------------------------------------------------------------------------------------- geometry

struct Vec {
    double z, y, x;
};
Vec sub(const double* a, const double* b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
Vec cross(Vec a, Vec b) { return {a.y * b.x - a.x * b.y, a.x * b.z - a.z * b.x, a.z * b.y - a.y * b.z}; }

constexpr double largest_density = 1e100;

struct Geometry {
    std::vector<double> centroid, edges, doubled_area, normal, weight, ones;

    Geometry(const Array<const double>& v, const Array<const std::int64_t>& faces, const Array<const double>& density) {
        const std::size_t count = deltamic_checks::places_in(v);
        const std::size_t n = deltamic_checks::joined_in(faces, "faces", 3, count);
        deltamic_checks::require(density.ndim() == 1 && density.shape(0) == n, "one density per face is needed");
        deltamic_checks::within(density, "densities", -largest_density, largest_density);
        centroid.resize(3 * n);
        edges.resize(9 * n);
        doubled_area.resize(n);
        normal.resize(3 * n);
        weight.resize(n);
        ones.assign(n, 1.0);
        for (std::size_t f = 0; f < n; ++f) {
            const double* p[3];
            for (int k = 0; k < 3; ++k) {
                p[k] = v.data() + 3 * faces.data()[3 * f + k];
            }
            const Vec e[3] = {sub(p[2], p[1]), sub(p[0], p[2]), sub(p[1], p[0])};
            for (int k = 0; k < 3; ++k) {
                edges[9 * f + 3 * k] = e[k].z;
                edges[9 * f + 3 * k + 1] = e[k].y;
                edges[9 * f + 3 * k + 2] = e[k].x;
                centroid[3 * f + k] = (p[0][k] + p[1][k] + p[2][k]) / 3.0;
            }
            // Of the cross product, never Heron's formula, which is far off on needles.
            const Vec c = cross(e[2], e[0]);
            const double size = std::hypot(c.z, c.y, c.x);
            const double inv = size > 0 ? 1.0 / size : 0.0;  // no direction, no area gradient
            doubled_area[f] = size;
            normal[3 * f] = c.z * inv;
            normal[3 * f + 1] = c.y * inv;
            normal[3 * f + 2] = c.x * inv;
            weight[f] = size * density.data()[f];
        }
    }
    Triangles triangles(bool backward) const {
        return {doubled_area.size(), centroid.data(), edges.data(), backward ? ones.data() : weight.data()};
    }
};

// grad_{v_p} u = density * ( -F w_p + 2A dF/dphase_p xi ),  w_p = e_p x N
void scatter(const Geometry& g, const std::vector<double>& sums, const std::int64_t* faces, const double* density,
             double* grad_vertices, double* grad_density) {
    for (std::size_t f = 0; f < g.doubled_area.size(); ++f) {
        const double* s = sums.data() + f * sums_per_triangle;
        const double area2 = g.doubled_area[f], rho = density[f];
        const double* n = g.normal.data() + 3 * f;
        grad_density[f] = area2 * s[0];
        for (int p = 0; p < 3; ++p) {
            const double* e = g.edges.data() + 9 * f + 3 * p;
            const Vec w = cross({e[0], e[1], e[2]}, {n[0], n[1], n[2]});
            const double wv[3] = {w.z, w.y, w.x};
            double* out = grad_vertices + 3 * faces[3 * f + p];
            for (int k = 0; k < 3; ++k) {
                // The three phase gradients sum to -iF.
                const double h = p < 2 ? s[1 + 3 * p + k] : s[7 + k] - s[1 + k] - s[4 + k];
                out[k] += rho * (area2 * h - s[0] * wv[k]);
            }
        }
    }
}

// -------------------------------------------------------------------------------------- threads

// Runs work(share) on every worker, without the GIL; Ctrl-C stops them.
template <class F>
void run(int threads, F work) {
    deltamic_checks::thread_count(threads);
    const std::size_t n = static_cast<std::size_t>(threads);
    std::atomic<std::size_t> next{0}, running{n};
    std::atomic<bool> stop{false}, out_of_memory{false};
    std::mutex mutex;
    std::condition_variable done;
    bool interrupted = false;
    {
        nb::gil_scoped_release release;
        std::vector<std::thread> pool;
        pool.reserve(n);
        for (std::size_t w = 0; w < n; ++w) {
            const auto share = [&, w] {
                work(Share{w, n, &next, &stop, &out_of_memory});
                std::lock_guard<std::mutex> lock(mutex);
                if (--running == 0) done.notify_all();
            };
            try {
                pool.emplace_back(share);
            } catch (const std::system_error&) {  // the system has no thread left
                share();
            }
        }
        for (;;) {
            {
                std::unique_lock<std::mutex> lock(mutex);
                if (done.wait_for(lock, std::chrono::milliseconds(100), [&] { return running == 0; })) break;
            }
            nb::gil_scoped_acquire acquire;
            if (PyErr_CheckSignals() != 0) {
                interrupted = true;
                stop = true;
                break;
            }
        }
        for (std::thread& t : pool) t.join();
    }
    if (interrupted) throw nb::python_error();
    if (out_of_memory) throw std::bad_alloc();
}

constexpr double largest_wavevector = 1e100;  // rad/um
constexpr std::int32_t longest_row = 1 << 16;

// count: of the wavevectors of all rows.
Band band_of(const Array<const std::int32_t>& rows, const Array<const std::int64_t>& offset,
             const std::vector<double>& spacing, std::size_t count, std::vector<std::int32_t>& columns) {
    using namespace deltamic_checks;
    const std::size_t n = rows_of(rows, "rows", 3);
    has_shape(offset, "offsets", {n});
    require(spacing.size() == 3, "spacing: three numbers");
    for (double s : spacing) within(s, "spacing", -largest_wavevector, largest_wavevector);
    std::int64_t end = 0;
    for (std::size_t r = 0; r < n; ++r) {
        const std::int32_t *row = rows.data() + 3 * r, length = row[2];
        require(length >= 1, "a row of the band is empty");
        require(std::max({row[0], row[1], length}) <= longest_row && std::min(row[0], row[1]) >= -longest_row,
                "the band is too large");
        require(offset.data()[r] == end, "rows of a band must lie one after the other");
        end += length;
    }
    require(static_cast<std::int64_t>(count) == end, "one number per wavevector is needed");
    columns.resize(3 * n);
    Band b{n, columns.data(), columns.data() + n, columns.data() + 2 * n, offset.data(),
           {spacing[0], spacing[1], spacing[2]}, 0, 0, 0};
    for (std::size_t r = 0; r < n; ++r) {
        const std::int32_t* row = rows.data() + 3 * r;
        for (int k = 0; k < 3; ++k) columns[k * n + r] = row[k];
        b.kmax_z = std::max(b.kmax_z, std::abs(row[0]));
        b.kmax_y = std::max(b.kmax_y, std::abs(row[1]));
        b.longest = std::max(b.longest, row[2]);
    }
    return b;
}

// Real and imaginary part of each wavevector: how many.
template <class A>
std::size_t complex_in(const A& a) {
    return deltamic_checks::rows_of(a, "complex numbers as two reals", 2);
}

template <class T>
void bind(nb::module_& m, const char* suffix) {
    using namespace deltamic_checks;
    const std::string s(suffix);
    // What is written to is never converted: that would write to a copy.
    const auto results = [](const Geometry& g, const Array<const double>& v, const Array<double>& by_vertex,
                            const Array<double>& by_density) {
        has_shape(by_vertex, "gradient of the vertices", {v.shape(0), 3});
        has_shape(by_density, "gradient of the densities", {g.doubled_area.size()});
    };
    m.def(("band_forward_" + s).c_str(),
          [](Array<const double> v, Array<const std::int64_t> faces, Array<const double> density,
             Array<const std::int32_t> rows, Array<const std::int64_t> offset, std::vector<double> spacing,
             Array<T> out, int threads, const std::string& simd) {
              const Geometry g(v, faces, density);
              std::vector<std::int32_t> columns;
              const Band band = band_of(rows, offset, spacing, complex_in(out), columns);
              const Triangles tri = g.triangles(false);
              const Loops<T>& l = loops_of<T>(simd);
              run(threads, [&](const Share& share) { l.band_forward(tri, band, out.data(), share); });
          },
          nb::arg("vertices"), nb::arg("faces"), nb::arg("density"), nb::arg("rows"), nb::arg("offset"),
          nb::arg("spacing"), nb::arg("out").noconvert(), nb::arg("threads"), nb::arg("simd"));
    m.def(("band_backward_" + s).c_str(),
          [results](Array<const double> v, Array<const std::int64_t> faces, Array<const double> density,
             Array<const std::int32_t> rows, Array<const std::int64_t> offset, std::vector<double> spacing,
             Array<const T> grad, Array<double> grad_v, Array<double> grad_density, int threads, const std::string& simd) {
              const Geometry g(v, faces, density);
              results(g, v, grad_v, grad_density);
              std::vector<std::int32_t> columns;
              const Band band = band_of(rows, offset, spacing, complex_in(grad), columns);
              const Triangles tri = g.triangles(true);
              const Loops<T>& l = loops_of<T>(simd);
              std::vector<double> sums(tri.count * sums_per_triangle);
              run(threads, [&](const Share& share) { l.band_backward(tri, band, grad.data(), sums.data(), share); });
              scatter(g, sums, faces.data(), density.data(), grad_v.data(), grad_density.data());
          },
          nb::arg("vertices"), nb::arg("faces"), nb::arg("density"), nb::arg("rows"), nb::arg("offset"),
          nb::arg("spacing"), nb::arg("grad"), nb::arg("grad_vertices").noconvert(),
          nb::arg("grad_density").noconvert(), nb::arg("threads"), nb::arg("simd"));
    m.def(("list_forward_" + s).c_str(),
          [](Array<const double> v, Array<const std::int64_t> faces, Array<const double> density,
             Array<const double> xi, Array<T> out, int threads, const std::string& simd) {
              const Geometry g(v, faces, density);
              has_shape(out, "out", {rows_of(xi, "wavevectors", 3), 2});
              within(xi, "wavevectors", -largest_wavevector, largest_wavevector);
              const Triangles tri = g.triangles(false);
              const Loops<T>& l = loops_of<T>(simd);
              run(threads, [&](const Share& share) { l.list_forward(tri, xi.shape(0), xi.data(), out.data(), share); });
          },
          nb::arg("vertices"), nb::arg("faces"), nb::arg("density"), nb::arg("wavevectors"), nb::arg("out").noconvert(),
          nb::arg("threads"), nb::arg("simd"));
    m.def(("list_backward_" + s).c_str(),
          [results](Array<const double> v, Array<const std::int64_t> faces, Array<const double> density,
             Array<const double> xi, Array<const T> grad, Array<double> grad_v, Array<double> grad_density, int threads,
             const std::string& simd) {
              const Geometry g(v, faces, density);
              results(g, v, grad_v, grad_density);
              has_shape(grad, "grad", {rows_of(xi, "wavevectors", 3), 2});
              within(xi, "wavevectors", -largest_wavevector, largest_wavevector);
              const Triangles tri = g.triangles(true);
              const Loops<T>& l = loops_of<T>(simd);
              std::vector<double> sums(tri.count * sums_per_triangle);
              run(threads, [&](const Share& share) {
                  l.list_backward(tri, xi.shape(0), xi.data(), grad.data(), sums.data(), share);
              });
              scatter(g, sums, faces.data(), density.data(), grad_v.data(), grad_density.data());
          },
          nb::arg("vertices"), nb::arg("faces"), nb::arg("density"), nb::arg("wavevectors"), nb::arg("grad"),
          nb::arg("grad_vertices").noconvert(), nb::arg("grad_density").noconvert(), nb::arg("threads"),
          nb::arg("simd"));
}

}  // namespace

NB_MODULE(_mesh_ft, m) {
    m.doc() = "Compiled loops of the mesh Fourier transform; use napari_deltamic.fourier instead.";
    m.def("simd_levels", [] {
        std::vector<std::string> names;
        for (const Level& l : levels()) names.push_back(l.name);
        return names;
    }, "Instruction sets that this build has and this processor runs, slowest first.");
    bind<float>(m, "f32");
    bind<double>(m, "f64");
    bind_particle_mesh(m);
    bind_spectra(m);
    bind_explain(m);
}
