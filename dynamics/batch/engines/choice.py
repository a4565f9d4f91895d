"""Which backends there are, and how `auto` chooses: the fastest that can be built here."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from typing import TypeVar

from dynamics.batch.arguments import BatchWarning
from dynamics.batch.engines.compiler import CompilerError
from dynamics.batch.graphs.tape import UnsupportedOperation

EngineT = TypeVar("EngineT")
_told: set[str] = set()


def choose(
    backend: str, makers: Mapping[str, Callable[[], EngineT]], what: str
) -> tuple[str, EngineT]:
    """Build the named backend, or for `auto` the first of `makers` that can be built.

    Under `auto`, a backend that cannot be built is passed over; a `BatchWarning` line gives the
    reason and the replacement, once for each reason in a process.
    Raises `ValueError` for an unknown name, and the backend's own error when it was named.
    """
    if backend != "auto":
        if backend not in makers:
            choices = ", ".join(("auto", *makers))
            raise ValueError(f"unknown backend {backend!r} for {what}; choose one of {choices}")
        try:
            return backend, makers[backend]()
        except CompilerError as error:
            raise CompilerError(f"{error}; use the numpy or auto backend") from error
    reasons: list[str] = []
    for name, make in makers.items():
        try:
            engine = make()
        except (CompilerError, UnsupportedOperation) as error:
            reasons.append(str(error))
            continue
        if reasons and reasons[0] not in _told:
            _told.add(reasons[0])
            warnings.warn(
                f"{reasons[0]}; {what} runs on the {name} backend", BatchWarning, stacklevel=4
            )
        return name, engine
    raise UnsupportedOperation("; ".join(dict.fromkeys(reasons)))
