// Python bindings of the particle-mesh: checks, tiles, threads. Compiled for the oldest processor.
#include "particle_mesh_bindings.h"

#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "checks.h"
#include "measure.h"
#include "simd_levels.h"
#include "team.h"

namespace nb = nanobind;
using namespace deltamic_api;

namespace {

using deltamic_checks::Array;
using std::size_t;

// -------------------------------------------------------------------------------- what is given

struct Quadrature {
    Array<const std::int32_t> rule;
    Array<const std::int64_t> rule_start;
    Array<const double> barycentric, weights;

    Quadrature(Array<const std::int32_t> rule_, Array<const std::int64_t> start, Array<const double> places,
               Array<const double> weights_)
        : rule(rule_), rule_start(start), barycentric(places), weights(weights_) {
        using namespace deltamic_checks;
        require(rule.ndim() == 1 && rule_start.ndim() == 1 && weights.ndim() == 1 && barycentric.ndim() == 2 &&
                    rule_start.shape(0) >= 1 && barycentric.shape(0) == weights.shape(0),
                "rules of quadrature: (E,), (rules + 1,), (points, corners), (points,)");
        const auto rules = static_cast<std::int64_t>(rule_start.shape(0)) - 1;
        const std::int64_t* first = rule_start.data();
        for (std::int64_t r = 0; r < rules; ++r) require(first[r] <= first[r + 1], "rules must lie one after the other");
        require(first[0] == 0 && first[rules] == static_cast<std::int64_t>(weights.shape(0)),
                "rules must cover their points");
        below(rule, static_cast<size_t>(rules), "an element names a rule that is not there");
        within(barycentric, "barycentric coordinates", -16, 16);
        within(weights, "weights", -1e6, 1e6);
    }
};

constexpr double largest_strength = 1e30;

// Raises std::invalid_argument for what the loops could not read.
Elements elements_of(const Array<const double>& vertices, const Array<const std::int64_t>& indices,
                     const Array<const double>& strengths, const Quadrature& q) {
    using namespace deltamic_checks;
    const size_t count = places_in(vertices);
    require(indices.ndim() == 2 && indices.shape(1) >= 1 && indices.shape(1) <= 3,
            "elements: (E, 1), (E, 2) or (E, 3)");
    const size_t n = indices.shape(0), corners = indices.shape(1);
    require(static_cast<std::int64_t>(n) < most_rows, "too many elements");
    require(strengths.ndim() == 1 && strengths.shape(0) == n && q.rule.shape(0) == n,
            "one strength and one rule per element are needed");
    require(q.barycentric.shape(1) == corners || q.weights.shape(0) == 0, "rules are of other elements");
    below(indices, count, "an element names a vertex that is not there");
    within(strengths, "densities", -largest_strength, largest_strength);
    return {n, static_cast<int>(corners), vertices.data(), indices.data(), strengths.data(), q.rule.data(),
            q.rule_start.data(), q.barycentric.data(), q.weights.data()};
}

constexpr std::int64_t longest_axis = 1 << 20;

template <class T>
struct Kernels {
    std::array<std::vector<T>, 3> coefficients;
    Grid<T> grid;

