"""What decided in a fit beside the settings of its run; kept with each result.

A number that decides is one of *rules*: a frozen dataclass whose docstring says, number by number,
its unit and where the value comes from. A caller cannot change rules, as opposed to settings; they
may be others in another version.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from ..evidence import (
    compressed_brightness,
    dents,
    fainter_membranes,
    left_out,
    necks,
    outgrowths,
    predicted_error,
    sanity,
    slices_apart,
    unseeded_objects,
    verdict_rules,
)
from ..evidence.evidence_rules import CAMERA, RESIDUAL, SPECTRUM
from ..fitting import (
    amplitudes,
    bright_regions,
    dark_nuclei,
    deep_insides,
    density,
    evening,
    foreign_light,
    ground_again,
    growth_alarm,
    hidden_membranes,
    light_cone,
    likelihood,
    missed_parts,
    noise_blur,
    protrusions,
    psf_tails,
    refits,
    rival_structures,
    saturation,
    shape_dial,
    structure_choice,
    tempering,
    topology,
    triangle_quality,
    unequal_insides,
    voxel_ownership,
)
from ..fitting.schedule import Schedule
from ..geometry.labels import whole_cells
from ..geometry.labels.cell_rules import FINDING
from ..optics import narrow

RULES_OF_A_FIT: dict[str, dict[str, Any]] = {
    "cells": asdict(FINDING),
    "markers": asdict(whole_cells.RULES),
    "sanity": asdict(sanity.RULES),
    "first PSF": asdict(SPECTRUM),
    "shape": asdict(shape_dial.RULES),
    "voxels that count": asdict(voxel_ownership.RULES),
    "voxels that count, asked again": asdict(ground_again.RULES),
    "missed parts": asdict(missed_parts.RULES),
    "foreign light": asdict(foreign_light.RULES),
    "protrusions": asdict(protrusions.RULES),
    "bright regions": asdict(bright_regions.RULES),
    "saturation": asdict(saturation.RULES),
    "weights": asdict(likelihood.RULES),
    "tempering": asdict(tempering.RULES),
    "schedule": asdict(Schedule()),
    "triangles": asdict(triangle_quality.RULES),
    "growth": asdict(growth_alarm.RULES),
    "amplitudes": asdict(amplitudes.RULES),
    "density": asdict(density.RULES),
    "structure": asdict(structure_choice.RULES),
    "unequal insides": asdict(unequal_insides.RULES),
    "dark nuclei": asdict(dark_nuclei.RULES),
    "deep insides": asdict(deep_insides.RULES),
    "uneven insides": asdict(evening.RULES),
    "rivals": asdict(rival_structures.RULES),
    "hidden membranes": asdict(hidden_membranes.RULES),
    "narrow PSFs": asdict(narrow.RULES),
    "light cone": asdict(light_cone.RULES),
    "tails of the PSF": asdict(psf_tails.RULES),
    "topology": asdict(topology.RULES),
    "camera": asdict(CAMERA),
    "residual": asdict(RESIDUAL),
    "necks": asdict(necks.RULES),
    "outgrowths": asdict(outgrowths.RULES),
    "dents": asdict(dents.RULES),
    "left out": asdict(left_out.RULES),
    "strays": asdict(unseeded_objects.RULES),
    "changed images": asdict(refits.RULES),
    "fainter membranes": asdict(fainter_membranes.RULES),
    "noise": asdict(noise_blur.RULES),
    "predicted error": asdict(predicted_error.RULES),
    "slices": asdict(slices_apart.RULES),
    "logarithms": asdict(compressed_brightness.RULES),
    "verdict": asdict(verdict_rules.RULES),
}
