// Python bindings of the remesher and of what keeps surfaces apart.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <optional>

#include "bending.h"
#include "checks.h"
#include "connectivity.h"
#include "distance_transform.h"
#include "flooding.h"
#include "gaussian_blur.h"
#include "proximity.h"
#include "remesh.h"

namespace nb = nanobind;
using namespace deltamic_remesh;

namespace {

using namespace deltamic_checks;
template <class T>
using Given = deltamic_checks::Array<const T>;

// A new array with a copy of what lies there.
template <class T, class S>
nb::ndarray<nb::numpy, T> copied(const S* data, std::size_t rows, std::size_t columns) {
    T* own = new T[rows * columns + 1];
    for (std::size_t k = 0; k < rows * columns; ++k) own[k] = static_cast<T>(data[k]);
    nb::capsule owner(own, [](void* p) noexcept { delete[] static_cast<T*>(p); });
    return nb::ndarray<nb::numpy, T>(own, {rows, columns}, owner);
}

// Region numbers may be larger than the loops' 32 bits: there they are places in a sorted list.
class Regions {
public:
    explicit Regions(const Given<std::int64_t>& pairs) : numbers_(pairs.data(), pairs.data() + pairs.size()) {
        std::sort(numbers_.begin(), numbers_.end());
        numbers_.erase(std::unique(numbers_.begin(), numbers_.end()), numbers_.end());
        require(numbers_.empty() || numbers_.front() >= 0, "region numbers must be 0 or positive");
        // The usual case: no list is needed.
        if (numbers_.empty() || numbers_.back() < most_rows) numbers_.clear();
    }
    std::int32_t place(std::int64_t number) const {
        if (numbers_.empty()) return static_cast<std::int32_t>(number);
        return static_cast<std::int32_t>(std::lower_bound(numbers_.begin(), numbers_.end(), number) - numbers_.begin());
    }
    std::int64_t number(std::int32_t place) const {
        return numbers_.empty() ? place : numbers_[static_cast<std::size_t>(place)];
    }
    std::vector<Two> places(const Given<std::int64_t>& pairs) const {
        std::vector<Two> found(pairs.shape(0));
        for (std::size_t f = 0; f < found.size(); ++f)
            for (std::size_t k = 0; k < 2; ++k) found[f][k] = place(pairs.data()[2 * f + k]);
        return found;
    }

private:
    std::vector<std::int64_t> numbers_;
};

constexpr double shortest = 1e-12;      // um: an edge may be as long as this
constexpr double most_faces = 1 << 24;  // that a call may make

// No more than four faces come of one in a pass, nor many more than fit its area.
void check_growth(const Surface& s, int passes) {
    double expected = 0;
    const double at_most = std::pow(4.0, passes);
    for (const auto& c : s.face) {
        const Vec p = s.position[c[0]], u = s.position[c[1]] - p, v = s.position[c[2]] - p, n = cross(u, v);
        const double wanted = std::min({s.length[c[0]], s.length[c[1]], s.length[c[2]]});
        const double longest = std::max({norm(u), norm(v), norm(v - u)});
        expected += std::min(at_most, 4 * (norm(n) / wanted / wanted + longest / wanted + 1));
    }
    require(expected < most_faces, "the wanted edges are so short that the mesh would not fit the memory");
}

Surface surface_of(const Given<double>& vertices, const Given<std::int64_t>& faces, const Regions& names,
                   const Given<std::int64_t>& regions, const Given<double>& length, const Given<std::uint8_t>& fixed,
                   const Given<double>& carried, const Given<std::uint8_t>& guard) {
    Surface s;
    const std::size_t n = places_in(vertices), m = joined_in(faces, "faces", 3, n);
    has_shape(regions, "regions", {m, 2});
    has_shape(length, "edge lengths", {n});
    has_shape(fixed, "fixed", {n});
    has_shape(guard, "guard", {n});
    require(carried.ndim() == 2 && carried.shape(0) == n && carried.shape(1) < 4096, "carried: (V, C)");
    within(length, "edge lengths", shortest, farthest);
    within(fixed, "fixed", 0, sealed);
    within(guard, "guard", 0, guarded);
    const double* v = vertices.data();
    s.position.resize(n);
    for (std::size_t i = 0; i < n; ++i) s.position[i] = {v[3 * i], v[3 * i + 1], v[3 * i + 2]};
    s.face.resize(m);
    for (std::size_t f = 0; f < m; ++f) {
        const std::int64_t* c = faces.data() + 3 * f;
        require(c[0] != c[1] && c[1] != c[2] && c[2] != c[0], "a face has the same vertex twice");
        for (int k = 0; k < 3; ++k) s.face[f][k] = static_cast<std::int32_t>(c[k]);
    }
    s.region = names.places(regions);
    s.length.assign(length.data(), length.data() + n);
    s.fixed.assign(fixed.data(), fixed.data() + n);
    s.columns = carried.shape(1);
    s.carried.assign(carried.data(), carried.data() + n * s.columns);
    s.guard.assign(guard.data(), guard.data() + n);
    s.origin.resize(n);
    std::iota(s.origin.begin(), s.origin.end(), 0);
    return s;
}

std::vector<Vec> places_of(const Given<double>& vertices) {
    places_in(vertices);
    const double* v = vertices.data();
    std::vector<Vec> places(vertices.shape(0));
    for (std::size_t i = 0; i < places.size(); ++i) places[i] = {v[3 * i], v[3 * i + 1], v[3 * i + 2]};
    return places;
}

// Checked before.
template <std::size_t n>
std::vector<std::array<std::int32_t, n>> table_of(const Given<std::int64_t>& numbers) {
    std::vector<std::array<std::int32_t, n>> rows(numbers.shape(0));
    for (std::size_t i = 0; i < rows.size(); ++i)
        for (std::size_t k = 0; k < n; ++k) rows[i][k] = static_cast<std::int32_t>(numbers.data()[n * i + k]);
    return rows;
}

}  // namespace

