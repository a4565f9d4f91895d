"""Values as JSON has them, and the hash of a run's content."""

from __future__ import annotations

import hashlib
import json
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import xarray as xr

# Where, when and how fast a run was made: runs that differ only in these are the same answer.
_PROVENANCE = {"argv", "created", "revision", "versions", "source"}
_TIMES = {"build_s", "solve_s", "audit_s", "seconds", "stage_seconds", "evaluation_s", "solver_s"}
_CIRCUMSTANCES = _PROVENANCE | _TIMES


def content_hash(data: xr.Dataset, meta: dict[str, Any]) -> str:
    """Ten hex digits over arrays and description without times and circumstances."""
    digest = hashlib.sha256()
    for name in sorted(set(map(str, data.variables)) - _CIRCUMSTANCES):
        variable = data.variables[name]
        values = np.asarray(variable.values)
        head = [name, list(variable.dims), list(values.shape), plain(dict(variable.attrs))]
        digest.update(json.dumps(head, sort_keys=True).encode())
        numeric = values.dtype.kind in "biuf"
        digest.update(values.tobytes() if numeric else json.dumps(plain(values)).encode())
    digest.update(json.dumps(_without_circumstances(plain(meta)), sort_keys=True).encode())
    return digest.hexdigest()[:10]


def plain(value: Any) -> Any:
    """Turn nested values into what JSON has; a number that is not finite becomes null."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    return str(value)


def _without_circumstances(value: Any) -> Any:
    if isinstance(value, dict):
        return {
            key: _without_circumstances(item)
            for key, item in value.items()
            if key not in _CIRCUMSTANCES
        }
    return [_without_circumstances(item) for item in value] if isinstance(value, list) else value


def number(value: float | None) -> float:
    """Read a number back: null stands for one that was not finite."""
    return float("nan") if value is None else float(value)


def read(kind: type, values: dict[str, Any]) -> Any:
    """Build a record, where JSON's null stands for a float that was not finite."""
    floats = {field.name for field in fields(kind) if field.type == "float"}
    return kind(**{k: number(v) if k in floats else v for k, v in values.items()})
