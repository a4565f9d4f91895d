"""Values as JSON has them, and the hash of a run's content."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Hashable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from enum import Enum
from functools import cache
from types import NoneType, UnionType
from typing import (
    TYPE_CHECKING,
    Any,
    Literal,
    Union,
    get_args,
    get_origin,
    get_type_hints,
    is_typeddict,
)

import numpy as np

if TYPE_CHECKING:
    import xarray as xr


# Where, when and how fast a run was made: runs that differ only in these are the same answer.
_PROVENANCE = {
    "argv",
    "created",
    "revision",
    "versions",
    "source",
    "source_digest",
    "contact_source",
    "contact_digest",
    "tags",
}
_TIMES = {"build_s", "solve_s", "audit_s", "seconds", "stage_seconds", "evaluation_s", "solver_s", "wall_s"}
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
        return {key: _without_circumstances(item) for key, item in value.items() if key not in _CIRCUMSTANCES}
    return [_without_circumstances(item) for item in value] if isinstance(value, list) else value


def from_json(kind: Any, value: Any, place: str = "") -> Any:
    """Build what the type ``kind`` says of ``value``, as JSON has it, records in records.

    Types are those of dataclasses and TypedDicts: numbers, texts, lists and mappings by text of
    them, Literals, Enums by their names' words, and unions. For a float null is NaN, a number that
    was not finite; of a TypedDict there may be more than it has.

    Raises ``ValueError`` that says what does not fit, at which ``place`` of the whole.
    """
    origin, inner = get_origin(kind), get_args(kind)
    if kind is Any:
        return value
    if origin in (Union, UnionType):
        return _of_union(inner, value, place)
    if origin is Literal:
        return _one_of(dict(zip(inner, inner, strict=True)), value, place)
    if isinstance(kind, type) and issubclass(kind, Enum):
        words = {name.lower().replace("_", "-"): one for name, one in kind.__members__.items()}
        return _one_of(words, value, place)
    if origin in (list, tuple):
        _expect(list, value, place)
        return [from_json(inner[0], item, f"{place}[{i}]") for i, item in enumerate(value)]
    if origin is dict:
        _expect(dict, value, place)
        return {key: from_json(inner[1], item, _under(place, key)) for key, item in value.items()}
    if is_dataclass(kind) or is_typeddict(kind):
        return _of_record(kind, value, place)
    _expect(kind, value, place)
    return (float("nan") if value is None else float(value)) if kind is float else value


_WORDS = {
    str: "a text",
    int: "a whole number",
    float: "a number or null",
    bool: "true or false",
    list: "a list",
    dict: "an object",
    NoneType: "null",
}
_PLAIN: dict[Any, Any] = {float: (int, float, NoneType)}


def _expect(kind: Any, value: Any, place: str) -> None:
    whole = isinstance(value, _PLAIN.get(kind, kind))
    if not whole or (isinstance(value, bool) and kind is not bool):
        raise _mismatch(place, value, _WORDS[kind])


def _of_union(kinds: tuple[Any, ...], value: Any, place: str) -> Any:
    """The first type that fits; null is null where the union has it."""
    if value is None and NoneType in kinds:
        return None
    errors = []
    for kind in kinds:
        try:
            return from_json(kind, value, place)
        except ValueError as error:
            errors.append(error)
    raise errors[0]


def _one_of(words: Mapping[Any, Any], value: Any, place: str) -> Any:
    if not isinstance(value, Hashable) or value not in words:
        raise _mismatch(place, value, f"one of {', '.join(map(str, words))}")
    return words[value]


def _of_record(kind: Any, value: Any, place: str) -> Any:
    """A dataclass has all of its fields and no others; a TypedDict those that are required."""
    _expect(dict, value, place)
    types, required = _fields(kind)
    if is_dataclass(kind) and (strange := sorted(set(value) - set(types))):
        raise ValueError(f"{_under(place, strange[0])} is unknown")
    if missing := sorted(required - set(value)):
        raise ValueError(f"{_under(place, missing[0])} is missing")
    parts = {
        key: from_json(types[key], item, _under(place, key)) if key in types else item for key, item in value.items()
    }
    made: Any = kind if is_dataclass(kind) else dict
    return made(**parts)


@cache
def _fields(kind: Any) -> tuple[dict[str, Any], frozenset[str]]:
    """Types of a record's fields, and the names of those that it must have."""
    if is_dataclass(kind):
        required = {f.name for f in fields(kind) if f.default is f.default_factory is MISSING}
        return get_type_hints(kind), frozenset(required)
    return get_type_hints(kind), kind.__required_keys__


def _under(place: str, key: str) -> str:
    return f"{place}.{key}" if place else key


def _mismatch(place: str, value: Any, expected: str) -> ValueError:
    shown = repr(value)
    shown = shown if len(shown) <= 40 else f"{shown[:37]}..."
    return ValueError(f"{place or 'it'} is {shown}, expected {expected}")
