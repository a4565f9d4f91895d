"""All scalar operations of CasADi at ordinary and special values, compiled and in NumPy."""

from __future__ import annotations

import warnings

import casadi as ca
import numpy as np
import pytest
from scipy import special

from dynamics.batch import BatchFunction, BatchWarning, UnsupportedOperation
from dynamics.batch.graphs.tape import BINARY, OP_NAMES, RENAMES, UNARY, tape_of
from tests.unit.dynamics.batch.backends import FAST

SPECIAL = np.array(
    [
        *(0.0, -0.0, 1.0, -1.0, 0.5, -0.5, 2.0, -3.0, np.inf, -np.inf, np.nan, 5e-324, -5e-324),
        *(1e300, -1e300, 1e-300, 1e308, 709.9, -746.0, 3.0, 0.1, 1e5, -1e5, 1e22),
    ]
)


def _functions() -> dict[str, ca.Function]:
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    unary = {
        **{"neg": -x, "exp": ca.exp(x), "log": ca.log(x), "sqrt": ca.sqrt(x), "sq": x * x},
        **{"twice": 2 * x, "inv": 1 / x, "sin": ca.sin(x), "cos": ca.cos(x), "tan": ca.tan(x)},
        **{"asin": ca.asin(x), "acos": ca.acos(x), "atan": ca.atan(x), "sinh": ca.sinh(x)},
        **{"cosh": ca.cosh(x), "tanh": ca.tanh(x), "asinh": ca.asinh(x), "acosh": ca.acosh(x)},
        **{"atanh": ca.atanh(x), "not": ca.logic_not(x), "floor": ca.floor(x)},
        **{"ceil": ca.ceil(x), "fabs": ca.fabs(x), "sign": ca.sign(x), "erf": ca.erf(x)},
        **{"log1p": ca.log1p(x), "expm1": ca.expm1(x), "cube": x**3, "root": x**1.5},
        **{"seventh": x / 7, "printme": x.printme(0), "constant": x + ca.SX(-0.0) * 3},
    }
    binary = {
        **{"add": x + y, "sub": x - y, "mul": x * y, "div": x / y, "pow": x**y, "lt": x < y},
        **{"le": x <= y, "eq": x == y, "ne": x != y, "and": ca.logic_and(x, y)},
        **{"or": ca.logic_or(x, y), "if_else_zero": ca.if_else(x, y, 0)},
        **{"fmod": ca.fmod(x, y), "remainder": ca.remainder(x, y), "fmin": ca.fmin(x, y)},
        **{"copysign": ca.copysign(x, y), "fmax": ca.fmax(x, y), "atan2": ca.atan2(x, y)},
        **{"hypot": ca.hypot(x, y), "if_else": ca.if_else(x < y, ca.exp(x), y)},
        **{"branch": ca.if_else(x, y, -y), "gap": ca.if_else(ca.logic_not(x), x, y)},
    }
    made = {name: ca.Function(name, [x], [e]) for name, e in unary.items()}
    return made | {name: ca.Function(name, [x, y], [e]) for name, e in binary.items()}


FUNCTIONS = _functions()


