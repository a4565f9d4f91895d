"""How a field of a command's options says what it is on the command line."""

from __future__ import annotations

from dataclasses import MISSING, field
from typing import Any

import typer


def option(default: Any, *flags: str, **shown: Any) -> Any:
    """Declare a field as an option: ``MISSING`` or its default, and as ``typer.Option`` has it."""
    return field(default=default, metadata={"typer": typer.Option(*flags, **shown)})


def argument(default: Any = MISSING, **shown: Any) -> Any:
    """Declare a field as a word without a flag, shown as ``typer.Argument`` has it."""
    return field(default=default, metadata={"typer": typer.Argument(**shown)})
