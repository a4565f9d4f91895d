"""The LLVM backend's place among the others, and what it does without its extra or a library."""

from __future__ import annotations

import stat
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from dynamics.batch import (
    BatchFunction,
    BatchWarning,
    CompilerError,
    Gaussian,
    RolloutFunction,
    affine,
    compiler,
    llvm_backend,
)
from dynamics.contact import Barrier
from tests.unit.batch.backends import LLVM
from tests.unit.batch.rollout_cases import closed, four_contacts

needs_llvm = pytest.mark.skipif(not LLVM, reason="llvmlite is not installed")


@pytest.fixture
def graph() -> ca.Function:
    x = ca.SX.sym("x", 2)
    y = ca.vertcat(ca.exp(x), ca.atan2(x[0], x[1]), ca.erf(x), ca.if_else(x[0] < x[1], x[0], 1))
    return ca.Function("graph", [x], [y])


def test_without_the_extra_it_says_how_to_get_it_and_auto_says_nothing(graph, monkeypatch):
    monkeypatch.setitem(sys.modules, "llvmlite", None)
    with pytest.raises(CompilerError, match=r"pip install 'centralpath\[llvm\]'$"):
        BatchFunction(graph, backend="llvm")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert BatchFunction(graph).backend == "c"


@needs_llvm
def test_functions_take_it_first_and_need_no_compiler(graph, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        f = BatchFunction(graph)
    assert f.backend == "llvm"
    at = np.array([[0.3, -2.0], [1.0, 0.5]])
    np.testing.assert_allclose(f(at), BatchFunction(graph, backend="casadi")(at), rtol=1e-14)


@needs_llvm
def test_rollouts_take_it_where_there_is_no_compiler(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    step, *costs = closed(four_contacts(), Barrier(mu=1e-3))
    with pytest.warns(BatchWarning, match="no C compiler found.*runs on the llvm backend"):
        f = RolloutFunction(step, *costs, 5, affine(6, 2))
    assert f.backend == "llvm"


@needs_llvm
@pytest.mark.parametrize("change", [{}, {"width": 2}, {"has_fma": False}])
def test_lesser_machines_compute_the_same(graph, change, monkeypatch):
    machine = replace(llvm_backend.machine(), **{"vector_math": {}, **change})
    monkeypatch.setattr(llvm_backend, "machine", lambda: machine)
    at = np.random.default_rng(0).standard_normal((37, 2))
    got = BatchFunction(graph, backend="llvm")(at)
    np.testing.assert_allclose(got, BatchFunction(graph, backend="casadi")(at), rtol=1e-14)


@needs_llvm
def test_rollouts_on_lesser_machines_are_the_same(monkeypatch):
    step, *costs = closed(four_contacts(), Barrier(mu=1e-3))
    wanted = RolloutFunction(step, *costs, 5, affine(6, 2), backend="numpy")
    machine = replace(llvm_backend.machine(), width=2, has_fma=False, vector_math={})
    monkeypatch.setattr(llvm_backend, "machine", lambda: machine)
    f = RolloutFunction(step, *costs, 5, affine(6, 2), backend="llvm")
    rng = np.random.default_rng(1)
    x0, theta = rng.standard_normal((21, 6)), 0.3 * rng.standard_normal(wanted.policy.shape(5))
    noise = Gaussian(0.1, seed=2)
    one, other = (g(x0, theta, noise=noise, score=True) for g in (f, wanted))
    np.testing.assert_allclose(one.cost, other.cost, rtol=1e-12)
    size = np.abs(other.gradient).max()
    np.testing.assert_allclose(one.gradient, other.gradient, rtol=1e-10, atol=1e-12 * size)
    np.testing.assert_allclose(one.score, other.score, rtol=1e-12)


@pytest.fixture
def own_cache(tmp_path, monkeypatch) -> Path:
    """A cache of the test's own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "centralpath" / "objects"


@needs_llvm
def test_objects_are_cached_for_the_owner_alone_and_not_compiled_again(
    graph, own_cache, monkeypatch
):
    at = np.random.default_rng(0).standard_normal((5, 2))
    first = BatchFunction(graph, backend="llvm")(at)
    (path,) = own_cache.glob("*")
    assert path.suffix == ".o"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert compiler.info()["objects"] == 1
    monkeypatch.setattr(llvm_backend, "_compile", lambda *_: pytest.fail("compiled again"))
    np.testing.assert_array_equal(BatchFunction(graph, backend="llvm")(at), first)
    assert compiler.clear() == 1


@needs_llvm
@pytest.mark.parametrize("damage", [b"", b"no object at all"])
def test_damaged_objects_are_compiled_again(graph, own_cache, damage):
    at = np.random.default_rng(0).standard_normal((5, 2))
    first = BatchFunction(graph, backend="llvm")(at)
    (path,) = own_cache.glob("*")
    whole = path.read_bytes()
    path.write_bytes(damage)
    np.testing.assert_array_equal(BatchFunction(graph, backend="llvm")(at), first)
    assert path.read_bytes() == whole


@needs_llvm
def test_a_cache_that_others_may_write_to_is_done_without(graph, own_cache):
    own_cache.mkdir(parents=True)
    own_cache.chmod(0o777)
    at = np.random.default_rng(0).standard_normal((5, 2))
    np.testing.assert_allclose(
        BatchFunction(graph, backend="llvm")(at),
        BatchFunction(graph, backend="casadi")(at),
        rtol=1e-13,
    )
    assert not list(own_cache.iterdir())
