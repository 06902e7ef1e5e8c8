// Which instruction sets this build has and this processor runs, and the loops compiled for each.
#pragma once
#include <string>
#include <vector>

#include "mesh_ft.h"
#include "particle_mesh.h"
#include "spectra.h"

namespace deltamic_api {

struct Level {
    std::string name;
    const Loops<float>* f32;
    const Loops<double>* f64;
    const MeshLoops<float>* mesh_f32;
    const MeshLoops<double>* mesh_f64;
    const SpectrumLoops<float>* spectrum_f32;
    const SpectrumLoops<double>* spectrum_f64;
};

// Slowest first.
const std::vector<Level>& levels();

// Raises std::invalid_argument where there is none of this name.
const Level& level_named(const std::string& name);

template <class T>
const Loops<T>& loops_of(const std::string& name) {
    if constexpr (sizeof(T) == 4) return *level_named(name).f32;
    else return *level_named(name).f64;
}

template <class T>
const MeshLoops<T>& mesh_loops_of(const std::string& name) {
    if constexpr (sizeof(T) == 4) return *level_named(name).mesh_f32;
    else return *level_named(name).mesh_f64;
}

template <class T>
const SpectrumLoops<T>& spectrum_loops_of(const std::string& name) {
    if constexpr (sizeof(T) == 4) return *level_named(name).spectrum_f32;
    else return *level_named(name).spectrum_f64;
}

}  // namespace deltamic_api
