"""Tables of parameters: values are set and read by name, independently of the vector's order."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynamics.systems import LAW_PREFIX, Parameter, ParameterTable, matrix_parameters, signals

FINITE = st.floats(-1e6, 1e6)


def table() -> ParameterTable:
    mixed = [Parameter("m", 2.0, "kg"), *matrix_parameters("F", [[1.0, 2.0], [3.0, 4.0]], "m/(N s)")]
    return ParameterTable([*mixed, Parameter(LAW_PREFIX + "mu", 1e-3, "N s m")])


@pytest.mark.costly
@given(st.lists(FINITE, min_size=6, max_size=6))
def test_packing_undoes_unpacking(vector: list[float]) -> None:
    named = table().unpack(vector)
    assert list(named) == ["m", "F[0,0]", "F[0,1]", "F[1,0]", "F[1,1]", "contact.mu"]
    np.testing.assert_array_equal(table().pack(dict(reversed(named.items()))), vector)


def test_who_has_no_value_keeps_its_default() -> None:
    np.testing.assert_array_equal(table().pack(), table().values)
    assert table().unpack(table().pack({"m": 5.0, "elsewhere": 7.0})) == {
        **table().defaults,
        "m": 5.0,
    }


def test_a_matrix_is_given_and_read_whole() -> None:
    p, F, w = table(), np.array([[0.1, 0.2], [0.3, 0.4]]), np.array([1.0, -2.0])
    one_by_one = {f"F[{i},{j}]": F[i, j] for i, j in np.ndindex(2, 2)}
    np.testing.assert_array_equal(p.pack({"F": F}), p.pack(one_by_one))
    product = ca.Function("product", [p.vector], [p["F"] @ ca.DM(w)])
    np.testing.assert_allclose(np.array(product(p.pack({"F": F})))[:, 0], F @ w)
    with pytest.raises(KeyError, match="G"):
        p["G"]


def test_samples_make_rows() -> None:
    F = np.arange(12.0).reshape(3, 2, 2)
    rows = table().pack({"F": F, "m": [1.0, 2.0, 3.0]}, mu=1e-2)
    for k, row in enumerate(rows):
        np.testing.assert_array_equal(row, table().pack({"F": F[k], "m": k + 1.0}, mu=1e-2))


def test_a_law_parameter_is_no_parameter_of_the_problem() -> None:
    both = ParameterTable([Parameter("mu", 1.0), Parameter(LAW_PREFIX + "mu", 2.0)])
    assert both.unpack(both.pack({"mu": 3.0})) == {"mu": 3.0, "contact.mu": 2.0}
    assert both.unpack(both.pack(mu=3.0)) == {"mu": 1.0, "contact.mu": 3.0}
    with pytest.raises(KeyError, match="kappa"):
        both.pack(kappa=1.0)


def test_units_are_told_by_name() -> None:
    assert table().units["F[1,0]"] == "m/(N s)" and table().units["contact.mu"] == "N s m"


@pytest.mark.parametrize("written", ["fl N left", "x [m]; v m/s speed", "fl [N left", "fl N] left"])
def test_signals_whose_brackets_are_forgotten_are_refused(written: str) -> None:
    with pytest.raises(ValueError, match="needs its unit in brackets"):
        signals(written)


def test_a_signal_of_one_word_has_no_unit() -> None:
    assert [signal.unit for signal in signals("x; v [m/s]")] == ["1", "m/s"]
