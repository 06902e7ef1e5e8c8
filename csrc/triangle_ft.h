// The Fourier transform of one triangle at one wavevector: value and gradient.
//
// Plain C++17 without headers; compiles for host and device. This is the only place
// where the formula is written: the CPU loops and the GPU kernel both include it.
//
// Notation. phase_p = v_p . xi; the edge phases are d1 = xi.(v3-v2), d2 = xi.(v1-v3),
// d3 = xi.(v2-v1), taken from edge vectors (differences of vertex phases would cancel).
//   F  = integral over the unit simplex of exp(-i lambda . phases),  u_T = 2 A F
//   F  = exp(-i C) S,  C = phase of the centroid
// Everything below works on S, the transform about the centroid, and on
//   g_p = exp(i C) dF/dphase_p,   g_1 + g_2 + g_3 = -i S  (translation).
//
// Two branches (each without cancellation on its own side of the threshold):
//   small  largest |d| < tau: Taylor series about the centroid, in two symmetric invariants;
//   large  otherwise: divided difference across the largest gap, of phi(x) = -i e^{-ix/2} sinc(x/2).
// Both are branch-free inside: T may be float, double or vector lanes of them. Errors against 50-digit
// arithmetic are measured in tests/fourier/test_adversarial_triangles.py.
#pragma once

// The CPU loops compile this file once per instruction set, each in a namespace of its own, so that
// the linker can never mix code for different processors.
#if !defined(DELTAMIC_NAMESPACE)
#define DELTAMIC_NAMESPACE deltamic
#endif

#if defined(__CUDACC__) || defined(__CUDACC_RTC__)
#define DELTAMIC_FN __host__ __device__ __forceinline__
#define DELTAMIC_CONSTANT __host__ __device__ constexpr
#elif defined(_MSC_VER)
#define DELTAMIC_FN __forceinline
#define DELTAMIC_CONSTANT constexpr
#else
#define DELTAMIC_FN inline __attribute__((always_inline))
#define DELTAMIC_CONSTANT constexpr
#endif

