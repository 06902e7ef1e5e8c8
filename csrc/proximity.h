// Which parts of a triangle mesh come near each other, cross, or would collide during a step.
//
// Two triangles that do not share a vertex can only come to cross if a vertex meets a face or an
// edge meets an edge, so these are the pairs looked at; those that share a vertex are left out.
#pragma once

#include <array>
#include <cstdint>
#include <utility>
#include <vector>

#include "boxes.h"

namespace deltamic_remesh {

using Triple = std::array<std::int32_t, 3>;

// (edge, face) of every edge that runs through a face or comes as near to one.
std::vector<Two> crossings(const std::vector<Vec>& place, const std::vector<Two>& edges,
                           const std::vector<Triple>& faces, double near);

// A face near a point, and its point nearest to it.
struct Near {
    std::int32_t point, face;
    Vec place;
};
std::vector<Near> near_faces(const std::vector<Vec>& points, const std::vector<Vec>& place,
                             const std::vector<Triple>& faces, double reach);

// Shortens steps so that nothing comes to cross.
//
// Each vertex has a ball in which it may move at will: as long as all stay in theirs, no pair can
// meet, because the radii are at most half the distance of any pair that the vertex is part of.
// Only vertices that leave their ball are looked at: pairs around them are tested, the relative
// motion of a pair against its distance first, then by the additive continuous test of M. Li et
// al., "Codimensional Incremental Potential Contact", ACM Trans. Graph. 40, 2021; and they get
// new balls. The work of a step is at most proportional to the size of the mesh: what cannot be
// looked at for that stays where it was.
class Guard {
public:
    // near: of each vertex, the distance up to which its pairs are looked at; contact: pairs this near that approach stop;
    // touch: pairs this near cross as good as. wall: one number for each face; pairs of walls with
    // a nonzero entry in `unguarded`, (walls, walls), are left alone.
    Guard(std::vector<Two> edges, std::vector<Triple> faces, std::vector<double> near, double contact,
          double touch, std::vector<std::int32_t> wall, std::vector<std::uint8_t> unguarded);

    // `end` becomes what each vertex may reach from `start`; how many were held back.
    std::int64_t limit(const std::vector<Vec>& start, std::vector<Vec>& end);

    // Where each vertex may move at will; a negative radius: nowhere yet.
    const std::vector<Vec>& centers() const { return center_; }
    const std::vector<double>& radii() const { return radius_; }

    std::int64_t renewed = 0;  // balls made anew, in all
    std::int64_t work = 0;     // couples of boxes and distances looked at, in all

private:
    struct Pair {
        std::array<std::int32_t, 4> v;
        bool edges;
    };
    std::vector<Two> edges_;
    std::vector<Triple> faces_;
    std::vector<double> near_;
    double contact_, touch_;
    std::vector<std::vector<std::int32_t>> walls_of_vertex_, walls_of_edge_;
    std::vector<std::int32_t> wall_;
    std::vector<std::uint8_t> unguarded_;
    std::size_t walls_ = 0;
    std::vector<Vec> center_;
    std::vector<double> radius_;

    // Pairs that could meet before one of the vertices has left its ball, old or new. False if
    // there are too many to look at: then the vertices that must stay are refused.
    bool pairs(const std::vector<Vec>& start, const std::vector<Vec>& end, const std::vector<char>& active,
               double reach, std::vector<Pair>& found, std::vector<char>& refused);
    bool left_alone(const std::vector<std::int32_t>& a, const std::vector<std::int32_t>& b) const;
    void shorten(const std::vector<Pair>& near, const std::vector<double>& distance, const std::vector<Vec>& start,
                 const std::vector<Vec>& end, std::vector<double>& share);
};

}  // namespace deltamic_remesh
