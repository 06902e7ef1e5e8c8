"""What decided in a fit beside the settings of its run; kept with each result.

A number that decides is one of *rules*: a frozen dataclass whose docstring says, number by number,
its unit and where the value comes from. A caller cannot change rules, as opposed to settings; they
may be others in another version.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from ..evidence import outgrowths, sanity, unseeded_objects, verdict
from ..evidence.evidence_rules import CAMERA, RESIDUAL, SPECTRUM
from ..fitting import evening, rival_structures, shape_dial, structure_choice, topology
from ..fitting.schedule import Schedule
from ..geometry.labels.cell_rules import FINDING

RULES_OF_A_FIT: dict[str, dict[str, Any]] = {
    "cells": asdict(FINDING),
    "sanity": asdict(sanity.RULES),
    "first PSF": asdict(SPECTRUM),
    "shape": asdict(shape_dial.RULES),
    "schedule": asdict(Schedule()),
    "structure": asdict(structure_choice.RULES),
    "uneven insides": asdict(evening.RULES),
    "rivals": asdict(rival_structures.RULES),
    "topology": asdict(topology.RULES),
    "camera": asdict(CAMERA),
    "residual": asdict(RESIDUAL),
    "outgrowths": asdict(outgrowths.RULES),
    "strays": asdict(unseeded_objects.RULES),
    "verdict": asdict(verdict.RULES),
}
