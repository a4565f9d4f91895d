"""The reader of AMPL's .nl files reads files written by hand."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from ocp.errors import InputError
from ocp.mpcc import solve
from ocp.mpcc.nl import NLProblem, read_nl, sol_text

HEADER = """g3 1 1 0	# problem by hand
 {n} {m} 1 0 0	# vars, constraints, objectives, ranges, eqns
 0 1 0 0
 0 0
 0 0 0
 0 0 0 1
 0 0 0 0 0
 0 0
 0 0
 0 0 0 0 0
"""
NOTHING = "O0 0\nn0\n"
FREE = "3\n"


def read(tmp_path: Path, n: int, m: int, segments: str) -> NLProblem:
    path = tmp_path / "hand.nl"
    path.write_text(HEADER.format(n=n, m=m) + segments)
    return read_nl(path)


def values(stated: NLProblem, x: list[float]) -> list[np.ndarray]:
    mpcc = stated.mpcc
    at = np.concatenate([x, np.zeros(mpcc.x.numel() - len(x))])
    found = ca.Function("all", [mpcc.x], [mpcc.f, mpcc.g, mpcc.G, mpcc.H])(at)
    return [np.array(value).ravel() for value in found]


@pytest.mark.parametrize(
    ("expression", "value"),
    [
        ("o0\nv0\nv1\n", 3.0 + 2.0),
        ("o1\nv0\nv1\n", 3.0 - 2.0),
        ("o2\nv0\nn-1.5e0\n", -4.5),
        ("o3\nv0\nv1\n", 1.5),
        ("o5\nv0\nn3\n", 27.0),
        ("o5\nv0\nv1\n", 9.0),
        ("o16\nv0\n", -3.0),
        ("o39\nv0\n", 3.0**0.5),
        ("o44\nv1\n", np.exp(2.0)),
        ("o43\nv1\n", np.log(2.0)),
        ("o15\no1\nv1\nv0\n", 1.0),
        ("o54\n3\nv0\no2\nv1\nv1\nn10\n", 17.0),
        ("o12\n3\nv0\nv1\nn7\n", 7.0),
        ("o1\no1\nv0\nv1\no1\nv1\nv0\n", 2.0),
    ],
)
def test_every_operator_means_what_the_manual_says(tmp_path: Path, expression: str, value: float) -> None:
    stated = read(tmp_path, 2, 0, f"O0 0\n{expression}b\n{FREE}{FREE}")
    assert values(stated, [3.0, 2.0])[0] == pytest.approx([value], rel=1e-14)


def test_linear_parts_defined_variables_bounds_and_start(tmp_path: Path) -> None:
    """f = x0² + 2 x1 and rows v + 3 x0 in [-1, 4], v <= 5, with v = x0 x1 + 7 x1."""
    segments = """V2 1 0
