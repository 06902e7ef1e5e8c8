// Runs CUDA kernels on the host, thread by thread: enough of the language for csrc/*_cuda.cu.
//
// Every thread of a block is a fibre with a stack of its own. A fibre runs until it waits at a
// barrier or a vote, then the next one does; a block in which nothing can go on any more (a barrier
// that some threads never reach, say) is an error. The order of the threads turns round at every
// barrier, so that a missing one shows. Included before the source by the compiler.
#pragma once
#include <ucontext.h>

#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <stdexcept>
#include <vector>

#define __global__
#define __device__
#define __host__
#define __forceinline__ inline
#define __launch_bounds__(...)
#define __shared__ static

inline double __longlong_as_double(long long bits) {
    double found;
    std::memcpy(&found, &bits, sizeof found);
    return found;
}
template <class T>
inline void atomicAdd(T* place, T value) {
    *place += value;
}
inline double __dmul_rn(double a, double b) { return a * b; }
inline double __dsub_rn(double a, double b) { return a - b; }
using std::ceil;
using std::fabs;
using std::floor;
using std::fma;
using std::fmax;
using std::rint;
using std::sqrt;

struct Index {
    unsigned int x, y;
};

namespace emulation {

struct Fibre {
    ucontext_t context;
    std::vector<char> stack = std::vector<char>(1 << 16);
    Index index;
    enum { ready, at_barrier, at_vote, done } state;
    bool vote;
};

inline std::vector<Fibre> fibres;
inline ucontext_t scheduler;
inline Fibre* current = nullptr;
inline Index block;
inline std::function<void()> body;
constexpr std::size_t warp = 32;

inline void run_body() {
    body();
    current->state = Fibre::done;
    swapcontext(&current->context, &scheduler);
}

inline void wait(decltype(Fibre::state) why) {
    current->state = why;
    swapcontext(&current->context, &scheduler);
}

// Lets go of those that have waited for all the others; false where nobody could be.
inline bool release() {
    bool any = false;
    std::size_t waiting = 0, finished = 0;
    for (Fibre& f : fibres) waiting += f.state == Fibre::at_barrier, finished += f.state == Fibre::done;
    if (waiting > 0 && waiting + finished == fibres.size()) {
        if (finished > 0) throw std::runtime_error("a barrier that some threads have left behind");
        for (Fibre& f : fibres) f.state = Fibre::ready;
        return true;
    }
    for (std::size_t first = 0; first < fibres.size(); first += warp) {
        const std::size_t last = std::min(first + warp, fibres.size());
        bool together = true, all = true;
        for (std::size_t i = first; i < last; ++i) {
            together = together && fibres[i].state == Fibre::at_vote;
            all = all && fibres[i].vote;
        }
        if (!together) continue;
        for (std::size_t i = first; i < last; ++i) fibres[i].state = Fibre::ready, fibres[i].vote = all;
        any = true;
    }
    return any;
}

inline void run_block(unsigned int threads) {
    fibres.resize(threads);
    for (unsigned int i = 0; i < threads; ++i) {
        Fibre& f = fibres[i];
        f.index = {i, 0};
        f.state = Fibre::ready;
        getcontext(&f.context);
        f.context.uc_stack.ss_sp = f.stack.data();
        f.context.uc_stack.ss_size = f.stack.size();
        f.context.uc_link = nullptr;
        makecontext(&f.context, run_body, 0);
    }
    for (bool backwards = true;; backwards = !backwards) {
        bool over = true;
        for (unsigned int i = 0; i < threads; ++i) {
            Fibre& f = fibres[backwards ? threads - 1 - i : i];
            if (f.state == Fibre::ready) {
                current = &f;
                swapcontext(&scheduler, &f.context);
            }
            over = over && f.state == Fibre::done;
        }
        if (over) return;
        if (!release()) throw std::runtime_error("threads wait for others that never come");
    }
}

template <class... A, std::size_t... I>
void call(void (*kernel)(A...), void** arguments, std::index_sequence<I...>) {
    kernel(*static_cast<A*>(arguments[I])...);
}

template <class... A>
void launch(void (*kernel)(A...), Index grid, unsigned int threads, void** arguments) {
    body = [=] { call(kernel, arguments, std::index_sequence_for<A...>()); };
    for (block.y = 0; block.y < grid.y; ++block.y)
        for (block.x = 0; block.x < grid.x; ++block.x) run_block(threads);
}

}  // namespace emulation

#define threadIdx (emulation::current->index)
#define blockIdx (emulation::block)

inline void __syncthreads() { emulation::wait(emulation::Fibre::at_barrier); }
inline bool __all_sync(unsigned int, bool vote) {
    emulation::current->vote = vote;
    emulation::wait(emulation::Fibre::at_vote);
    return emulation::current->vote;
}
