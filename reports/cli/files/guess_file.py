"""Initial guess of ``--guess``: a stored run, or a file of keyframes, paths and contacts."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable, Iterable
from dataclasses import fields
from pathlib import Path
from typing import Any

from ocp.errors import InputError, abbreviated, choose
from ocp.problem.sketch import Sketch
from ocp.solve.guesses import GuessLike
from ocp.validation import expand_path, validated
from reports.cli.options.shared import StoreOptions


def read_guess(options: StoreOptions, guess: str) -> GuessLike:
    """Return the guess of ``--guess``: the sketch in a .json or .toml file, or the data of a stored solve."""
    if Path(guess).suffix in READERS:
        return read_sketch(expand_path(guess))
    stored_run = options.stored(guess)
    stored_run.check_solve()
    return stored_run.data


def read_sketch(file: Path) -> Sketch:
    """Return the sketch in a file with the tables ``keyframes``, whose keys are steps, ``paths`` and ``contacts``.

    Raises :class:`~ocp.errors.InputError` for an unreadable file, an unknown table, or a repeated step.
    """
    try:
        tables = READERS[file.suffix](file.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"--guess {file}: {error.strerror or error}") from None
    except (ValueError, RecursionError) as error:
        reason = abbreviated(str(error) or type(error).__name__)
        raise InputError(f"--guess {file} cannot be read as {file.suffix[1:].upper()}: {reason}") from None
    tables = validated(f"--guess {file}", tables, dict[str, dict[str, Any]])
    for name in tables:
        choose(f"table of {file}:", name, {field.name: field for field in fields(Sketch)})
    keyframes = _unique((_step(file, text), pose) for text, pose in tables.pop("keyframes", {}).items())
    return Sketch(keyframes, **tables)


def _step(file: Path, text: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) < 10):
        raise InputError(f"--guess {file}: the name of a keyframe is its step, a whole number; got {abbreviated(text)}")
    return int(text)


def _unique(pairs: Iterable[tuple[Any, Any]]) -> dict[Any, Any]:
    """Return a dictionary of the pairs; raise :class:`~ocp.errors.InputError` for a repeated key."""
    mapping: dict[Any, Any] = {}
    for key, value in pairs:
        if key in mapping:
            raise InputError(f"the guess has {key!r} twice; give it once")
        mapping[key] = value
    return mapping


def _read_json(text: str) -> Any:
    return json.loads(text, object_pairs_hook=_unique)


READERS: dict[str, Callable[[str], Any]] = {".json": _read_json, ".toml": tomllib.loads}
"""Mapping from the suffix of a sketch's file to the function that parses its text."""
