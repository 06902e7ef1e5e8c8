// The kernels as a library for the host: launch(name, grid, arguments), 0 where all went well.
#include <cstring>

#if defined(DELTAMIC_POINTS)
#include "particle_mesh_cuda.cu"
using namespace deltamic;
#else
#include "mesh_ft_cuda.cu"
#endif

extern "C" int launch(const char* name, unsigned int x, unsigned int y, void** arguments) {
    try {
#define KERNEL_NAMED(kernel)                                                          \
    if (std::strcmp(name, #kernel) == 0) {                                            \
        emulation::launch(kernel, {x, y}, threads, arguments);                        \
        return 0;                                                                     \
    }
#if defined(DELTAMIC_POINTS)
        KERNEL_NAMED(locate)
        KERNEL_NAMED(spread)
        KERNEL_NAMED(spread_dipoles)
        KERNEL_NAMED(gather)
        KERNEL_NAMED(gather_slopes)
        KERNEL_NAMED(sum_values)
        KERNEL_NAMED(sum_slopes)
        KERNEL_NAMED(pull)
#else
        KERNEL_NAMED(prepare_band)
        KERNEL_NAMED(prepare_list)
        KERNEL_NAMED(add_parts)
        KERNEL_NAMED(face_gradient)
        KERNEL_NAMED(list_face_gradient)
        KERNEL_NAMED(vertex_gradient)
        KERNEL_NAMED(band_forward)
        KERNEL_NAMED(band_backward)
        KERNEL_NAMED(list_forward)
        KERNEL_NAMED(list_backward)
#endif
    } catch (const std::exception&) {
        return 1;
    }
    return 2;
}
