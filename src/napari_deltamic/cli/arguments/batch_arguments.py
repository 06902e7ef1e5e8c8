"""The arguments of ``batch``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ...errors import InputError
from ..folders import check_folder
from .fit_arguments import add_fit_options, check_fit_options


def add_parser(commands: Any) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "batch",
        help="many stacks, one table: resumed where it was stopped, on one machine or many",
        description="Fit every stack of a folder, or of a TOML file. Each gets a folder in DIR; "
        "summary.csv has a row for each image, cells.csv all cells. Options are those of fit; "
        "--seeds is a pattern, {stem} for the name of the image: '{stem}_labels.tif'. The same "
        "command again goes on where it was stopped.",
    )
    add = parser.add_argument
    add("source", metavar="FOLDER_OR_CONFIG", help="folder of stacks (.tif, .npy, .zarr), or .toml")
    add_fit_options(parser)
    add(
        "--workers",
        type=int,
        metavar="N",
        help="processes of one thread each (default: one per core); 0: this process alone, without "
        "Dask",
    )
    add(
        "--scheduler",
        metavar="ADDRESS",
        help="scheduler of a Dask cluster whose workers see the same files",
    )
    add("-o", "--output", required=True, metavar="DIR", help="folder for the results")
    parser.set_defaults(module="batch_command", check=_check)


def _check(arguments: argparse.Namespace) -> None:
    if not Path(arguments.source).exists():
        raise InputError(f"{arguments.source}: there is no such file or folder")
    if arguments.workers is not None and arguments.workers < 0:
        raise InputError(f"--workers must be 0 or more, not {arguments.workers}")
    if arguments.workers is not None and arguments.scheduler is not None:
        raise InputError("--scheduler brings its own workers: leave out --workers")
    # Seeds are a pattern, and each image is checked when its turn comes.
    alone = {**vars(arguments), "image": arguments.source, "seeds": arguments.source}
    check_fit_options(argparse.Namespace(**alone), "batch")
    folder = Path(arguments.output)
    check_folder(folder, ())
    if (folder / "cells.csv").exists() and not (folder / "summary.csv").exists():
        raise InputError(f"{folder} holds a cells.csv that no batch wrote: choose another folder")


def fit_words(arguments: argparse.Namespace) -> tuple[str, ...]:
    """The options of ``fit`` that were given, as one would type them; seeds are left out."""
    parser = argparse.ArgumentParser(add_help=False)
    add_fit_options(parser)
    words: list[str] = []
    for action in parser._actions:
        value = getattr(arguments, action.dest)
        if value is None or value == action.default or action.dest == "seeds":
            continue
        if action.dest in ("settings", "optics", "psf"):  # for processes that start elsewhere
            value = Path(value).absolute()
        if isinstance(value, bool):
            words.append(action.option_strings[0 if value else -1])
        else:
            many = value if isinstance(value, list) else [value]
            words += [action.option_strings[0], *map(str, many)]
    return tuple(words)
