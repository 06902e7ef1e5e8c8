// Whether an edge runs through a face, and a grid of faces that change one by one.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "boxes.h"
#include "distance.h"
#include "vec.h"

namespace deltamic_remesh {

// Touching counts, unless the edge lies within the plane of the face.
inline bool runs_through(Vec p, Vec q, Vec a, Vec b, Vec c) {
    const Vec u = q - p;
    const auto side = [&](Vec s, Vec t) { return dot(u, cross(s - p, t - p)); };
    const double x = side(a, b), y = side(b, c), z = side(c, a);
    if (!((x >= 0 && y >= 0 && z >= 0) || (x <= 0 && y <= 0 && z <= 0))) return false;
    const Vec n = cross(b - a, c - a);
    const double over = dot(n, p - a), under = dot(n, q - a);
    return (over >= 0 && under <= 0 && over > under) || (over <= 0 && under >= 0 && over < under);
}

// Whether an edge runs through a face, or comes as near to it.
inline bool meets(Vec p, Vec q, Vec a, Vec b, Vec c, double near) {
    if (runs_through(p, q, a, b, c)) return true;
    if (near <= 0) return false;
    const Vec n = cross(b - a, c - a);
    const double over = dot(n, p - a), under = dot(n, q - a), beyond = near * norm(n);
    if ((over > beyond && under > beyond) || (over < -beyond && under < -beyond)) return false;
    const double square = near * near;
    for (Vec end : {p, q}) {
        const Vec way = end - nearest_in_triangle(end, a, b, c);
        if (dot(way, way) <= square) return true;
    }
    return squared_between_segments(p, q, a, b) <= square || squared_between_segments(p, q, b, c) <= square ||
           squared_between_segments(p, q, c, a) <= square;
}

// A face: its vertices and where they lie.
struct Placed {
    std::array<std::int32_t, 3> vertex;
    std::array<Vec, 3> corner;

    Box box(double margin) const {
        Box b = Box::around(corner[0]);
        for (int k = 1; k < 3; ++k) b.take(Box::around(corner[k]));
        b.grow(margin);
        return b;
    }
    bool has(std::int32_t v) const { return vertex[0] == v || vertex[1] == v || vertex[2] == v; }
    // Whether an edge of this face meets the other; those that share a vertex do not count.
    bool reaches(const Placed& other, double near) const {
        for (int k = 0; k < 3; ++k) {
            const int l = (k + 1) % 3;
            if (other.has(vertex[k]) || other.has(vertex[l])) continue;
            if (meets(corner[k], corner[l], other.corner[0], other.corner[1], other.corner[2], near)) return true;
        }
        return false;
    }
    bool crosses(const Placed& other, double near) const { return reaches(other, near) || other.reaches(*this, near); }
};

// The faces in each cell of a regular grid; its side is near the wanted length of edges.
class FaceGrid {
public:
    FaceGrid(Box all, double side, std::size_t faces) : corner_(all.low) {
        const auto cells = [&](int k) { return std::floor((all.high[k] - all.low[k]) / side) + 1; };
        while (cells(0) * cells(1) * cells(2) > 8.0 * static_cast<double>(faces) + 4096) side *= 1.3;
        for (int k = 0; k < 3; ++k) shape_[k] = static_cast<std::int64_t>(cells(k));
        per_cell_ = 1 / side;
        cells_.resize(static_cast<std::size_t>(shape_[0] * shape_[1] * shape_[2]));
    }

    void put(std::int32_t face, const Box& box) {
        const auto f = static_cast<std::size_t>(face);
        if (f >= box_.size()) box_.resize(f + 1, nowhere), in_.resize(f + 1, 0);
        take_out(face);
        box_[f] = box;
        in_[f] = 1;
        for_cells(box, [&](std::size_t cell) { cells_[cell].push_back(face); });
    }
    void take_out(std::int32_t face) {
        const auto f = static_cast<std::size_t>(face);
        if (f >= in_.size() || !in_[f]) return;
        in_[f] = 0;
        for_cells(box_[f], [&](std::size_t cell) {
            auto& own = cells_[cell];
            *std::find(own.begin(), own.end(), face) = own.back();
            own.pop_back();
        });
    }
    // Whether f(face) holds for a face whose box meets this one.
    template <class F>
    bool any(const Box& box, F&& f) const {
        bool found = false;
        for_cells(box, [&](std::size_t cell) {
            if (found) return;
            for (std::int32_t face : cells_[cell])
                if (box_[static_cast<std::size_t>(face)].meets(box) && f(face)) {
                    found = true;
                    return;
                }
        });
        return found;
    }

private:
    static constexpr Box nowhere{{0, 0, 0}, {0, 0, 0}};
    std::array<double, 3> corner_;
    std::array<std::int64_t, 3> shape_{1, 1, 1};
    double per_cell_ = 1;
    std::vector<std::vector<std::int32_t>> cells_;
    std::vector<Box> box_;
    std::vector<char> in_;

    template <class F>
    void for_cells(const Box& b, F&& f) const {
        std::array<std::int64_t, 3> from{}, to{};
        for (int k = 0; k < 3; ++k) {
            const auto at = [&](double x) {
                const auto cell = static_cast<std::int64_t>((x - corner_[k]) * per_cell_);
                return std::clamp<std::int64_t>(cell, 0, shape_[k] - 1);
            };
            from[k] = at(b.low[k]);
            to[k] = at(b.high[k]);
        }
        for (std::int64_t z = from[0]; z <= to[0]; ++z)
            for (std::int64_t y = from[1]; y <= to[1]; ++y)
                for (std::int64_t x = from[2]; x <= to[2]; ++x)
                    f(static_cast<std::size_t>((z * shape_[1] + y) * shape_[2] + x));
    }
};

}  // namespace deltamic_remesh
