"""Declarations of settings: default, unit, meaning and range.

:func:`declare` makes a field of a pydantic model, such as a parameter of a problem; :func:`setting` makes a field of
a dataclass that derives from :class:`Configured`, such as a contact law, a policy or an algorithm. The declaration
is used to parse text, to check values, to list settings (:func:`settings_of`) and to write error messages.

Numbers in options of the command line and in text passed to Python follow the same grammar. A number has the
digits 0 to 9, a sign, a point and a power of ten: ``20``, ``-0.5``, ``.5``, ``1e-3``, ``+2E4``. A whole number has
no fraction: ``20``, ``2e1`` and ``20.0`` are the same. Surrounding blanks are ignored and ``-0`` is 0. The parser
rejects ``nan``, ``inf``, ``1e999`` and ``1e-999`` (outside the range of a double), ``1_000``, ``0x10``, ``1,5`` and
digits of other scripts.
"""

from __future__ import annotations

import inspect
import math
import re
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, is_dataclass
from decimal import Decimal
from functools import cache, cached_property, lru_cache
from types import SimpleNamespace
from typing import Annotated, Any, TypedDict, Unpack, get_args, get_type_hints

import numpy as np
from pydantic import ConfigDict, Field, TypeAdapter
from pydantic.fields import FieldInfo

from dynamics.errors import InputError, did_you_mean

LARGEST = 2**63 - 1
"""Maximum absolute value of a whole number."""
MAX_CHARACTERS = 30
"""Maximum number of characters of a whole number in text; longer text is rejected before it is parsed."""
_INTEGER = re.compile(r"[+-]?[0-9]+")
_FLOAT = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?")
_METADATA_KEY = "setting"
_SIGNS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
_KINDS = {bool: "true or false", int: "a whole number", float: "a number", str: "a word", tuple: "whole numbers"}


class Range(TypedDict, total=False):
    """Limits of a number: ``above < x < below`` and ``least <= x <= most``."""

    above: float
    below: float
    least: float
    most: float


def declare(default: Any, meaning: str, unit: str = "1", limits: Range | None = None, **extra: Any) -> Any:
    """Declare a field of a pydantic model in SI ``unit`` within ``limits``.

    ``extra`` may contain ``words``, the only allowed values, and ``hint``, a sentence at the end of the error message
    for a value out of range; the caller may use other keys as needed.
    """
    limits = limits or {}
    bounds = {"gt": limits.get("above"), "ge": limits.get("least"), "lt": limits.get("below"), "le": limits.get("most")}
    return Field(default, description=meaning, json_schema_extra={"unit": unit, **extra}, **bounds)  # pyright: ignore


def setting(
    default: Any, meaning: str = "", unit: str = "1", words: Sequence[str] = (), hint: str = "", **limits: Unpack[Range]
) -> Any:
    """Declare a field of a :class:`Configured` dataclass; a field without ``meaning`` is checked but not listed."""
    declaration = declare(default, meaning, unit, limits, words=list(words), hint=hint)
    return field(default=default, metadata={_METADATA_KEY: declaration})


