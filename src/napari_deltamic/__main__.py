"""``python -m napari_deltamic`` is the command ``napari-deltamic``.

Both start here, so that Ctrl-C ends them in one line also while modules are loaded.
"""

import sys


def main() -> int:
    """Run the command line of this process; returns the exit code."""
    try:
        from .common.seldom_collected import collect_seldom

        collect_seldom()
        from .cli import main as command

        code = command()
    except KeyboardInterrupt:
        print("napari-deltamic: error: interrupted", file=sys.stderr)
        code = 130  # as everywhere; the modules that name these may not be there yet
    # CPython forgets the code and dies of the signal where the text that was executed last, as the
    # makers of dataclasses do, was left by Ctrl-C, caught or not. This text is not.
    exec("")
    return code


if __name__ == "__main__":
    sys.exit(main())
