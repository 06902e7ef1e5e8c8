// Remeshing of surfaces whose faces separate two regions each and may meet in junctions.
//
// Edges get near a wanted length, triangles near equilateral, by four local operations that keep
// every region closed: edges that are too long are split, too short ones collapsed, diagonals
// flipped (Delaunay), vertices moved within the surface. Junctions, where faces of different pairs
// of regions meet, are only changed along themselves; the vertices where junctions meet stay.
// The operations are those of M. Botsch and L. Kobbelt, "A remeshing approach to multiresolution
// modeling", SGP 2004; the link condition for complexes with junctions is that of T. K. Dey et al.,
// "Topology preserving edge contraction", Publ. Inst. Math. 66, 1999.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "vec.h"

namespace deltamic_remesh {

struct Surface {
    std::vector<Vec> position;
    std::vector<std::array<std::int32_t, 3>> face;    // vertices
    std::vector<std::array<std::int32_t, 2>> region;  // the two sides of each face
    std::vector<double> length;                       // wanted edge length at each vertex
    std::vector<char> fixed;                          // vertices that neither move nor vanish; see Fixed
    std::size_t columns = 0;                          // numbers that each vertex carries along
    std::vector<double> carried;                      // (V, columns)
    std::vector<std::int32_t> origin;                 // the given vertex that each one is; -1: new
    std::vector<char> guard;                          // how near each vertex is to what may cross
};

// Of Surface::fixed; edges between two sealed vertices stay as they are.
enum Fixed : char { loose, held, sealed };

// Of Surface::guard: nothing is looked at; faces are looked at where others change; changes are
// looked at before they are made.
enum Guarded : char { away, seen, guarded };

struct Counts {
    std::int64_t splits = 0, collapses = 0, flips = 0;
};

// Each pass splits, collapses, flips and moves. Vertices and faces that are not used any more are
// gone from the surface afterwards; regions are written larger number first.
// apart: if above 0, no operation at a guarded vertex is done that makes an edge run through a face
// or come as near to one; the surface must be free of such places before.
Counts remesh(Surface& surface, int passes, bool smooth, double apart);

}  // namespace deltamic_remesh
