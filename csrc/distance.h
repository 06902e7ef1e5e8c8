// Distances between points, edges and triangles.
#pragma once

#include <algorithm>
#include <cmath>

#include "vec.h"

namespace deltamic_remesh {

inline Vec nearest_in_triangle(Vec p, Vec a, Vec b, Vec c) {
    // By the regions around a triangle: C. Ericson, "Real-Time Collision Detection", 2005, 5.1.5.
    const Vec ab = b - a, ac = c - a, ap = p - a;
    const double d1 = dot(ab, ap), d2 = dot(ac, ap);
    if (d1 <= 0 && d2 <= 0) return a;
    const Vec bp = p - b;
    const double d3 = dot(ab, bp), d4 = dot(ac, bp);
    if (d3 >= 0 && d4 <= d3) return b;
    const double vc = d1 * d4 - d3 * d2;
    if (vc <= 0 && d1 >= 0 && d3 <= 0 && d1 > d3) return a + (d1 / (d1 - d3)) * ab;
    const Vec cp = p - c;
    const double d5 = dot(ab, cp), d6 = dot(ac, cp);
    if (d6 >= 0 && d5 <= d6) return c;
    const double vb = d5 * d2 - d1 * d6;
    if (vb <= 0 && d2 >= 0 && d6 <= 0 && d2 > d6) return a + (d2 / (d2 - d6)) * ac;
    const double va = d3 * d6 - d5 * d4;
    const double bc = (d4 - d3) + (d5 - d6);
    if (va <= 0 && d4 >= d3 && d5 >= d6 && bc > 0) return b + ((d4 - d3) / bc) * (c - b);
    const double total = va + vb + vc;
    if (!(total > 0)) return a;
    return a + (vb / total) * ab + (vc / total) * ac;
}

inline double squared_between_segments(Vec p, Vec q, Vec r, Vec s) {
    // C. Ericson, "Real-Time Collision Detection", 2005, 5.1.9.
    const Vec u = q - p, v = s - r, w = p - r;
    const double a = dot(u, u), e = dot(v, v), f = dot(v, w), c = dot(u, w), b = dot(u, v);
    double m = 0, n = 0;
    if (a <= 0 && e <= 0) return dot(w, w);
    if (a <= 0) {
        n = std::clamp(f / e, 0.0, 1.0);
    } else if (e <= 0) {
        m = std::clamp(-c / a, 0.0, 1.0);
    } else {
        const double below = a * e - b * b;
        m = below > 1e-14 * a * e ? std::clamp((b * f - c * e) / below, 0.0, 1.0) : 0.0;
        n = (b * m + f) / e;
        if (n < 0) {
            n = 0;
            m = std::clamp(-c / a, 0.0, 1.0);
        } else if (n > 1) {
            n = 1;
            m = std::clamp((b - c) / a, 0.0, 1.0);
        }
    }
    const Vec d = w + m * u - n * v;
    return dot(d, d);
}

}  // namespace deltamic_remesh
