// Python bindings of the remesher.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstdint>

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
                   Array<double> length, Array<std::uint8_t> fixed, Array<double> carried) {
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
    return s;
}

}  // namespace

NB_MODULE(_remesh, m) {
    m.doc() = "The remesher; use napari_deltamic.geometry.remesh instead.";
    m.def("remesh", [](Array<double> vertices, Array<std::int64_t> faces, Array<std::int64_t> regions,
                       Array<double> length, Array<std::uint8_t> fixed, Array<double> carried, int passes, bool smooth) {
        Surface s = surface_of(vertices, faces, regions, length, fixed, carried);
        Counts c;
        {
            nb::gil_scoped_release others_may_run;
            c = remesh(s, passes, smooth);
        }
        const std::size_t n = s.position.size(), m = s.face.size();
        return nb::make_tuple(
            copied<double>(n ? &s.position.data()->z : nullptr, n, 3),
            copied<std::int64_t>(m ? s.face.data()->data() : nullptr, m, 3),
            copied<std::int64_t>(m ? s.region.data()->data() : nullptr, m, 2), copied<std::uint8_t>(s.fixed.data(), n, 1),
            copied<double>(s.carried.data(), n, s.columns), nb::make_tuple(c.splits, c.collapses, c.flips));
    });
}