namespace DELTAMIC_NAMESPACE {

template <class T>
struct Complex {
    T re, im;
};

template <class T>
struct Value {  // S
    T re, im;
};

template <class T>
struct Gradient {  // S and g_1, g_2, g_3
    Complex<T> value, g1, g2, g3;
};

template <class T>
struct Scalar {
    using type = T;
};
template <class T>
constexpr bool is_single = sizeof(typename Scalar<T>::type) == 4;

// Largest edge phase for which the Taylor series below is accurate to the type's precision.
constexpr double tau = 2.0;

DELTAMIC_FN float select(bool m, float yes, float no) { return m ? yes : no; }
DELTAMIC_FN double select(bool m, double yes, double no) { return m ? yes : no; }

template <class T>
DELTAMIC_FN T magnitude(T a) {
    return select(a < T(0), -a, a);
}

template <class T>
DELTAMIC_FN T larger(T a, T b) {
    return select(a < b, b, a);
}

template <class T>
DELTAMIC_FN T largest(T d1, T d2, T d3) {
    return larger(larger(magnitude(d1), magnitude(d2)), magnitude(d3));
}

// ---------------------------------------------------------------------------------------------
// Small triangles
//   S = sum_l (i r)^l sum_j (-q)^j C(j+l, l) / (2j+3l+2)!,  terms with 2j+3l <= K
// with q = -(alpha beta + beta gamma + gamma alpha) >= 0 and r = alpha beta gamma of the centred
// phases alpha = (d2-d3)/3, beta = (d3-d1)/3, gamma = (d1-d2)/3. K = 9 in float, 18 in double.
// Written as polynomials in q (Horner), one for each power of r:
//   Re S = A0(q) - r^2 A2(q) + r^4 A4(q) ...,  Im S = r (A1(q) - r^2 A3(q) + ...).
// ---------------------------------------------------------------------------------------------

DELTAMIC_CONSTANT double factorial(int n) { return n < 2 ? 1.0 : n * factorial(n - 1); }
DELTAMIC_CONSTANT double binomial(int n, int k) { return factorial(n) / (factorial(k) * factorial(n - k)); }

// A polynomial given by its coefficients, C::at(0) + C::at(1) z + ... up to degree N, and its slope.
template <class T, class C, int N, int J = 0>
DELTAMIC_FN T horner(T z) {
    constexpr double c = C::at(J);
    if constexpr (J == N) {
        return T(c);
    } else {
        return T(c) + z * horner<T, C, N, J + 1>(z);
    }
}
template <class T, class C, int N, int J = 1>
DELTAMIC_FN T horner_slope(T z) {
    constexpr double c = J * C::at(J);
    if constexpr (J > N) {
        return T(0);
    } else if constexpr (J == N) {
        return T(c);
    } else {
        return T(c) + z * horner_slope<T, C, N, J + 1>(z);
    }
}

template <int L>
struct TaylorCoefficients {  // of q^j in A_L
    static DELTAMIC_CONSTANT double at(int j) {
        return (j % 2 ? -1.0 : 1.0) * binomial(j + L, L) / factorial(2 * j + 3 * L + 2);
    }
};

template <class T>
constexpr int order = is_single<T> ? 9 : 18;  // K

template <class T, int L>
DELTAMIC_FN T poly(T q) {
    return horner<T, TaylorCoefficients<L>, (order<T> - 3 * L) / 2>(q);
}
template <class T, int L>
DELTAMIC_FN T poly_slope(T q) {
    return horner_slope<T, TaylorCoefficients<L>, (order<T> - 3 * L) / 2>(q);
}

template <class T>
struct Invariants {
    T alpha, beta, gamma, q, r;
};

template <class T>
DELTAMIC_FN Invariants<T> invariants(T alpha, T beta) {
    const T gamma = -(alpha + beta), product = beta * gamma;
    return {alpha, beta, gamma, alpha * alpha - product, alpha * product};
}

template <class T>
DELTAMIC_FN Value<T> small_value(T alpha, T beta) {
    const Invariants<T> v = invariants(alpha, beta);
    const T q = v.q, r2 = v.r * v.r;
    if constexpr (is_single<T>) {
        return {poly<T, 0>(q) - r2 * poly<T, 2>(q), v.r * (poly<T, 1>(q) - r2 * poly<T, 3>(q))};
    } else {
        return {poly<T, 0>(q) - r2 * (poly<T, 2>(q) - r2 * (poly<T, 4>(q) - r2 * poly<T, 6>(q))),
                v.r * (poly<T, 1>(q) - r2 * (poly<T, 3>(q) - r2 * poly<T, 5>(q)))};
    }
}

// S, dS/dq and dS/dr: what the gradient of a small triangle is made of.
template <class T>
struct SmallJet {
    Complex<T> s, sq, sr;
    Invariants<T> inv;
};

template <class T>
DELTAMIC_FN SmallJet<T> small_jet(T alpha, T beta) {
    const Invariants<T> v = invariants(alpha, beta);
    const T q = v.q, r = v.r, r2 = r * r;
    if constexpr (is_single<T>) {
        const T a0 = poly<T, 0>(q), a1 = poly<T, 1>(q), a2 = poly<T, 2>(q), a3 = poly<T, 3>(q);
        return {{a0 - r2 * a2, r * (a1 - r2 * a3)},
                {poly_slope<T, 0>(q) - r2 * poly_slope<T, 2>(q), r * poly_slope<T, 1>(q)},
                {T(-2) * r * a2, a1 - T(3) * r2 * a3},
                v};
    } else {
        const T a0 = poly<T, 0>(q), a1 = poly<T, 1>(q), a2 = poly<T, 2>(q), a3 = poly<T, 3>(q),
                a4 = poly<T, 4>(q), a5 = poly<T, 5>(q), a6 = poly<T, 6>(q);
        const T b0 = poly_slope<T, 0>(q), b1 = poly_slope<T, 1>(q), b2 = poly_slope<T, 2>(q),
                b3 = poly_slope<T, 3>(q), b4 = poly_slope<T, 4>(q), b5 = poly_slope<T, 5>(q);
        return {{a0 - r2 * (a2 - r2 * (a4 - r2 * a6)), r * (a1 - r2 * (a3 - r2 * a5))},
                {b0 - r2 * (b2 - r2 * b4), r * (b1 - r2 * (b3 - r2 * b5))},
                {r * (T(-2) * a2 + r2 * (T(4) * a4 - r2 * T(6) * a6)),
                 a1 - r2 * (T(3) * a3 - r2 * T(5) * a5)},
                v};
    }
}

// g_p = -i S / 3 + alpha_p S_q + (product of the two others + q/3) S_r
template <class T>
DELTAMIC_FN Complex<T> small_gradient(const SmallJet<T>& j, T a, T product_of_others) {
    const T m = product_of_others + j.inv.q * T(1.0 / 3.0);
    return {j.s.im * T(1.0 / 3.0) + a * j.sq.re + m * j.sr.re,
            j.s.re * T(-1.0 / 3.0) + a * j.sq.im + m * j.sr.im};
}

template <class T>
DELTAMIC_FN Gradient<T> small_full(T alpha, T beta) {
    const SmallJet<T> j = small_jet(alpha, beta);
    const Invariants<T>& v = j.inv;
    return {j.s, small_gradient(j, v.alpha, v.beta * v.gamma),
            small_gradient(j, v.beta, v.gamma * v.alpha),
            small_gradient(j, v.gamma, v.alpha * v.beta)};
}

// What a gradient takes of one triangle at one wavevector, contracted with t = exp(-iC) conj(G), G
// being the incoming gradient: t S, and the slopes of Re(t S) along alpha and beta with gamma =
// -alpha - beta, that is Re(t (alpha - gamma)(S_q - beta S_r)) and Re(t (beta - gamma)(S_q - alpha
// S_r)). The phases follow by sums alone: 3 Re(t g_1) = Im(t S) + 2 by_alpha - by_beta,
// 3 Re(t g_2) = Im(t S) + 2 by_beta - by_alpha.
template <class T>
struct Contracted {
    T re, im, by_alpha, by_beta;
};

template <class T>
DELTAMIC_FN Contracted<T> small_contracted(T alpha, T beta, Complex<T> t) {
    const SmallJet<T> j = small_jet(alpha, beta);
    const T q = t.re * j.sq.re - t.im * j.sq.im, r = t.re * j.sr.re - t.im * j.sr.im;
    return {t.re * j.s.re - t.im * j.s.im, t.re * j.s.im + t.im * j.s.re,
            (alpha - j.inv.gamma) * (q - beta * r), (beta - j.inv.gamma) * (q - alpha * r)};
}

// ---------------------------------------------------------------------------------------------
// Large triangles
// ---------------------------------------------------------------------------------------------

struct CosCoefficients {  // of z^j in cos(sqrt z)
    static DELTAMIC_CONSTANT double at(int j) { return (j % 2 ? -1.0 : 1.0) / factorial(2 * j); }
};
struct SincCoefficients {  // of z^j in sin(sqrt z) / sqrt z
    static DELTAMIC_CONSTANT double at(int j) { return (j % 2 ? -1.0 : 1.0) / factorial(2 * j + 1); }
};

// cos x + i sin x, by reduction to [-pi/2, pi/2] and Taylor polynomials; the absolute error is that
// of the argument plus about one rounding. Written out because library calls do not run on vector
// lanes everywhere.
template <class T>
DELTAMIC_FN Complex<T> cis(T x) {
    // pi in three parts; the first two are short, so that n * part is exact.
    constexpr bool single = is_single<T>;
    constexpr double p1 = single ? 3.140625 : 3.141592651605606;
    constexpr double p2 = single ? 9.675025939941406e-4 : 1.9841871583270443e-09;
    constexpr double p3 = single ? 1.5099579909783765e-07 : 1.034036596358821e-18;
    // Adding and taking away 1.5 * 2^23 (2^52) rounds to the nearest whole number.
    constexpr double round = single ? 12582912.0 : 6755399441055744.0;
    const T n = (x * T(0.31830988618379067154) + T(round)) - T(round);
    const T r = ((x - n * T(p1)) - n * T(p2)) - n * T(p3);
    const T odd = n - T(2) * ((n * T(0.5) + T(round)) - T(round));  // -1, 0 or 1
    const T sign = T(1) - T(2) * odd * odd;
    const T z = r * r;
    return {sign * horner<T, CosCoefficients, single ? 6 : 10>(z),
            sign * r * horner<T, SincCoefficients, single ? 5 : 10>(z)};
}

template <class T>
DELTAMIC_FN Complex<T> operator*(Complex<T> a, Complex<T> b) {
    return {a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re};
}

// sinc(h) = sin h / h and its derivative: near zero from the series, elsewhere from e = cis(h).
template <class T>
struct Sinc {
    T s, ds;
};

template <class T, bool derivative>
DELTAMIC_FN Sinc<T> sinc(T h, Complex<T> e) {
    constexpr int terms = is_single<T> ? 6 : 10;
    const T z = h * h;
    const auto near_zero = z < T(1);
    const T zz = select(near_zero, z, T(0));  // the lane that is not chosen must stay finite
    const T inv = T(1) / select(near_zero, T(1), h);
    const T far = e.im * inv;
    const T s = select(near_zero, horner<T, SincCoefficients, terms>(zz), far);
    if constexpr (!derivative) {
        return {s, T(0)};
    } else {
        const T near = T(2) * h * horner_slope<T, SincCoefficients, terms>(zz);
        return {s, select(near_zero, near, (e.re - far) * inv)};
    }
}

// The largest gap D = y - x belongs to edge p; x and y are the phases of the two ends of that edge
// relative to the third vertex, the median one.
template <class T, class M>
struct Sorted {
    T x, y, D;
    M is1, is2;  // which p; neither: p = 3
};

template <class T>
DELTAMIC_FN auto sorted(T d1, T d2, T d3) {
    const T a1 = magnitude(d1), a2 = magnitude(d2), a3 = magnitude(d3);
    const auto is1 = (a1 >= a2) & (a1 >= a3);
    const auto is2 = (!is1) & (a2 >= a3);
    const T D = select(is1, d1, select(is2, d2, d3));
    const T x = select(is1, d3, select(is2, d1, d2));
    const T y = select(is1, -d2, select(is2, -d3, -d1));
    // A small triangle's lane gets a harmless one, so that no division by zero leaks through a select.
    const auto safe = magnitude(D) >= T(0.5 * tau);
    return Sorted<T, decltype(is1 & is2)>{select(safe, x, T(0)), select(safe, y, T(tau)), select(safe, D, T(tau)),
                                          is1, is2};
}

template <class T>
DELTAMIC_FN Value<T> large_value(T d1, T d2, T d3) {
    const auto o = sorted(d1, d2, d3);
    const T sixth = T(1.0 / 6.0);
    const Complex<T> ea = cis((T(2) * o.x - o.y) * sixth), eb = cis((T(2) * o.y - o.x) * sixth);
    const Complex<T> both = ea * eb;                   // e^{i(x+y)/6}
    const Complex<T> ex = both * ea, ey = both * eb;   // e^{ix/2}, e^{iy/2}
    const T sx = sinc<T, false>(T(0.5) * o.x, ex).s, sy = sinc<T, false>(T(0.5) * o.y, ey).s;
    const T inv = T(1) / o.D;
    // S = i [ e^{ia} s(y/2) - e^{ib} s(x/2) ] / D
    return {-(ea.im * sy - eb.im * sx) * inv, (ea.re * sy - eb.re * sx) * inv};
}

template <class T>
DELTAMIC_FN Gradient<T> large_full(T d1, T d2, T d3) {
    const auto o = sorted(d1, d2, d3);
    const T sixth = T(1.0 / 6.0);
    const Complex<T> ea = cis((T(2) * o.x - o.y) * sixth), eb = cis((T(2) * o.y - o.x) * sixth);
    const Complex<T> both = ea * eb;
    const Complex<T> ex = both * ea, ey = both * eb;
    const Sinc<T> sx = sinc<T, true>(T(0.5) * o.x, ex), sy = sinc<T, true>(T(0.5) * o.y, ey);
    const T inv = T(1) / o.D;
    const Complex<T> s = {-(ea.im * sy.s - eb.im * sx.s) * inv, (ea.re * sy.s - eb.re * sx.s) * inv};
    // dF/dx = (-1/2 e^{ib}(s + i s')(x) + S) / D,  dF/dy = (1/2 e^{ia}(s + i s')(y) - S) / D
    const Complex<T> px = eb * Complex<T>{sx.s, sx.ds}, py = ea * Complex<T>{sy.s, sy.ds};
    const Complex<T> gx = {(s.re - T(0.5) * px.re) * inv, (s.im - T(0.5) * px.im) * inv};
    const Complex<T> gy = {(T(0.5) * py.re - s.re) * inv, (T(0.5) * py.im - s.im) * inv};
    const Complex<T> gm = {s.im - gx.re - gy.re, -s.re - gx.im - gy.im};
    // p = 1: x belongs to v2, y to v3; p = 2: v3, v1; p = 3: v1, v2.
    const auto three = [&](const Complex<T>& a, const Complex<T>& b, const Complex<T>& c) {
        return Complex<T>{select(o.is1, a.re, select(o.is2, b.re, c.re)),
                          select(o.is1, a.im, select(o.is2, b.im, c.im))};
    };
    return {s, three(gm, gy, gx), three(gx, gm, gy), three(gy, gx, gm)};
}

template <class T>
DELTAMIC_FN Contracted<T> large_contracted(T d1, T d2, T d3, Complex<T> t) {
    const Gradient<T> g = large_full(d1, d2, d3);
    const T im = t.re * g.value.im + t.im * g.value.re;
    const T r1 = t.re * g.g1.re - t.im * g.g1.im, r2 = t.re * g.g2.re - t.im * g.g2.im;
    return {t.re * g.value.re - t.im * g.value.im, im, T(2) * r1 + r2 - im, r1 + T(2) * r2 - im};
}

// ---------------------------------------------------------------------------------------------
// Either, chosen by the largest edge phase
// ---------------------------------------------------------------------------------------------

template <class T>
DELTAMIC_FN Value<T> triangle_value(T d1, T d2, T d3) {
    const auto small = largest(d1, d2, d3) < T(tau);
    const T third = T(1.0 / 3.0), none = T(0);
    const Value<T> a = small_value(select(small, (d2 - d3) * third, none), select(small, (d3 - d1) * third, none));
    const Value<T> b = large_value(d1, d2, d3);
    return {select(small, a.re, b.re), select(small, a.im, b.im)};
}

template <class T>
DELTAMIC_FN Gradient<T> triangle_full(T d1, T d2, T d3) {
    const auto small = largest(d1, d2, d3) < T(tau);
    const T third = T(1.0 / 3.0), none = T(0);
    const Gradient<T> a = small_full(select(small, (d2 - d3) * third, none), select(small, (d3 - d1) * third, none));
    const Gradient<T> b = large_full(d1, d2, d3);
    const auto either = [&](const Complex<T>& p, const Complex<T>& q) {
        return Complex<T>{select(small, p.re, q.re), select(small, p.im, q.im)};
    };
    return {either(a.value, b.value), either(a.g1, b.g1), either(a.g2, b.g2), either(a.g3, b.g3)};
}

}  // namespace DELTAMIC_NAMESPACE
