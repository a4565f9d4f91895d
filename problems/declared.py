"""What a user's file says a problem is, name by name, of the kinds that are expected."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, Field

from ocp.errors import InputError
from ocp.validation import Line, validated
from problems.drawing import ContactFrame, Shape
from problems.spec import Citation, Golden, ProblemSpec, defined
from problems.user_code import guarded

_REQUIRED = ("name", "title", "Params", "build")
_LONGEST = 100


def _word(name: str) -> str:
    if not re.fullmatch(r"\w[\w.-]*", name) or len(name) > _LONGEST:
        raise ValueError(
            f"must be a word of letters, digits, '-' and '_', of at most {_LONGEST} signs"
        )
    return name


def _lines(text: str) -> str:
    if not all(line.replace("\t", " ").isprintable() for line in text.splitlines()):
        raise ValueError("must be a text in typst's mathematics without control characters")
    return text


def _plain_function(function: Any) -> Any:
    if inspect.isgeneratorfunction(function) or inspect.iscoroutinefunction(function):
        raise ValueError("must be a plain function, without yield or async")
    return function


def _parameters(kind: Any) -> Any:
    if not (isinstance(kind, type) and issubclass(kind, BaseModel)):
        raise ValueError("must be a class derived from problems.Parameters (a pydantic model)")
    return kind


_Function = Annotated[Callable[..., Any], AfterValidator(_plain_function)]
_MaybeFunction = Annotated[Callable[..., Any] | None, AfterValidator(_plain_function)]
_KINDS: dict[str, Any] = {
    "name": Annotated[Line, AfterValidator(_word)],
    "title": Line,
    "Params": Annotated[Any, AfterValidator(_parameters)],
    "build": _Function,
    "equations": Annotated[str, Field(strict=True), AfterValidator(_lines)],
    "citation": Citation | None,
    "axes": tuple[Line, Line],
    "golden": dict[Line, Golden],
    "draw": _MaybeFunction,
    "frames": _MaybeFunction,
    "region": _MaybeFunction,
}
_RETURNED = {
    "build": ("build(params)", None),
    "draw": ("draw(params, state)", list[Shape]),
    "frames": ("frames(params, state)", list[ContactFrame]),
    "region": ("region(params)", None),
}
"""How each function is called, and what it must return where no other place checks that."""


def read(module: ModuleType, file: Path, digest: str) -> ProblemSpec:
    """Make the spec of what ``module``, the file at ``file`` with that digest, defines.

    Its functions raise nothing but :class:`~ocp.errors.InputError` from then on.

    Raises :class:`~ocp.errors.InputError` where a name is missing or of the wrong kind.
    """
    missing = [key for key in _REQUIRED if not hasattr(module, key)]
    if missing:
        raise InputError(
            f"{file}: the file must define {', '.join(_REQUIRED)};"
            f" {', '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing"
        )
    for key, kind in _KINDS.items():
        if hasattr(module, key):
            setattr(module, key, validated(f"{file}: {key}", getattr(module, key), kind))
    found = defined(ProblemSpec, module, path=file, digest=digest)
    functions = {key: getattr(found, key) for key in _RETURNED}
    return replace(
        found, **{key: _own(key, function, file) for key, function in functions.items() if function}
    )


def _own(key: str, function: Callable[..., Any], file: Path) -> Callable[..., Any]:
    call, kind = _RETURNED[key]
    return guarded(function, call, file, kind and (lambda value: validated("it", value, kind)))
