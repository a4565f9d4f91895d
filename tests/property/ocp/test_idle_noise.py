"""Only noise that affects the cost is scored: idle inputs add no variance to any gradient estimator."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from dynamics.batch import Gaussian, RolloutFunction, affine_policy, open_loop
from dynamics.contact import Barrier, Exact
from dynamics.systems import ParameterTable, Signal, lcs
from ocp.gradients import RolloutObjective, StaticObjective, estimate_gradient
from ocp.gradients.estimators import SAMPLED
from ocp.learning.experiment import Experiment
from ocp.learning.total_propagation import TotalPropagation
from ocp.learning.unroll_gradients import ARS, FOPG, ZOPG, AoBG
from ocp.learning.unrolling import unroll_episodes
from ocp.problem.policy import Feedback
from ocp.problem.problem import Problem
from ocp.problem.task import Task
from problems.tasks import registry
from tests.unit.dynamics.batch.backends import BACKENDS

LAW = Barrier(mu=0.1)
MANY = 12
"""Number of idle inputs."""
SIGMA, N = 0.3, 6


def system(idle: int, states: int):
    """Return a mass at a wall with ``states`` further states, each moved by the mass and an idle input."""
    A, B = 0.9 * np.eye(1 + states), np.eye(1 + states, 1 + idle)
    A[1:, 0] = 1.0
    first = np.eye(1 + states)[:, :1]
    return lcs("mass", A=A, B=B, C=first, D=first.T, E=B[:1], F=[[1.0]], d=[0.2])


def problem(idle: int, states: int) -> Problem:
    """Return a problem in which the mass goes to 1 and the other states cost nothing."""
    made = system(idle, states)
    return Problem(
        name="mass",
        system=made,
        N=N,
        stage_cost=(made.x[0] - 1) ** 2 + 0.1 * made.u[0] ** 2,
        terminal_cost=made.x[0] ** 2,
        x0=ca.SX.zeros(1 + states),
        parameters=ParameterTable(),
    )


def task(idle: int) -> Task:
    """Return the problem as a learning task that observes the mass alone."""
    made, chance = system(idle, idle), ca.SX.sym("chance")
    return Task(
        name="mass",
        system=made,
        parameters=ParameterTable(),
        horizon=N,
        start=ca.vertcat(0.2 * chance, ca.SX.zeros(idle)),
        chance=chance,
        reward=-((made.x_next[0] - 1) ** 2) - 0.1 * made.u[0] ** 2,
        observation=made.x[0],
        observations=(Signal("x", "1"),),
        lower=-2 * np.ones(1 + idle),
        upper=2 * np.ones(1 + idle),
    )


def variance(samples: np.ndarray) -> tuple[float, float]:
    """Return the trace of the covariance of samples (n, d), and its standard error."""
    squares = np.square(samples - samples.mean(axis=0)).sum(axis=1)
    return float(squares.mean()), float(squares.std() / np.sqrt(len(squares)))


def alike(one: tuple[float, float], other: tuple[float, float]) -> bool:
    """Return whether two values agree within five standard errors."""
    return abs(one[0] - other[0]) <= 5 * np.hypot(one[1], other[1])


def static(idle: int) -> StaticObjective:
    """Return the objective ``(theta_0 - 1)²`` with ``1 + idle`` components."""
    theta = ca.SX.sym("theta", 1 + idle)
    names = tuple(Signal(f"theta{i}", "1") for i in range(1 + idle))
    cost, value = (theta[0] - 1) ** 2, 0.5 * np.ones(1 + idle)
    return StaticObjective("idle", names, theta, cost, value, ParameterTable(), backend="numpy")


# Feedback from a state that an idle input moves would let that input act: there are none.
OBJECTIVES = {
    "static": static,
    "open-loop": lambda idle: RolloutObjective(problem(idle, idle), LAW, backend="numpy"),
    "feedback": lambda idle: RolloutObjective(problem(idle, 0), LAW, Feedback(stationary=True), backend="numpy"),
}


@pytest.mark.costly_cases(
    "zobg-antithetic-open-loop",
    "zobg-zero-noise-open-loop",
    "zobg-zero-noise-feedback",
    "zobg-mean-open-loop",
    "zobg-antithetic-feedback",
    "fobg-open-loop",
    "fobg-feedback",
    "es-open-loop",
)
@pytest.mark.parametrize("kind", OBJECTIVES)
@pytest.mark.parametrize("name", [*SAMPLED])
def test_no_estimators_variance_grows_with_idle_inputs(name: str, kind: str) -> None:
    n, found = 2000, []
    for idle in (0, MANY):
        objective, noise = OBJECTIVES[kind](idle), Gaussian(SIGMA, seed=3 + idle)
        singles = SAMPLED[name].make_sampler(objective, noise, n).single(noise, n)
        first = np.arange(1 + idle) == 0
        assert not singles[:, ~np.resize(first, singles.shape[1])].any()
        found.append(variance(singles))
    assert found[0][0] > 0 or name == "fobg"
    assert alike(*found), found


@pytest.mark.costly
def test_alpha_weighs_the_variances_of_what_acts() -> None:
    """The first component has the same noise, and so alpha is the same, with idle components or without."""
    alphas = [
        estimate_gradient(static(idle), ["alpha-variance"], 40_000, SIGMA, seed=1)["alpha-variance"]
        for idle in (0, MANY)
    ]
    assert alphas[0].choice is not None and alphas[1].choice is not None
    assert alphas[0].choice.alpha == pytest.approx(alphas[1].choice.alpha, rel=1e-12)


@pytest.mark.cheap_cases("AoBG-None", "TotalPropagation-hidden4")
@pytest.mark.parametrize(
    ("make", "hidden"),
    [(ZOPG, None), (ZOPG, (4,)), (AoBG, None), (FOPG, ()), (TotalPropagation, (4,))],
)
def test_no_algorithms_variance_grows_with_idle_inputs(make, hidden) -> None:
    """Variances are over 10 batches of 128 samples, at the same policy of the input that acts.

    Total propagation weighs by variances, so that the likelihood ratio's share would fall with idle noise.
    """
    found = []
    for idle in (0, MANY):
        algorithm = make(samples=128, unroll=N, sigma=SIGMA)
        e = Experiment(
            task=task(idle),
            algorithm=algorithm,
            law=LAW,
            hidden=hidden,
            threads=1,
            normalise=False,
            seed=idle,
        )
        state = algorithm.begin(e)
        state["theta"] = _same_policy(e, hidden)
        name = "likelihood_ratio_share" if make is TotalPropagation else "gradient_variance"
        told = [algorithm.iterate(e, state, k)[1][name] for k in range(10)]
        found.append((float(np.mean(told)), float(np.std(told, ddof=1) / np.sqrt(10))))
    assert alike(*found), found


def _same_policy(e: Experiment, hidden: tuple[int, ...] | None) -> np.ndarray:
    """Return parameters with which the first action does not depend on the number of others."""
    theta = np.zeros(e.policy.n_theta)
    if hidden is None:
        theta[0] = 0.3
        return theta
    for W, b in e.policy.layers(theta):  # pyright: ignore[reportAttributeAccessIssue]
        W[:], b[:] = 0.4, 0.1
    return theta


def test_random_search_leaves_idle_weights_alone() -> None:
    e = Experiment(task=task(3), algorithm=ARS(), law=LAW, hidden=(4,), threads=1, normalise=False)
    state = e.algorithm.begin(e)
    changed = e.algorithm.iterate(e, state, 0)[0]["theta"] - state["theta"]
    *below, (W, b) = e.policy.layers(changed)  # pyright: ignore[reportAttributeAccessIssue]
    assert all(part.all() for pair in below for part in pair)
    assert W[0].all() and b[0] and not W[1:].any() and not b[1:].any()


def law_parameters() -> ca.SX:
    """Return symbols of the law's parameters."""
    return LAW.close(system(0, 0)).p.vector


