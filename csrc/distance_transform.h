// Distance of each voxel of a mask to the nearest voxel outside it.
//
// Exact, one axis after the other, each line as the lower envelope of parabolas (P. Felzenszwalb and
// D. Huttenlocher, "Distance transforms of sampled functions", Theory of Computing 8, 2012). Lines do
// not depend on each other, so the result does not depend on the number of threads.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "team.h"

namespace deltamic_distances {

constexpr double none = std::numeric_limits<double>::infinity();
constexpr std::size_t together = 16;  // columns read side by side along y: two cache lines of them
constexpr double cost = 10;           // ns per voxel, measured

// What a worker needs for lines of at most n voxels, and for rows of nx along z. Made before the
// threads are, in which nothing can be told of memory that runs out.
struct Scratch {
    Scratch(std::size_t n, std::size_t nx) : site(n), from(n + 1), before(n), at(n), last(nx) {}
    std::vector<std::size_t> site;    // where the parabolas of the envelope have their minima
    std::vector<double> from;         // where each begins to be the lowest
    std::vector<double> before;       // the line before this axis
    std::vector<std::int64_t> at;     // and its nearest voxels
    std::vector<std::int64_t> last;   // the last voxel outside, of each column
};

// One line, `apart` numbers between voxels: squared distances, and the nearest voxels if they are asked
// for, with one more axis.
inline void add_axis(double* squared, std::int64_t* nearest, std::size_t n, std::size_t apart, double size, Scratch& s) {
    std::size_t count = 0;
    const double twice = 2 * size * size;
    for (std::size_t q = 0; q < n; ++q) {
        const double own = s.before[q] = squared[q * apart];
        if (nearest) s.at[q] = nearest[q * apart];
        if (own == none) continue;
        double meet = -none;
        for (; count > 0; --count) {
            const std::size_t p = s.site[count - 1];
            // Half way, and off it: squares of places would cost digits along long axes.
            meet = (own - s.before[p]) / (twice * static_cast<double>(q - p)) + 0.5 * static_cast<double>(p + q);
            if (meet > s.from[count - 1]) break;
        }
        s.site[count] = q;
        s.from[count] = count == 0 ? -none : meet;
        ++count;
    }
    if (count == 0) return;
    std::size_t k = 0;
    for (std::size_t i = 0; i < n; ++i) {
        while (k + 1 < count && s.from[k + 1] < static_cast<double>(i)) ++k;
        const std::size_t p = s.site[k];
        const double along = (static_cast<double>(i) - static_cast<double>(p)) * size;
        squared[i * apart] = s.before[p] + along * along;
        if (nearest) nearest[i * apart] = s.at[p];
    }
}

// The columns along z of one y, the first axis.
inline void begin(const std::uint8_t* mask, double* squared, std::int64_t* nearest, const std::array<std::size_t, 3>& shape,
                  std::size_t y, double size, std::vector<std::int64_t>& last) {
    const std::size_t nz = shape[0], nx = shape[2], plane = shape[1] * nx;
    const auto column = static_cast<std::int64_t>(y * nx);
    std::fill(last.begin(), last.end(), -1);
    for (std::size_t z = 0; z < nz; ++z) {  // the last voxel outside, up to here
        const std::size_t row = z * plane + y * nx;
        for (std::size_t x = 0; x < nx; ++x) {
            if (!mask[row + x]) last[x] = static_cast<std::int64_t>(z);
            squared[row + x] = static_cast<double>(last[x]);
        }
    }
    std::fill(last.begin(), last.end(), -1);
    for (std::size_t z = nz; z-- > 0;) {
        const std::size_t row = z * plane + y * nx;
        const auto here = static_cast<std::int64_t>(z);
        for (std::size_t x = 0; x < nx; ++x) {
            if (!mask[row + x]) last[x] = here;
            const auto below = static_cast<std::int64_t>(squared[row + x]);
            const std::int64_t down = below < 0 ? static_cast<std::int64_t>(nz) : here - below;
            const std::int64_t up = last[x] < 0 ? static_cast<std::int64_t>(nz) : last[x] - here;
            const double along = static_cast<double>(std::min(down, up)) * size;
            const bool any = below >= 0 || last[x] >= 0;
            squared[row + x] = any ? along * along : none;
            const std::int64_t at = down <= up ? below : last[x];
            if (nearest) nearest[row + x] = at * static_cast<std::int64_t>(plane) + column + static_cast<std::int64_t>(x);
        }
    }
}

// distance : (Z, Y, X). nearest : (Z, Y, X) places of the nearest voxels in the flat image, or null.
// Something lies outside the mask.
inline void distance_transform(const std::uint8_t* mask, const std::array<std::size_t, 3>& shape, const std::array<double, 3>& size,
                               double* distance, std::int64_t* nearest, int threads) {
    const std::size_t nz = shape[0], ny = shape[1], nx = shape[2];
    const std::size_t longest = std::max(ny, nx), blocks = (nx + together - 1) / together;
    deltamic_api::Team team(deltamic_api::worth(cost * static_cast<double>(nz * ny * nx), threads));
    const auto of = [&](std::size_t i) { return nearest ? nearest + i : nullptr; };
    std::vector<Scratch> of_workers(static_cast<std::size_t>(team.size()), Scratch(longest, nx));
    team.run([&](int worker) {
        Scratch& scratch = of_workers[static_cast<std::size_t>(worker)];
        team.each(ny, [&](std::size_t y) { begin(mask, distance, nearest, shape, y, size[0], scratch.last); });
        team.each(nz * blocks, [&](std::size_t i) {
            const std::size_t z = i / blocks, first = i % blocks * together, last = std::min(first + together, nx);
            for (std::size_t x = first; x < last; ++x)
                add_axis(distance + z * ny * nx + x, of(z * ny * nx + x), ny, nx, size[1], scratch);
        });
        team.each(nz * ny, [&](std::size_t row) {
            double* const own = distance + row * nx;
            add_axis(own, of(row * nx), nx, 1, size[2], scratch);
            for (std::size_t x = 0; x < nx; ++x) own[x] = std::sqrt(own[x]);
        });
    });
}

}  // namespace deltamic_distances
