"""A compiled stage is the same stage."""

import casadi as ca
import numpy as np
import pytest

from dynamics.batch import compiler
from dynamics.contact import Barrier
from ocp import Direct, InputError, MultipleShooting, solve
from ocp.transcription import compiled
from problems import get


def has_compiler() -> bool:
    try:
        compiler.find_compiler()
    except compiler.CompilerError:
        return False
    return True


@pytest.mark.skipif(not has_compiler(), reason="there is no C compiler here")
@pytest.mark.parametrize("method", [Direct(), MultipleShooting()])
def test_compiled_and_plain_solves_agree(method) -> None:
    plain, fast = (
        solve(get("push-1d"), Barrier(mu=1e-3), method, settings={"compile": word})
        for word in ("false", "true")
    )
    assert fast.success
    assert fast.cost == pytest.approx(plain.cost, rel=1e-10)
    np.testing.assert_allclose(fast.data["x"], plain.data["x"], atol=1e-7)


def test_without_a_compiler_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def none(source: str) -> None:
        raise compiler.CompilerError("no C compiler was found")

    monkeypatch.setattr(compiled, "load", none)
    x = ca.SX.sym("x")
    with pytest.raises(InputError, match="no C compiler was found; leave compile out"):
        compiled.compiled_stage(ca.Function("f", [x], [x**2]))