    // Coefficients of each axis: (degree + 1, width), highest power first.
    Kernels(const std::vector<std::int64_t>& shape, const std::vector<double>& scale,
            const std::vector<Array<const double>>& given, const Array<const double>& vertices) {
        using namespace deltamic_checks;
        require(shape.size() == 3 && scale.size() == 3 && given.size() == 3,
                "shape, scale and kernels of three axes are needed");
        size_t widest = 0;
        for (const auto& k : given) {
            require(k.ndim() == 2 && k.shape(0) >= 1 && k.shape(0) <= 64 && k.shape(1) >= 1, "a kernel has no coefficients");
            within(k, "coefficients", -1e30, 1e30);
            widest = std::max(widest, k.shape(1));
        }
        require(widest <= widest_kernel, "a kernel is too wide");
        for (int axis = 0; axis < 3; ++axis) {
            require(shape[axis] >= 1 && shape[axis] <= longest_axis, "the grid is empty, or too large");
            within(scale[axis], "scale", 0, 1e12);
        }
        // Beyond this, how far a place lies between two nodes is lost to rounding, and so is the node.
        for (size_t i = 0; i < vertices.size(); ++i)
            require(std::fabs(vertices.data()[i]) * scale[i % 3] < 1e12, "vertices are too far from the grid");
        const size_t lanes = widest <= 4 ? 4 : widest <= 8 ? 8 : 16;
        grid.lanes = static_cast<int>(lanes);
        for (int axis = 0; axis < 3; ++axis) {
            const auto& k = given[axis];
            const size_t rows = k.shape(0), width = k.shape(1);
            if (shape[axis] < static_cast<std::int64_t>(width)) throw std::invalid_argument("the grid is smaller than its kernel");
            coefficients[axis].assign(rows * lanes, T(0));
            for (size_t d = 0; d < rows; ++d)
                for (size_t l = 0; l < width; ++l)
                    coefficients[axis][d * lanes + l] = static_cast<T>(k.data()[d * width + l]);
            grid.shape[axis] = shape[axis];
            grid.scale[axis] = scale[axis];
            grid.kernel[axis] = {static_cast<int>(width), static_cast<int>(rows) - 1, coefficients[axis].data()};
        }
        grid.row = shape[2] + static_cast<std::int64_t>(lanes);
    }
};

template <class T>
void check_size(const Array<T>& given, const Grid<T>& g) {
    const double size = static_cast<double>(g.shape[0]) * g.shape[1] * g.row;
    deltamic_checks::require(static_cast<double>(given.size()) == size, "the grid has another size");
}

// -------------------------------------------------------------------------------------- tiles

// Equal parts of an axis, an even number of them (or one), each at least as long as a kernel reaches
// beyond it: of those with even numbers no two touch the same node, nor of those with odd ones.
struct Parts {
    std::vector<std::int32_t> of;  // part of each node
    int count;

    Parts(std::int64_t nodes, int width) {
        constexpr std::int64_t shortest = 8;  // nodes; shorter ones cost more than they balance
        count = static_cast<int>(2 * (nodes / (2 * std::max<std::int64_t>(shortest, width))));
        if (count == 0) count = 1;
        of.resize(nodes);
        for (int p = 0; p < count; ++p)
            for (std::int64_t i = p * nodes / count; i < (p + 1) * nodes / count; ++i) of[i] = p;
    }
};

constexpr size_t chunk = 128;  // elements that are located together

size_t chunks_of(size_t elements) { return (elements + chunk - 1) / chunk; }

template <class T>
std::unique_ptr<T[]> uninitialised(size_t n) {
    return std::unique_ptr<T[]>(new T[n]);
}

// Points of all elements, sorted by tile, in a tile in the order of the elements.
template <class T>
struct Sorted {
    std::unique_ptr<Point<T>[]> points;
    std::vector<size_t> start;  // of each tile, and the end
};

template <class T>
class Spreading {
public:
    Spreading(const Elements& e, const Grid<T>& g, const MeshLoops<T>& loops, const double* vectors, T* grid)
        : e_(e), g_(g), loops_(loops), vectors_(vectors), grid_(grid),
          z_(g.shape[0], g.kernel[0].width), y_(g.shape[1], g.kernel[1].width),
          tiles_(static_cast<size_t>(z_.count) * y_.count), chunks_(chunks_of(e.count)), first_(chunks_ + 1) {
        size_t total = 0;
        for (size_t c = 0; c < chunks_; ++c) {
            first_[c] = total;
            for (size_t i = c * chunk; i < std::min(e.count, (c + 1) * chunk); ++i)
                total += static_cast<size_t>(e.rule_start[e.rule[i] + 1] - e.rule_start[e.rule[i]]);
        }
        first_[chunks_] = total;
        located_ = uninitialised<Point<T>>(total);
        sorted_ = uninitialised<Point<T>>(total);
        // Counts per chunk and tile: for many of both, chunks share.
        groups_ = std::min<size_t>(chunks_, 64);
        where_.assign(groups_ * tiles_ + 1, 0);
    }

