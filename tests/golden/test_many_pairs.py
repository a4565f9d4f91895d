"""Steps with many pairs on few coordinates: factors of the compliance and calls of a solver change no solution."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Exact, ncp, reduced_path
from dynamics.contact.reduced_path import ReducedPath, path_of
from dynamics.systems import ContactSystem
from ocp.judge.measures import DenseFunction
from tests.benchmarks.ocp.world_scenes import STIFFNESS, H, row_of_discs


def solved(system: ContactSystem, x: np.ndarray, u: np.ndarray) -> list[np.ndarray]:
    """Return x_next, lam, gap and error of one exact step of a new solver."""
    step = Exact().close(system)
    return [np.array(part).ravel() for part in step.solve(x, u, step.p.values)]


@pytest.mark.costly
@pytest.mark.parametrize("push", [(0.3, 0.0), (0.1, 0.05)])
def test_a_finger_that_pushes_a_row_ends_where_it_does_with_a_dense_compliance(
    push: tuple[float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Four discs touch each other and the finger, which moves them by ``d = h² k (push - d) / 4`` along the row."""
    system = row_of_discs(4, N=2).system
    x = np.zeros(14)
    x[[0, 3, 6, 9]], x[12] = [0.0, 0.2, 0.4, 0.6], -0.15
    u = x[12:] + push
    assert isinstance(path_of(system, True), ReducedPath)
    by_factors = solved(system, x, u)
    monkeypatch.setattr(reduced_path, "MANY_PAIRS", 1000)
    by_matrix = solved(system, x, u)
    assert by_factors[3].max() < 1e-7
    if push[1] == 0:
        spring = H**2 * STIFFNESS
        np.testing.assert_allclose(by_factors[0][[0, 3, 6, 9]] - x[[0, 3, 6, 9]], spring * push[0] / (4 + spring))
    np.testing.assert_allclose(by_factors[0], by_matrix[0], atol=1e-7)


def test_a_damped_step_is_that_of_levenberg_and_marquardt() -> None:
    """NumPy solves the damped normal equations of ``phi = lam + gap - sqrt(lam² + gap² + 2 mu)``."""
    path = path_of(row_of_discs(2, N=2).system, True)
    step, lam = ncp._damped_step(path), ca.SX.sym("lam", path.n)
    gap_at = ca.Function("gap", [lam, path.data], [*path.true_gap_at(lam), path.data_parts["mu"]])
    rng, lowered = np.random.default_rng(0), 0
    for _ in range(20):
        point = np.concatenate([10 ** rng.uniform(-3, 1, path.n), 10 ** rng.uniform(-4, 0, 1)])
        data = rng.uniform(-1, 1, path.data.numel()) ** 2
        phi, jacobian = fischer_burmeister(point[:-1], *gap_at(point[:-1], data))
        normal = jacobian.T @ jacobian
        damped = normal + point[-1] * np.diag(np.maximum(np.diag(normal), 1e-12))
        trial = point[:-1] - np.linalg.solve(damped, jacobian.T @ phi)
        trial_phi, _ = fischer_burmeister(trial, *gap_at(trial, data))
        is_lower = trial_phi @ trial_phi < phi @ phi
        expected = [*trial, point[-1] / 5] if is_lower else [*point[:-1], 4 * point[-1]]
        lowered += is_lower
        np.testing.assert_allclose(np.array(step(point, data)).ravel(), expected, rtol=1e-9, atol=1e-12)
    assert 0 < lowered < 20


def fischer_burmeister(lam: np.ndarray, gap: ca.DM, by_lam: ca.DM, mu: ca.DM) -> tuple[np.ndarray, np.ndarray]:
    """Return phi (n,) and its derivative by lam (n, n), of gaps with the derivative ``by_lam`` (n, n)."""
    s, slopes, targets = np.array(gap).ravel(), np.array(by_lam), np.array(mu).ravel()
    size = np.sqrt(lam**2 + s**2 + 2 * targets)
    return lam + s - size, np.diag(1 - lam / size) + (1 - s / size)[:, None] * slopes


def test_entries_at_their_positions_are_the_dense_matrices() -> None:
    v = ca.SX.sym("v", 3)
    function = DenseFunction([v], [ca.jacobian(ca.vertcat(v[0] * v[1], v[2] ** 2), v), v[1]])
    points = np.arange(1.0, 13.0).reshape(4, 3)
    for dense, entries, places in zip(function(points), function.entries(points), function.positions, strict=True):
        np.testing.assert_array_equal(entries[:, places], dense)
    assert np.count_nonzero(function(points)[0][0]) == 3