@pytest.fixture(scope="module")
def together() -> ca.Function:
    """Return all operations in one function, so that they are compiled once."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    values = [fn(*(x, y)[: fn.n_in()]) for fn in FUNCTIONS.values()]
    return ca.Function("together", [x, y], values, ["x", "y"], list(FUNCTIONS))


@pytest.fixture(scope="module", params=FAST)
def evaluated(request, together):
    """Return all operations at samples of (x, y), by the backend and by CasADi."""
    rng = np.random.default_rng(0)
    ordinary = rng.standard_normal((400, 2)) * rng.choice([0.3, 1.0, 20.0], (400, 1))
    pairs = np.stack(np.meshgrid(SPECIAL, SPECIAL), axis=-1).reshape(-1, 2)
    x, y = np.concatenate((ordinary, pairs)).T[:, :, None]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BatchWarning)
        got = BatchFunction(together, backend=request.param)(x=x, y=y)
        wanted = BatchFunction(together, backend="casadi")(x=x, y=y)
    return got, wanted


@pytest.mark.parametrize("name", list(FUNCTIONS))
def test_agrees_with_casadi_on_ordinary_and_special_values(name, evaluated):
    got, wanted = (values[name][:, 0] for values in evaluated)
    np.testing.assert_array_equal(np.isnan(got), np.isnan(wanted))
    finite = np.isfinite(wanted)
    np.testing.assert_array_equal(got[~finite], wanted[~finite])
    np.testing.assert_allclose(got[finite], wanted[finite], rtol=1e-12, atol=1e-307)


def test_every_scalar_operation_of_casadi_is_known():
    graph_only = {
        *("INPUT", "OUTPUT", "CONST", "PARAMETER", "CALL", "FIND", "LOW", "MAP", "MTIMES"),
        *("SOLVE", "TRANSPOSE", "DETERMINANT", "INVERSE", "DOT", "BILIN", "RANK1", "HORZCAT"),
        *("VERTCAT", "DIAGCAT", "HORZSPLIT", "VERTSPLIT", "DIAGSPLIT", "RESHAPE", "SUBREF"),
        *("SUBASSIGN", "GETNONZEROS", "GETNONZEROS_PARAM", "ADDNONZEROS", "ADDNONZEROS_PARAM"),
        *("SETNONZEROS", "SETNONZEROS_PARAM", "PROJECT", "ASSERTION", "MONITOR", "NORM2"),
        *("NORM1", "NORMINF", "NORMF", "MMIN", "MMAX", "HORZREPMAT", "HORZREPSUM", "EINSTEIN"),
        *("BSPLINE", "CONVEXIFY", "SPARSITY_CAST", "LOGSUMEXP", "DUMP", "KRON", "KRON_CONTRACT"),
    }
    known = {OP_NAMES[op] for op in UNARY | BINARY | RENAMES}
    assert known == set(OP_NAMES.values()) - {f"OP_{name}" for name in graph_only}


@pytest.mark.parametrize("backend", FAST)
def test_erfinv_is_accurate_where_casadi_is_not(backend):
    # CasADi 3.8's erfinv is off by up to 2e-6 near |x| = 0.7, so SciPy is the reference.
    x = ca.SX.sym("x")
    ends = np.array([-1.0, -0.0, 0.0, 1.0, 1.5, np.nan])
    tails = 1.0 - np.logspace(-16, -1, 50)
    at = np.concatenate((np.linspace(-0.999, 0.999, 999), tails, -tails, 10.0**-tails, ends))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BatchWarning)
        got = BatchFunction(ca.Function("f", [x], [ca.erfinv(x)]), backend=backend)(at[:, None])
    np.testing.assert_allclose(got[:, 0], special.erfinv(at), rtol=1e-14, atol=0)


def test_mx_functions_expand():
    x = ca.MX.sym("x", 3)
    f = ca.Function("f", [x], [ca.mtimes(x.T, x), ca.norm_2(x)])
    squared, norm = BatchFunction(f)(np.array([[1.0, 2.0, 2.0], [0.0, 3.0, 4.0]]))
    np.testing.assert_allclose(squared[:, 0], [9, 25])
    np.testing.assert_allclose(norm[:, 0], [3, 5])


def test_kept_call_is_named_and_auto_falls_back_to_casadi():
    x = ca.SX.sym("x", 2)
    inner = ca.Function("inner", [x], [ca.sin(x)], {"never_inline": True})
    f = ca.Function("outer", [x], [2 * inner(x)])
    with pytest.raises(UnsupportedOperation, match=r"OP_CALL in function 'outer'"):
        BatchFunction(f, backend="c")
    with pytest.warns(BatchWarning, match="OP_CALL.*runs on the casadi backend"):
        batch = BatchFunction(f)
    at = np.array([[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]])
    np.testing.assert_allclose(batch(at), 2 * np.sin(at), rtol=1e-15)


def test_free_variables_are_refused():
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    f = ca.Function("f", [x], [x * y], {"allow_free": True})
    with pytest.raises(UnsupportedOperation, match=r"free variables.*make them inputs"):
        tape_of(f)