1 7
o2
v0
v1
C0
v2
C1	#a comment
v2
O0 0
o5
v0
n2
x1
1 2.5
r
0 -1 4
1 5
b
0 -1 1
2 0.5
k1
2
J0 2
0 3
1 0
G0 1
1 2
"""
    stated = read(tmp_path, 2, 2, segments)
    f, g, G, H = values(stated, [3.0, 2.0])
    assert f == pytest.approx([13.0])
    assert g == pytest.approx([6 + 14 + 9, 6 + 14])
    assert G.size == H.size == 0
    assert np.array_equal(stated.mpcc.x_bounds, [[-1, 0.5], [1, np.inf]])
    assert np.array_equal(stated.mpcc.g_bounds, [[-1, -np.inf], [4, 5]])
    assert np.array_equal(stated.start, [0, 2.5])
    assert not stated.maximise


def test_a_cost_to_be_maximised_is_turned_round(tmp_path: Path) -> None:
    stated = read(tmp_path, 1, 0, f"O0 1\nn0\nb\n{FREE}G0 1\n0 4\n")
    assert stated.maximise
    assert values(stated, [2.0])[0] == pytest.approx([-8.0])


BODY = "C0\nn-3\n" + NOTHING + "r\n5 {kind} 2\nb\n3\n{bounds}\nJ0 1\n0 2\n"
"""Text of an .nl file with one row, ``2 x0 - 3``, that is complementary to the second variable."""


@pytest.mark.parametrize(
    ("kind", "bounds", "G", "H"),
    [
        (1, "2 0", [2 * 5 - 3], [4]),
        (1, "2 1.5", [2 * 5 - 3], [4 - 1.5]),
        (2, "1 9", [3 - 2 * 5], [9 - 4]),
    ],
)
def test_a_complementary_row_is_a_pair(tmp_path: Path, kind: int, bounds: str, G: list[float], H: list[float]) -> None:
    stated = read(tmp_path, 2, 1, BODY.format(kind=kind, bounds=bounds))
    _, g, first, second = values(stated, [5.0, 4.0])
    assert g.size == 0
    assert np.array_equal(first, G)
    assert np.array_equal(second, H)


def test_a_row_between_two_bounds_is_two_pairs(tmp_path: Path) -> None:
    """``2 x0 - 3 = w - v``, ``0 <= w ⟂ x1 - 1 >= 0`` and ``0 <= v ⟂ 9 - x1 >= 0``."""
    stated = read(tmp_path, 2, 1, BODY.format(kind=3, bounds="0 1 9"))
    mpcc = stated.mpcc
    found = ca.Function("all", [mpcc.x], [mpcc.g, mpcc.G, mpcc.H])([5.0, 4.0, 0.25, 0.5])
    g, G, H = (np.array(value).ravel() for value in found)
    assert g == pytest.approx([2 * 5 - 3 - 0.25 + 0.5])
    assert np.array_equal(mpcc.g_bounds, [[0], [0]])
    assert np.array_equal(G, [0.25, 0.5])
    assert np.array_equal(H, [3, 5])


def test_a_row_that_complements_a_free_variable_is_an_equation(tmp_path: Path) -> None:
    stated = read(tmp_path, 2, 1, BODY.format(kind=0, bounds="3"))
    _, g, G, _ = values(stated, [5.0, 4.0])
    assert np.array_equal(g, [7])
    assert np.array_equal(stated.mpcc.g_bounds, [[0], [0]])
    assert G.size == 0


def test_a_variable_that_complements_itself_is_zero(tmp_path: Path) -> None:
    segments = "C0\nn0\n" + NOTHING + "r\n5 1 1\nb\n2 0\nJ0 1\n0 1\n"
    stated = read(tmp_path, 1, 1, segments)
    assert stated.mpcc.G.numel() == 0
    assert values(stated, [5.0])[1] == pytest.approx([5.0])
    assert np.array_equal(stated.mpcc.g_bounds, [[0], [0]])


@pytest.mark.parametrize(
    ("segments", "said"),
    [
        ("O0 0\no81\nv0\n", "o81 is not known"),
        ("O0 0\nv7\n", "line 11"),
        (NOTHING + "b\n7 1\n", "type 7"),
        ("F0 1 -1 name\n", "'F0' is not known"),
        ("J3 1\n0 1\n", "row 3 does not exist; expected 0 to 0"),
        ("C1\nn0\n", "row 1 does not exist"),
        ("J0 1\n4 1\n", "variable 4 does not exist"),
        ("J0 1\n-1 1\n", "variable -1 does not exist"),
        ("J0 1\n0 nan\n", "variable 0 is nan, expected a finite number"),
        ("J0 -1\n0 1\n", "number of lines, -1, is negative"),
        ("d-1\n0 1\n", "number of lines, -1, is negative"),
        ("x1\n9 1\n", "variable 9 does not exist"),
        ("O0 0\nninf\n", "a constant is inf"),
        ("O0 0\no0\nv0\n", "a line or a word is missing"),
        ("O0 0\nv0\nv0\n", "leaves 2 values, expected 1"),
        ("r\n5 1 0\n", "variable 0 does not exist; expected 1 to 1"),
        ("r\n5 1 2\n", "variable 2 does not exist"),
        ("r\n5 7 1\n", "kind of complementarity 7 does not exist"),
    ],
)
def test_what_is_not_known_is_refused_with_its_line(tmp_path: Path, segments: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        read(tmp_path, 1, 1, segments)


@pytest.mark.parametrize(("n", "m"), [(-1, 0), (1, -1), (10**12, 0), (1, 10**12)])
def test_numbers_that_no_file_of_this_length_has_are_refused(tmp_path: Path, n: int, m: int) -> None:
    with pytest.raises(InputError, match="do not fit 13 lines"):
        read(tmp_path, n, m, NOTHING + "b\n")


def test_a_file_that_ends_within_its_terms_is_refused(tmp_path: Path) -> None:
    segments = "C0\nn0\nC1\nn0\n" + NOTHING + "r\n4 1\n4 2\nb\n3\n3\nJ0 2\n0 1\n1 1\nJ1 1\n0 1\n"
    whole = HEADER.replace(" 0 0\n 0 0\n 0 0 0 0 0\n", " 3 0\n 0 0\n 0 0 0 0 0\n")
    lines = (whole.format(n=2, m=2) + segments).splitlines(keepends=True)
    path = tmp_path / "cut.nl"
    path.write_text("".join(lines))
    assert np.allclose(values(read_nl(path), [3.0, 5.0])[1], [8, 3])
    for missing in range(1, 6):
        path.write_text("".join(lines[:-missing]))
        with pytest.raises(InputError, match="is it cut off"):
            read_nl(path)


def test_names_in_another_encoding_are_read(tmp_path: Path) -> None:
    (tmp_path / "hand.col").write_bytes(b"h\xf6he\n")
    stated = read(tmp_path, 1, 0, "O0 0\nv0\nb\n3\n")
    assert stated.mpcc.x.numel() == 1 and values(stated, [2.0])[0] == pytest.approx([2.0])


def test_a_binary_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "binary.nl"
    path.write_text("b3 1 1 0\n")
    with pytest.raises(InputError, match=r"not an AMPL \.nl text file"):
        read_nl(path)


def read_sol(text: str) -> tuple[list[float], list[float], int]:
    """Return duals, values and result code of a .sol file, by the layout that AMPL documents."""
    lines = text.splitlines()
    rest = lines[lines.index("Options") + 1 :]
    rest = rest[1 + int(rest[0]) :]
    rows, duals, variables, values = (int(line) for line in rest[:4])
    assert duals in (0, rows) and values == variables
    numbers = [float(line) for line in rest[4 : 4 + duals + values]]
    (last,) = rest[4 + duals + values :]
    assert last.startswith("objno 0 ")
    return numbers[:duals], numbers[duals:], int(last.split()[2])


def market(demand: float, sense: int) -> str:
    """Text of an .nl file with ``q = demand - v`` and ``0 <= v ⟂ q >= 0``, then ``-1 <= w <= 1 ⟂ w - 2 v - 3``.

    The cost is ``(v - 4)² + w`` or, to be maximised, its negative.
    """
    cost = "o0\no5\no0\nv0\nn-4\nn2\nv2\n"
    objective = f"O0 1\no16\n{cost}" if sense else f"O0 0\n{cost}"
    bounds = f"r\n4 {demand}\n5 1 2\n5 3 3\nb\n2 0\n2 0\n0 -1 1\n"
    rows = "J0 2\n0 1\n1 1\nJ1 1\n0 1\nJ2 2\n0 -2\n2 1\n"
    return f"C0\nn0\nC1\nn0\nC2\nn-3\n{objective}{bounds}{rows}"


@pytest.mark.cheap_cases("minimise")
@pytest.mark.parametrize("sense", [0, 1], ids=["minimise", "maximise"])
def test_a_solution_file_has_values_and_duals_of_every_row(tmp_path: Path, sense: int) -> None:
    """v is 0 or the demand, whichever is nearer 4, and w is 1 since its row is negative; duals are differences."""

    def solved(demand: float) -> tuple[list[float], list[float], float]:
        problem = read(tmp_path, 3, 3, market(demand, sense))
        solution = solve(problem.mpcc, problem.start)
        assert solution.success and problem.maximise == bool(sense)
        duals, x, code = read_sol(sol_text(problem, solution))
        assert code == 0
        return duals, x, problem.cost(solution)

    duals, x, cost = solved(3.0)
    assert x == pytest.approx([3, 0, 1], abs=1e-6)
    assert cost == pytest.approx(-2 if sense else 2, abs=1e-6)
    assert duals[0] == pytest.approx((solved(3.01)[2] - solved(2.99)[2]) / 0.02, abs=1e-4)
    assert duals[1:] == pytest.approx([0, 0], abs=1e-6), "rows that are not zero have no dual"


def test_a_solution_that_fails_has_no_duals_and_a_code(tmp_path: Path) -> None:
    segments = "C0\nn0\n" + NOTHING + "r\n4 -1\nb\n2 0\nJ0 1\n0 1\n"
    problem = read(tmp_path, 1, 1, segments)
    duals, x, code = read_sol(sol_text(problem, solve(problem.mpcc, problem.start)))
    assert not duals and len(x) == 1 and code == 200


def test_integer_variables_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "binary.nl"
    path.write_text(HEADER.format(n=1, m=0).replace(" 0 0 0 0 0\n 0 0\n", " 1 2 0 0 0\n 0 0\n", 1) + f"{NOTHING}b\n3\n")
    assert read_nl(path).contents.n_integer == 3


def test_a_file_that_is_cut_off_is_refused_up_to_its_bounds(tmp_path: Path) -> None:
    lines = (HEADER.format(n=3, m=3) + market(3.0, 0)).splitlines(keepends=True)
    path = tmp_path / "cut.nl"
    bounds_end = lines.index("J0 2\n")
    for count in range(bounds_end):
        path.write_text("".join(lines[:count]))
        with pytest.raises(InputError):
            read_nl(path)


def test_a_header_without_numbers_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "words.nl"
    path.write_text("g3 1 1 0\n" + "some words here\n" * 12)
    with pytest.raises(InputError, match="no header"):
        read_nl(path)
