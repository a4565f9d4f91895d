"""Read and check values from outside: numbers, types and paths, or raise one sentence.

One grammar of numbers holds for every option of the command line and every text given to Python. A
number has the digits 0 to 9, a sign, a point and a power of ten: ``20``, ``-0.5``, ``.5``,
``1e-3``, ``+2E4``. A whole number has no fraction: ``20``, ``2e1`` and ``20.0`` are the same.
Surrounding blanks are ignored and ``-0`` is 0. Refused are ``nan``, ``inf``, ``1e999`` and
``1e-999`` (outside the range of a double), ``1_000``, ``0x10``, ``1,5`` and other scripts' digits.
"""

from __future__ import annotations

import math
import re
import sys
from dataclasses import dataclass
from decimal import Decimal
from functools import cache
from os import PathLike, fspath
from pathlib import Path
from types import GenericAlias
from typing import Annotated, Any, get_args

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Field,
    TypeAdapter,
    ValidationError,
)

from ocp.errors import InputError, abbreviated

LARGEST = 2**63 - 1
"""No whole number is larger in size."""
_TOO_LARGE = f"a whole number of at most {LARGEST:.2g} in size"
_WHOLE = re.compile(r"[+-]?[0-9]+")
_NUMBER = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?")
_DIGITS = 30
"""Of a whole number at most; more are not worth reading."""


def parse_float(word: str) -> float | None:
    """The finite number that ``word`` writes, None where it writes none."""
    text = word.strip()
    if not _NUMBER.fullmatch(text):
        return None
    value = float(text)
    lost = value == 0 and re.search("[1-9]", re.split("[eE]", text)[0])
    return value + 0.0 if math.isfinite(value) and not lost else None


def parse_int(word: str) -> int | None:
    """The whole number that ``word`` writes, None where it writes none."""
    text = word.strip()
    if _WHOLE.fullmatch(text):
        value = int(text) if len(text) <= _DIGITS else LARGEST + 1
        return value if abs(value) <= LARGEST else None
    real = parse_float(text)
    if real is None or not real.is_integer() or abs(real) > LARGEST:
        return None
    # Doubles skip whole numbers beyond 2^53, and 0.99999999999999999 is 1 to them.
    exact = Decimal(text)
    return int(exact) if exact == exact.to_integral_value() else None


GRAMMAR = "NAME=A:B:n, or NAME=A:B:n:log in equal ratios"
MOST = 100_000
"""Values of a sweep, and points of a grid."""


@dataclass(frozen=True)
class Axis:
    """A name and the values (n,) that it takes; ``log``: drawn in equal ratios."""

    name: str
    values: tuple[float, ...]
    log: bool = False


def parse_axis_option(option: str, text: str, least: int = 1) -> Axis:
    """Read text of :data:`GRAMMAR`.

    Raises :class:`~ocp.errors.InputError`, which names the ``option``, for anything else, and for n
    below ``least`` or above :data:`MOST`.
    """
    name, equals, spacing = (piece.strip() for piece in text.partition("="))
    if not (name and equals and spacing):
        raise InputError(f"{option}: expected {GRAMMAR}, got {text!r}; as in {option} M=0.5:2:7")
    pieces, place = [piece.strip() for piece in spacing.split(":")], f"{option} {name}"
    if len(pieces) not in (3, 4) or pieces[3:] not in ([], ["log"], ["linear"]):
        raise InputError(f"{place}: expected {GRAMMAR}, got {spacing!r}")
    numbers = [value for piece in pieces[:3] if (value := parse_float(piece)) is not None]
    if len(numbers) < 3:
        wrong = next(piece for piece in pieces if parse_float(piece) is None)
        raise InputError(f"{place}: expected {GRAMMAR}, got {wrong!r} for a number")
    first, last, count = numbers
    if not (count.is_integer() and least <= count <= MOST):
        single = f"; a single value goes with -p {name}=..." if least > 1 else ""
        raise InputError(f"{place}: n must be a whole number from {least} to {MOST}, got {pieces[2]}{single}")
    log = pieces[3:] == ["log"]
    if log and not min(first, last) > 0:
        raise InputError(f"{place}: equal ratios need ends above zero, got {first:g} and {last:g}; leave out :log")
    values = (np.geomspace if log else np.linspace)(first, last, int(count))
    return Axis(name, tuple(values.tolist()), log)


def parse_number(value: Any, kind: Any) -> Any:
    """``value`` for an argument of type ``kind``: a word as the number it writes.

    What ``kind`` takes otherwise, words among it, is returned as it is.

    Raises ``ValueError``, with what was expected, for a word that is no number, for true and false
    in the place of one, for what is not finite, and for whole numbers beyond :data:`LARGEST`.
    """
    kinds = _kinds(kind)
    if not kinds & {int, float} or kinds & {str, tuple, list, dict}:
        return value
    if isinstance(value, np.generic):
        value = value.item()
    if (isinstance(value, str) or value is True or value is False) and bool not in kinds:
        value = _written(str(value), float in kinds)
    if float in kinds and type(value) is int:
        value = float(value) if abs(value) < sys.float_info.max else math.inf
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError("a finite number" if float in kinds else "a whole number")
    if isinstance(value, int) and abs(value) > LARGEST:
        raise ValueError(_TOO_LARGE)
    return value


