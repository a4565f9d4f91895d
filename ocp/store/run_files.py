"""Files of a run: regular files of limited size, verified by checksums.

``meta.json`` contains, under ``parts``, the SHA-256 of every other file, and at its end a checksum of all its
preceding content. Checksums are verified before a file is parsed.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

from ocp.errors import DamagedRun, InputError

DATA_FILE = "solution.nc"
"""Name of the file with a run's arrays."""
META_FILE = "meta.json"
"""Name of the file with a run's description."""
PROBLEM_FILE = "problem.json"
"""Name of the file that describes a user's problem."""
MAX_BYTES = {DATA_FILE: 4 << 30, META_FILE: 32 << 20, PROBLEM_FILE: 256 << 20}
"""Mapping from names of the files that a run may have to their maximum sizes [bytes]."""

_MAX_JSON_DEPTH = 20
"""Maximum depth of nesting in a run's JSON files."""
_CONTROL_ESCAPES = {code: f"\\x{code:02x}" for code in (*range(32), *range(127, 160)) if chr(code) not in "\n\t"}
"""Mapping from control characters to escapes such as ``\\x1b``, for ``str.translate``."""
_CONTROL_PATTERN = re.compile(rb"[\x7f-\xff]|\\u00[0189][0-9a-fA-F]|\\u007[fF]|\\[bfr]")
"""Pattern of bytes in a JSON document that may be control characters, either raw or escaped."""
_SEAL_PATTERN = re.compile(rb',\n "checksum": "([0-9a-f]{64})"\n}\n')
"""Pattern of the end of ``meta.json``, which contains its checksum."""
_SEAL_LENGTH = len(b',\n "checksum": ""\n}\n') + 64
"""Length [bytes] of the end of ``meta.json`` that contains its checksum."""


def seal_run(description: Mapping[str, Any], parts: Mapping[str, bytes]) -> dict[str, bytes]:
    """Return a mapping from names to contents of a run's files: ``parts`` and ``meta.json`` with all checksums.

    Raises :class:`~ocp.errors.InputError` for a file above its maximum size.
    """
    sums = {name: hashlib.sha256(content).hexdigest() for name, content in parts.items()}
    text = json.dumps({**description, "parts": sums}, indent=1, sort_keys=True, allow_nan=False)
    body = text.encode().removesuffix(b"\n}")
    seal = f',\n "checksum": "{hashlib.sha256(body).hexdigest()}"\n}}\n'
    files = {**parts, META_FILE: body + seal.encode()}
    for name, content in files.items():
        if len(content) > MAX_BYTES[name]:
            raise InputError(
                f"{name} of the run would have {len(content)} bytes, and may have"
                f" {MAX_BYTES[name]}; take fewer points, steps or scenarios"
            )
    return files


def read_sealed(directory: Path) -> dict[str, Any]:
    """Read ``meta.json`` of a run and verify its checksum.

    Raises :class:`~ocp.errors.DamagedRun`, with file and reason, if the file is missing or was changed.
    """
    file = directory / META_FILE
    content = read_regular_file(file, MAX_BYTES[META_FILE])
    seal = _SEAL_PATTERN.fullmatch(content[-_SEAL_LENGTH:])
    if seal is None:
        raise DamagedRun(f"{file} does not end in its checksum: cut short or changed")
    if hashlib.sha256(content[:-_SEAL_LENGTH]).hexdigest().encode() != seal[1]:
        raise DamagedRun(f"{file} does not match its checksum: changed since it was written")
    return parse_json_object(file, content)


def read_part(directory: Path, meta: Mapping[str, Any], name: str) -> bytes:
    """Read the file ``name`` of a run and verify its checksum in ``meta``; raises the errors of :func:`read_sealed`."""
    file = directory / name
    content = read_regular_file(file, MAX_BYTES[name])
    if hashlib.sha256(content).hexdigest() != meta["parts"][name]:
        raise DamagedRun(f"{file} does not match its checksum in {META_FILE}: cut short or changed")
    return content


def parse_json_object(file: Path, content: bytes) -> dict[str, Any]:
    """Parse a JSON object and escape control characters; raise :class:`~ocp.errors.DamagedRun` for anything else."""
    try:
        document = json.loads(content, parse_constant=_reject_constant)
    except ValueError as error:
        raise DamagedRun(f"{file} is not JSON: {error}") from error
    except RecursionError:
        document = None
    if document is None or _is_deeper(document, _MAX_JSON_DEPTH):
        raise DamagedRun(f"{file} is nested more than {_MAX_JSON_DEPTH} levels deep")
    if _CONTROL_PATTERN.search(content):
        document = escape_controls(document)
    if not isinstance(document, dict):
        raise DamagedRun(f"{file} holds a {type(document).__name__}, expected an object")
    return document


def read_regular_file(file: Path, most: int) -> bytes:
    """Read a regular file of at most ``most`` bytes.

    Files of other kinds are not opened: reading a FIFO would wait for a writer, reading a device might never
    end, and a symbolic link may point outside the run. Raises :class:`~ocp.errors.DamagedRun` with the reason.
    """
    try:
        _check_regular(file, os.lstat(file), most)
        handle = os.open(file, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        with os.fdopen(handle, "rb") as stream:
            # The check is repeated, since the file may have been replaced between the two calls.
            _check_regular(file, os.fstat(handle), most)
            content = stream.read(most + 1)
    except OSError as error:
        raise DamagedRun(f"{file} cannot be read: {error_reason(error)}") from error
    if len(content) > most:
        _too_large(file, len(content), most)
    return content


def error_reason(error: OSError) -> str:
    """Return the reason for an OSError, as a phrase for messages."""
    if error.errno == errno.ELOOP:
        return "it is a symbolic link; a run holds regular files"
    return error.strerror or str(error)


def _check_regular(file: Path, status: os.stat_result, most: int) -> None:
    if not stat.S_ISREG(status.st_mode):
        kinds = {
            stat.S_IFLNK: "a symbolic link",
            stat.S_IFIFO: "a FIFO",
            stat.S_IFDIR: "a directory",
            stat.S_IFSOCK: "a socket",
        }
        kind = kinds.get(stat.S_IFMT(status.st_mode), "a device")
        raise DamagedRun(f"{file} cannot be read: it is {kind}; a run holds regular files")
    if status.st_size > most:
        _too_large(file, status.st_size, most)


def _too_large(file: Path, size: int, most: int) -> NoReturn:
    raise DamagedRun(f"{file} has {size} bytes, and that file of a run has at most {most}")


def _is_deeper(value: Any, most: int) -> bool:
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return any(most == 0 or _is_deeper(item, most - 1) for item in inner if isinstance(item, dict | list))


def escape_controls(value: Any) -> Any:
    """Escape control characters in nested texts, as in ``\\x1b``, since terminals execute them."""
    if isinstance(value, dict):
        return {escape_controls(key): escape_controls(item) for key, item in value.items()}
    if isinstance(value, list):
        return [escape_controls(item) for item in value]
    return value.translate(_CONTROL_ESCAPES) if isinstance(value, str) else value


def _reject_constant(word: str) -> NoReturn:
    raise ValueError(f"{word} is not a JSON number")
