"""All kinds of emitted C compile without warnings and give the same numbers.

The CPU's instruction set determines the width of registers; code for other instruction sets that
the compiler supports is compiled but not run.
"""

from __future__ import annotations

import functools
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from dynamics.batch import BatchFunction, Gaussian, RolloutFunction, affine_policy, open_loop
from dynamics.batch.engines import c_flat, c_rollout, compiler
from dynamics.batch.graphs.tape import tape_of
from dynamics.batch.random import key_of, standard_normals
from dynamics.contact import Barrier
from problems import get
from tests.unit.conftest import COMPILERS
from tests.unit.dynamics.batch import c_draws
from tests.unit.dynamics.batch.rollout_cases import closed, four_contacts, wall

STRICT = ("-Wall", "-Wextra", "-Werror")
HORIZON = 4
N = 75


def every_operation() -> ca.Function:
    """Return a function with every kind of statement, in two parts, one of whose outputs is an input."""
    x, p = ca.SX.sym("x", 3), ca.SX.sym("p", 2)
    y = ca.if_else(x > 0, ca.sqrt(ca.fabs(x)), ca.atan2(x, p[0])) * ca.exp(-x) + ca.floor(x)
    logic = ca.logic_and(x[0] < x[1], ca.logic_not(x[2] == 0)) + ca.logic_or(x[0] > 1, x[1] != 2)
    more = [ca.erf(x), ca.erfinv(0.9 * ca.tanh(x)), ca.fmod(x, 0.7), ca.remainder(x, 0.6)]
    more += [ca.sign(x), ca.copysign(x, p[1]), ca.fmin(x, p[0]), ca.ceil(x), x**3, x**2.5, x / 3]
    for _ in range(20):
        y = ca.sin(ca.vertcat(y[1:], y[0])) + 0.3 * y * ca.cos(x) - y / (2 + x * x)
    return ca.Function("every", [x, p], [ca.vertcat(y, logic, *more), x, p[0] * p[1]])


@functools.cache
def systems() -> dict[str, tuple]:
    """Return a mapping from kind of solver to step, costs and policy: closed form, Newton loop, path."""
    cases = {
        "closed form": closed(wall(), Barrier(mu=1e-3)),
        "inner loop": closed(four_contacts(), Barrier(mu=1e-3)),
        "path": closed(get("hopper-1d").system, Barrier(mu=1e-3)),
    }
    policies = {"closed form": open_loop, "path": open_loop}
    return {
        name: (*parts, policies.get(name, affine_policy)(parts[0].system.nx, parts[0].system.nu))
        for name, parts in cases.items()
    }


def rolled(name: str, **options) -> list[np.ndarray]:
    """Return costs, gradients, scores and their moments under noise that the kernel draws."""
    *parts, policy = systems()[name]
    f = RolloutFunction(*parts, HORIZON, policy, **options)
    rng = np.random.default_rng(0)
    x0 = 0.3 * rng.standard_normal((N, parts[0].system.nx))
    theta = 0.3 * rng.standard_normal(policy.shape(HORIZON))
    given = {"noise": Gaussian(0.1, seed=3), "score": True}
    single, whole = f(x0, theta, **given), f.moments(x0, theta, **given)
    moments = [whole.value, whole.gradient, whole.zeroth]
    return [single.cost, single.gradient, single.score, *[m.mean for m in moments], *[m.m2 for m in moments]]


@pytest.mark.costly_cases("gcc -march=x86-64")
def test_functions_are_the_same_everywhere(strict):
    f, rng = every_operation(), np.random.default_rng(1)
    x, p = rng.standard_normal((N, 3)), np.array([0.7, -1.2])
    wanted = BatchFunction(f, backend="numpy")(x, p)
    made = [
        BatchFunction(f, backend="c", threads=threads, block=block)(x, p)
        for threads, block in ((1, 32), (2, 8), (2, 64))
    ]
    for one, other in zip(made[0], wanted, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-12)
    for again in made[1:]:
        for one, other in zip(made[0], again, strict=True):
            np.testing.assert_array_equal(one, other)


