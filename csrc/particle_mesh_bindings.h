#pragma once
#include <nanobind/nanobind.h>

void bind_particle_mesh(nanobind::module_& m);
void bind_spectra(nanobind::module_& m);
void bind_explain(nanobind::module_& m);
