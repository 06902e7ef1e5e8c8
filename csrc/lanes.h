// Lanes<T, W>: W numbers that one instruction works on; stands in for T in triangle_ft.h.
//
// Built on the vector extensions of GCC and Clang, which turn into SSE, AVX, AVX-512 or NEON code
// for whatever the file is compiled for. Other compilers get W = 1.
#pragma once
#include <cstring>

#if defined(__AVX512F__)
#define DELTAMIC_VECTOR_BYTES 64
#elif defined(__AVX2__)
#define DELTAMIC_VECTOR_BYTES 32
#else
#define DELTAMIC_VECTOR_BYTES 16
#endif

namespace DELTAMIC_NAMESPACE {

#if defined(__GNUC__) || defined(__clang__)

template <class T>
constexpr int lanes = DELTAMIC_VECTOR_BYTES / sizeof(T);

template <class T>
struct VectorOf;
template <>
struct VectorOf<float> {
    typedef float type __attribute__((vector_size(DELTAMIC_VECTOR_BYTES)));
};
template <>
struct VectorOf<double> {
    typedef double type __attribute__((vector_size(DELTAMIC_VECTOR_BYTES)));
};

template <class T>
struct Lanes {
    using V = typename VectorOf<T>::type;
    V v;

    Lanes() = default;
    DELTAMIC_FN Lanes(V vector) : v(vector) {}
    DELTAMIC_FN Lanes(T all) : v(V{} + all) {}
    template <class U>
    DELTAMIC_FN explicit Lanes(U all) : v(V{} + static_cast<T>(all)) {}

    static DELTAMIC_FN Lanes load(const T* p) {
        Lanes r;
        std::memcpy(&r.v, p, sizeof(V));
        return r;
    }
    DELTAMIC_FN void store(T* p) const { std::memcpy(p, &v, sizeof(V)); }
    // 0, 1, 2, ...
    static DELTAMIC_FN Lanes ramp() {
        V r;
        for (int i = 0; i < lanes<T>; ++i) r[i] = static_cast<T>(i);
        return r;
    }
};

template <class T>
struct Mask {
    decltype(typename Lanes<T>::V{} < typename Lanes<T>::V{}) m;
};

#define DELTAMIC_OP(op)                                                                         \
    template <class T>                                                                          \
    DELTAMIC_FN Lanes<T> operator op(Lanes<T> a, Lanes<T> b) { return Lanes<T>(a.v op b.v); }
DELTAMIC_OP(+)
DELTAMIC_OP(-)
DELTAMIC_OP(*)
DELTAMIC_OP(/)
#undef DELTAMIC_OP

#define DELTAMIC_COMPARE(op)                                                                    \
    template <class T>                                                                          \
    DELTAMIC_FN Mask<T> operator op(Lanes<T> a, Lanes<T> b) { return {a.v op b.v}; }
DELTAMIC_COMPARE(<)
DELTAMIC_COMPARE(>=)
#undef DELTAMIC_COMPARE

template <class T>
DELTAMIC_FN Lanes<T> operator-(Lanes<T> a) { return Lanes<T>(-a.v); }
template <class T>
DELTAMIC_FN Lanes<T>& operator+=(Lanes<T>& a, Lanes<T> b) {
    a.v += b.v;
    return a;
}
template <class T>
DELTAMIC_FN Mask<T> operator&(Mask<T> a, Mask<T> b) { return {a.m & b.m}; }
template <class T>
DELTAMIC_FN Mask<T> operator!(Mask<T> a) { return {~a.m}; }
template <class T>
DELTAMIC_FN Lanes<T> select(Mask<T> m, Lanes<T> yes, Lanes<T> no) { return Lanes<T>(m.m ? yes.v : no.v); }

template <class T>
struct Scalar<Lanes<T>> {
    using type = T;
};

#else

template <class T>
constexpr int lanes = 1;

template <class T>
struct Lanes {
    T v;
    Lanes() = default;
    template <class U>
    Lanes(U all) : v(static_cast<T>(all)) {}
    static Lanes load(const T* p) { return Lanes(*p); }
    void store(T* p) const { *p = v; }
    static Lanes ramp() { return Lanes(T(0)); }
};
template <class T>
Lanes<T> operator+(Lanes<T> a, Lanes<T> b) { return {a.v + b.v}; }
template <class T>
Lanes<T> operator-(Lanes<T> a, Lanes<T> b) { return {a.v - b.v}; }
template <class T>
Lanes<T> operator*(Lanes<T> a, Lanes<T> b) { return {a.v * b.v}; }
template <class T>
Lanes<T> operator/(Lanes<T> a, Lanes<T> b) { return {a.v / b.v}; }
template <class T>
Lanes<T> operator-(Lanes<T> a) { return {-a.v}; }
template <class T>
Lanes<T>& operator+=(Lanes<T>& a, Lanes<T> b) { a.v += b.v; return a; }
template <class T>
bool operator<(Lanes<T> a, Lanes<T> b) { return a.v < b.v; }
template <class T>
bool operator>=(Lanes<T> a, Lanes<T> b) { return a.v >= b.v; }
template <class T>
Lanes<T> select(bool m, Lanes<T> yes, Lanes<T> no) { return m ? yes : no; }
template <class T>
struct Scalar<Lanes<T>> {
    using type = T;
};

#endif

}  // namespace DELTAMIC_NAMESPACE