@pytest.mark.costly_cases(
    "gcc -march=x86-64-inner loop",
    "gcc -march=x86-64-v3-inner loop",
    "gcc -march=x86-64-path",
    "gcc -march=x86-64-v3-path",
)
@pytest.mark.parametrize("name", ["closed form", "inner loop", "path"])
def test_rollouts_are_the_same_everywhere(name, strict):
    wanted = rolled(name, backend="numpy")
    made = [rolled(name, backend="c", threads=t, block=b) for t, b in ((1, 32), (2, 8), (2, 64))]
    for one, other in zip(made[0], wanted, strict=True):
        scale = np.abs(other).max()
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-11 * scale)
    for again in made[1:]:
        for one, other in zip(made[0][:3], again[:3], strict=True):
            np.testing.assert_array_equal(one, other)


@pytest.mark.costly_cases("gcc -march=x86-64")
def test_moments_do_not_depend_on_threads(strict):
    one, other = (rolled("inner loop", backend="c", threads=threads) for threads in (1, 2))
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.skipif(not COMPILERS, reason="no C compiler")
@pytest.mark.cheap_cases("-O0")
@pytest.mark.parametrize("level", ["-O0", "-O1", "-O3"])
def test_optimisation_changes_no_bit(level, monkeypatch):
    """Quick tests compile without optimisation (``tests/conftest.py``), unless warnings are errors."""
    native, f, rng, values = compiler.NATIVE_FLAGS, every_operation(), np.random.default_rng(1), []
    x, p = rng.standard_normal((N, 3)), np.array([0.7, -1.2])
    for flag in (level, "-O2"):
        monkeypatch.setattr(compiler, "NATIVE_FLAGS", tuple((*flags, flag, "-Werror") for flags in native))
        compiler._probe.cache_clear()
        values.append(BatchFunction(f, backend="c")(x, p))
    compiler._probe.cache_clear()
    for one, other in zip(*values, strict=True):
        np.testing.assert_array_equal(one, other)


def test_random_numbers_are_the_same_everywhere(strict):
    out = c_draws.draw(9, 5, 1001)
    assert len(out) == strict.width
    wanted = standard_normals(key_of(9), 5, *out.shape)
    np.testing.assert_allclose(out, wanted, rtol=1e-13, atol=1e-15)


def texts(machine: compiler.Compiler) -> dict[str, Callable[[], str]]:
    """Return a mapping from name to a function that emits one kind of source for a machine."""
    from dynamics.batch.graphs.objective import Costs
    from dynamics.batch.graphs.rollout_tapes import ClosedStep

    made: dict[str, Callable[[], str]] = {
        "function": lambda: c_flat.batch_source(tape_of(every_operation()), 32, machine),
        "random": lambda: c_draws.source(machine),
    }
    for name, parts in systems().items():
        for per_sample_p in (False, True):
            for tapes in ("tapes", "tapes_with_adjoint"):
                made[f"{name}, {tapes}, own p: {per_sample_p}"] = functools.partial(
                    lambda parts, tapes, per_sample_p: c_rollout.rollout_source(
                        getattr(ClosedStep(parts[0], Costs(*parts[1:3]), parts[3]), tapes), 32, machine, per_sample_p
                    ),
                    parts,
                    tapes,
                    per_sample_p,
                )
    return made


def test_other_processors_have_nothing_to_complain_of(tmp_path):
    """Code for ARM's 128-bit registers, with the compiler's generic vectors, is compiled but not run."""
    clang = shutil.which("clang")
    target = "--target=aarch64-linux-gnu"
    if clang is None or b"aarch64" not in _targets(clang):
        pytest.skip("no clang here that writes code for aarch64")
    machine = replace(compiler.find_compiler(), width=2, has_fma=True, vector_math={})
    for name, make in texts(machine).items():
        source = tmp_path / "text.c"
        source.write_text(make())
        command = [clang, target, "-std=c11", "-O0", *STRICT, "-c", source, "-o", tmp_path / "o"]
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode == 0, f"{name}: {done.stderr[:500]}"


def _targets(clang: str) -> bytes:
    return subprocess.run([clang, "--print-targets"], capture_output=True, check=True).stdout
