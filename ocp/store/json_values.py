"""Values as JSON has them, and the hash of a run's content."""

from __future__ import annotations

import hashlib
import json
from dataclasses import is_dataclass
from enum import Enum
from types import UnionType
from typing import TYPE_CHECKING, Any, get_args, get_origin, get_type_hints

import numpy as np

if TYPE_CHECKING:
    import xarray as xr

# Where, when and how fast a run was made: runs that differ only in these are the same answer.
_PROVENANCE = {"argv", "created", "revision", "versions", "source", "source_digest",
               "tags"}  # fmt: skip
_TIMES = {"build_s", "solve_s", "audit_s", "seconds", "stage_seconds", "evaluation_s", "solver_s",
          "wall_s"}  # fmt: skip
_CIRCUMSTANCES = _PROVENANCE | _TIMES


def content_hash(data: xr.Dataset, meta: dict[str, Any]) -> str:
    """Ten hex digits over arrays and description without times and circumstances."""
    digest = hashlib.sha256()
    for name in sorted(set(map(str, data.variables)) - _CIRCUMSTANCES):
        variable = data.variables[name]
        values = np.asarray(variable.values)
        head = [name, list(variable.dims), list(values.shape), to_json(dict(variable.attrs))]
        digest.update(json.dumps(head, sort_keys=True).encode())
        numeric = values.dtype.kind in "biuf"
        digest.update(values.tobytes() if numeric else json.dumps(to_json(values)).encode())
    digest.update(json.dumps(_without_circumstances(to_json(meta)), sort_keys=True).encode())
    return digest.hexdigest()[:10]


def to_json(value: Any) -> Any:
    """Turn nested values into what JSON has; a number that is not finite becomes null."""
    if isinstance(value, dict):
        return {str(key): to_json(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [to_json(item) for item in value]
    if isinstance(value, np.ndarray):
        return to_json(value.tolist())
    if isinstance(value, np.generic):
        return to_json(value.item())
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


def from_json(kind: Any, value: Any) -> Any:
    """Build what the type ``kind`` says, records in records; null is a float that was not finite.

    Raises ``KeyError`` or ``TypeError`` for records that are not whole.
    """
    if value is None:
        return float("nan") if kind is float else None
    if isinstance(kind, type) and is_dataclass(kind):
        types = get_type_hints(kind)
        return kind(**{name: from_json(types[name], item) for name, item in value.items()})
    inner = [part for part in get_args(kind) if part is not type(None)]
    if get_origin(kind) is list:
        return [from_json(inner[0], item) for item in value]
    if isinstance(kind, UnionType):
        return from_json(inner[0], value)
    if isinstance(kind, type) and issubclass(kind, Enum):
        return kind[str(value).replace("-", "_").upper()]
    return float(value) if kind is float else value
