"""The arguments of each command, and what is refused before any work.

Nothing here loads the engine: ``--version``, ``--help`` and errors are answered at once. A command
sets ``module``, which runs it, and ``check``, which raises InputError.
"""

from . import (
    accuracy_arguments,
    batch_arguments,
    demo_arguments,
    doctor_arguments,
    effects_arguments,
    fit_arguments,
    measure_arguments,
    render_arguments,
    simulate_arguments,
    track_arguments,
)

COMMANDS = (
    fit_arguments,
    batch_arguments,
    track_arguments,
    measure_arguments,
    effects_arguments,
    render_arguments,
    simulate_arguments,
    accuracy_arguments,
    doctor_arguments,
    demo_arguments,
)
