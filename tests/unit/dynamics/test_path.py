"""Graphs of the path solver at single pairs: when a path ends, which errors are reported, and what is raised."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import brentq

from dynamics.contact.interior_point import FLOOR, _lift
from dynamics.contact.path import ARRIVED, DIVERGED, MU_EXACT, MU_LINEAR, TRUE_GAP, Path
from dynamics.systems import ContactSystem, lcs, signals

F = np.array([[2.0, 0.5], [0.3, 1.0]])
LAM = np.array([0.5, 0.02])
GAP = np.array([0.3, 0.8])


def path_and_data(unique: bool, mu: np.ndarray, exact: bool = False, z: np.ndarray | None = None) -> tuple[Path, ca.DM]:
    """Return the path of ``lam (z + F lam) = mu`` and its data; by default the gaps at :data:`LAM` are :data:`GAP`."""
    system = lcs("two", A=1, B=1, C=np.ones((1, 2)), D=np.zeros((2, 1)), E=np.zeros((2, 1)), F=F)
    path = Path(ca.Sparsity.dense(2, 2), exact) if unique else Path.of_system(system, exact)
    z = GAP - F @ LAM if z is None else z
    return path, ca.evalf(path.opening_data(ca.SX(z), ca.SX(F), ca.SX(mu)))


def scaled(data: ca.DM, path: Path) -> dict[str, np.ndarray]:
    parts = path.split_data(ca.SX(data))
    return {name: np.array(ca.evalf(part)).ravel() for name, part in parts.items()}


@pytest.mark.parametrize("unique", [True, False])
def test_scaled_unknowns_have_the_path_of_the_unscaled_ones(unique: bool) -> None:
    """``lam' = lam / (c D)``, ``s' = s D / c``: D F D has a unit diagonal, and no scaled gap exceeds 1."""
    path, data = path_and_data(unique, LAM * GAP)
    parts = scaled(data, path)
    D, c = parts["D"], parts["c"].item()
    np.testing.assert_allclose(D, 1 / np.sqrt(np.diag(F)))
    assert c == pytest.approx(max(np.abs((GAP - F @ LAM) * D).max(), np.sqrt((LAM * GAP).max())))
    lam, s = LAM / (c * D), GAP * D / c
    np.testing.assert_allclose(lam * s, parts["mu"])
    np.testing.assert_allclose(parts["mu"] * parts["per_mu"], 1.0)
    np.testing.assert_allclose(parts["z"] + parts["entries"].reshape(2, 2).T @ lam, s)


CHANGES = {
    "none": (0.0, 0.0, True),
    "product of one contact": (1e-6, 0.0, False),
    "product, less than the tolerance": (1e-8, 0.0, True),
    "gap of one contact": (0.0, 1e-8, False),
    "gap, less than the tolerance": (0.0, 1e-11, True),
}


@pytest.mark.parametrize("contact", [0, 1])
@pytest.mark.parametrize("name", CHANGES)
def test_a_path_ends_where_all_products_and_all_gaps_are_accurate(name: str, contact: int) -> None:
    """Either of two contacts is off the path by a relative error of its product, or an error of its gap."""
    product, gap, ends = CHANGES[name]
    mu = LAM * GAP
    mu[contact] /= 1 + product
    path, data = path_and_data(False, mu)
    parts = scaled(data, path)
    lam, s = LAM / (parts["c"] * parts["D"]), GAP * parts["D"] / parts["c"]
    s[contact] += gap
    lam[contact] = parts["mu"][contact] * (1 + product) / s[contact]
    pair = np.concatenate([lam, s, [TRUE_GAP]])
    after = np.array(path.iteration_function()(pair, data)).ravel()
    assert (after[-1] == ARRIVED) == ends
    at_end = np.concatenate([lam, s, [ARRIVED]])
    np.testing.assert_array_equal(np.array(path.iteration_function()(at_end, data)).ravel(), at_end)


def test_products_below_the_floor_are_accurate_relative_to_the_floor() -> None:
    """With mu = 1e-14 a product of 1.05e-14 is off by 5 %, but by 5e-8 of :data:`FLOOR`."""
    lam = np.array([LAM[0], 1.05e-14])
    mu = np.array([LAM[0] * GAP[0], 1e-14 * GAP[1]])
    path, data = path_and_data(False, mu, z=GAP - F @ lam)
    parts = scaled(data, path)
    pair = np.concatenate([lam / (parts["c"] * parts["D"]), GAP * parts["D"] / parts["c"], [TRUE_GAP]])
    assert 0.01 * parts["mu"][1] < abs(np.prod(pair[[1, 3]]) - parts["mu"][1]) < 1e-7 * FLOOR
    assert np.array(path.iteration_function()(pair, data)).ravel()[-1] == ARRIVED


def test_a_pair_that_is_no_longer_finite_has_diverged() -> None:
    path, data = path_and_data(False, LAM * GAP)
    pair = np.array([np.nan, 1.0, 1.0, 1.0, TRUE_GAP])
    after = np.array(path.iteration_function()(pair, data)).ravel()
    assert after[-1] == DIVERGED
    error = np.array(path.ending_function()(pair, data)[2]).ravel()
    assert error[0] == np.inf


def test_a_unique_path_ends_at_a_pair_that_its_iteration_does_not_change() -> None:
    path, data = path_and_data(True, LAM * GAP)
    body, pairs = path.iteration_function(), [np.append(np.ones(4), TRUE_GAP)]
    while pairs[-1][-1] < ARRIVED and len(pairs) < 60:
        pairs.append(np.array(body(pairs[-1], data)).ravel())
    assert pairs[-1][-1] == ARRIVED
    np.testing.assert_array_equal(pairs[-1][:4], pairs[-2][:4])
    lam, gap, error = (np.array(v).ravel() for v in path.ending_function()(pairs[-1], data))
    np.testing.assert_allclose([lam, gap], [LAM, GAP], rtol=1e-9)
    assert error.max() < 1e-12


@pytest.mark.parametrize("unique", [True, False])
def test_errors_at_the_end_are_those_of_each_contact(unique: bool) -> None:
    """The larger one of ``|lam s - mu|`` and ``|z + F lam - s| / (1 + s)`` at random pairs, in scaled units."""
    mu = np.array([3.0, 0.01])
    path, data = path_and_data(unique, mu)
    D = 1 / np.sqrt(np.diag(F))
    z = GAP - F @ LAM
    c = max(np.abs(z * D).max(), np.sqrt(mu.max()))
    rng, by_product = np.random.default_rng(0), 0
    for _ in range(20):
        lam, s = rng.uniform(0, 2, (2, 2))
        lam_out, gap_out, error = (
            np.array(v).ravel() for v in path.ending_function()(np.concatenate([lam, s, [TRUE_GAP]]), data)
        )
        np.testing.assert_allclose(lam_out, c * D * lam)
        np.testing.assert_allclose(gap_out, s * c / D)
        product = np.abs(lam * s - mu / c**2)
        gap = np.abs(z * D / c + (D[:, None] * F * D) @ lam - s) / (1 + s)
        np.testing.assert_allclose(error, np.maximum(product, gap))
        by_product += (product > gap).sum()
    assert 0 < by_product < 40, "either error is the larger one somewhere"


def test_the_exact_end_is_the_solution_on_the_paths_active_set() -> None:
    """With z = (-1, 3) only the first contact acts; a pair on another active set is left as it is, with its error."""
    z = np.array([-1.0, 3.0])
    path, data = path_and_data(True, np.full(2, 100.0), exact=True, z=z)
    D, c = 1 / np.sqrt(np.diag(F)), 3.0
    np.testing.assert_allclose(scaled(data, path)["mu"], MU_EXACT)
    end = path.ending_function()

    def ending(lam: list[float], s: list[float]) -> list[np.ndarray]:
        return [np.array(v).ravel() for v in end(np.array([*lam, *s, TRUE_GAP]), data)]

    lam, gap, error = ending([0.3, 1e-6], [2e-6, 0.9])
    np.testing.assert_allclose(lam, [0.5, 0.0], atol=1e-15)
    np.testing.assert_allclose(gap, [0.0, 3 + 0.3 * 0.5], atol=1e-15)
    # The error compares with the gap at the solution, not at the pair.
    np.testing.assert_allclose(error, 0.0, atol=1e-12)
    lam, gap, error = ending([0.1, 1e-6], [0.2, 0.9])
    np.testing.assert_allclose(lam, c * D * [0.1, 1e-6])
    np.testing.assert_allclose(gap, c / D * [0.2, 0.9])
    assert error[0] == pytest.approx(abs(-D[0] / c + 0.1 - 0.2 + D[0] * D[1] * F[0, 1] * 1e-6) / 1.2)


def curved(x_next: ca.SX, x: ca.SX, u: ca.SX, lam: ca.SX) -> ContactSystem:
    """Return the step ``x_next = x + u + lam`` with the gap ``x_next + x_next² / 4``."""
    return ContactSystem(
        name="curved",
        x=x,
        u=u,
        x_next=x_next,
        lam=lam,
        residual=x_next - x - u - lam,
        gap=x_next + x_next**2 / 4,
        states=signals("q [m]"),
        inputs=signals("u [m]"),
        contacts=signals("wall [N s]"),
        h=0.1,
    )


@pytest.mark.parametrize("mu", [1e-2, 1e-8])
def test_a_curved_gap_is_first_followed_linearised(mu: float) -> None:
    """The phase rises by one: on the linear gap's path at mu >= 1e-4, on the true gap's path, at its end."""
    x_next, x, u, lam = (ca.SX.sym(name) for name in ("x_next", "x", "u", "lam"))
    system, mu_symbol = curved(x_next, x, u, lam), ca.SX.sym("mu")
    path = Path.of_system(system, False)
    inputs = [x, u, system.parameters.vector, mu_symbol]
    start, push = 0.5, -0.9
    data = ca.Function("data", inputs, [path.opening_data_of(system, mu_symbol)])(start, push, [], mu)
    parts = scaled(data, path)
    D, c = parts["D"].item(), parts["c"].item()
    body, pair, phases = path.iteration_function(), np.ones(3), [1.0]
    while pair[-1] < ARRIVED and len(phases) < 60:
        previous, pair = pair, np.array(body(pair, data)).ravel()
        phases.append(pair[-1])
        if previous[-1] == 1:
            linear = parts["z"].item() + parts["entries"].item() * previous[0]
            level = max(parts["mu"].item(), MU_LINEAR)
            near = abs(previous[0] * previous[1] / level - 1) < 1e-2 and abs(linear - previous[1]) < 1e-2
            assert pair[-1] == (TRUE_GAP if near else 1.0)
    assert sorted(set(phases)) == [1.0, TRUE_GAP, ARRIVED] and phases == sorted(phases)
    free = start + push

    def product(lam: float) -> float:
        return lam * ((free + lam) + (free + lam) ** 2 / 4) - mu

    assert pair[0] * c * D == pytest.approx(brentq(product, -free, 2.0, xtol=1e-14), rel=1e-6)


def test_small_products_are_raised_by_the_smaller_member() -> None:
    """The product is the least that is allowed, and the larger member, which determines the gap's error, stays."""
    symbols = [ca.SX.sym(name) for name in ("lam", "s", "least")]
    raised = ca.Function("raised", symbols, [*_lift(*symbols)])
    rng = np.random.default_rng(0)
    for lam, s, least in 10 ** rng.uniform(-4, 1, (200, 3)):
        pair = [float(v) for v in raised(lam, s, least)]
        larger = int(s > lam)
        assert pair[larger] == (lam, s)[larger]
        assert np.prod(pair) == pytest.approx(max(lam * s, least))
        assert lam * s < least or tuple(pair) == (lam, s)
