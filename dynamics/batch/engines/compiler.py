"""The system's C compiler, and the cache of compiled libraries.

The user's cache directory contains objects named `<key>-<sha256>.so`. The key is a hash of the source, the
compiler's version, the flags and the CPU's instruction set; the second part is the checksum of the object
itself. A file is created by one atomic rename, so that several processes may use the cache at once. An object
whose bytes do not match its name is deleted and compiled again before anything is loaded. The cache may be
emptied at any time: :func:`clear_cache` does not delete the folders of running compilations, and an object that
vanishes before it is loaded is compiled again in a private folder.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import hashlib
import logging
import os
import re
import shutil
import signal
import stat
import subprocess
import tempfile
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

_LOG = logging.getLogger(__name__)
# Names of compilers; the first that is on the search path is used.
CANDIDATES = ("cc", "gcc", "clang")
# Compiler flags. None of them permits the compiler to assume that NaN or infinity do not occur, reorder a sum, or
# choose where to contract a*b+c; the emitted source uses explicit fused operations.
FLAGS = ("-std=c11", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math", "-fPIC", "-shared")
# Flags that enable this CPU's instructions; the first that the compiler accepts are used.
NATIVE_FLAGS = (("-march=native",), ("-mcpu=native",), ())
# Text in a line of a compiler's error output that does not state a cause.
_NOISE_LINE = "compilation terminated"
# Time limit of a compilation [s].
COMPILE_TIMEOUT_S = 300
# Time limit of a query of the compiler's version and macros [s].
PROBE_TIMEOUT_S = 30
# Prefix of the folders of running compilations.
_BUILD_PREFIX = "build-"
# C functions for which a vector math library may have a SIMD version.
VECTOR_FUNCTIONS = (
    *("acos", "acosh", "asin", "asinh", "atan", "atanh", "cos", "cosh", "erf", "exp", "expm1"),
    *("log", "log1p", "sin", "sinh", "tan", "tanh", "atan2", "hypot", "pow"),
)
# Members of VECTOR_FUNCTIONS with two arguments.
TWO_ARGUMENTS = frozenset({"atan2", "hypot", "pow"})


class CompilerError(RuntimeError):
    """Error for a missing or failing C compiler; its message is one line with the cause."""

    exit_code = 2


@dataclass(frozen=True)
class Compiler:
    """A C compiler, and the CPU features that its code may use.

    `width` is the number of doubles in a SIMD register; `vector_math` maps the name of a C function
    to its vector version in the system's vector math library (empty without such a library).
    """

    path: str
    version: str
    native: tuple[str, ...]
    instruction_set: str
    width: int
    has_fma: bool
    vector_math: dict[str, str]
    identity: str


def find_compiler() -> Compiler:
    """Return the instruction set, its doubles per register, and the prefix of its names in the vector math library.

    Raises `CompilerError` when none is found; when none of those found runs, with the error of the first.
    """
    errors: list[CompilerError] = []
    for path in filter(None, map(shutil.which, CANDIDATES)):
        try:
            return _probe(path, Path(path).stat().st_mtime_ns)
        except CompilerError as error:
            errors.append(error)
    raise errors[0] if errors else CompilerError(f"no C compiler found (looked for {', '.join(CANDIDATES)})")


@functools.lru_cache(maxsize=8)
def _probe(path: str, _changed: int) -> Compiler:
    version = (_run([path, "--version"], PROBE_TIMEOUT_S).splitlines() or ["unknown version"])[0]
    for native in NATIVE_FLAGS:
        with contextlib.suppress(CompilerError):
            macros = _run([path, *native, "-dM", "-E", "-x", "c", os.devnull], PROBE_TIMEOUT_S)
            break
    else:
        raise CompilerError(f"{path} cannot preprocess an empty file")
    defined = set(re.findall(r"^#define (\w+)", macros, re.MULTILINE))
    instruction_set, width, mangling = _simd(defined)
    return Compiler(
        path=path,
        version=version,
        native=native,
        instruction_set=instruction_set,
        width=width,
        has_fma=bool(defined & {"__FMA__", "__ARM_FEATURE_FMA"}),
        vector_math=vector_math(mangling) if mangling else {},
        identity=hashlib.sha256(f"{version}\n{macros}".encode()).hexdigest(),
    )


def _simd(defined: set[str]) -> tuple[str, int, str]:
    """Return the instruction set, its doubles per register, and its prefix in the vector math library's names."""
    if {"__AVX512F__", "__AVX512DQ__"} <= defined:
        return "AVX-512", 8, "_ZGVeN8"
    if "__AVX2__" in defined:
        return "AVX2", 4, "_ZGVdN4"
    if "__AVX__" in defined:
        return "AVX", 4, "_ZGVcN4"
    if "__SSE2__" in defined:
        return "SSE2", 2, "_ZGVbN2"
    if "__aarch64__" in defined:
        return "NEON", 2, "_ZGVnN2"
    return "scalar", 2, ""


