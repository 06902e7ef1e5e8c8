"""The version that is installed; read when it is asked for, as that takes longer than the rest."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("napari-deltamic")
except PackageNotFoundError:  # running from a source tree that was never installed
    __version__ = "0+unknown"
