"""Other processors are emulated in glibc, OpenBLAS, NumPy and generated C."""

from __future__ import annotations

import datetime
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests import cpus

_ASK = """
import ctypes, json
import numpy as np
from numpy._core._multiarray_umath import __cpu_features__ as features
from dynamics.batch.engines.compiler import compiler_info

class Leaf(ctypes.Structure):
    _fields_ = [("has", ctypes.c_uint * 4), ("active", ctypes.c_uint * 4)]

leaf = getattr(ctypes.CDLL(None), "__x86_get_cpuid_feature_leaf", None)
glibc = None
if leaf is not None:
    leaf.restype = ctypes.POINTER(Leaf)
    glibc = bool(leaf(0).contents.active[2] >> 12 & 1)  # FMA, CPUID.1:ECX bit 12
np.linalg.inv(np.eye(3))
print(json.dumps({
    "numpy": {f: features[f] for f in ("X86_V3", "X86_V4") if f in features},
    "glibc": glibc,
    "c": compiler_info().get("instruction_set"),
}))
"""
SETS = {"AVX-512": 3, "AVX2": 2, "AVX": 1, "SSE2": 0}


@pytest.mark.costly_cases("nehalem", "nehalem-with-native-c")
@pytest.mark.skipif(not cpus.here(), reason="no x86")
@pytest.mark.parametrize("name", cpus.here())
def test_a_process_acts_a_processor(name: str, tmp_path: Path) -> None:
    environment = {**os.environ, **cpus.variables(name, tmp_path), "OPENBLAS_VERBOSE": "2"}
    done = subprocess.run([sys.executable, "-c", _ASK], env=environment, capture_output=True, text=True, check=True)
    found, one = json.loads(done.stdout), cpus.PROCESSORS[name]
    assert f"Core: {one.openblas}" in done.stderr
    assert not any(found["numpy"].get(level) for level in one.numpy)
    if found["glibc"] is not None:
        assert found["glibc"] is ("FMA" not in one.glibc)
    highest = {"skylake-avx512": 3, "sandybridge": 1, "x86-64": 0}.get(one.march, 3)
    assert found["c"] is None or SETS[found["c"]] <= highest


def test_every_processor_has_its_day() -> None:
    names = list(cpus.PROCESSORS)
    days = [datetime.date(2026, 12, 30) + datetime.timedelta(k) for k in range(len(names))]
    assert sorted(cpus.today(names, day) for day in days) == sorted(names)


def test_a_processor_that_cannot_be_acted_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert cpus.main(["pentium"]) == 2
    assert "cannot act pentium" in capsys.readouterr().out
