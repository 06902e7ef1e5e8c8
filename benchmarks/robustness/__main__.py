"""``python -m benchmarks.robustness files|kills|native``."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from importlib import import_module

EXPERIMENTS = {
    "files": "damaged files, over all readers and through the command line",
    "kills": "runs that are ended, also while they write",
    "native": "wrong calls of the compiled functions",
    "window": "random actions in the window",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one experiment; 1 if anything went wrong."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.robustness", description=__doc__)
    commands = parser.add_subparsers(required=True, dest="experiment")
    for name, text in EXPERIMENTS.items():
        module = import_module(f".{name}", __package__)
        own = commands.add_parser(name, help=text, description=module.__doc__)
        own.add_argument("--seed", type=int, default=0, help="of the random numbers")
        module.add_arguments(own)
        own.set_defaults(run=module.run)
    arguments = parser.parse_args(argv)
    return int(arguments.run(arguments))


if __name__ == "__main__":
    raise SystemExit(main())
