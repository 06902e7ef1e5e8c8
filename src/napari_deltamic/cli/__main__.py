"""``python -m napari_deltamic.cli`` is the command ``napari-deltamic``."""

import sys

from . import main

if __name__ == "__main__":
    sys.exit(main())
