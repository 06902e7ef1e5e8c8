// Vectors in Z, Y, X.
#pragma once

#include <cmath>

namespace deltamic_remesh {

struct Vec {
    double z, y, x;
};

inline Vec operator+(Vec a, Vec b) { return {a.z + b.z, a.y + b.y, a.x + b.x}; }
inline Vec operator-(Vec a, Vec b) { return {a.z - b.z, a.y - b.y, a.x - b.x}; }
inline Vec operator*(double s, Vec a) { return {s * a.z, s * a.y, s * a.x}; }
inline double dot(Vec a, Vec b) { return a.z * b.z + a.y * b.y + a.x * b.x; }
inline Vec cross(Vec a, Vec b) {
    return {a.y * b.x - a.x * b.y, a.x * b.z - a.z * b.x, a.z * b.y - a.y * b.z};
}
inline double norm(Vec a) { return std::sqrt(dot(a, a)); }

}  // namespace deltamic_remesh
