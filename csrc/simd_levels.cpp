// Compiled for the oldest processor of the platform, like bindings.cpp.
#include "simd_levels.h"

#include <stdexcept>
#if defined(_MSC_VER)
#include <intrin.h>
#endif

#define DECLARE_LOOPS(name)                                          \
    namespace deltamic_##name {                                      \
    extern const deltamic_api::Loops<float> loops_f32;               \
    extern const deltamic_api::Loops<double> loops_f64;              \
    extern const deltamic_api::MeshLoops<float> mesh_f32;            \
    extern const deltamic_api::MeshLoops<double> mesh_f64;           \
    extern const deltamic_api::SpectrumLoops<float> spectrum_f32;    \
    extern const deltamic_api::SpectrumLoops<double> spectrum_f64;   \
    }
DECLARE_LOOPS(generic)
#ifdef DELTAMIC_HAS_avx2
DECLARE_LOOPS(avx2)
#endif
#ifdef DELTAMIC_HAS_avx512
DECLARE_LOOPS(avx512)
#endif

#define LEVEL(name)                                                                                 \
    {#name, &deltamic_##name::loops_f32, &deltamic_##name::loops_f64, &deltamic_##name::mesh_f32,   \
     &deltamic_##name::mesh_f64, &deltamic_##name::spectrum_f32, &deltamic_##name::spectrum_f64}

namespace deltamic_api {
namespace {

#if defined(_MSC_VER) && (defined(_M_X64) || defined(_M_IX86))
bool cpu_has_avx2() {
    int r[4];
    __cpuid(r, 1);
    const bool os = (r[2] & (1 << 27)) && (r[2] & (1 << 12));  // OSXSAVE, FMA
    if (!os || (_xgetbv(0) & 6) != 6) return false;
    __cpuidex(r, 7, 0);
    return (r[1] & (1 << 5)) != 0;
}
#elif defined(__x86_64__)
bool cpu_has_avx2() { return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma"); }
#else
bool cpu_has_avx2() { return false; }
#endif

std::vector<Level> find_levels() {
    std::vector<Level> v = {LEVEL(generic)};
#ifdef DELTAMIC_HAS_avx2
    if (cpu_has_avx2()) v.push_back(LEVEL(avx2));
#endif
#ifdef DELTAMIC_HAS_avx512
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
        __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512bw"))
        v.push_back(LEVEL(avx512));
#endif
    return v;
}

}  // namespace

const std::vector<Level>& levels() {
    static const std::vector<Level> found = find_levels();
    return found;
}

const Level& level_named(const std::string& name) {
    for (const Level& l : levels())
        if (l.name == name) return l;
    throw std::invalid_argument("this processor or build has no instruction set '" + name + "'");
}

}  // namespace deltamic_api
