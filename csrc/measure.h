// Area of a triangle, length of a segment, 1 for a point; with gradients. For host and device.
#pragma once
#if defined(__CUDACC_RTC__)
#define DELTAMIC_MEASURE __device__ inline
#else
#include <cmath>
#define DELTAMIC_MEASURE inline
#endif

namespace deltamic_api {

#if !defined(__CUDACC_RTC__)
using std::sqrt;
#endif

struct Measure {
    double value;
    double gradient[3][3];  // by corner
};

// Half a cross product's norm, never Heron's formula, which is far off on needles. Where there is no
// area or length there is no direction, and no gradient.
DELTAMIC_MEASURE Measure measure(int corners, const double* const* p) {
    Measure m{1.0, {}};
    if (corners == 2) {
        double d[3];
        for (int k = 0; k < 3; ++k) d[k] = p[1][k] - p[0][k];
        m.value = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
        const double inverse = m.value > 0 ? 1.0 / m.value : 0.0;
        for (int k = 0; k < 3; ++k) {
            m.gradient[1][k] = d[k] * inverse;
            m.gradient[0][k] = -m.gradient[1][k];
        }
    } else if (corners == 3) {
        double e[3][3];  // opposite each corner
        for (int i = 0; i < 3; ++i)
            for (int k = 0; k < 3; ++k) e[i][k] = p[(i + 2) % 3][k] - p[(i + 1) % 3][k];
        double n[3];
        for (int k = 0; k < 3; ++k) n[k] = e[2][(k + 1) % 3] * e[0][(k + 2) % 3] - e[2][(k + 2) % 3] * e[0][(k + 1) % 3];
        const double doubled = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        m.value = 0.5 * doubled;
        const double inverse = doubled > 0 ? 0.5 / doubled : 0.0;
        for (int i = 0; i < 3; ++i)
            for (int k = 0; k < 3; ++k)
                m.gradient[i][k] = inverse * (n[(k + 1) % 3] * e[i][(k + 2) % 3] - n[(k + 2) % 3] * e[i][(k + 1) % 3]);
    }
    return m;
}

}  // namespace deltamic_api
