"""The exported C file, compiled with a driver, returns the numbers of CasADi's step and its derivatives."""

from __future__ import annotations

import functools
import re
import shutil
import subprocess
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from dynamics.batch.export import TabulatedPolicy, c_identifier, export_step
from dynamics.contact import Adaptive, Barrier, Exact, Randomized, Step
from problems import get

STRICT = ("-std=c11", "-O1", "-Wall", "-Wextra", "-Werror", "-Wpedantic")
COMPILERS = [name for name in ("gcc", "clang") if shutil.which(name)]
LAWS = {
    "barrier": Barrier(mu=1e-3),
    "exact": Exact(),
    "adaptive": Adaptive(sigma=0.2),
    "randomized": Randomized(sigma=0.2, samples=2, base=Barrier(mu=1e-3)),
}
# A closed form, one with roots, an inner loop with two contacts, and paths through friction.
CASES = [
    *[("wall-1d", law) for law in LAWS],
    *[("push-disc", law) for law in ("barrier", "adaptive")],
    *[("cart-walls", law) for law in ("barrier", "exact", "randomized")],
    *[("hopper-1d", law) for law in ("barrier", "adaptive")],
    ("planar-push", "barrier"),
]
DRIVER = """\
#include <stdio.h>
static void show(const double *a, int n) { for (int i = 0; i < n; i++) printf("%.17g ", a[i]); }
int main(void) {
  enum { nx = NAME_nx, nu = NAME_nu, nlam = NAME_nlam, np = NAME_np };
  double x[nx], u[nu + 1], p[np + 1], next[nx], lam[nlam + 1], A[nx * nx], B[nx * nu + 1];
  for (;;) {
    for (int i = 0; i < nx; i++) if (scanf("%lf", x + i) != 1) return 0;
    for (int i = 0; i < nu; i++) if (scanf("%lf", u + i) != 1) return 1;
    for (int i = 0; i < np; i++) p[i] = NAME_parameters[i];
    printf("%d ", NAME_derivatives(x, u, p, next, lam, A, B));
    show(next, nx); show(lam, nlam); show(A, nx * nx); show(B, nx * nu);
    printf("%d ", NAME_step(x, u, 0, x, 0));
    show(x, nx);
    printf("\\n");
  }
}
"""