NB_MODULE(_remesh, m) {
    m.doc() = "The remesher, the guard against crossings and the flood of images; use napari_deltamic.geometry instead.";
    m.def("remesh", [](Given<double> vertices, Given<std::int64_t> faces, Given<std::int64_t> regions,
                       Given<double> length, Given<std::uint8_t> fixed, Given<double> carried,
                       Given<std::uint8_t> guard, int passes, bool smooth, double apart) {
        const Regions names(regions);
        Surface s = surface_of(vertices, faces, names, regions, length, fixed, carried, guard);
        require(passes >= 0 && passes <= 1000, "passes: 0 to 1000");
        within(apart, "apart", 0, farthest);
        check_growth(s, passes);
        Counts c;
        {
            nb::gil_scoped_release others_may_run;
            c = remesh(s, passes, smooth, apart);
        }
        const std::size_t n = s.position.size(), m = s.face.size();
        std::vector<std::int64_t> sides;
        for (const Two& pair : s.region)
            for (std::int32_t place : pair) sides.push_back(names.number(place));
        return nb::make_tuple(
            copied<double>(n ? &s.position.data()->z : nullptr, n, 3),
            copied<std::int64_t>(m ? s.face.data()->data() : nullptr, m, 3),
            copied<std::int64_t>(sides.data(), m, 2), copied<std::uint8_t>(s.fixed.data(), n, 1),
            copied<double>(s.carried.data(), n, s.columns), copied<std::int64_t>(s.origin.data(), n, 1),
            nb::make_tuple(c.splits, c.collapses, c.flips));
    }, nb::arg("vertices"), nb::arg("faces"), nb::arg("regions"), nb::arg("length"), nb::arg("fixed"), nb::arg("carried"),
          nb::arg("guard"), nb::arg("passes"), nb::arg("smooth"), nb::arg("apart"));
    m.def("crossings", [](Given<double> vertices, Given<std::int64_t> edges, Given<std::int64_t> faces, double near) {
        const auto places = places_of(vertices);
        joined_in(edges, "edges", 2, places.size());
        joined_in(faces, "faces", 3, places.size());
        within(near, "near", 0, farthest);
        const auto lines = table_of<2>(edges);
        const auto triangles = table_of<3>(faces);
        std::vector<Two> found;
        {
            nb::gil_scoped_release others_may_run;
            found = crossings(places, lines, triangles, near);
        }
        return copied<std::int64_t>(found.empty() ? nullptr : found.data()->data(), found.size(), 2);
    }, nb::arg("vertices"), nb::arg("edges"), nb::arg("faces"), nb::arg("near") = 0.0);
    m.def("near_faces", [](Given<double> query, Given<double> vertices, Given<std::int64_t> faces, double reach) {
        const auto queries = places_of(query), places = places_of(vertices);
        joined_in(faces, "faces", 3, places.size());
        within(reach, "reach", 0, farthest);
        const auto triangles = table_of<3>(faces);
        std::vector<Near> found;
        {
            nb::gil_scoped_release others_may_run;
            found = near_faces(queries, places, triangles, reach);
        }
        std::vector<Two> pairs;
        std::vector<Vec> points;
        for (const Near& n : found) pairs.push_back({n.point, n.face}), points.push_back(n.place);
        return nb::make_tuple(copied<std::int64_t>(pairs.empty() ? nullptr : pairs.data()->data(), pairs.size(), 2),
                              copied<double>(points.empty() ? nullptr : &points.data()->z, points.size(), 3));
    });
    m.def("bending", [](Given<double> vertices, Given<std::int64_t> faces, Given<double> smooth,
                        Given<std::int64_t> wall, Given<double> side, std::int64_t walls, double own) {
        const auto n = static_cast<std::int64_t>(places_in(vertices));
        const auto f = static_cast<std::int64_t>(joined_in(faces, "faces", 3, vertices.shape(0)));
        has_shape(smooth, "smooth", {vertices.shape(0)});
        within(smooth, "smooth", 0, 1);
        has_shape(wall, "wall", {vertices.shape(0)});
        has_shape(side, "side", {faces.shape(0)});
        within(side, "side", -1, 1);
        require(walls >= 0 && walls <= f, "there are more walls than faces");
        require(own >= 0 && own < 1e30, "own must be an area");
        for (std::int64_t v = 0; v < n; ++v)
            require(wall.data()[v] >= -1 && wall.data()[v] < walls, "a vertex names a wall that is not there");
        const deltamic_bending::Walls of{walls, wall.data(), side.data(), own};
        std::vector<double> gradient(3 * n);
        double energy = 0;
        {
            nb::gil_scoped_release others_may_run;
            energy = deltamic_bending::bending(vertices.data(), n, faces.data(), f, smooth.data(), of, gradient.data());
        }
        return nb::make_tuple(energy, copied<double>(gradient.data(), n, 3));
    });
    m.def("region_pieces", [](Given<std::int64_t> face_edges, Given<std::int64_t> regions, std::size_t edges) {
        const std::size_t f = rows_of(face_edges, "edges of faces", 3);
        has_shape(regions, "regions", {f, 2});
        require(edges <= 3 * f, "there are more edges than corners of faces");
        below(face_edges, edges, "a face names an edge that is not there");
        const auto pieces = region_pieces(table_of<3>(face_edges), Regions(regions).places(regions), edges);
        return copied<std::int64_t>(pieces.data(), pieces.size() / 2, 2);
    });
    m.def("connected", [](Given<std::int64_t> links, std::size_t count) {
        const std::size_t n = rows_of(links, "links", 2);
        require(static_cast<std::int64_t>(count) < most_rows, "too many to link");
        below(links, count, "a link names what is not there");
        Sets sets(count);
        for (std::size_t i = 0; i < n; ++i)
            sets.join(static_cast<std::int32_t>(links.data()[2 * i]), static_cast<std::int32_t>(links.data()[2 * i + 1]));
        const auto number = sets.numbers();
        return copied<std::int64_t>(number.data(), number.size(), 1);
    });
    m.def("flooded", [](Given<std::uint16_t> levels) {
        require(levels.ndim() == 3 && levels.size() > 0, "levels: (Z, Y, X)");
        deltamic_flooding::Tree tree;
        {
            nb::gil_scoped_release others_may_run;
            tree = deltamic_flooding::flooded(levels.data(), levels.shape(0), levels.shape(1), levels.shape(2));
        }
        const auto n = tree.parent.size();
        return nb::make_tuple(copied<std::int64_t>(tree.parent.data(), n, 1), copied<std::int64_t>(tree.order.data(), n, 1));
    });
    m.def("distance_transform", [](Given<std::uint8_t> mask, std::array<double, 3> size, Array<double> distance,
                                   std::optional<Array<std::int64_t>> nearest, int threads) {
        require(mask.ndim() == 3 && mask.size() > 0, "mask: (Z, Y, X)");
        const std::array<std::size_t, 3> shape{mask.shape(0), mask.shape(1), mask.shape(2)};
        has_shape(distance, "distance", {shape[0], shape[1], shape[2]});
        if (nearest) has_shape(*nearest, "nearest", {shape[0], shape[1], shape[2]});
        for (const double s : size) require(s > 0 && s <= farthest, "voxels must have a size");
        thread_count(threads);
        nb::gil_scoped_release others_may_run;
        deltamic_distances::distance_transform(mask.data(), shape, size, distance.data(), nearest ? nearest->data() : nullptr,
                                               threads);
    }, nb::arg("mask"), nb::arg("size"), nb::arg("distance"), nb::arg("nearest").none(), nb::arg("threads"));
    m.def("blur", [](Given<float> image, std::array<std::vector<float>, 3> weights, Array<float> to, int threads) {
        require(image.ndim() == 3 && image.size() > 0, "image: (Z, Y, X)");
        const std::array<std::size_t, 3> shape{image.shape(0), image.shape(1), image.shape(2)};
        has_shape(to, "to", {shape[0], shape[1], shape[2]});
        require(image.data() != to.data(), "the result needs an array of its own");
        thread_count(threads);
        nb::gil_scoped_release others_may_run;
        deltamic_blur::blur(image.data(), shape, weights, to.data(), threads);
    });
    nb::class_<Guard>(m, "Guard")
        .def("__init__",
             [](Guard* self, Given<std::int64_t> edges, Given<std::int64_t> faces, Given<double> near, double contact,
                double touch, Given<std::int64_t> wall, Given<std::uint8_t> unguarded) {
                 const std::size_t v = near.shape(0);
                 has_shape(near, "near", {near.size()});
                 within(near, "near", 0, farthest);
                 joined_in(edges, "edges", 2, v);
                 const std::size_t f = joined_in(faces, "faces", 3, v);
                 within(contact, "contact", 0, farthest);
                 within(touch, "touch", 0, farthest);
                 // (walls, walls), flat.
                 const auto walls = static_cast<std::size_t>(std::llround(std::sqrt(static_cast<double>(unguarded.size()))));
                 has_shape(unguarded, "unguarded", {walls * walls});
                 has_shape(wall, "wall", {f});
                 if (walls) below(wall, walls, "a face names a wall that is not there");
                 new (self) Guard(table_of<2>(edges), table_of<3>(faces), {near.data(), near.data() + near.size()}, contact, touch,
                                  {wall.data(), wall.data() + wall.size()},
                                  {unguarded.data(), unguarded.data() + unguarded.size()});
             })
        .def("limit",
             [](Guard& self, Given<double> start, Given<double> end) {
                 require(start.ndim() == 2 && end.ndim() == 2 && start.shape(0) == self.centers().size() &&
                             end.shape(0) == start.shape(0),
                         "one start and one end per vertex are needed");
                 const auto from = places_of(start);
                 auto to = places_of(end);
                 std::int64_t held = 0;
                 {
                     nb::gil_scoped_release others_may_run;
                     held = self.limit(from, to);
                 }
                 return nb::make_tuple(copied<double>(to.empty() ? nullptr : &to.data()->z, to.size(), 3), held);
             })
        .def("balls",
             [](const Guard& self) {
                 const auto& c = self.centers();
                 const auto& r = self.radii();
                 return nb::make_tuple(copied<double>(c.empty() ? nullptr : &c.data()->z, c.size(), 3),
                                       copied<double>(r.data(), r.size(), 1));
             })
        .def_ro("renewed", &Guard::renewed)
        .def_ro("work", &Guard::work);
}
