"""Values as JSON has them, and the hash of a run's content."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
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


_WORDS = {
    str: "a text", int: "a whole number", float: "a number or null", bool: "true or false",
    list: "a list", dict: "an object", NoneType: "null",
}  # fmt: skip


def misfit(kind: Any, value: Any, place: str = "") -> str:
    """Say where ``value``, as JSON has it, is not of type ``kind``; empty where it is.

    Types are those of dataclasses and TypedDicts: numbers, texts, lists and mappings by text of
    them, Literals, Enums by their names' words, and unions. A float may be null, which stands for a
    number that was not finite; of a TypedDict there may be more than it has.
    """
    if kind is Any:
        return ""
    if get_origin(kind) in (Union, UnionType):
        found = [misfit(part, value, place) for part in get_args(kind)]
        return "" if "" in found else found[0]
    for applies, check in _CHECKS:
        if applies(kind):
            return check(kind, value, place)
    return "" if _is_plain(kind, value) else _mismatch(place, value, _WORDS[kind])


def _is_plain(kind: Any, value: Any) -> bool:
    if kind is float:
        return value is None or (isinstance(value, int | float) and not isinstance(value, bool))
    return isinstance(value, kind) and (kind is bool or not isinstance(value, bool))


def _of_literal(kind: Any, value: Any, place: str) -> str:
    words = get_args(kind)
    return "" if value in words else _mismatch(place, value, f"one of {', '.join(map(str, words))}")


def _of_enum(kind: type[Enum], value: Any, place: str) -> str:
    words = [name.lower().replace("_", "-") for name in kind.__members__]
    return "" if value in words else _mismatch(place, value, f"one of {', '.join(words)}")


def _of_list(kind: Any, value: Any, place: str) -> str:
    if not isinstance(value, list):
        return _mismatch(place, value, _WORDS[list])
    inner = get_args(kind)[0]
    return _first(misfit(inner, item, f"{place}[{i}]") for i, item in enumerate(value))


def _of_dict(kind: Any, value: Any, place: str) -> str:
    if not isinstance(value, dict):
        return _mismatch(place, value, _WORDS[dict])
    inner = get_args(kind)[1]
    return _first(misfit(inner, item, _under(place, key)) for key, item in value.items())


def _of_record(kind: Any, value: Any, place: str) -> str:
    """A dataclass has all of its fields and no others; a TypedDict those that are required."""
    if not isinstance(value, dict):
        return _mismatch(place, value, _WORDS[dict])
    types, required = _fields(kind)
    if is_dataclass(kind) and (strange := sorted(set(value) - set(types))):
        return f"{_under(place, strange[0])} is unknown"
    if missing := sorted(required - set(value)):
        return f"{_under(place, missing[0])} is missing"
    return _first(
        misfit(types[key], item, _under(place, key)) for key, item in value.items() if key in types
    )


@cache
def _fields(kind: Any) -> tuple[dict[str, Any], frozenset[str]]:
    """Types of a record's fields, and the names of those that it must have."""
    if is_dataclass(kind):
        required = {f.name for f in fields(kind) if f.default is f.default_factory is MISSING}
        return get_type_hints(kind), frozenset(required)
    return get_type_hints(kind), kind.__required_keys__


_CHECKS: list[tuple[Callable[[Any], bool], Callable[[Any, Any, str], str]]] = [
    (lambda kind: get_origin(kind) is Literal, _of_literal),
    (lambda kind: get_origin(kind) is list, _of_list),
    (lambda kind: get_origin(kind) is tuple, _of_list),
    (lambda kind: get_origin(kind) is dict, _of_dict),
    (lambda kind: is_dataclass(kind) or is_typeddict(kind), _of_record),
    (lambda kind: isinstance(kind, type) and issubclass(kind, Enum), _of_enum),
]


def _first(found: Any) -> str:
    return next(filter(None, found), "")


def _under(place: str, key: str) -> str:
    return f"{place}.{key}" if place else key


def _mismatch(place: str, value: Any, expected: str) -> str:
    shown = repr(value)
    shown = shown if len(shown) <= 40 else f"{shown[:37]}..."
    return f"{place or 'it'} is {shown}, expected {expected}"
