"""The files of a run: regular ones only, of a size that can be, and each as it was written.

``meta.json`` names the SHA-256 of every other file under ``parts`` and ends in a checksum of its
own, over all that stands before it. Both are compared before anything of a file is understood.
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

DATA_FILE, META_FILE, PROBLEM_FILE = "solution.nc", "meta.json", "problem.json"
MOST = {DATA_FILE: 4 << 30, META_FILE: 32 << 20, PROBLEM_FILE: 256 << 20}
"""The files that a run may have, and how many bytes each may be."""

_DEEPEST = 20
_SHOWN = {code: f"\\x{code:02x}" for code in (*range(32), *range(127, 160)) if chr(code) not in "\n\t"}
# Where text may hold one: written out, or as JSON escapes it.
_CONTROL = re.compile(rb"[\x7f-\xff]|\\u00[0189][0-9a-fA-F]|\\u007[fF]|\\[bfr]")
_END = re.compile(rb',\n "checksum": "([0-9a-f]{64})"\n}\n')
_END_LENGTH = len(b',\n "checksum": ""\n}\n') + 64


def sealed(described: Mapping[str, Any], parts: Mapping[str, bytes]) -> dict[str, bytes]:
    """All files of a run by name: ``parts``, and the description with the checksums of all.

    Raises :class:`~ocp.errors.InputError` for one that no run may have so large.
    """
    sums = {name: hashlib.sha256(content).hexdigest() for name, content in parts.items()}
    text = json.dumps({**described, "parts": sums}, indent=1, sort_keys=True, allow_nan=False)
    body = text.encode().removesuffix(b"\n}")
    end = f',\n "checksum": "{hashlib.sha256(body).hexdigest()}"\n}}\n'
    files = {**parts, META_FILE: body + end.encode()}
    for name, content in files.items():
        if len(content) > MOST[name]:
            raise InputError(
                f"{name} of the run would have {len(content)} bytes, and may have"
                f" {MOST[name]}; take fewer points, steps or scenarios"
            )
    return files


def read_sealed(directory: Path) -> dict[str, Any]:
    """Read ``meta.json`` of a run, its own checksum compared.

    Raises :class:`~ocp.errors.DamagedRun`, naming file and reason, where it is not as written.
    """
    file = directory / META_FILE
    content = contents(file, MOST[META_FILE])
    end = _END.fullmatch(content[-_END_LENGTH:])
    if end is None:
        raise DamagedRun(f"{file} does not end in its checksum: cut short or changed")
    if hashlib.sha256(content[:-_END_LENGTH]).hexdigest().encode() != end[1]:
        raise DamagedRun(f"{file} does not match its checksum: changed since it was written")
    return parsed(file, content)


def part(directory: Path, meta: Mapping[str, Any], name: str) -> bytes:
    """Read another file of a run, its checksum compared; raises as :func:`read_sealed` does."""
    file = directory / name
    content = contents(file, MOST[name])
    if hashlib.sha256(content).hexdigest() != meta["parts"][name]:
        raise DamagedRun(f"{file} does not match its checksum in {META_FILE}: cut short or changed")
    return content


def parsed(file: Path, content: bytes) -> dict[str, Any]:
    """The object that JSON holds; raises :class:`~ocp.errors.DamagedRun` for anything else."""
    try:
        found = json.loads(content, parse_constant=_no_number)
    except ValueError as error:
        raise DamagedRun(f"{file} is not JSON: {error}") from error
    except RecursionError:
        found = None
    if found is None or _is_deeper(found, _DEEPEST):
        raise DamagedRun(f"{file} is nested more than {_DEEPEST} levels deep")
    if _CONTROL.search(content):
        found = visible(found)
    if not isinstance(found, dict):
        raise DamagedRun(f"{file} holds a {type(found).__name__}, expected an object")
    return found


def contents(file: Path, most: int) -> bytes:
    """Read a regular file of at most ``most`` bytes.

    Nothing else is opened: a FIFO would wait for a writer, a device might never end, and a link
    leads out of the run. Raises :class:`~ocp.errors.DamagedRun` with the reason.
    """
    try:
        _check_regular(file, os.lstat(file), most)
        handle = os.open(file, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        with os.fdopen(handle, "rb") as stream:
            # Again, for what lies there may have changed between the two calls.
            _check_regular(file, os.fstat(handle), most)
            found = stream.read(most + 1)
    except OSError as error:
        raise DamagedRun(f"{file} cannot be read: {reason(error)}") from error
    if len(found) > most:
        _too_large(file, len(found), most)
    return found


def reason(error: OSError) -> str:
    """What the system says of an error."""
    if error.errno == errno.ELOOP:
        return "it is a symbolic link; a run holds regular files"
    return error.strerror or str(error)


def _check_regular(file: Path, about: os.stat_result, most: int) -> None:
    if not stat.S_ISREG(about.st_mode):
        kinds = {
            stat.S_IFLNK: "a symbolic link",
            stat.S_IFIFO: "a FIFO",
            stat.S_IFDIR: "a directory",
            stat.S_IFSOCK: "a socket",
        }
        found = kinds.get(stat.S_IFMT(about.st_mode), "a device")
        raise DamagedRun(f"{file} cannot be read: it is {found}; a run holds regular files")
    if about.st_size > most:
        _too_large(file, about.st_size, most)


def _too_large(file: Path, size: int, most: int) -> NoReturn:
    raise DamagedRun(f"{file} has {size} bytes, and that file of a run has at most {most}")


def _is_deeper(value: Any, most: int) -> bool:
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return any(most == 0 or _is_deeper(item, most - 1) for item in inner if isinstance(item, dict | list))


def visible(value: Any) -> Any:
    """Write control characters of texts in plain values as ``\\x1b``: a terminal obeys them."""
    if isinstance(value, dict):
        return {visible(key): visible(item) for key, item in value.items()}
    if isinstance(value, list):
        return [visible(item) for item in value]
    return value.translate(_SHOWN) if isinstance(value, str) else value


def _no_number(word: str) -> NoReturn:
    raise ValueError(f"{word} is not a JSON number")
