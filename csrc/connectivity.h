// Which faces belong together.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <utility>
#include <vector>

namespace deltamic_remesh {

// Sets that grow together (union-find with path halving); the smallest member names a set.
class Sets {
public:
    explicit Sets(std::size_t n) : above_(n) { std::iota(above_.begin(), above_.end(), 0); }

    std::int32_t name(std::int32_t i) {
        while (above_[i] != i) i = above_[i] = above_[above_[i]];
        return i;
    }
    void join(std::int32_t i, std::int32_t j) {
        i = name(i);
        j = name(j);
        if (i < j) std::swap(i, j);
        above_[i] = j;
    }
    // Numbers from 0 on, in the order of first members.
    std::vector<std::int32_t> numbers() {
        std::vector<std::int32_t> number(above_.size());
        std::int32_t count = 0;
        for (std::size_t i = 0; i < above_.size(); ++i) {
            const auto own = static_cast<std::int32_t>(i), first = name(own);
            number[i] = first == own ? count++ : number[first];
        }
        return number;
    }

private:
    std::vector<std::int32_t> above_;
};

// The piece of a region's surface on each side of each face: faces of a region that share an edge
// are in one piece. (2 F): sides of face after face.
inline std::vector<std::int32_t> region_pieces(const std::vector<std::array<std::int32_t, 3>>& face_edges,
                                               const std::vector<std::array<std::int32_t, 2>>& regions,
                                               std::size_t edges) {
    std::vector<std::int32_t> begin(edges + 1, 0), face(3 * face_edges.size());
    for (const auto& own : face_edges)
        for (std::int32_t e : own) ++begin[e + 1];
    std::partial_sum(begin.begin(), begin.end(), begin.begin());
    std::vector<std::int32_t> next(begin.begin(), begin.end() - 1);
    for (std::size_t f = 0; f < face_edges.size(); ++f)
        for (std::int32_t e : face_edges[f]) face[next[e]++] = static_cast<std::int32_t>(f);
    Sets sides(2 * face_edges.size());
    for (std::size_t e = 0; e < edges; ++e)
        for (std::int32_t i = begin[e]; i < begin[e + 1]; ++i)
            for (std::int32_t j = i + 1; j < begin[e + 1]; ++j)
                for (int k = 0; k < 2; ++k)
                    for (int l = 0; l < 2; ++l)
                        if (regions[face[i]][k] == regions[face[j]][l]) sides.join(2 * face[i] + k, 2 * face[j] + l);
    return sides.numbers();
}

}  // namespace deltamic_remesh