def built(folder: Path, text: str, driver: str, cc: str) -> Path:
    """Compile the exported file and a driver; return the program."""
    source, program = folder / f"{cc}.c", folder / cc
    source.write_text(text + driver)
    done = subprocess.run([cc, *STRICT, source, "-o", program, "-lm"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[:2000]
    return program


def answers(program: Path, rows: np.ndarray) -> np.ndarray:
    """Return the numbers that the program prints for each row of input."""
    given = "\n".join(" ".join(map(repr, row)) for row in rows.tolist())
    told = subprocess.run([program], input=given, capture_output=True, text=True, check=True)
    return np.array([line.split() for line in told.stdout.splitlines()], dtype=float)


@functools.cache
def case(problem: str, law: str) -> tuple[Step, np.ndarray, np.ndarray]:
    """Return a step, states and inputs (n, nx + nu), and the numbers that the driver should print for them."""
    made = get(problem)
    step = LAWS[law].close(made.system)
    nx, nu = made.system.nx, made.system.nu
    x, u = ca.MX.sym("x", nx), ca.MX.sym("u", nu)
    x_next, lam = step.map(x, u, step.p.values)
    by_x, by_u = ca.jacobian(x_next, x), ca.jacobian(x_next, u)
    wanted = ca.Function("wanted", [x, u], [x_next, lam, by_x.T, by_u.T])
    start, before = (np.array(v)[:, 0] for v in made.limits(made.parameters.values)[:2])
    rng, sizes = np.random.default_rng(3), made.scaling
    shaken = [signal.name != "h" for signal in made.system.states]
    far = np.repeat([0.2, 1.5], 8)[:, None]
    rows = np.hstack(
        [
            start + far * sizes.x * rng.standard_normal((16, nx)) * shaken,
            before + sizes.u * rng.standard_normal((16, nu)),
        ]
    )
    told = []
    for row in rows:
        values = [np.array(v.full()).ravel(order="F") for v in wanted(row[:nx], row[nx:])]
        told.append(np.concatenate([[0.0], *values, [0.0], values[0]]))
    return step, rows, np.array(told)


@pytest.mark.one_case_in(6)
@pytest.mark.parametrize("cc", COMPILERS)
@pytest.mark.parametrize(("problem", "law"), CASES)
def test_the_file_has_the_step_and_its_derivatives(problem, law, cc, tmp_path):
    step, rows, wanted = case(problem, law)
    text, _ = export_step(step, step.p.values, problem)
    driver = DRIVER.replace("NAME", c_identifier(problem))
    got = answers(built(tmp_path, text, driver, cc), rows)
    assert got.shape == wanted.shape
    assert np.abs(wanted[:, 1 + step.system.nx : 1 + step.system.nx + step.n]).max() > 1e-3
    for one, other in zip(got, wanted, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-11 * np.abs(other).max())


@pytest.mark.parametrize("cc", COMPILERS)
def test_parameters_may_be_given_at_run_time(cc, tmp_path):
    step, rows, _ = case("push-disc", "barrier")
    values = step.p.values * 1.25
    text, _ = export_step(step, values, "push-disc")
    driver = DRIVER.replace("NAME", "push_disc").replace("_step(x, u, 0,", "_step(x, u, p,")
    driver = driver.replace("p[i] = ", "p[i] = 0.8 * ")
    got = answers(built(tmp_path, text, driver, cc), rows)
    wanted = np.array([step.map(r[:4], r[4:], step.p.values)[0] for r in rows])[:, :, 0]
    np.testing.assert_allclose(got[:, 1:5], wanted, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(got[:, -4:], wanted, rtol=1e-12, atol=1e-13)


POLICY_DRIVER = """\
#include <stdio.h>
int main(void) {
  double row[3], u[2];
  while (scanf("%lf %lf %lf", row, row + 1, row + 2) == 3) {
    push_policy((int)row[0], row + 1, u);
    printf("%.17g %.17g\\n", u[0], u[1]);
  }
  return 0;
}
"""


@pytest.mark.parametrize("cc", COMPILERS)
@pytest.mark.parametrize("feedback", [False, True])
def test_the_policy_is_in_it(feedback, cc, tmp_path):
    """The policy is u = K x + k within bounds, or the plan's inputs; after the horizon the last row is used."""
    rng = np.random.default_rng(0)
    k, K = rng.standard_normal((3, 2)), rng.standard_normal((3, 2, 2))
    bounds = np.array([-0.5, -np.inf]), np.array([np.inf, 0.7])
    policy = TabulatedPolicy(k, K, *bounds) if feedback else TabulatedPolicy(k)
    step, *_ = case("wall-1d", "barrier")
    text, _ = export_step(step, step.p.values, "push", policy=policy)
    rows = np.hstack([np.arange(6.0)[:, None], rng.standard_normal((6, 2))])
    got = answers(built(tmp_path, text, POLICY_DRIVER, cc), rows)
    at = np.minimum(np.arange(6), 2)
    wanted = k[at]
    if feedback:
        wanted = np.clip(np.einsum("tij,tj->ti", K[at], rows[:, 1:]) + k[at], *bounds)
    np.testing.assert_allclose(got, wanted, rtol=1e-14, atol=1e-15)


def test_the_header_states_layout_units_law_and_values():
    step, *_ = case("push-disc", "barrier")
    values = step.p.values
    values[step.p.names.index("contact.mu")] = 0.125
    text, _ = export_step(step, values, "9 push/disc", ["Pushed */ far /* away ??", "", "barrier law"])
    head = text[: text.index("*/")]
    assert "Pushed * / far / * away ? ?" in head
    assert "/*" not in head[2:]
    assert "barrier law" in head
    for signal in (*step.system.states, *step.system.inputs, *step.contacts, *step.p):
        assert re.search(rf": {re.escape(signal.name)}( = \S+)? \[{re.escape(signal.unit)}\]", head)
    assert "contact.mu = 0.125 [N s m]" in head
    assert "int c_9_push_disc_step(" in text
    assert "__" not in text.replace("__cplusplus", "")


def test_a_step_that_comes_to_no_number_says_so(tmp_path):
    step, rows, _ = case("hopper-1d", "barrier")
    text, _ = export_step(step, step.p.values, "hopper-1d")
    driver = DRIVER.replace("NAME", "hopper_1d")
    bad = rows[:1].copy()
    bad[0, 0] = np.nan
    assert answers(built(tmp_path, text, driver, COMPILERS[0]), bad)[0, 0] == 1
