// The component tree of the sub-level sets of an image: how its dark parts join as it is flooded.
#pragma once
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <utility>
#include <vector>

namespace deltamic_flooding {

// For each voxel, the next one of its component: that of its level, or the component that holds it.
// By union-find over voxels in the order of their levels, with union by rank (C. Berger et al.,
// "Effective component tree computation", ICIP 2007). Voxels are neighbours if they share a face.
struct Tree {
    std::vector<std::int64_t> parent;
    std::vector<std::int64_t> order;  // the root first, parents before their children
};

class Sets {
public:
    explicit Sets(std::size_t count) : above_(count), rank_(count, 0) { std::iota(above_.begin(), above_.end(), std::size_t{0}); }
    std::size_t root(std::size_t i) {
        while (above_[i] != i) i = above_[i] = above_[above_[i]];
        return i;
    }
    // Joins two roots; the one that stays a root.
    std::size_t join(std::size_t a, std::size_t b) {
        if (rank_[a] < rank_[b]) std::swap(a, b);
        if (rank_[a] == rank_[b]) ++rank_[a];
        return above_[b] = a;
    }

private:
    std::vector<std::size_t> above_;
    std::vector<std::uint8_t> rank_;
};

// Voxels from the lowest level to the highest; of one level, in the order of the image.
inline std::vector<std::size_t> by_level(const std::uint16_t* level, std::size_t count) {
    std::vector<std::size_t> first(65537, 0), order(count);
    for (std::size_t i = 0; i < count; ++i) ++first[level[i] + 1u];
    std::partial_sum(first.begin(), first.end(), first.begin());
    for (std::size_t i = 0; i < count; ++i) order[first[level[i]]++] = i;
    return order;
}

inline Tree flooded(const std::uint16_t* level, std::size_t nz, std::size_t ny, std::size_t nx) {
    const std::size_t count = nz * ny * nx;
    const std::vector<std::size_t> rising = by_level(level, count);
    Tree tree{std::vector<std::int64_t>(count), std::vector<std::int64_t>(count)};
    Sets sets(count);
    std::vector<std::size_t> highest(count);  // of each root: the voxel that its component got last
    std::vector<bool> wet(count, false);
    for (const std::size_t here : rising) {
        tree.parent[here] = static_cast<std::int64_t>(here);
        highest[here] = here;
        wet[here] = true;
        std::size_t own = here;
        const auto meet = [&](std::size_t other) {
            if (!wet[other]) return;
            const std::size_t root = sets.root(other);
            if (root == own) return;
            tree.parent[highest[root]] = static_cast<std::int64_t>(here);
            own = sets.join(root, own);
            highest[own] = here;
        };
        const std::size_t x = here % nx, y = here / nx % ny, z = here / (nx * ny);
        if (x > 0) meet(here - 1);
        if (x + 1 < nx) meet(here + 1);
        if (y > 0) meet(here - nx);
        if (y + 1 < ny) meet(here + nx);
        if (z > 0) meet(here - nx * ny);
        if (z + 1 < nz) meet(here + nx * ny);
    }
    for (std::size_t i = 0; i < count; ++i) {  // from the root on, so that each level has one node
        const std::size_t here = rising[count - 1 - i];
        const auto up = static_cast<std::size_t>(tree.parent[here]);
        const auto further = static_cast<std::size_t>(tree.parent[up]);
        if (level[further] == level[up]) tree.parent[here] = tree.parent[up];
        tree.order[i] = static_cast<std::int64_t>(here);
    }
    return tree;
}

}  // namespace deltamic_flooding
