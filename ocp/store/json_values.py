"""Conversion of values to and from JSON, and a hash of a run's content."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Hashable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from enum import Enum
from functools import cache
from types import NoneType, UnionType
from typing import (
    Any,
    Literal,
    Union,
    get_args,
    get_origin,
    get_type_hints,
    is_typeddict,
)

import numpy as np

from ocp.labelled import LabelledArrays

# Keys on where, when and from which files a run was made, which its hash does not depend on.
_PROVENANCE_KEYS = {
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
_TIME_KEYS = {"build_s", "solve_s", "audit_s", "seconds", "stage_seconds", "evaluation_s", "solver_s", "wall_s"}
"""Keys of computing times [s]."""
_UNHASHED_KEYS = _PROVENANCE_KEYS | _TIME_KEYS
"""Keys that are ignored by the hash of a run's content."""


def content_hash(arrays: LabelledArrays, meta: dict[str, Any]) -> str:
    """Return ten hexadecimal digits of a hash of a run's arrays and description, without times and provenance."""
    digest = hashlib.sha256()
    for name in sorted(set(arrays.variables) - _UNHASHED_KEYS):
        dims, values, attrs = arrays.variables[name]
        header = [name, list(dims), list(values.shape), to_json(dict(attrs))]
        digest.update(json.dumps(header, sort_keys=True).encode())
        numeric = values.dtype.kind in "biuf"
        digest.update(values.tobytes() if numeric else json.dumps(to_json(values)).encode())
    digest.update(json.dumps(_without_unhashed_keys(to_json(meta)), sort_keys=True).encode())
    return digest.hexdigest()[:10]


def to_json(value: Any) -> Any:
    """Convert nested values to JSON types; numbers that are not finite become None."""
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


def _without_unhashed_keys(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_unhashed_keys(item) for key, item in value.items() if key not in _UNHASHED_KEYS}
    return [_without_unhashed_keys(item) for item in value] if isinstance(value, list) else value


def from_json(kind: Any, value: Any, path: str = "") -> Any:
    """Build an instance of the type ``kind``, with nested records, from the JSON ``value``.

    Supported types are dataclasses and TypedDicts whose fields are numbers, texts, lists, mappings from texts,
    Literals, Enums (stored as their names in lower case), and unions. A float that is null becomes NaN, since
    numbers that are not finite are stored as null. A TypedDict may have additional entries.

    Raises ``ValueError``, with the mismatch and its ``path`` in the document in its message.
    """
    origin, arguments = get_origin(kind), get_args(kind)
    if kind is Any:
        return value
    if origin in (Union, UnionType):
        return _union_from_json(arguments, value, path)
    if origin is Literal:
        return _choice_from_json(dict(zip(arguments, arguments, strict=True)), value, path)
    if isinstance(kind, type) and issubclass(kind, Enum):
        members = {name.lower().replace("_", "-"): member for name, member in kind.__members__.items()}
        return _choice_from_json(members, value, path)
    if origin in (list, tuple):
        _check_type(list, value, path)
        return [from_json(arguments[0], item, f"{path}[{i}]") for i, item in enumerate(value)]
    if origin is dict:
        _check_type(dict, value, path)
        return {key: from_json(arguments[1], item, _child_path(path, key)) for key, item in value.items()}
    if is_dataclass(kind) or is_typeddict(kind):
        return _record_from_json(kind, value, path)
    _check_type(kind, value, path)
    return (float("nan") if value is None else float(value)) if kind is float else value


_TYPE_DESCRIPTIONS = {
    str: "a text",
    int: "a whole number",
    float: "a number or null",
    bool: "true or false",
    list: "a list",
    dict: "an object",
    NoneType: "null",
}
"""Mapping from types to their descriptions in messages."""
_ACCEPTED_TYPES: dict[Any, Any] = {float: (int, float, NoneType)}
"""Mapping from types to the Python types accepted for them, if these differ."""


def _check_type(kind: Any, value: Any, path: str) -> None:
    fits = isinstance(value, _ACCEPTED_TYPES.get(kind, kind))
    if not fits or (isinstance(value, bool) and kind is not bool):
        raise _mismatch(path, value, _TYPE_DESCRIPTIONS[kind])


def _union_from_json(kinds: tuple[Any, ...], value: Any, path: str) -> Any:
    """Build an instance of the first type of a union that fits ``value``; null is None if the union allows None."""
    if value is None and NoneType in kinds:
        return None
    errors = []
    for kind in kinds:
        try:
            return from_json(kind, value, path)
        except ValueError as error:
            errors.append(error)
    raise errors[0]


def _choice_from_json(choices: Mapping[Any, Any], value: Any, path: str) -> Any:
    if not isinstance(value, Hashable) or value not in choices:
        raise _mismatch(path, value, f"one of {', '.join(map(str, choices))}")
    return choices[value]


def _record_from_json(kind: Any, value: Any, path: str) -> Any:
    """Build a dataclass or TypedDict; raise ``ValueError`` for missing fields and a dataclass's unknown fields.

    A property of a dataclass may be stored beside its fields; it must equal the property of the record.
    """
    _check_type(dict, value, path)
    types, required = _field_types(kind)
    derived = {key: item for key, item in value.items() if isinstance(getattr(kind, key, None), property)}
    if is_dataclass(kind) and (unknown := sorted(set(value) - set(types) - set(derived))):
        raise ValueError(f"{_child_path(path, unknown[0])} is unknown")
    if missing := sorted(required - set(value)):
        raise ValueError(f"{_child_path(path, missing[0])} is missing")
    entries = {
        key: from_json(types[key], item, _child_path(path, key)) if key in types else item
        for key, item in value.items()
        if key not in derived
    }
    make_record: Any = kind if is_dataclass(kind) else dict
    record = make_record(**entries)
    for key, item in derived.items():
        if item != (expected := to_json(getattr(record, key))):
            raise _mismatch(_child_path(path, key), item, f"{expected!r} by its other entries")
    return record


@cache
def _field_types(kind: Any) -> tuple[dict[str, Any], frozenset[str]]:
    """Return a mapping from fields of a dataclass or TypedDict to types, and the names of required fields."""
    if is_dataclass(kind):
        required = {f.name for f in fields(kind) if f.default is f.default_factory is MISSING}
        return get_type_hints(kind), frozenset(required)
    return get_type_hints(kind), kind.__required_keys__


def _child_path(path: str, key: str) -> str:
    return f"{path}.{key}" if path else key


def _mismatch(path: str, value: Any, expected: str) -> ValueError:
    quoted = repr(value)
    quoted = quoted if len(quoted) <= 40 else f"{quoted[:37]}..."
    return ValueError(f"{path or 'it'} is {quoted}, expected {expected}")
