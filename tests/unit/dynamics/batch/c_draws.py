"""Calls of the kernel's random numbers: normals of a seed, and the transformation of given words."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np

from dynamics.batch.engines import c_random, compiler
from dynamics.batch.engines.c_prelude import vector_prelude
from dynamics.batch.random import key_of

_CALLS = """\
void draw(i64 first, i64 size, i64 key0, i64 key1, double *out);
void draw(i64 first, i64 size, i64 key0, i64 key1, double *out) {
  Q keys[2 * ROUNDS];
  schedule(key0, key1, keys);
  for (i64 m = 0; m < size; m += 4) {
    V z[4];
    four_normals(first, m / 4, keys, z);
    for (i64 k = 0; k < 4 && m + k < size; k++) LANES out[l * size + m + k] = z[k][l];
  }
}
void transform(i64 n, const unsigned long long *words, double *out);
void transform(i64 n, const unsigned long long *words, double *out) {
  for (i64 i = 0; i + W <= n; i += W) {
    Q a, b;
    V z[2];
    LANES a[l] = words[i + l];
    LANES b[l] = words[n + i + l];
    box_muller(a, b, z, z + 1);
    LANES out[i + l] = z[0][l];
    LANES out[n + i + l] = z[1][l];
  }
}
"""


def source(machine: compiler.Compiler) -> str:
    """Return the C source of both calls."""
    return vector_prelude(machine) + c_random.normals_source() + _CALLS


def _loaded() -> tuple[Any, compiler.Compiler]:
    machine = compiler.find_compiler()
    return compiler.load_library(source(machine)), machine


def draw(seed: int, first: int, size: int) -> np.ndarray:
    """Return the kernel's normals (width, size) of the samples ``first`` to ``first + width - 1``."""
    library, machine = _loaded()
    library.draw.argtypes = [*4 * [ctypes.c_int64], ctypes.c_void_p]
    out = np.empty((machine.width, size))
    library.draw(first, size, *key_of(seed), out.ctypes.data)
    return out


def transform(words: np.ndarray) -> np.ndarray:
    """Return the kernel's normals (2, n) from random words (2, n), n a multiple of 8."""
    library, _ = _loaded()
    library.transform.argtypes = [ctypes.c_int64, ctypes.c_void_p, ctypes.c_void_p]
    given = np.ascontiguousarray(words, dtype=np.uint64)
    out = np.empty(given.shape)
    library.transform(given.shape[1], given.ctypes.data, out.ctypes.data)
    return out