    void run(Team& team) {
        const size_t rows = static_cast<size_t>(g_.shape[0] * g_.shape[1]);
        const size_t slabs = std::min<size_t>(rows, 64);
        team.run([&](int) {
            team.each(slabs, [&](size_t s) { clear(s * rows / slabs, (s + 1) * rows / slabs); });
            team.each(groups_, [&](size_t group) { locate(group); });
            team.once([&] { place(); });
            team.each(groups_, [&](size_t group) { sort(group); });
            for (int colour = 0; colour < 4; ++colour) {
                const int nz = (z_.count + 1 - colour / 2) / 2, ny = (y_.count + 1 - colour % 2) / 2;
                team.each(static_cast<size_t>(nz) * ny, [&](size_t i) {
                    const int z = 2 * static_cast<int>(i / ny) + colour / 2, y = 2 * static_cast<int>(i % ny) + colour % 2;
                    spread(static_cast<size_t>(z) * y_.count + y);
                });
            }
            team.each(slabs, [&](size_t s) { fold(s * rows / slabs, (s + 1) * rows / slabs); });
        });
    }

private:
    std::array<size_t, 2> range(size_t group) const {
        return {group * chunks_ / groups_, (group + 1) * chunks_ / groups_};
    }
    size_t tile_of(const Point<T>& p) const {
        return static_cast<size_t>(z_.of[p.at[0]]) * y_.count + y_.of[p.at[1]];
    }

    void clear(size_t first, size_t last) { std::memset(grid_ + first * g_.row, 0, (last - first) * g_.row * sizeof(T)); }

    void locate(size_t group) {
        const auto [begin, end] = range(group);
        const size_t last = std::min(e_.count, end * chunk);
        loops_.locate(e_, g_, begin * chunk, last, located_.get() + first_[begin]);
        size_t* counts = where_.data() + group * tiles_;
        for (size_t p = first_[begin]; p < first_[end]; ++p) ++counts[tile_of(located_[p])];
    }

    // From counts to where each group's points of a tile begin.
    void place() {
        size_t at = 0;
        start_.resize(tiles_ + 1);
        for (size_t tile = 0; tile < tiles_; ++tile) {
            start_[tile] = at;
            for (size_t group = 0; group < groups_; ++group) {
                const size_t n = where_[group * tiles_ + tile];
                where_[group * tiles_ + tile] = at;
                at += n;
            }
        }
        start_[tiles_] = at;
    }

    void sort(size_t group) {
        const auto [begin, end] = range(group);
        size_t* where = where_.data() + group * tiles_;
        for (size_t p = first_[begin]; p < first_[end]; ++p) sorted_[where[tile_of(located_[p])]++] = located_[p];
    }

    void spread(size_t tile) {
        loops_.spread(sorted_.get() + start_[tile], start_[tile + 1] - start_[tile], g_, vectors_, grid_);
    }

    // What reached beyond the end of a row belongs to its beginning.
    void fold(size_t first, size_t last) {
        const std::int64_t n = g_.shape[2];
        for (size_t r = first; r < last; ++r) {
            T* row = grid_ + r * g_.row;
            for (std::int64_t i = n; i < g_.row; ++i) row[i % n] += row[i];
        }
    }

