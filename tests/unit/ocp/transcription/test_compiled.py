"""Compiled functions of a stage return the same values as interpreted ones."""

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from dynamics.batch.engines import compiler
from dynamics.contact import Barrier
from ocp import Direct, MultipleShooting, SingleShooting, solve
from ocp.solve.solve import new_session
from problems import get


def has_compiler() -> bool:
    try:
        compiler.find_compiler()
    except compiler.CompilerError:
        return False
    return True


needs_compiler = pytest.mark.skipif(not has_compiler(), reason="there is no C compiler here")
METHODS = [Direct(), MultipleShooting(), SingleShooting()]


@pytest.mark.costly
@needs_compiler
@pytest.mark.parametrize("method", METHODS)
def test_compiled_and_plain_solves_agree(method) -> None:
    plain, fast = (
        solve(get("push-1d"), Barrier(mu=1e-3), method, settings={"jit": word}) for word in ("false", "true")
    )
    assert fast.success
    assert fast.cost == pytest.approx(plain.cost, rel=1e-10)
    np.testing.assert_allclose(fast.data["x"], plain.data["x"], atol=1e-7)
    assert (plain.record["jit"], fast.record["jit"]) == (None, "compiled")


@pytest.mark.cheap_cases("method0")
@needs_compiler
@pytest.mark.parametrize("method", METHODS)
def test_every_function_of_an_nlp_is_the_same(method) -> None:
    """With two contacts the path solver is compiled too, in methods that use it."""
    plain, fast = (
        new_session(get("cart-walls", N=4), Barrier(mu=1e-3), method, settings={"jit": word}) for word in (False, True)
    )
    one, two = plain.nlp_of("product"), fast.nlp_of("product")
    noise = np.random.default_rng(5)
    x, lam = 0.1 + noise.random(one.n), noise.standard_normal(one.m)
    p = one.parameter_vector(plain.values)
    for name in ("f_g", "gradient", "jacobian", "hessian"):
        given = [ca.DM(v) for v in ((x, p, 0.7, lam) if name == "hessian" else (x, p))]
        for plain_value, value in zip(getattr(one, name).call(given), getattr(two, name).call(given), strict=True):
            a, b = (np.array(ca.densify(v)) for v in (plain_value, value))
            np.testing.assert_allclose(b, a, rtol=1e-9, atol=1e-9 * np.abs(a).max(initial=1))


@pytest.mark.costly
@needs_compiler
def test_a_second_solve_compiles_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(compiler, "_loaded", {})
    settings = {"jit": True, "homotopy": False}
    first = solve(get("push-1d", N=3), Barrier(mu=1e-2), settings=settings)
    objects = set(tmp_path.rglob("*.so"))
    assert objects
    monkeypatch.setattr(compiler, "_loaded", {})
    monkeypatch.setattr(compiler, "_compile", lambda *_: pytest.fail("compiled again"))
    second = solve(get("push-1d", N=3), Barrier(mu=1e-2), settings=settings)
    assert set(tmp_path.rglob("*.so")) == objects
    assert second.cost == first.cost and second.record["jit"] == "compiled"


@pytest.mark.costly
def test_without_a_compiler_functions_are_interpreted_and_it_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls = []

    def none(source: str) -> None:
        calls.append(source)
        raise compiler.CompilerError("no C compiler was found")

    monkeypatch.setattr(compiler, "load_library", none)
    plain, found = (solve(get("push-1d"), Barrier(mu=1e-3), settings={"jit": word}) for word in ("no", "yes"))
    assert len(calls) == 1, "it is not looked for again and again"
    assert found.record["jit"] == "no C compiler was found; functions are interpreted"
    assert found.cost == plain.cost
