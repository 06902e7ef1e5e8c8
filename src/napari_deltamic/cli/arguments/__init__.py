"""What each command takes, and what is refused before any work.

Nothing here loads the engine: ``--version``, ``--help`` and mistakes answer at once. A command sets
``module``, which runs it, and ``check``, which raises InputError.
"""

from . import accuracy, demo, doctor, effects, fit, measure, render, simulate, track

COMMANDS = (fit, track, measure, effects, render, simulate, accuracy, doctor, demo)
