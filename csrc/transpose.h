// Squares of numbers on their side: as many vectors as a vector has lanes.
#pragma once
#include "lanes.h"

namespace DELTAMIC_NAMESPACE {
namespace {

#if defined(__clang__) || (defined(__GNUC__) && __GNUC__ >= 12)

// The lanes of two vectors in turn, from their first halves and from their second ones.
template <class V>
inline void zip(V a, V b, V& low, V& high) {
    constexpr int n = sizeof(V) / sizeof(a[0]);
    if constexpr (n == 2) {
        low = __builtin_shufflevector(a, b, 0, 2);
        high = __builtin_shufflevector(a, b, 1, 3);
    } else if constexpr (n == 4) {
        low = __builtin_shufflevector(a, b, 0, 4, 1, 5);
        high = __builtin_shufflevector(a, b, 2, 6, 3, 7);
    } else if constexpr (n == 8) {
        low = __builtin_shufflevector(a, b, 0, 8, 1, 9, 2, 10, 3, 11);
        high = __builtin_shufflevector(a, b, 4, 12, 5, 13, 6, 14, 7, 15);
    } else {
        low = __builtin_shufflevector(a, b, 0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23);
        high = __builtin_shufflevector(a, b, 8, 24, 9, 25, 10, 26, 11, 27, 12, 28, 13, 29, 14, 30, 15, 31);
    }
}

template <class T>
inline void transpose(Lanes<T> (&v)[lanes<T>]) {
    constexpr int n = lanes<T>;
    for (int step = 1; step < n; step *= 2) {
        Lanes<T> w[n];
        for (int i = 0; i < n / 2; ++i) zip(v[i].v, v[i + n / 2].v, w[2 * i].v, w[2 * i + 1].v);
        for (int i = 0; i < n; ++i) v[i] = w[i];
    }
}

#else

template <class T>
inline void transpose(Lanes<T> (&v)[lanes<T>]) {
    constexpr int n = lanes<T>;
    T from[n][n], to[n][n];
    for (int i = 0; i < n; ++i) v[i].store(from[i]);
    for (int i = 0; i < n; ++i)
        for (int j = 0; j < n; ++j) to[j][i] = from[i][j];
    for (int i = 0; i < n; ++i) v[i] = Lanes<T>::load(to[i]);
}

#endif

}  // namespace
}  // namespace DELTAMIC_NAMESPACE
