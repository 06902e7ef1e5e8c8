"""``python -m napari_deltamic`` is the command ``napari-deltamic``."""

import sys

from .cli import main

if __name__ == "__main__":
    sys.exit(main())