@dataclass(frozen=True)
class Setting:
    """A setting: its name, its declaration (default, unit, meaning, range) and its type annotation."""

    name: str
    declaration: FieldInfo
    annotation: Any

    def extra(self, key: str, default: Any) -> Any:
        """Return the entry ``key`` that the declaration has besides unit, meaning and range, or ``default``."""
        extra = self.declaration.json_schema_extra
        return extra.get(key, default) if isinstance(extra, dict) else default

    @property
    def default(self) -> Any:
        """Default value; None if the setting is required."""
        return None if self.declaration.is_required() else self.declaration.default

    @property
    def meaning(self) -> str:
        """Description of the setting, ``""`` if it has none."""
        return self.declaration.description or ""

    @property
    def unit(self) -> str:
        """SI unit, ``"1"`` if none was declared."""
        return str(self.extra("unit", "1"))

    @property
    def kind(self) -> str:
        """First type of the annotation in words: ``"number"``, ``"true or false"``."""
        return _KINDS.get(_first_type(self.annotation), "name").removeprefix("a ")

    @property
    def range(self) -> str:
        """Allowed values in words, with the unit: ``"a number > 0 [kg]"``."""
        return self._range()

    def _range(self, kind: str = "") -> str:
        """Return :attr:`range` with ``kind`` in place of the type's words, such as "a finite number"."""
        if words := self.extra("words", ()):
            return " or ".join(repr(word) for word in words)
        first = _first_type(self.annotation)
        kind = kind or _KINDS.get(first, "a name" if first is Any else f"a {getattr(first, '__name__', first)}")
        limits = [
            f"{sign} {getattr(bound, attribute):.10g}"
            for bound in self.declaration.metadata
            for attribute, sign in _SIGNS.items()
            if getattr(bound, attribute, None) is not None
        ]
        unit = "" if self.unit == "1" else f" [{self.unit}]"
        return " and ".join([f"{kind} {limits[0]}", *limits[1:]] if limits else [kind]) + unit

    def message(self, label: str, value: Any, kind: str = "") -> str:
        """Return the error message for a wrong ``value`` of the setting ``label``; ``kind`` is the expected type."""
        words, hint = self.extra("words", ()), self.extra("hint", "")
        value_text = abbreviated_number(value)
        proposal = did_you_mean(value, words) if isinstance(value, str) and words else ""
        return f"{label} must be {self._range(kind)}, got {value_text}{proposal}{'; ' if hint else ''}{hint}"

    def read(self, value: Any, owner: str = "") -> Any:
        """Return ``value`` checked, and parsed if it is text; the default is accepted without a check.

        Raises :class:`~dynamics.errors.InputError` with ``owner``, the setting and its range in its message.
        """
        if not self.declaration.is_required() and type(value) is type(self.default) and value == self.default:
            return value
        try:
            number = parse_number(value, self.annotation)
        except ValueError as error:
            raise InputError(self.message(f"{owner}{self.name}", value, str(error))) from None
        try:
            parsed = self._adapter.validate_python(number)
        except ValueError:
            raise InputError(self.message(f"{owner}{self.name}", number)) from None
        if (words := self.extra("words", ())) and isinstance(parsed, str) and parsed not in words:
            raise InputError(self.message(f"{owner}{self.name}", value))
        return parsed

    @cached_property
    def _adapter(self) -> TypeAdapter[Any]:
        bounds = [entry for entry in self.declaration.metadata if any(hasattr(entry, name) for name in _SIGNS)]
        kind: Any = Annotated[self.annotation, *bounds] if bounds else self.annotation
        if bounds and _first_type(self.annotation) is tuple:
            kind = tuple[Annotated[int, *bounds], ...] | None
        return TypeAdapter(kind, config=ConfigDict(arbitrary_types_allowed=True))


def read_value(label: str, value: Any, annotation: Any, **limits: Unpack[Range]) -> Any:
    """Return ``value`` as the type ``annotation`` within ``limits``; text is parsed.

    Raises :class:`~dynamics.errors.InputError`, whose message calls the value ``label``.
    """
    return _limited_setting(label, annotation, **limits).read(value)


@lru_cache(maxsize=256)
def _limited_setting(label: str, annotation: Any, **limits: Unpack[Range]) -> Setting:
    """Return a setting whose value is required; its reader takes 0.2 ms to build."""
    return Setting(label, declare(..., "", limits=limits), annotation)


def read_count(label: str, value: Any) -> int:
    """Return ``value`` as a whole number >= 1; raise :class:`~dynamics.errors.InputError` with ``label`` otherwise."""
    return read_value(label, value, int, least=1)


def abbreviated_number(value: Any) -> str:
    """Return the text of a value in an error message: its ``repr``, without a trailing ``.0`` for numbers."""
    return str(value).removesuffix(".0") if isinstance(value, int | float) else repr(value)


class Configured:
    """Base class of dataclasses whose fields :func:`setting` declares; the constructor parses and checks them."""

    def __post_init__(self) -> None:
        name = getattr(type(self), "name", "")
        for key, declared in _settings_of_dataclass(type(self)).items():
            object.__setattr__(self, key, declared.read(getattr(self, key), f"{name}: " if name else ""))


@cache
def settings_of(cls: type) -> dict[str, Setting]:
    """Return a dict from name to setting of a pydantic model, a dataclass, or the constructor of another class.

    ``Annotated[float, "meaning"]`` gives the meaning of a constructor's argument; it is "" by default.
    """
    if hasattr(cls, "model_fields"):
        return {key: Setting(key, about, about.annotation) for key, about in cls.model_fields.items()}
    arguments = inspect.signature(cls).parameters
    if is_dataclass(cls) and [*arguments] == [field_info.name for field_info in fields(cls) if field_info.init]:
        return _settings_of_dataclass(cls)
    return {key: _from_argument(cls, argument) for key, argument in arguments.items()}


@cache
def _settings_of_dataclass(cls: Any) -> dict[str, Setting]:
    declared = {
        field_info.name: field_info.metadata.get(_METADATA_KEY) for field_info in fields(cls) if field_info.init
    }
    return {key: Setting(key, about, _annotation(cls, key)) for key, about in declared.items() if about}


