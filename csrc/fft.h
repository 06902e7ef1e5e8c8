// Complex FFTs of many columns side by side: every operation works on a vector of columns, so that
// nothing is ever shuffled within one. Stockham's ordering, factors 4, 2, 3, 5 and any others.
#pragma once
#include "spectra.h"
#include "lanes.h"

namespace DELTAMIC_NAMESPACE {
namespace {

using deltamic_api::Fft;

template <class T>
struct Number {
    Lanes<T> re, im;
};
template <class T>
inline Number<T> number_at(const T* p, int i) {
    return {Lanes<T>::load(p + 2 * i * lanes<T>), Lanes<T>::load(p + (2 * i + 1) * lanes<T>)};
}
template <class T>
inline void put(T* p, int i, Number<T> v) {
    v.re.store(p + 2 * i * lanes<T>);
    v.im.store(p + (2 * i + 1) * lanes<T>);
}
template <class T>
inline Number<T> operator+(Number<T> a, Number<T> b) {
    return {a.re + b.re, a.im + b.im};
}
template <class T>
inline Number<T> operator-(Number<T> a, Number<T> b) {
    return {a.re - b.re, a.im - b.im};
}
template <class T>
inline Number<T> times(Number<T> a, T re, T im) {
    const Lanes<T> c(re), s(im);
    return {a.re * c - a.im * s, a.re * s + a.im * c};
}
template <class T>
inline Number<T> scaled(Number<T> a, T by) {
    return {a.re * Lanes<T>(by), a.im * Lanes<T>(by)};
}
template <class T>
inline Number<T> times_minus_i(Number<T> a) {
    return {a.im, -a.re};
}

// DFTs of 2, 3, 4 and 5 numbers, in place.
template <class T>
inline void dft(Number<T> (&a)[2]) {
    const Number<T> d = a[0] - a[1];
    a[0] = a[0] + a[1];
    a[1] = d;
}
template <class T>
inline void dft(Number<T> (&a)[3]) {
    const Number<T> sum = a[1] + a[2], turned = times_minus_i(scaled(a[1] - a[2], T(0.86602540378443864676)));
    const Number<T> middle = a[0] - scaled(sum, T(0.5));
    a[0] = a[0] + sum;
    a[1] = middle + turned;
    a[2] = middle - turned;
}
template <class T>
inline void dft(Number<T> (&a)[4]) {
    const Number<T> s = a[0] + a[2], d = a[0] - a[2], t = a[1] + a[3], e = times_minus_i(a[1] - a[3]);
    a[0] = s + t;
    a[1] = d + e;
    a[2] = s - t;
    a[3] = d - e;
}
template <class T>
inline void dft(Number<T> (&a)[5]) {
    constexpr double c1 = 0.30901699437494742410, c2 = -0.80901699437494742410;
    constexpr double s1 = 0.95105651629515357212, s2 = 0.58778525229247312917;
    const Number<T> p = a[1] + a[4], q = a[2] + a[3], m = a[1] - a[4], n = a[2] - a[3];
    const Number<T> x = a[0] + scaled(p, T(c1)) + scaled(q, T(c2)), y = a[0] + scaled(p, T(c2)) + scaled(q, T(c1));
    const Number<T> u = times_minus_i(scaled(m, T(s1)) + scaled(n, T(s2)));
    const Number<T> v = times_minus_i(scaled(m, T(s2)) - scaled(n, T(s1)));
    a[0] = a[0] + p + q;
    a[1] = x + u;
    a[4] = x - u;
    a[2] = y + v;
    a[3] = y - v;
}

template <class T, int radix>
void pass(const T* in, T* out, int done, int left, const T* twiddles) {
    for (int p = 0; p < left; ++p, twiddles += 2 * (radix - 1)) {
        for (int q = 0; q < done; ++q) {
            Number<T> a[radix];
            for (int k = 0; k < radix; ++k) a[k] = number_at(in, q + done * (p + k * left));
            dft(a);
            put(out, q + done * radix * p, a[0]);
            for (int j = 1; j < radix; ++j) {
                const Number<T> v = p == 0 ? a[j] : times(a[j], twiddles[2 * j - 2], twiddles[2 * j - 1]);
                put(out, q + done * (radix * p + j), v);
            }
        }
    }
}

// Any other factor, by its definition; roots are exp(-2 pi i k / radix).
template <class T>
void pass_of(int radix, const T* in, T* out, int done, int left, const T* twiddles, const T* roots) {
    for (int p = 0; p < left; ++p, twiddles += 2 * (radix - 1)) {
        for (int q = 0; q < done; ++q) {
            for (int j = 0; j < radix; ++j) {
                Number<T> sum = number_at(in, q + done * p);
                for (int k = 1, at = 0; k < radix; ++k) {
                    at = (at + j) % radix;
                    sum = sum + times(number_at(in, q + done * (p + k * left)), roots[2 * at], roots[2 * at + 1]);
                }
                if (j > 0) sum = times(sum, twiddles[2 * j - 2], twiddles[2 * j - 1]);
                put(out, q + done * (radix * p + j), sum);
            }
        }
    }
}

// The transform of what is in a, with b to work in; returns where it ends up. For the inverse, swap
// real and imaginary parts before and after.
template <class T>
T* transform(const Fft<T>& f, T* a, T* b) {
    int done = 1, left = f.size;
    const T* twiddles = f.twiddles;
    for (int i = 0; i < f.factors; ++i) {
        const int radix = f.factor[i];
        left /= radix;
        switch (radix) {
            case 2: pass<T, 2>(a, b, done, left, twiddles); break;
            case 3: pass<T, 3>(a, b, done, left, twiddles); break;
            case 4: pass<T, 4>(a, b, done, left, twiddles); break;
            case 5: pass<T, 5>(a, b, done, left, twiddles); break;
            default: pass_of<T>(radix, a, b, done, left, twiddles, f.roots[i]);
        }
        twiddles += 2 * (radix - 1) * left;
        done *= radix;
        T* const other = a;
        a = b;
        b = other;
    }
    return a;
}

}  // namespace
}  // namespace DELTAMIC_NAMESPACE
