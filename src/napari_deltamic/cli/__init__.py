"""The command line: the same engine as the widget, without Qt.

Results go to stdout, one line each; progress, remarks and errors to stderr. Exit codes: 0 done,
1 failed, 2 bad usage or input, 130 interrupted.
"""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from typing import NoReturn

from .. import __version__
from ..errors import PROGRAM, Failure, InputError, failure, one_line
from .arguments import COMMANDS
from .messages import INTERRUPTED, Notes

_log = logging.getLogger(__name__)


class _Parser(argparse.ArgumentParser):
    """A parser that reports bad usage like other bad input: in one line, without usage text."""

    def error(self, message: str) -> NoReturn:
        raise InputError(message)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line (of this process by default); returns the exit code."""
    with suppress(AttributeError):  # a table is worth printing without signs that stdout lacks
        sys.stdout.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
    try:
        arguments = build_parser().parse_args(argv)
    except SystemExit as stop:  # after --help and --version
        return int(stop.code or 0)
    except InputError as error:
        return _end(str(error), 2)
    with _logging(arguments.verbose):
        return _run(arguments)


def _run(arguments: argparse.Namespace) -> int:
    notes = Notes()
    try:
        arguments.check(arguments)
        with notes.catching_warnings():
            command = import_module(f".{arguments.module}", __package__)  # loads the engine
            code = int(command.run(arguments, notes))
        sys.stdout.flush()  # what cannot be written is an error here, not a remark at exit
        return code
    except InputError as error:
        return _end(str(error), 2)
    except KeyboardInterrupt:
        return _end("interrupted", INTERRUPTED)
    except BrokenPipeError:  # whoever reads the results has left
        return 1
    except Exception as error:
        _log.error("unexpected error", exc_info=error)
        return _end(str(error if isinstance(error, Failure) else failure(error)), 1)


def build_parser() -> argparse.ArgumentParser:
    """The parser of all commands; each sets `module`, and `check` if it can refuse arguments."""
    parser = _Parser(
        prog=PROGRAM,
        description="Cell shapes in 3D, as meshes, straight from a fluorescence stack.",
        epilog="Lengths are um, in the order Z Y X.",
    )
    parser.add_argument("--version", action="version", version=f"{PROGRAM} {__version__}")
    parser.set_defaults(check=lambda arguments: None)
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for command in COMMANDS:
        command.add_parser(commands)
    # Before the command or after it.
    for where in (parser, *commands.choices.values()):
        where.add_argument(
            "-v",
            "--verbose",
            action="store_true",
            default=False if where is parser else argparse.SUPPRESS,
            help="write the log on stderr, with the traceback of unexpected errors",
        )
    return parser


@contextmanager
def _logging(verbose: bool) -> Iterator[None]:
    """Send the log to stderr, or nowhere: libraries log what does not matter to a run."""
    root = logging.getLogger()
    handler = logging.StreamHandler() if verbose else logging.NullHandler()
    level = root.level
    root.addHandler(handler)
    if verbose:
        root.setLevel(logging.INFO)
    try:
        yield
    finally:
        root.removeHandler(handler)
        root.setLevel(level)


def _end(message: str, code: int) -> int:
    print(f"{PROGRAM}: error: {one_line(message)}", file=sys.stderr)
    return code