    const Elements& e_;
    const Grid<T>& g_;
    const MeshLoops<T>& loops_;
    const double* vectors_;
    T* grid_;
    Parts z_, y_;
    size_t tiles_, chunks_, groups_ = 0;
    std::vector<size_t> first_, where_, start_;
    std::unique_ptr<Point<T>[]> located_, sorted_;
};

template <class T>
void gather(const Elements& e, const Grid<T>& g, const MeshLoops<T>& loops, T* field, bool derivatives, double* sums,
            Team& team) {
    const size_t rows = static_cast<size_t>(g.shape[0] * g.shape[1]), slabs = std::min<size_t>(rows, 64);
    team.run([&](int) {
        team.each(slabs, [&](size_t s) {
            for (size_t r = s * rows / slabs; r < (s + 1) * rows / slabs; ++r) {
                T* row = field + r * g.row;
                for (std::int64_t i = g.shape[2]; i < g.row; ++i) row[i] = row[i % g.shape[2]];
            }
        });
        team.each(chunks_of(e.count), [&](size_t c) {
            loops.gather(e, g, c * chunk, std::min(e.count, (c + 1) * chunk), field, derivatives, sums);
        });
    });
}

Measure measure_of(const Elements& e, size_t element) {
    const double* p[3];
    for (int i = 0; i < e.corners; ++i) p[i] = e.vertices + 3 * e.indices[element * e.corners + i];
    return measure(e.corners, p);
}

// Gradients of vertices and densities from what was gathered, (elements, corners, 4), overwritten.
// Corners are added to their vertices in the order of the elements.
void pull(const Elements& e, const double* density, double* sums, double* by_vertex, double* by_density, Team& team) {
    team.run([&](int) {
        team.each(chunks_of(e.count), [&](size_t c) {
            for (size_t element = c * chunk; element < std::min(e.count, (c + 1) * chunk); ++element) {
                double* s = sums + element * e.corners * 4;
                const Measure m = measure_of(e, element);
                double all = 0;
                for (int i = 0; i < e.corners; ++i) all += s[4 * i];
                by_density[element] = m.value * all;
                for (int i = 0; i < e.corners; ++i)
                    for (int k = 0; k < 3; ++k)
                        s[4 * i + 1 + k] = density[element] * (m.value * s[4 * i + 1 + k] + all * m.gradient[i][k]);
            }
        });
        team.once([&] {
            for (size_t corner = 0; corner < e.count * e.corners; ++corner)
                for (int k = 0; k < 3; ++k) by_vertex[3 * e.indices[corner] + k] += sums[4 * corner + 1 + k];
        });
    });
}

// Nanoseconds on one thread, about: of points, and of the grid.
template <class T>
double work_of(const Elements& e, const Grid<T>& g) {
    double points = 0;
    for (size_t i = 0; i < e.count; ++i) points += e.rule_start[e.rule[i] + 1] - e.rule_start[e.rule[i]];
    return 90.0 * points + 1.0 * g.shape[0] * g.shape[1] * g.shape[2];
}

template <class T>
void bind(nb::module_& m, const char* suffix) {
    using namespace deltamic_checks;
    const std::string s(suffix);
    using Shape = std::vector<std::int64_t>;
    using Coefficients = std::vector<Array<const double>>;
    m.def(("spread_" + s).c_str(),
          [](Array<const double> vertices, Array<const std::int64_t> indices, Array<const double> density,
             const Quadrature& q, const Shape& shape, const std::vector<double>& scale, const Coefficients& kernels,
             std::optional<Array<const double>> vectors, Array<T> out, int threads, const std::string& simd) {
              Elements e = elements_of(vertices, indices, density, q);
              const Kernels<T> k(shape, scale, kernels, vertices);
              if (vectors) {
                  has_shape(*vectors, "vectors", {e.count, 3});
                  within(*vectors, "vectors", -largest_strength, largest_strength);
              }
              thread_count(threads);
              const MeshLoops<T>& loops = mesh_loops_of<T>(simd);
              check_size(out, k.grid);
              std::vector<double> strengths(density.data(), density.data() + e.count);
              if (!vectors)
                  for (size_t i = 0; i < e.count; ++i) strengths[i] *= measure_of(e, i).value;
              e.strengths = strengths.data();
              nb::gil_scoped_release release;
              Team team(worth(work_of(e, k.grid), threads));
              Spreading<T>(e, k.grid, loops, vectors ? vectors->data() : nullptr, out.data()).run(team);
          },
          nb::arg("vertices"), nb::arg("indices"), nb::arg("density"), nb::arg("quadrature"), nb::arg("shape"),
          nb::arg("scale"), nb::arg("kernels"), nb::arg("vectors").none(), nb::arg("out").noconvert(), nb::arg("threads"),
          nb::arg("simd"));
    m.def(("gather_" + s).c_str(),
          [](Array<const double> vertices, Array<const std::int64_t> indices, Array<const double> density,
             const Quadrature& q, const Shape& shape, const std::vector<double>& scale, const Coefficients& kernels,
             Array<T> field, Array<double> sums, int threads, const std::string& simd) {
              const Elements e = elements_of(vertices, indices, density, q);
              const Kernels<T> k(shape, scale, kernels, vertices);
              check_size(field, k.grid);
              const size_t all = e.count * e.corners;
              require(sums.size() == all || sums.size() == 4 * all, "one sum, or four, per element and corner are needed");
              const bool derivatives = sums.size() > all;
              thread_count(threads);
              const MeshLoops<T>& loops = mesh_loops_of<T>(simd);
              nb::gil_scoped_release release;
              Team team(worth(work_of(e, k.grid), threads));
              gather(e, k.grid, loops, field.data(), derivatives, sums.data(), team);
          },
          nb::arg("vertices"), nb::arg("indices"), nb::arg("density"), nb::arg("quadrature"), nb::arg("shape"),
          nb::arg("scale"), nb::arg("kernels"), nb::arg("field").noconvert(), nb::arg("sums").noconvert(),
          nb::arg("threads"), nb::arg("simd"));
    m.def(("pull_" + s).c_str(),
          [](Array<const double> vertices, Array<const std::int64_t> indices, Array<const double> density,
             const Quadrature& q, const Shape& shape, const std::vector<double>& scale, const Coefficients& kernels,
             Array<T> field, Array<double> by_vertex, Array<double> by_density, int threads, const std::string& simd) {
              const Elements e = elements_of(vertices, indices, density, q);
              const Kernels<T> k(shape, scale, kernels, vertices);
              check_size(field, k.grid);
              has_shape(by_vertex, "gradient of the vertices", {vertices.shape(0), 3});
              has_shape(by_density, "gradient of the densities", {e.count});
              thread_count(threads);
              const MeshLoops<T>& loops = mesh_loops_of<T>(simd);
              nb::gil_scoped_release release;
              Team team(worth(work_of(e, k.grid), threads));
              const auto sums = uninitialised<double>(e.count * e.corners * 4);
              gather(e, k.grid, loops, field.data(), true, sums.get(), team);
              pull(e, density.data(), sums.get(), by_vertex.data(), by_density.data(), team);
          },
          nb::arg("vertices"), nb::arg("indices"), nb::arg("density"), nb::arg("quadrature"), nb::arg("shape"),
          nb::arg("scale"), nb::arg("kernels"), nb::arg("field").noconvert(), nb::arg("by_vertex").noconvert(),
          nb::arg("by_density").noconvert(), nb::arg("threads"), nb::arg("simd"));
}

}  // namespace

void bind_particle_mesh(nb::module_& m) {
    nb::class_<Quadrature>(m, "Quadrature", "Rules of quadrature, and which element takes which.")
        .def(nb::init<Array<const std::int32_t>, Array<const std::int64_t>, Array<const double>, Array<const double>>());
    bind<float>(m, "f32");
    bind<double>(m, "f64");
}
