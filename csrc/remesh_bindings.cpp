// Python bindings of the remesher and of what keeps surfaces apart.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstdint>
#include <numeric>

#include "bending.h"
#include "connectivity.h"
#include "proximity.h"
#include "remesh.h"

namespace nb = nanobind;
using namespace deltamic_remesh;

namespace {

template <class T>
using Array = nb::ndarray<const T, nb::c_contig, nb::device::cpu>;

// A new array with a copy of what lies there.
template <class T, class S>
nb::ndarray<nb::numpy, T> copied(const S* data, std::size_t rows, std::size_t columns) {
    T* own = new T[rows * columns + 1];
    for (std::size_t k = 0; k < rows * columns; ++k) own[k] = static_cast<T>(data[k]);
    nb::capsule owner(own, [](void* p) noexcept { delete[] static_cast<T*>(p); });
    return nb::ndarray<nb::numpy, T>(own, {rows, columns}, owner);
}

Surface surface_of(Array<double> vertices, Array<std::int64_t> faces, Array<std::int64_t> regions,
                   Array<double> length, Array<std::uint8_t> fixed, Array<double> carried,
                   Array<std::uint8_t> guard) {
    Surface s;
    const std::size_t n = vertices.shape(0), m = faces.shape(0);
    const double* v = vertices.data();
    s.position.resize(n);
    for (std::size_t i = 0; i < n; ++i) s.position[i] = {v[3 * i], v[3 * i + 1], v[3 * i + 2]};
    s.face.resize(m);
    s.region.resize(m);
    for (std::size_t f = 0; f < m; ++f) {
        for (int k = 0; k < 3; ++k) s.face[f][k] = static_cast<std::int32_t>(faces.data()[3 * f + k]);
        for (int k = 0; k < 2; ++k) s.region[f][k] = static_cast<std::int32_t>(regions.data()[2 * f + k]);
    }
    s.length.assign(length.data(), length.data() + n);
    s.fixed.assign(fixed.data(), fixed.data() + n);
    s.columns = carried.shape(1);
    s.carried.assign(carried.data(), carried.data() + n * s.columns);
    s.guard.assign(guard.data(), guard.data() + n);
    s.origin.resize(n);
    std::iota(s.origin.begin(), s.origin.end(), 0);
    return s;
}

std::vector<Vec> places_of(Array<double> vertices) {
    const double* v = vertices.data();
    std::vector<Vec> places(vertices.shape(0));
    for (std::size_t i = 0; i < places.size(); ++i) places[i] = {v[3 * i], v[3 * i + 1], v[3 * i + 2]};
    return places;
}

template <std::size_t n>
std::vector<std::array<std::int32_t, n>> rows_of(Array<std::int64_t> numbers) {
    std::vector<std::array<std::int32_t, n>> rows(numbers.shape(0));
    for (std::size_t i = 0; i < rows.size(); ++i)
        for (std::size_t k = 0; k < n; ++k) rows[i][k] = static_cast<std::int32_t>(numbers.data()[n * i + k]);
    return rows;
}

}  // namespace

NB_MODULE(_remesh, m) {
    m.doc() = "The remesher and the guard against crossings; use napari_deltamic.geometry instead.";
    m.def("remesh", [](Array<double> vertices, Array<std::int64_t> faces, Array<std::int64_t> regions,
                       Array<double> length, Array<std::uint8_t> fixed, Array<double> carried,
                       Array<std::uint8_t> guard, int passes, bool smooth, double apart) {
        Surface s = surface_of(vertices, faces, regions, length, fixed, carried, guard);
        Counts c;
        {
            nb::gil_scoped_release others_may_run;
            c = remesh(s, passes, smooth, apart);
        }
        const std::size_t n = s.position.size(), m = s.face.size();
        return nb::make_tuple(
            copied<double>(n ? &s.position.data()->z : nullptr, n, 3),
            copied<std::int64_t>(m ? s.face.data()->data() : nullptr, m, 3),
            copied<std::int64_t>(m ? s.region.data()->data() : nullptr, m, 2), copied<std::uint8_t>(s.fixed.data(), n, 1),
            copied<double>(s.carried.data(), n, s.columns), copied<std::int64_t>(s.origin.data(), n, 1),
            nb::make_tuple(c.splits, c.collapses, c.flips));
    }, nb::arg("vertices"), nb::arg("faces"), nb::arg("regions"), nb::arg("length"), nb::arg("fixed"), nb::arg("carried"),
          nb::arg("guard"), nb::arg("passes"), nb::arg("smooth"), nb::arg("apart"));
    m.def("crossings", [](Array<double> vertices, Array<std::int64_t> edges, Array<std::int64_t> faces, double near) {
        const auto places = places_of(vertices);
        const auto lines = rows_of<2>(edges);
        const auto triangles = rows_of<3>(faces);
        std::vector<Two> found;
        {
            nb::gil_scoped_release others_may_run;
            found = crossings(places, lines, triangles, near);
        }
        return copied<std::int64_t>(found.empty() ? nullptr : found.data()->data(), found.size(), 2);
    }, nb::arg("vertices"), nb::arg("edges"), nb::arg("faces"), nb::arg("near") = 0.0);
    m.def("near_faces", [](Array<double> query, Array<double> vertices, Array<std::int64_t> faces, double reach) {
        const auto queries = places_of(query), places = places_of(vertices);
        const auto triangles = rows_of<3>(faces);
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
    m.def("bending", [](Array<double> vertices, Array<std::int64_t> faces, Array<double> smooth) {
        const std::int64_t n = static_cast<std::int64_t>(vertices.shape(0)), f = static_cast<std::int64_t>(faces.shape(0));
        std::vector<double> gradient(3 * n);
        double energy = 0;
        {
            nb::gil_scoped_release others_may_run;
            energy = deltamic_bending::bending(vertices.data(), n, faces.data(), f, smooth.data(), gradient.data());
        }
        return nb::make_tuple(energy, copied<double>(gradient.data(), n, 3));
    });
    m.def("region_pieces", [](Array<std::int64_t> face_edges, Array<std::int64_t> regions, std::size_t edges) {
        const auto pieces = region_pieces(rows_of<3>(face_edges), rows_of<2>(regions), edges);
        return copied<std::int64_t>(pieces.data(), pieces.size() / 2, 2);
    });
    nb::class_<Guard>(m, "Guard")
        .def("__init__",
             [](Guard* self, Array<std::int64_t> edges, Array<std::int64_t> faces, Array<double> near, double contact,
                double touch, Array<std::int64_t> wall, Array<std::uint8_t> unguarded) {
                 new (self) Guard(rows_of<2>(edges), rows_of<3>(faces), {near.data(), near.data() + near.size()}, contact, touch,
                                  {wall.data(), wall.data() + wall.size()},
                                  {unguarded.data(), unguarded.data() + unguarded.size()});
             })
        .def("limit",
             [](Guard& self, Array<double> start, Array<double> end) {
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
