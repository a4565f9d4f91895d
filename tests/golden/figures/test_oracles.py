"""Functions of the studies agree with closed forms, conservation laws, differences and published values."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.stats import norm

from dynamics.batch import Gaussian
from dynamics.contact import Adaptive, Barrier, Exact
from problems import get, studies
from problems.studies.barrier_relaxation import eq5, newton_step, solve_qp
from problems.studies.bouncing_ball import in_log_height, least_height, turning_points
from problems.studies.impact_and_friction.data import cost_of_averaging, smoothed_box, softened_box
from problems.studies.jumping_objectives import drop_ball, hit_bar, throw_wall
from problems.studies.shared import contact_bounds as bounds
from problems.studies.shared.sampled_step import (
    SampledStep,
    averaged_exact,
    best_lines,
    gaussian_density,
    least_residual,
    printed_kappa,
    scalar_contact,
    student_density,
)
from problems.studies.stiff_pushing import Params as PushParams
from problems.studies.stiff_pushing import pushing_system, stability_limit
from problems.studies.wall_corner import ThrownBall, Wall


def test_eq5_solves_the_optimality_condition() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        x, v, u = rng.uniform(0, 1), *rng.uniform(-3, 3, 2)
        kappa, m, h = 10 ** rng.uniform(0, 4), rng.uniform(0.5, 2), 0.1
        after = float(eq5(x, v, u, kappa, m, h))
        velocity = (after - x) / h
        assert m * (velocity - v) == pytest.approx(u + h / (kappa * after), abs=1e-9)
        assert after > 0
    assert eq5(*map(np.array, (0.0, 0.0, 0.0, 1e4)), 1.0, 0.1) == pytest.approx(1e-3)


def test_the_qp_is_the_clipped_step_and_newton_ends_at_the_barriers_minimum() -> None:
    rng = np.random.default_rng(3)
    x, v, u = rng.uniform(0, 1, 40), *rng.uniform(-3, 3, (2, 40))
    after, lam = solve_qp(x, v, u, 2.0, 0.1)
    assert after == pytest.approx(np.maximum(0, x + 0.1 * (v + u / 2)), abs=1e-12)
    assert lam == pytest.approx(np.maximum(0, -2 * (x / 0.1 + v) - u), abs=1e-11)
    kappa = 10 ** rng.uniform(1, 4, 40)
    least = eq5(x, v, u, kappa, 2.0, 0.1)
    assert newton_step(x, v, u, kappa, least, 2.0, 0.1) == pytest.approx(0, abs=1e-12)
    off = 1e-6 * least
    assert newton_step(x, v, u, kappa, least + off, 2.0, 0.1) == pytest.approx(off, rel=1e-4)


def test_kappa_true_and_printed_as_the_errata_have_them() -> None:
    soft = scalar_contact(Adaptive(sigma=0.5), [0.3], 2.0)
    assert soft.lam[0] == pytest.approx(0.04217, abs=5e-6)
    assert averaged_exact(0.3, 2.0, gaussian_density(0.5)) == pytest.approx(soft.lam[0], rel=1e-10)
    assert printed_kappa(np.array(0.3), 0.5) == pytest.approx(0.5577, abs=1e-4)
    assert best_lines(0.5) == pytest.approx(np.array([[0.087, -0.129], [0.198, -0.309]]), abs=2e-3)


def test_constant_mu_is_student_noise_and_its_curvature_the_density() -> None:
    F, mu = 2.5, 0.03
    z = np.array([-0.7, 0.01, 1.3])
    soft = scalar_contact(Barrier(mu=mu), z, F)
    expected = [averaged_exact(at, F, student_density(F, mu)) for at in z]
    assert soft.lam == pytest.approx(expected, rel=1e-8)
    assert F * soft.curvature == pytest.approx(student_density(F, mu)(z), rel=1e-9)
    assert soft.curvature[1] == pytest.approx(1 / (4 * F**1.5 * np.sqrt(mu)), rel=1e-2)


@pytest.mark.parametrize("mu", [1.0, 3.0])
def test_the_softened_ball_keeps_its_energy_and_turns_where_lambert_says(mu: float) -> None:
    low, high, _ = turning_points(mu, 1.0, 9.81)
    assert low == pytest.approx(least_height(mu, 1.0, 9.81), rel=1e-8)
    assert high == pytest.approx(1.0, rel=1e-7)
    assert 9.81 * low - mu * np.log(low) == pytest.approx(9.81, rel=1e-8)
    y, v = in_log_height(mu, 1.0, 9.81, np.linspace(0, 0.3, 301))
    assert np.gradient(v, 0.001)[1:-1] == pytest.approx(mu / y[1:-1] - 9.81, abs=1e-3)


def test_the_box_sticks_slips_and_softens_as_its_closed_form() -> None:
    values = {"m": 1.0, "g": 9.81, "friction": 0.5, "h": 0.05}
    system, rest = get("box-slide", **values).system, np.zeros((1, 2))
    u = np.array([-9.0, -3.0, 0.0, 4.0, 8.0])
    bound = 0.5 * 9.81
    exact = SampledStep(Exact().close(system))(rest, u[:, None])
    slip = 0.05 * np.sign(u) * np.maximum(0, np.abs(u) - bound)
    assert exact.x_next[:, 1] == pytest.approx(slip, abs=1e-9)
    assert exact.x_by_u[:, 1, 0] == pytest.approx(0.05 * (np.abs(u) > bound), abs=1e-6)
    soft = SampledStep(Barrier(mu=2.5e-4).close(system))(rest, u[:, None])
    closed, slope = softened_box(u, 2.5e-4, **values)
    assert soft.x_next[:, 1] == pytest.approx(closed, abs=1e-11)
    assert soft.x_by_u[:, 1, 0] == pytest.approx(slope, abs=1e-10)
    # The same holds with forces for impulses and velocities for distances: mu/h² = 0.1 W.
    friction = closed / 0.05 - u
    assert closed == pytest.approx(-2 * 0.1 * friction / (bound**2 - friction**2), abs=1e-9)
    ahead, behind = (softened_box(u + d, 2.5e-4, **values)[0] for d in (1e-5, -1e-5))
    assert slope == pytest.approx((ahead - behind) / 2e-5, abs=1e-8)


@pytest.mark.costly
def test_averages_of_exact_solves_cost_what_the_closed_form_says() -> None:
    box = {"m": 2.0, "g": 9.81, "friction": 0.3, "h": 0.05}
    u = np.linspace(0, 24, 1201)
    cost = cost_of_averaging(u, 1e-3, **box)
    bound = box["friction"] * box["m"] * box["g"]
    exact = np.where(u > bound, 0.025, 0)
    softened = softened_box(u, 1e-3, **box)[1]
    assert cost.bias == pytest.approx(np.sqrt(np.mean((softened - exact) ** 2)))
    rng = np.random.default_rng(4)
    push = u + cost.sigma * rng.standard_normal((4000, len(u)))
    solves = 0.025 * (np.abs(push) > bound)
    assert solves.mean(axis=0) == pytest.approx(smoothed_box(u, cost.sigma, **box)[0], abs=2e-3)
    for count, expected in ((1, cost.single), (round(cost.needed), 1.1)):
        mean = solves[: 4000 // count * count].reshape(-1, count, len(u)).mean(axis=1)
        error = np.sqrt(np.mean((mean - exact) ** 2))
        assert error / cost.bias == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize("t", [-0.8, 0.0, 1.1])
def test_the_least_absolute_residual_is_that_of_a_linear_program(t: float) -> None:
    w = np.linspace(-6, 6, 601)
    weight = norm.pdf(w) * (w[1] - w[0])
    target = np.maximum(0, -(t + w))
    one = np.eye(len(w))
    # The variables are K, W and |residual|, which bounds both signs of the residual.
    line = np.stack((np.ones_like(w), w), axis=1)
    rows = np.block([[line, -one], [-line, -one]])
    found = linprog(
        np.concatenate(([0, 0], weight)),
        rows,
        np.concatenate((target, -target)),
        bounds=[(None, None)] * 2 + [(0, None)] * len(w),
    )
    assert least_residual(3 * t, 0.5, 3.0) == pytest.approx(6 * found.fun, rel=2e-3)


@pytest.mark.parametrize("kind", bounds.KINDS)
def test_random_systems_are_solved_and_differentiated(kind: str) -> None:
    rng = np.random.default_rng(1)
    F = np.stack([bounds.random_p_matrix(rng, 3, kind) for _ in range(20)])
    z, mu = rng.standard_normal((20, 3)), 10 ** rng.uniform(-4, 0, 20)
    found = bounds.solve_softened(z, F, mu)
    assert found.lam * found.gap == pytest.approx(np.repeat(mu[:, None], 3, 1), rel=1e-8)
    assert found.gap == pytest.approx(z + np.einsum("kij,kj->ki", F, found.lam), abs=1e-9)
    for column in range(3):
        shift = np.zeros((1, 3))
        shift[0, column] = 1e-6
        ahead, behind = bounds.solve_softened(z + shift, F, mu), bounds.solve_softened(z - shift, F, mu)
        difference = (ahead.lam - behind.lam) / 2e-6
        assert found.slope[:, :, column] == pytest.approx(difference, rel=1e-3, abs=1e-4)


def test_bounds_have_the_values_of_the_errata() -> None:
    one, z = np.ones((1, 1, 1)), np.ones(1)
    assert bounds.theorem_4_5(z, one, np.array([1e-6]), 1)[0] == pytest.approx(1e6, rel=1e-5)
    # 1/F - ... cancels to mu/(2 eps F²) as mu falls, eps = 1/2.
    assert bounds.theorem_4_5(z, one, np.array([1e-6]), -1)[0] == pytest.approx(1e-6, rel=1e-4)
    e, mu, F = 0.5, 0.3, 1.0
    plain = e / mu + 1 / F - e * np.sqrt(1 / mu**2 + 2 / (e * mu * F))
    assert bounds.theorem_4_5(z, one, np.array([mu]), -1)[0] == pytest.approx(plain, rel=1e-12)
    F2 = np.array([[[1.0, -100.0], [0.0, 1.0]]])
    found = bounds.solve_softened(np.ones((1, 2)), F2, np.ones(1))
    assert bounds.spectral_norms(found.slope)[0] == pytest.approx(27.63, abs=0.05)
    assert found.lam[0, 0] == pytest.approx(60.8, abs=0.05)


def test_throw_wall_as_in_the_facts() -> None:
    throw = throw_wall(1.0, 0.06, 0.02, 9.81)

    def x(angle: float) -> float:
        return float(np.sqrt(-throw.costs(np.array([[angle]]))[0]))

    assert x(np.pi / 4) == pytest.approx(0.10194, abs=1e-5)
    assert x(0.31) < 0.06
    assert x(0.32) == x(0.69) == x(1.2) == pytest.approx(0.06)
    assert x(0.694) == pytest.approx(0.1002, abs=1e-4)
    assert x(1.199) == pytest.approx(0.0690, abs=1e-4)


def test_drop_is_a_step_and_pivot_keeps_angular_momentum() -> None:
    fall = drop_ball(1.0, 2.0, 9.81)
    assert fall.costs(np.array([[-1e-3], [0.0], [0.4]])) == pytest.approx([0.0, -1.0, -1.0])
    theta = np.array([[-0.5], [0.1], [0.6], [0.63]])
    arm = 0.7 * np.tan(theta[:, 0])
    # In the plastic impact ball and bar share the angular momentum of the velocity along x.
    omega = 2.0 * np.cos(theta[:, 0]) * arm / (1.0 + arm**2)
    expected = np.where(np.abs(arm) <= 0.5, -(omega**2), 0)
    hit = hit_bar(2.0, 0.7, 0.5, 1.0, 1.0)
    assert hit.costs(theta) == pytest.approx(expected, rel=1e-12)
    assert expected[-1] == 0 < -expected[2]


@pytest.mark.costly_cases("True")
@pytest.mark.parametrize("dome", [False, True])
def test_a_thrown_ball_is_mirrored_and_differentiated(dome: bool) -> None:
    ball = ThrownBall(Wall(1.5, 0.05, 0.5, dome), 5.0, 9.81, 0.005, 80).at({"theta": 0.7})
    found = ball.sample_gradients(Gaussian(0.02, 0), 400)
    w = Gaussian(0.02, 0).draw(400, 1, 1)[:, 0]
    difference = (ball.costs(w + 1e-7) - ball.costs(w - 1e-7)) / 2e-7
    # None of the 400 samples is within 1e-7 of a kink.
    assert found.direction[:, 0] == pytest.approx(difference, rel=1e-5, abs=1e-5)
    path = ball.paths(np.array([0.68, 0.71]))
    speed = np.linalg.norm(np.diff(path, axis=1), axis=2) / 0.005
    whole = speed**2 / 2 + 9.81 * path[:, 1:, 1]
    # Except in the step of the impact, energy is that of semi-implicit free flight.
    assert np.median(np.abs(whole - 12.5)) < 0.2
    inside = (path[..., 0] > 1.4751) & (path[..., 0] < 1.5249) & (path[..., 1] < 0.4999)
    assert not inside.any()


def test_the_spring_is_the_semi_implicit_one_and_fails_at_its_limit() -> None:
    m, c, h, k = 0.1, 0.998, 0.005, 700.0
    step = SampledStep(Exact().close(pushing_system(k, m, c, h, 1.0)))
    rng = np.random.default_rng(2)
    x = np.column_stack((rng.uniform(-0.1, 0.1, 50), np.ones(50), *rng.uniform(-1, 1, (2, 50))))
    u = rng.uniform(-1, 1, (50, 1))
    force = k * np.maximum(0, -(x[:, 1] - x[:, 0] - 1.0))
    v1 = c * x[:, 2] + h / m * (u[:, 0] - force)
    v2 = c * x[:, 3] + h / m * force
    expected = np.column_stack((x[:, 0] + h * v1, x[:, 1] + h * v2, v1, v2))
    assert step(x, u).x_next == pytest.approx(expected, abs=1e-12)
    assert stability_limit(PushParams()) == pytest.approx(7992)
    for factor, grows in ((0.99, False), (1.01, True)):
        closed = step(np.array([[0.01, 1.0, 0, 0]]), np.zeros((1, 1)), {"k": 7992 * factor}).x_by_x[0]
        assert (np.abs(np.linalg.eigvals(closed)).max() > 1 + 1e-9) is np.bool_(grows)


def test_implicit_pushing_never_penetrates_and_keeps_momentum() -> None:
    m, c, h = 0.1, 1.0, 0.005
    step = SampledStep(Exact().close(pushing_system(None, m, c, h, 1.0)))
    x = np.array([[0.0, 1.001, 2.0, -1.0], [0.0, 1.5, 2.0, -1.0]])
    after = step(x, np.zeros((1, 1))).x_next
    assert np.all(after[:, 1] - after[:, 0] - 1 >= -1e-12)
    assert after[:, 2] + after[:, 3] == pytest.approx([1.0, 1.0])
    assert after[1] == pytest.approx([0.01, 1.495, 2.0, -1.0])


def test_variances_of_pushing_are_those_of_the_facts() -> None:
    data = studies.get("P5").data({"points": 4, "k_least": 10, "k_most": 1e4, "n_samples": 150})
    first, zeroth = data["first_order"].values, data["zeroth_order"].values
    assert zeroth[:3] == pytest.approx([2.4e3, 2.6e3, 2.6e3], rel=0.25)
    assert np.log(first[:3]) == pytest.approx(np.log([1.7e-2, 0.19, 1.6e2]), abs=0.6)
    assert first[3] > 1e24


@pytest.mark.costly
def test_randomized_friction_tends_to_its_closed_form() -> None:
    data = studies.get("A6").data()
    off = np.abs(data["push_rs"].values - data["push_limit"].values)
    assert off[2].max() < 5 * float(data["push_error"][2])
    u, bound = data["u"].values, 0.5 * 9.81
    chance = norm.sf(bound, u, 0.5) + norm.cdf(-bound, u, 0.5)
    assert data["push_limit"].values == pytest.approx(0.05 * chance, abs=1e-12)