def vector_math(mangling: str) -> dict[str, str]:
    """Return a mapping from names of C functions to names of their vector versions in glibc's libmvec.

    `mangling` is the prefix of a vector function's name and encodes the instruction set; see "Vector
    Function Application Binary Interface Specification for OpenMP", x86 and AArch64.
    """
    try:
        library = ctypes.CDLL("libmvec.so.1")
    except OSError:
        return {}
    names = {name: f"{mangling}{'vv' if name in TWO_ARGUMENTS else 'v'}_{name}" for name in VECTOR_FUNCTIONS}
    return {name: symbol for name, symbol in names.items() if hasattr(library, symbol)}


def _run(command: list[str], limit_s: float = COMPILE_TIMEOUT_S) -> str:
    """Return the output of a command; if it fails, kill its process group and raise `CompilerError`."""
    try:
        with subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            env={**os.environ, "LC_ALL": "C"},
            process_group=0,
        ) as process:
            try:
                output, errors = process.communicate(timeout=limit_s)
            except BaseException:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                raise
    except subprocess.TimeoutExpired:
        raise CompilerError(f"{command[0]} did not finish within {limit_s:g} s") from None
    except (OSError, subprocess.SubprocessError) as error:
        raise CompilerError(f"{command[0]} could not run: {error}") from error
    if process.returncode != 0:
        lines = [line for line in errors.splitlines() if line.strip(" .") not in ("", _NOISE_LINE)]
        last_line = lines[-1].strip() if lines else f"exit status {process.returncode}, no message"
        raise CompilerError(f"{command[0]} failed: {last_line}")
    return output


_loaded: dict[str, ctypes.CDLL] = {}
_lock = threading.Lock()
_MIN_FREE_BYTES = 1 << 24
"""Free disk space [bytes] below which a failed compilation is repeated in a private folder."""


def load_library(source: str, symbols: Sequence[str] = (), level: int = 2) -> ctypes.CDLL:
    """Compile C source to a shared object with the functions ``symbols``, or find it in the cache, and load it.

    The optimisation ``level`` affects the time of the compilation and the code's speed, but not results.
    If the compiler or the loader fails, raises `CompilerError` with the last line of its output.
    """
    compiler = find_compiler()
    flags = (*FLAGS, f"-O{level}", *compiler.native)
    key = hashlib.sha256("\n".join((compiler.identity, *flags, source)).encode()).hexdigest()[:32]
    with _lock:
        if key not in _loaded:
            object_request = key, source, compiler, flags
            try:
                library = _open(_object(*object_request), symbols)
                if library is None:
                    library = _open(_compile(*object_request, _private_directory()), symbols)
            except OSError as error:
                reason = f"{error.strerror or error}: {error.filename or 'temporary files'}"
                raise CompilerError(f"{compiler.path} produced no object: {reason}") from error
            if library is None:
                raise CompilerError("the compiled object was removed before it was loaded")
            _loaded[key] = library
        return _loaded[key]


def _open(path: Path, symbols: Sequence[str]) -> ctypes.CDLL | None:
    """Load a library and check that it has the functions ``symbols``; return None if the file no longer exists."""
    try:
        library = ctypes.CDLL(str(path))
        for name in symbols:
            getattr(library, name)
    except (OSError, AttributeError) as error:
        if not path.exists():
            return None
        # The file's name depends on source and compiler alone, so that the next call would find this file
        # again.
        path.unlink(missing_ok=True)
        raise CompilerError(f"the compiled object does not load: {error}") from error
    return library