def drawn(seed: int):
    """Return a random sparse system, with a stage and a terminal cost of some of its states."""
    rng = np.random.default_rng(seed)
    nx, nu, nlam = 5, 3, 2

    def sparse(rows: int, columns: int, share: float) -> np.ndarray:
        return rng.normal(size=(rows, columns)) * (rng.random((rows, columns)) < share)

    made = lcs(
        "drawn",
        A=sparse(nx, nx, 0.25),
        B=sparse(nx, nu, 0.3),
        C=sparse(nx, nlam, 0.3),
        D=sparse(nlam, nx, 0.3),
        E=sparse(nlam, nu, 0.3),
        F=np.eye(nlam) + 0.3 * np.diag([1.0], rng.choice([-1, 1])),
    )
    p = law_parameters()
    of_stage, of_end = (ca.DM((rng.random(nx) < share).astype(float)) for share in (0.15, 0.3))
    stage = ca.Function("stage", [made.x, made.u, p], [ca.dot(of_stage, ca.sin(made.x))])
    end = ca.Function("end", [made.x, p], [ca.dot(of_end, ca.sin(made.x))])
    return made, stage, end


@pytest.mark.one_case_in(8)
@pytest.mark.parametrize("per_step", [True, False])
@pytest.mark.parametrize("seed", range(12))
def test_what_is_scored_is_what_moves_the_cost(seed: int, per_step: bool) -> None:
    """Differences with large noise find the same pairs of step and input as the graph."""
    made, stage, end = drawn(seed)
    law = LAW.close(made)
    policy = open_loop(made.nx, made.nu) if per_step else affine_policy(made.nx, made.nu)
    f = RolloutFunction(law, stage, end, 4, policy, backend="numpy")
    rng = np.random.default_rng(seed)
    shape, tries = (4, made.nu), 30
    x0, noise = rng.normal(size=(tries, made.nx)), rng.normal(size=(tries, *shape))
    theta = rng.normal(size=(tries, *f.policy.shape(4)))
    before, moves = f(x0, theta, noise=noise, gradient=False).cost, np.zeros(shape, dtype=bool)
    for t, j in np.ndindex(shape):
        moved = noise.copy()
        moved[:, t, j] += rng.normal(size=tries)
        moves[t, j] = (f(x0, theta, noise=moved, gradient=False).cost != before).any()
    np.testing.assert_array_equal(f.acting[0], moves)
    scored = f(x0, theta, noise=Gaussian(SIGMA, seed), gradient=False, score=True).score
    if per_step:
        drawn_noise = Gaussian(SIGMA, seed).draw(tries, *shape)
        np.testing.assert_allclose(scored, moves * drawn_noise / SIGMA**2, rtol=1e-12)


