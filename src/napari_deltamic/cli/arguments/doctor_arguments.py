"""The arguments of ``doctor``."""

from __future__ import annotations

from typing import Any


def add_parser(commands: Any) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "doctor",
        help="devices, engines, threads, versions; what would be used and why",
        description="Say what this machine offers, and what would be used and why.",
    )
    parser.add_argument("--json", action="store_true", help="the same as JSON")
    parser.set_defaults(module="doctor_command")
