"""Checks of external values: axes, structured data and paths; errors are one sentence."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from os import PathLike, fspath
from pathlib import Path
from types import GenericAlias
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, TypeAdapter, ValidationError

from dynamics.settings import parse_float
from ocp.errors import InputError, abbreviated

AXIS_GRAMMAR = "NAME=A:B:n, or NAME=A:B:n:log in equal ratios"
MAX_AXIS_VALUES = 100_000
"""Maximum number of values of an axis, and of points of a grid."""


@dataclass(frozen=True)
class Axis:
    """An axis of a grid: the name of a parameter and its values (n,); ``log`` marks values in equal ratios."""

    name: str
    values: tuple[float, ...]
    log: bool = False


def parse_axis_option(option: str, text: str, least_count: int = 1) -> Axis:
    """Return the axis that a text of the form :data:`AXIS_GRAMMAR` describes.

    Raises :class:`~ocp.errors.InputError`, with the ``option`` in its message, for any other text, and for n below
    ``least_count`` or above :data:`MAX_AXIS_VALUES`.
    """
    name, equals, spacing = (piece.strip() for piece in text.partition("="))
    if not (name and equals and spacing):
        raise InputError(f"{option}: expected {AXIS_GRAMMAR}, got {text!r}; as in {option} M=0.5:2:7")
    parts, title = [piece.strip() for piece in spacing.split(":")], f"{option} {name}"
    if len(parts) not in (3, 4) or parts[3:] not in ([], ["log"], ["linear"]):
        raise InputError(f"{title}: expected {AXIS_GRAMMAR}, got {spacing!r}")
    numbers = [value for piece in parts[:3] if (value := parse_float(piece)) is not None]
    if len(numbers) < 3:
        wrong = next(piece for piece in parts if parse_float(piece) is None)
        raise InputError(f"{title}: expected {AXIS_GRAMMAR}, got {wrong!r} for a number")
    first, last, count = numbers
    if not (count.is_integer() and least_count <= count <= MAX_AXIS_VALUES):
        single = f"; a single value goes with -p {name}=..." if least_count > 1 else ""
        raise InputError(
            f"{title}: n must be a whole number from {least_count} to {MAX_AXIS_VALUES}, got {parts[2]}{single}"
        )
    log = parts[3:] == ["log"]
    if log and not min(first, last) > 0:
        raise InputError(f"{title}: equal ratios need ends above zero, got {first:g} and {last:g}; leave out :log")
    values = (np.geomspace if log else np.linspace)(first, last, int(count))
    return Axis(name, tuple(values.tolist()), log)


def _refuse_text(value: Any) -> Any:
    if isinstance(value, bool | np.bool_ | str | bytes | bytearray):
        raise ValueError("must be a number")
    is_scalar = isinstance(value, np.generic | np.ndarray) and value.shape == ()
    return _refuse_text(value.item()) if is_scalar else value


def _refuse_control_characters(text: str) -> str:
    if not text.isprintable():
        raise ValueError("must be one line of text without control characters")
    return text


Number = Annotated[float, BeforeValidator(_refuse_text), Field(allow_inf_nan=False)]
"""A finite number of Python or NumPy; text and booleans are rejected."""
Positive = Annotated[Number, Field(gt=0)]
NotNegative = Annotated[Number, Field(ge=0)]
Count = Annotated[int, BeforeValidator(_refuse_text), Field(ge=1)]
Index = Annotated[int, BeforeValidator(_refuse_text), Field(ge=0)]
Line = Annotated[str, Field(strict=True), AfterValidator(_refuse_control_characters)]
"""A text of one line without control characters."""
Name = Annotated[Line, Field(min_length=1)]
Scalar = bool | int | float | str
Recorded = Scalar | list[Scalar]
"""Type of the value of a parameter or setting in the record of a run."""


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    config = ConfigDict(arbitrary_types_allowed=True, revalidate_instances="always")
    # pydantic accepts a configuration for a tuple of a dataclass, but not for the dataclass itself.
    singleton: Any = GenericAlias(tuple, (kind,))
    return TypeAdapter(singleton, config=config)


def validated(label: str, value: Any, kind: Any) -> Any:
    """Return ``value`` converted to the type ``kind``, with its parts checked as well.

    Raises :class:`~ocp.errors.InputError`, with the invalid part of ``label`` in its message.
    """
    try:
        return _adapter(kind).validate_python((value,))[0]
    except ValidationError as error:
        # In a union the branch that got furthest shows what is wrong.
        details = max(error.errors(), key=lambda branch: len(branch["loc"]))
    message = details["msg"].removeprefix("Value error, ")
    _, should, expected = message.partition(" should ")
    expected = expected.replace("valid string", "text").replace("valid ", "")
    sentence = f"must {expected}" if should else message
    path = _python_path(value, details["loc"][1:])
    raise InputError(f"{label}{path} {sentence}, got {abbreviated(details['input'])}")


def validate_fields(instance: Any, label: str, **kinds: Any) -> None:
    """Convert the fields of a frozen dataclass to their ``kinds``; raise as :func:`validated` does."""
    for name, kind in kinds.items():
        value = validated(f"{label}.{name}", getattr(instance, name), kind)
        object.__setattr__(instance, name, value)


def _python_path(value: Any, keys: tuple[int | str, ...]) -> str:
    """Return the path ``keys`` into a value in Python's notation, without pydantic's labels of union branches."""
    path = ""
    for key in keys:
        try:
            value, path = value[key], f"{path}[{key!r}]"
        except (TypeError, LookupError):
            if not hasattr(value, str(key)):
                break
            value, path = getattr(value, str(key)), f"{path}.{key}"
    return path


def expand_path(path: str | PathLike[str]) -> Path:
    """Return the path with a leading ``~`` or ``~name`` replaced by the home directory.

    Shells expand ``~`` only at the beginning of a word, not after ``--out=``, and Python does not expand it. Raises
    :class:`~ocp.errors.InputError` if there is no such home directory.
    """
    unexpanded = Path(fspath(path))
    try:
        return unexpanded.expanduser()
    except RuntimeError:
        raise InputError(
            f"{unexpanded}: there is no user called {unexpanded.parts[0][1:]}; give the whole path, or"
            f" ./{unexpanded} for a file of that name"
        ) from None