def test_the_tied_are_scored_with_whom_they_are_tied_to() -> None:
    """Gap 1 depends on lam_0 and input 1, lam_0 on input 0, so that both inputs reach a cost of lam_1's state."""
    made = lcs(
        "tied",
        A=[[0.0]],
        B=[[0.0, 0.0, 0.0]],
        C=[[0.0, 1.0]],
        D=[[0.0], [0.0]],
        E=[[1.0, 0, 0], [0, 1.0, 0]],
        F=[[1.0, 0.0], [0.5, 1.0]],
    )
    p = law_parameters()
    free = ca.Function("stage", [made.x, made.u, p], [ca.SX(0)])
    end = ca.Function("end", [made.x, p], [made.x[0]])
    f = RolloutFunction(LAW.close(made), free, end, 3, open_loop(1, 3), backend="numpy")
    np.testing.assert_array_equal(f.acting[0], [[0, 0, 0], [0, 0, 0], [1, 1, 0]])


@pytest.mark.costly_cases("casadi")
@pytest.mark.parametrize("backend", BACKENDS)
def test_the_ball_is_thrown_by_the_first_noise_alone(backend: str) -> None:
    """The score is w_0 / sigma², and zero for a ball that is in flight from the start."""
    ball = registry.get("ball-throw")
    e = Experiment(task=ball, algorithm=FOPG(), law=Exact(), hidden=None, threads=1)
    rollouts = e.rollouts(ball.horizon)
    if backend != "c":
        from ocp.learning.rollouts import TaskRollouts

        rollouts = TaskRollouts(ball, Exact(), e.policy, ball.horizon, backend=backend, threads=1)
    noise, n = Gaussian(0.1, seed=5), 500
    first = np.repeat(ball.reset(1, np.random.default_rng(0)), n, axis=0)
    score = rollouts(first, np.array([-0.2, -0.4]), noise=noise, n_samples=n, score=True).score
    wanted = noise.draw(n, ball.horizon, 2)[:, 0] / 0.1**2
    np.testing.assert_allclose(score, wanted, rtol=1e-12)
    in_flight = first.copy()
    in_flight[::2, 4] = 0.0
    mixed = rollouts(in_flight, np.array([-0.2, -0.4]), noise=noise, n_samples=n, score=True).score
    np.testing.assert_allclose(mixed[1::2], wanted[1::2], rtol=1e-12)
    assert not mixed[::2].any()


def test_a_throws_estimate_varies_as_little_as_one_draw_lets_it() -> None:
    """ZOPG's mean agrees with FOPG's within five standard errors, 5 times as large with scores of 50 draws."""
    ball, n = registry.get("ball-throw"), 4096
    theta, noise = np.array([-0.2, -0.44]), Gaussian(0.1, seed=7)
    e = Experiment(task=ball, algorithm=FOPG(), law=LAW, hidden=None, threads=1, normalise=False)
    state = {**e.algorithm.begin(e), "theta": theta}
    x0 = np.repeat(ball.reset(1, np.random.default_rng(0)), n, axis=0)
    found = unroll_episodes(e, state, x0, ball.horizon, noise=noise, gradient=True, score=True)
    centred = found.value - found.value.mean()
    # Every score is of one independent pair of normal draws, so that E s² = 1 / sigma².
    assert np.square(found.score).mean() * 0.1**2 == pytest.approx(1, abs=5 * np.sqrt(2 / (2 * n)))
    zeroth, first = centred[:, None] * found.score, found.gradient
    error = np.sqrt((zeroth.var(axis=0) + first.var(axis=0)) / n)
    assert np.all(np.abs(zeroth.mean(axis=0) - first.mean(axis=0)) <= 5 * error)