def _from_argument(cls: type, argument: inspect.Parameter) -> Setting:
    annotation = _annotation(cls, argument.name)
    words = [word for word in getattr(annotation, "__metadata__", ()) if isinstance(word, str)]
    default = ... if argument.default is argument.empty else argument.default
    return Setting(argument.name, declare(default, words[0] if words else ""), annotation)


def _annotation(cls: type, name: str) -> Any:
    """Return the type of a field or argument; ``Any`` if its names are imported only for type checkers."""
    owner = next((base for base in cls.__mro__ if name in vars(base).get("__annotations__", {})), cls.__init__)
    scope = vars(sys.modules[owner.__module__])
    with suppress(NameError, KeyError):
        alone = SimpleNamespace(__annotations__={name: owner.__annotations__[name]})
        return get_type_hints(alone, scope, include_extras=True)[name]
    return Any


def parse_float(text: str) -> float | None:
    """Parse a finite number; return None if ``text`` is not a number or is outside the range of a double."""
    text = text.strip()
    if not _FLOAT.fullmatch(text):
        return None
    value = float(text)
    underflow = value == 0 and re.search("[1-9]", re.split("[eE]", text)[0])
    return value + 0.0 if math.isfinite(value) and not underflow else None


def parse_int(text: str) -> int | None:
    """Parse a whole number; return None if ``text`` is not one or is larger than :data:`LARGEST`."""
    text = text.strip()
    if _INTEGER.fullmatch(text):
        value = int(text) if len(text) <= MAX_CHARACTERS else LARGEST + 1
        return value if abs(value) <= LARGEST else None
    rounded = parse_float(text)
    if rounded is None or not rounded.is_integer() or abs(rounded) > LARGEST:
        return None
    # Doubles skip whole numbers beyond 2^53, and round 0.99999999999999999 to 1.
    exact = Decimal(text)
    return int(exact) if exact == exact.to_integral_value() else None


def parse_number(value: Any, annotation: Any) -> Any:
    """Parse text as a number if ``annotation`` allows numbers and no text; return any other value unchanged.

    If ``annotation`` is a tuple, text is parsed as whole numbers separated by commas.

    Raises ``ValueError``, whose message is the expected kind, for text that is not a number, for true and false in
    place of a number, for numbers that are not finite, and for whole numbers beyond :data:`LARGEST`.
    """
    if isinstance(value, np.generic) or (isinstance(value, np.ndarray) and value.ndim == 0):
        value = value.item()
    kinds = _types_in(annotation)
    if isinstance(value, str) and _first_type(annotation) is tuple and str not in kinds:
        return tuple(parse_number(word, int) for word in value.split(","))
    if not kinds & {int, float} or kinds & {str, tuple, list, dict}:
        return value
    if (isinstance(value, str) or value is True or value is False) and bool not in kinds:
        value = _parse_text(str(value), float in kinds)
    if float in kinds and type(value) is int:
        value = float(value) if abs(value) < sys.float_info.max else math.inf
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError("a finite number" if float in kinds else "a whole number")
    if isinstance(value, int) and abs(value) > LARGEST:
        raise ValueError(f"a whole number of at most {LARGEST:.2g} in size")
    return value


def _parse_text(text: str, is_real: bool) -> float | int:
    number = parse_float(text) if is_real else parse_int(text)
    if number is not None:
        return number
    if not is_real:
        too_large = _INTEGER.fullmatch(text.strip()) or (parse_float(text) or 0.5).is_integer()
        raise ValueError(f"a whole number of at most {LARGEST:.2g} in size" if too_large else "a whole number")
    try:
        float(text)
    except ValueError:
        raise ValueError("a number") from None
    # Python also accepts text that is rejected here: nan, inf, 1_000 and digits of other scripts.
    raise ValueError("a finite number" if text.strip().isascii() and "_" not in text else "a number")


def _types_in(annotation: Any) -> set[Any]:
    """Return the alternatives of an annotation, without metadata of ``Annotated`` and arguments of generics."""
    if not (arguments := get_args(annotation)):
        return {annotation}
    if hasattr(annotation, "__metadata__"):
        return _types_in(arguments[0])
    origin = getattr(annotation, "__origin__", None)
    if isinstance(origin, type):
        return {origin}
    return set().union(*map(_types_in, arguments))


def _first_type(annotation: Any) -> Any:
    """Return the first alternative of an annotation, such as ``float`` of ``float | None``."""
    if hasattr(annotation, "__metadata__"):
        return _first_type(get_args(annotation)[0])
    origin = getattr(annotation, "__origin__", None)
    if isinstance(origin, type):
        return origin
    return _first_type(get_args(annotation)[0]) if get_args(annotation) else annotation
