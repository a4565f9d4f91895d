"""Reading a model from its file."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def read_model(path: Path) -> Any:
    """The model in a netCDF file.

    Raises ``ValueError`` where there is no such file or it holds no model.
    """
    raise ValueError(f"{path}: there is no such file; make it with ocp learn")
