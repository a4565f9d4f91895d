"""Run tests as on other processors: without some vector instructions of this computer.

    python -m tests.cpus [PROCESSOR...]   golden, docs and property tests, as on each possible processor
    python -m tests.cpus --today CMD...   one command, as on the processor whose turn it is today

Processors differ in the last bit of a sum or a sine: glibc, OpenBLAS, NumPy and XLA choose among
variants at run time, and the C compiler at compile time, for which a wrapper of ``cc`` on the
search path replaces ``-march=native``. CasADi's virtual machine, IPOPT and MUMPS have one variant,
but call glibc.
"""

from __future__ import annotations

import datetime
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests import times

TESTS = ("tests/golden", "tests/docs", "tests/property")
_AVX512 = ("AVX512F", "AVX512VL", "AVX512BW", "AVX512CD", "AVX512DQ")
_X86_V4 = ("X86_V4", *_AVX512, "AVX512_SKX", "AVX512_CLX", "AVX512_CNL", "AVX512_ICL", "AVX512_SPR")
_X86_V3 = ("X86_V3", "AVX2", "FMA3", "F16C", *_X86_V4)


@dataclass(frozen=True)
class Processor:
    """Processor to emulate: flags of /proc/cpuinfo that it ``needs``, and how libraries are limited to it.

    ``glibc`` and ``numpy`` are features to switch off. ``openblas``, ``xla`` and ``march`` are the names of the
    processor in OpenBLAS, XLA and the compiler; an empty ``march`` keeps this computer's own.
    """

    needs: tuple[str, ...]
    glibc: tuple[str, ...]
    numpy: tuple[str, ...]
    openblas: str
    xla: str
    march: str


PROCESSORS: Mapping[str, Processor] = {
    "skylake-x": Processor(("avx512f", "avx512dq", "avx512vl"), (), (), "SkylakeX", "AVX512", "skylake-avx512"),
    "haswell": Processor(("avx2", "fma"), _AVX512, _X86_V4, "Haswell", "AVX2", ""),
    "sandybridge": Processor(("avx",), (*_AVX512, "AVX2", "FMA"), _X86_V3, "Sandybridge", "AVX", "sandybridge"),
    "nehalem": Processor(("sse4_2",), (*_AVX512, "AVX2", "FMA", "AVX"), _X86_V3, "Nehalem", "SSE4_2", "x86-64"),
    "nehalem-with-native-c": Processor(("sse4_2",), (*_AVX512, "AVX2", "FMA", "AVX"), _X86_V3, "Nehalem", "SSE4_2", ""),
}
"""Mapping from name to processor; the last one separates errors of libraries from those of generated C."""


def here() -> list[str]:
    """Return the names of the processors that this computer can emulate; empty if it is not an x86."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return []
    has = {word for line in text.splitlines() if line.startswith("flags") for word in line.split()}
    return [name for name, one in PROCESSORS.items() if has.issuperset(one.needs)]


def today(names: Sequence[str], day: datetime.date) -> str:
    """Return the processor for a ``day``; each has its turn, so that all are tested."""
    return names[day.toordinal() % len(names)]


def variables(name: str, folder: Path) -> dict[str, str]:
    """Return the environment variables that emulate a processor; a wrapper of the compiler is written to ``folder``."""
    from numpy._core._multiarray_umath import __cpu_dispatch__

    one = PROCESSORS[name]
    # Names of glibc before 2.33 end in _Usable; each version ignores names that it does not know.
    off = [f"-{feature}{end}" for feature in one.glibc for end in ("", "_Usable")]
    made = {
        "GLIBC_TUNABLES": f"glibc.cpu.hwcaps={','.join(off)}" if off else "",
        "OPENBLAS_CORETYPE": one.openblas,
        "NPY_DISABLE_CPU_FEATURES": " ".join(f for f in one.numpy if f in __cpu_dispatch__),
        "XLA_FLAGS": f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_max_isa={one.xla}".strip(),
    }
    compiler = shutil.which("cc")
    if one.march and compiler:
        wrapper = folder / "cc"
        wrapper.write_text(
            "#!/bin/sh\n"
            f'for a; do [ "$a" = -march=native ] && a=-march={one.march}; '
            'set -- "$@" "$a"; shift; done\n'
            f'exec "{compiler}" "$@"\n',
            encoding="utf-8",
        )
        wrapper.chmod(0o755)
        made["PATH"] = os.pathsep.join((str(folder), os.environ.get("PATH", os.defpath)))
    return made


def act(name: str, command: Sequence[str]) -> int:
    """Run a command as on the processor ``name`` and return its exit code; print the settings."""
    with tempfile.TemporaryDirectory() as folder:
        made = variables(name, Path(folder))
        settings = " ".join(f"{k}={v!r}" for k, v in made.items() if k != "PATH")
        march = PROCESSORS[name].march or "native"
        print(f"as {name}: {settings}, C at -march={march}", flush=True)
        return subprocess.run(command, env={**os.environ, **made}, check=False).returncode


def main(arguments: Sequence[str]) -> int:
    """Run the tests, or one command, as on the processors in ``arguments``; return 0 if all pass."""
    names = here()
    if arguments[:1] == ["--today"]:
        if not names:
            print("this computer acts no other processor", flush=True)
            return subprocess.run(arguments[1:], check=False).returncode
        return act(today(names, datetime.date.today()), arguments[1:])
    unknown = [name for name in arguments if name not in names]
    if unknown:
        print(f"cannot act {', '.join(unknown)}; this computer can be {', '.join(names)}")
        return 2
    os.environ[times.ALL] = "1"
    pytest = [sys.executable, "-m", "pytest", "-n", "auto", *TESTS]
    codes = {name: act(name, pytest) for name in arguments or names}
    for name in PROCESSORS:
        told = {None: "not run", 0: "passed"}.get(codes.get(name), "failed")
        print(f"{name:24}{told}")
    return int(any(codes.values()))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