def _object(key: str, source: str, compiler: Compiler, flags: tuple[str, ...]) -> Path:
    directory = cache_directory()
    if directory is not None:
        cached_object = _find_verified(directory, key)
        if cached_object is not None:
            _LOG.debug("%s: taken from the cache", cached_object.name)
            return cached_object
        try:
            with contextlib.suppress(OSError):
                return _compile(key, source, compiler, flags, directory)
        except CompilerError:
            if shutil.disk_usage(directory).free > _MIN_FREE_BYTES:
                raise
    return _compile(key, source, compiler, flags, _private_directory())


def _find_verified(directory: Path, key: str) -> Path | None:
    for path in sorted(directory.glob(f"{key}-*.so")):
        with contextlib.suppress(OSError):
            if hashlib.sha256(path.read_bytes()).hexdigest() == path.stem.partition("-")[2]:
                return path
            path.unlink()
    return None


def _compile(key: str, source: str, compiler: Compiler, flags: tuple[str, ...], directory: Path) -> Path:
    with tempfile.TemporaryDirectory(prefix=_BUILD_PREFIX, dir=directory, ignore_cleanup_errors=True) as build:
        source_file, object_file = Path(build, "batch.c"), Path(build, "batch.so")
        source_file.write_text(source, encoding="utf-8")
        libraries = ["-lmvec", "-lm"] if compiler.vector_math else ["-lm"]
        start_s = time.perf_counter()
        try:
            _run([compiler.path, *flags, "-o", str(object_file), str(source_file), *libraries])
        except CompilerError as error:
            if not source_file.exists():
                raise FileNotFoundError(f"{build} was removed while it was compiled in") from error
            raise
        seconds = time.perf_counter() - start_s
        _LOG.info("%s compiled %d lines of C in %.2f s", compiler.path, source.count("\n"), seconds)
        object_file.chmod(0o600)
        checksum = hashlib.sha256(object_file.read_bytes()).hexdigest()
        return object_file.replace(directory / f"{key}-{checksum}.so")


@functools.cache
def _private_directory() -> Path:
    """Return a temporary folder for libraries if the cache cannot be used; it is removed when the process ends."""
    holder = tempfile.TemporaryDirectory(prefix="centralpath-")
    _holders.append(holder)
    return Path(holder.name)


_holders: list[tempfile.TemporaryDirectory[str]] = []


def cache_directory() -> Path | None:
    """Return the owner-only directory of compiled libraries, created if needed; None if it cannot be used.

    A directory that belongs to another user, or that others may write to, is not used.
    """
    try:
        root = os.environ.get("XDG_CACHE_HOME")
        directory = (Path(root) if root else Path.home() / ".cache") / "centralpath" / "objects"
        directory.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = directory.stat()
        if status.st_uid != os.getuid() or status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
            return None
        if not os.access(directory, os.W_OK | os.X_OK):
            return None
    except (OSError, RuntimeError):
        return None
    return directory


def compiler_identity() -> str:
    """Return a hash that identifies this compiler and CPU; "" without a working compiler."""
    try:
        return find_compiler().identity
    except CompilerError:
        return ""


def compiler_info() -> dict[str, object]:
    """Describe the compiler, its vector library, and the cache, for `ocp doctor`.

    The keys are `compiler version instruction_set width vector_math cache objects bytes`. Without a compiler
    `compiler` is None and `problem` is the cause; `cache` is None if it is unusable.
    """
    directory = cache_directory()
    objects = list(directory.glob("*.so")) if directory else []
    cache = {
        "cache": str(directory) if directory else None,
        "objects": len(objects),
        "bytes": sum(path.stat().st_size for path in objects),
    }
    try:
        compiler = find_compiler()
    except CompilerError as error:
        return {"compiler": None, "problem": str(error), **cache}
    return {
        "compiler": compiler.path,
        "version": compiler.version,
        "instruction_set": compiler.instruction_set,
        "width": compiler.width,
        "vector_math": sorted(compiler.vector_math),
        **cache,
    }


def clear_cache() -> int:
    """Delete all compiled objects in the cache and return their number.

    Temporary folders left behind by killed processes are deleted too, once they are older than twice the time limit of
    a compilation.
    """
    directory = cache_directory()
    if directory is None:
        return 0
    objects = list(directory.glob("*.so"))
    for path in objects:
        path.unlink(missing_ok=True)
    for build in directory.glob(f"{_BUILD_PREFIX}*"):
        with contextlib.suppress(OSError):
            if time.time() - build.stat().st_mtime > 2 * COMPILE_TIMEOUT_S:
                shutil.rmtree(build)
    return len(objects)
