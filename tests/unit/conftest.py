"""Fixture of C compilers that treat warnings as errors, for all tests of emitted C."""

from __future__ import annotations

import shutil

import pytest

from dynamics.batch.engines import compiler

STRICT = ("-Wall", "-Wextra", "-Werror")
COMPILERS = [name for name in ("gcc", "clang") if shutil.which(name)]
# A CPU with the instruction set of one entry can run that entry and those before it.
MARCHES = {"SSE2": "-march=x86-64", "AVX2": "-march=x86-64-v3", "AVX-512": "-march=native"}


def runnable() -> list[str]:
    """Return the `-march` flags whose code this machine can run; empty if it is not an x86."""
    has = compiler.find_compiler().instruction_set
    names = list(MARCHES)
    return [MARCHES[name] for name in names[: names.index(has) + 1]] if has in names else []


VARIANTS = [(cc, march) for cc in COMPILERS for march in (runnable() if COMPILERS else [])]


@pytest.fixture(params=VARIANTS, ids=" ".join)
def strict(request, monkeypatch) -> compiler.Compiler:
    """Yield a compiler that treats warnings as errors and emits code for one instruction set."""
    cc, march = request.param
    monkeypatch.setattr(compiler, "CANDIDATES", (cc,))
    monkeypatch.setattr(compiler, "NATIVE_FLAGS", ((march,),))
    monkeypatch.setattr(compiler, "FLAGS", (*compiler.FLAGS, *STRICT))
    compiler._probe.cache_clear()
    yield compiler.find_compiler()
    compiler._probe.cache_clear()
