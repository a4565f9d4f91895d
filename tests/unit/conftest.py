"""Compilers that take no warning, for every test of emitted C."""

from __future__ import annotations

import shutil

import pytest

from dynamics.batch.engines import compiler

STRICT = ("-Wall", "-Wextra", "-Werror")
COMPILERS = [name for name in ("gcc", "clang") if shutil.which(name)]
# What a CPU with a row's instruction set can run: itself and the rows before it.
MARCHES = {"SSE2": "-march=x86-64", "AVX2": "-march=x86-64-v3", "AVX-512": "-march=native"}


def runnable() -> list[str]:
    """The `-march` flags that this machine can run, none where it is no x86."""
    has = compiler.find_compiler().instruction_set
    names = list(MARCHES)
    return [MARCHES[name] for name in names[: names.index(has) + 1]] if has in names else []


VARIANTS = [(cc, march) for cc in COMPILERS for march in (runnable() if COMPILERS else [])]


@pytest.fixture(params=VARIANTS, ids=" ".join)
def strict(request, monkeypatch) -> compiler.Compiler:
    """A compiler that takes a warning for an error, and code for one instruction set."""
    cc, march = request.param
    monkeypatch.setattr(compiler, "CANDIDATES", (cc,))
    monkeypatch.setattr(compiler, "NATIVE_FLAGS", ((march,),))
    monkeypatch.setattr(compiler, "FLAGS", (*compiler.FLAGS, *STRICT))
    compiler._probe.cache_clear()
    yield compiler.find_compiler()
    compiler._probe.cache_clear()