def _written(word: str, real: bool) -> float | int:
    value = parse_float(word) if real else parse_int(word)
    if value is not None:
        return value
    if not real:
        is_large = _WHOLE.fullmatch(word.strip()) or (parse_float(word) or 0.5).is_integer()
        raise ValueError(_TOO_LARGE if is_large else "a whole number")
    try:
        float(word)
    except ValueError:
        raise ValueError("a number") from None
    # Python reads more than is a number here: nan, inf, 1_000 and digits of other scripts.
    raise ValueError("a finite number" if word.strip().isascii() and "_" not in word else "a number")


def _kinds(kind: Any) -> set[Any]:
    """The types that ``kind`` is made of, without what annotates them."""
    if not (inner := get_args(kind)):
        return {kind}
    if hasattr(kind, "__metadata__"):
        return _kinds(inner[0])
    origin = getattr(kind, "__origin__", None)
    if isinstance(origin, type):
        return {origin}
    return set().union(*map(_kinds, inner))


def _number(value: Any) -> Any:
    if isinstance(value, bool | np.bool_ | str | bytes | bytearray):
        raise ValueError("must be a number")
    single = isinstance(value, np.generic | np.ndarray) and value.shape == ()
    return _number(value.item()) if single else value


def _line(text: str) -> str:
    if not text.isprintable():
        raise ValueError("must be one line of text without control characters")
    return text


Number = Annotated[float, BeforeValidator(_number), Field(allow_inf_nan=False)]
"""A finite number of Python's or NumPy's, and no word."""
Positive = Annotated[Number, Field(gt=0)]
NotNegative = Annotated[Number, Field(ge=0)]
Count = Annotated[int, BeforeValidator(_number), Field(ge=1)]
Index = Annotated[int, BeforeValidator(_number), Field(ge=0)]
Line = Annotated[str, Field(strict=True), AfterValidator(_line)]
"""A text that fits into a line and a terminal."""
Name = Annotated[Line, Field(min_length=1)]
Scalar = bool | int | float | str
Recorded = Scalar | list[Scalar]
"""What the record of a run holds of a parameter or a setting."""


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    config = ConfigDict(arbitrary_types_allowed=True, revalidate_instances="always")
    # pydantic takes no configuration for a bare dataclass, but for a tuple of one.
    wrapped: Any = GenericAlias(tuple, (kind,))
    return TypeAdapter(wrapped, config=config)


def validated(name: str, value: Any, kind: Any) -> Any:
    """Return a ``value`` that code made as the type ``kind``; what it is made of is checked too.

    Raises :class:`~ocp.errors.InputError` that names the part of ``what`` that does not fit.
    """
    try:
        return _adapter(kind).validate_python((value,))[0]
    except ValidationError as error:
        # Of a union the branch that came furthest says what is wrong.
        first_error = max(error.errors(), key=lambda one: len(one["loc"]))
    place = _place(value, first_error["loc"][1:])
    _, should, expected = first_error["msg"].removeprefix("Value error, ").partition(" should ")
    expected = expected.replace("valid string", "text").replace("valid ", "")
    message = f"must {expected}" if should else first_error["msg"].removeprefix("Value error, ")
    raise InputError(f"{name}{place} {message}, got {abbreviated(first_error['input'])}")


def validate_fields(instance: Any, what: str, **kinds: Any) -> None:
    """Make the fields of a frozen dataclass what ``kinds`` say; raises as :func:`validated`."""
    for name, kind in kinds.items():
        value = validated(f"{what}.{name}", getattr(instance, name), kind)
        object.__setattr__(instance, name, value)


def _place(value: Any, path: tuple[int | str, ...]) -> str:
    """The part at ``path`` as Python writes it, without pydantic's own words for branches."""
    place = ""
    for key in path:
        try:
            value, place = value[key], f"{place}[{key!r}]"
        except (TypeError, LookupError):
            if not hasattr(value, str(key)):
                break
            value, place = getattr(value, str(key)), f"{place}.{key}"
    return place


_KINDS = {
    "bool": "true or false",
    "int": "a whole number",
    "float": "a number",
    "finite": "a finite number",
    "less": "between 0 and 1",
    "greater": "a positive finite number",
}
"""What to expect, by the first word of pydantic's name for what was wrong."""


def parse(name: str, value: Any, kind: Any) -> Any:
    """Return ``value``, a word or already a value, as the type ``kind``.

    Numbers follow the grammar of this module.

    Raises :class:`~ocp.errors.InputError` that says what was expected of ``what``.
    """
    try:
        number = parse_number(value, kind)
    except ValueError as error:
        raise InputError(f"{name} must be {error}, got {value!r}") from None
    try:
        adapter = TypeAdapter(kind, config=ConfigDict(arbitrary_types_allowed=True))
        return adapter.validate_python(number)
    except ValidationError as error:
        expectations = (_KINDS.get(detail["type"].partition("_")[0]) for detail in error.errors())
        expected = next((words for words in expectations if words), error.errors()[0]["msg"].lower())
        raise InputError(f"{name} must be {expected}, got {value!r}") from None


def expand_path(path: str | PathLike[str]) -> Path:
    """The path, with a leading ``~`` or ``~name`` as the home directory that it stands for.

    Shells do this for a word of its own, not behind ``--out=``, in a variable or in Python.

    Raises :class:`~ocp.errors.InputError` where there is no such home.
    """
    short_path = Path(fspath(path))
    try:
        return short_path.expanduser()
    except RuntimeError:
        raise InputError(
            f"{short_path}: there is no user called {short_path.parts[0][1:]}; give the whole path, or"
            f" ./{short_path} for a file of that name"
        ) from None
