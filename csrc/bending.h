// The bending energy of a surface and its gradient; formulas and names as in geometry/bending.py.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

namespace deltamic_bending {

// Cotangents beyond these are of slivers, whose curvature says nothing of the surface.
constexpr double kLeast = -2.0, kLargest = 4.0;
constexpr double kPoint = 1e-100;  // um^2: a surface without area has no curvature
constexpr double kNoArea = 1e-12;  // of the mean area: a face without area has no cotangents

struct Face {
    double edge[3][3];  // the edge opposite each corner, from corner p + 1 to corner p + 2
    double normal[3];   // of length `doubled`
    double dot[3];      // of the two edges at each corner
    double doubled;     // twice the area
};

inline double dot3(const double* a, const double* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

inline void cross3(const double* a, const double* b, double* out) {
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

inline Face face_of(const double* vertices, const std::int64_t* corner) {
    Face f;
    for (int p = 0; p < 3; ++p)
        for (int i = 0; i < 3; ++i)
            f.edge[p][i] = vertices[3 * corner[(p + 2) % 3] + i] - vertices[3 * corner[(p + 1) % 3] + i];
    cross3(f.edge[0], f.edge[1], f.normal);
    f.doubled = std::sqrt(dot3(f.normal, f.normal));
    for (int p = 0; p < 3; ++p) f.dot[p] = -dot3(f.edge[(p + 1) % 3], f.edge[(p + 2) % 3]);
    return f;
}

// Walls that have a mean curvature of their own.
struct Walls {
    std::int64_t count;
    const std::int64_t* of;  // (V,) number of the wall that a vertex lies within, or -1
    const double* side;      // (F,) 1 or -1: which way faces look, the same throughout a wall
    double own;              // um^2
};

// smooth: (V,) 1 where a vertex counts. gradient: (V, 3), overwritten.
inline double bending(const double* vertices, std::int64_t n_vertices, const std::int64_t* faces, std::int64_t n_faces,
                      const double* smooth, const Walls& walls, double* gradient) {
    std::vector<Face> face(n_faces);
    double total = 0;
    for (std::int64_t f = 0; f < n_faces; ++f) {
        face[f] = face_of(vertices, faces + 3 * f);
        total += face[f].doubled;
    }
    std::fill(gradient, gradient + 3 * n_vertices, 0.0);
    if (!(total > kPoint)) return 0.0;
    const double least = kNoArea * total / static_cast<double>(n_faces);
    std::vector<double> area(n_vertices, 0.0), bend(3 * n_vertices, 0.0);
    std::vector<double> vector(walls.count ? 3 * n_vertices : 0, 0.0);  // a third of the area vectors around
    for (std::int64_t f = 0; f < n_faces; ++f) {
        Face& t = face[f];
        t.doubled = std::max(t.doubled, least);
        const std::int64_t* c = faces + 3 * f;
        for (int p = 0; p < 3; ++p) {
            area[c[p]] += t.doubled / 6;
            const double half = 0.5 * std::clamp(t.dot[p] / t.doubled, kLeast, kLargest);
            for (int i = 0; i < 3; ++i) {
                bend[3 * c[(p + 2) % 3] + i] += half * t.edge[p][i];
                bend[3 * c[(p + 1) % 3] + i] -= half * t.edge[p][i];
                if (walls.count) vector[3 * c[p] + i] += walls.side[f] / 6 * t.normal[i];
            }
        }
    }
    std::vector<double> mean(walls.count, 0.0), held(walls.count, walls.own);
    for (std::int64_t v = 0; v < n_vertices && walls.count; ++v) {
        if (walls.of[v] < 0 || !(area[v] > 0)) continue;
        mean[walls.of[v]] += smooth[v] / area[v] * dot3(&bend[3 * v], &vector[3 * v]);
        held[walls.of[v]] += smooth[v] * area[v];
    }
    double energy = 0;
    for (std::int64_t w = 0; w < walls.count; ++w) {
        const double whole = mean[w];
        mean[w] /= std::max(held[w], kPoint);
        energy -= 0.5 * whole * mean[w];
    }
    std::vector<double> density(n_vertices);
    for (std::int64_t v = 0; v < n_vertices; ++v) {
        const double a = area[v] > 0 ? area[v] : 1.0, weight = smooth[v] / a;
        const double squared = dot3(&bend[3 * v], &bend[3 * v]);
        energy += 0.5 * weight * squared;
        density[v] = 0.5 * weight / a * squared;
        const bool within = walls.count && walls.of[v] >= 0 && area[v] > 0;
        const double c = within ? mean[walls.of[v]] : 0.0;
        if (within)
            density[v] -= smooth[v] * (c * dot3(&bend[3 * v], &vector[3 * v]) / (a * a) + 0.5 * c * c);
        // From here on the pull on K, and on the area vectors.
        for (int i = 0; i < 3; ++i) {
            const double k = bend[3 * v + i];
            bend[3 * v + i] = weight * k;
            if (!walls.count) continue;
            bend[3 * v + i] -= weight * c * vector[3 * v + i];
            vector[3 * v + i] = -weight * c * k;
        }
    }
    for (std::int64_t f = 0; f < n_faces; ++f) {
        const Face& t = face[f];
        const std::int64_t* c = faces + 3 * f;
        double by_area = -(density[c[0]] + density[c[1]] + density[c[2]]) / 6;
        double of_edge[3][3];
        double by_dot[3];
        for (int p = 0; p < 3; ++p) {
            const double raw = t.dot[p] / t.doubled, half = 0.5 * std::clamp(raw, kLeast, kLargest);
            double difference[3];
            for (int i = 0; i < 3; ++i) {
                difference[i] = bend[3 * c[(p + 2) % 3] + i] - bend[3 * c[(p + 1) % 3] + i];
                of_edge[p][i] = half * difference[i];
            }
            const bool free = raw > kLeast && raw < kLargest;
            const double by_cotangent = free ? 0.5 * dot3(difference, t.edge[p]) : 0.0;
            by_dot[p] = by_cotangent / t.doubled;
            by_area -= by_cotangent * t.dot[p] / (t.doubled * t.doubled);
        }
        for (int p = 0; p < 3; ++p) {
            const int q = (p + 1) % 3, r = (p + 2) % 3;
            for (int i = 0; i < 3; ++i) {
                of_edge[q][i] -= by_dot[p] * t.edge[r][i];
                of_edge[r][i] -= by_dot[p] * t.edge[q][i];
            }
        }
        double pull[3] = {0, 0, 0};
        for (int i = 0; i < 3 && walls.count; ++i)
            pull[i] = walls.side[f] / 6 * (vector[3 * c[0] + i] + vector[3 * c[1] + i] + vector[3 * c[2] + i]);
        for (int p = 0; p < 3; ++p) {
            double twisted[3];
            cross3(pull, t.edge[p], twisted);
            double turned[3];  // d |N| by a corner is the edge opposite it, turned about the normal
            cross3(t.normal, t.edge[p], turned);
            for (int i = 0; i < 3; ++i)
                gradient[3 * c[p] + i] +=
                    of_edge[(p + 1) % 3][i] - of_edge[(p + 2) % 3][i] + by_area * turned[i] / t.doubled + twisted[i];
        }
    }
    return energy;
}

}  // namespace deltamic_bending
