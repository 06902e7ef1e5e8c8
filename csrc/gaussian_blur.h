// Symmetric filters along the axes of an image, which is 0 beyond its border.
//
// Sums run over the filter in one order for every voxel, so the result does not depend on the number
// of threads. Rows along x are added whole, for compilers to use vector instructions.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <vector>

#include "team.h"

namespace deltamic_blur {

constexpr double cost = 0.5;  // ns per voxel and pair of neighbours along an axis, measured
constexpr std::size_t together = 256;  // voxels along x of a strip that is blurred along y: it stays in the cache

// weights[k]: of both voxels k away. None: the axis is left as it is.
using Weights = std::vector<float>;

inline void scaled(const float* from, float weight, std::size_t n, float* to) {
    for (std::size_t x = 0; x < n; ++x) to[x] = weight * from[x];
}
inline void add(const float* one, float weight, std::size_t n, float* to) {
    for (std::size_t x = 0; x < n; ++x) to[x] += weight * one[x];
}
inline void add(const float* one, const float* other, float weight, std::size_t n, float* to) {
    for (std::size_t x = 0; x < n; ++x) to[x] += weight * (one[x] + other[x]);
}

// Row `here` of so many, a number of voxels apart, each of n voxels.
inline void across(const float* rows, std::size_t here, std::size_t count, std::size_t apart, const Weights& weights, std::size_t n,
                   float* to) {
    scaled(rows + here * apart, weights[0], n, to);
    for (std::size_t k = 1; k < weights.size(); ++k) {
        const float* const before = here >= k ? rows + (here - k) * apart : nullptr;
        const float* const after = here + k < count ? rows + (here + k) * apart : nullptr;
        if (before && after) add(before, after, weights[k], n, to);
        else if (before || after) add(before ? before : after, weights[k], n, to);
    }
}

// A row along x; padded: room for it, with zeros for the filter on either side.
inline void along(float* row, const Weights& weights, std::size_t n, float* padded) {
    const std::size_t far = weights.size() - 1;
    std::copy_n(row, n, padded + far);
    scaled(padded + far, weights[0], n, row);
    for (std::size_t k = 1; k <= far; ++k) add(padded + far - k, padded + far + k, weights[k], n, row);
}

// What a worker needs. Made before the threads are, in which nothing can be told of memory that runs out.
struct Scratch {
    std::vector<float> before, padded;
};

inline void blur(const float* image, const std::array<std::size_t, 3>& shape, const std::array<Weights, 3>& weights, float* to,
                 int threads) {
    const std::size_t nz = shape[0], ny = shape[1], nx = shape[2];
    const std::size_t plane = ny * nx, pairs = weights[0].size() + weights[1].size() + weights[2].size();
    const std::size_t strips = (nx + together - 1) / together;
    deltamic_api::Team team(deltamic_api::worth(cost * static_cast<double>(nz * plane * pairs), threads));
    const std::size_t room = weights[2].empty() ? 0 : nx + 2 * (weights[2].size() - 1);
    std::vector<Scratch> of_workers(static_cast<std::size_t>(team.size()));
    for (Scratch& scratch : of_workers) {
        scratch.before.resize(weights[1].empty() ? 0 : ny * std::min(nx, together));
        scratch.padded.resize(room);
    }
    team.run([&](int worker) {
        Scratch& scratch = of_workers[static_cast<std::size_t>(worker)];
        team.each(ny, [&](std::size_t y) {  // row by row, so that what is read stays near
            for (std::size_t z = 0; z < nz; ++z) {
                float* const own = to + z * plane + y * nx;
                if (weights[0].empty()) std::copy_n(image + z * plane + y * nx, nx, own);
                else across(image + y * nx, z, nz, plane, weights[0], nx, own);
            }
        });
        if (!weights[1].empty()) {
            team.each(nz * strips, [&](std::size_t i) {
                const std::size_t first = i % strips * together, width = std::min(together, nx - first);
                float* const own = to + i / strips * plane + first;
                for (std::size_t y = 0; y < ny; ++y) std::copy_n(own + y * nx, width, scratch.before.data() + y * width);
                for (std::size_t y = 0; y < ny; ++y)
                    across(scratch.before.data(), y, ny, width, weights[1], width, own + y * nx);
            });
        }
        if (!weights[2].empty()) {
            team.each(nz * ny, [&](std::size_t row) { along(to + row * nx, weights[2], nx, scratch.padded.data()); });
        }
    });
}

}  // namespace deltamic_blur
