"""Linearised steps, active sets and the regulator agree with independent computations."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from dynamics.batch import StepFunction
from ocp.mpc.active_set import ActiveSets
from ocp.mpc.horizon_qp import HorizonQP
from ocp.mpc.linearised import Affine, LinearClosure, Linearised, linearise, project_psd
from ocp.mpc.receding import Receding
from ocp.mpc.riccati import regulator_gains
from ocp.mpc.rollouts import CandidateRollouts
from ocp.mpc.stages import Plan, StageModel
from ocp.problem.problem import Problem
from problems import get


@cache
def model_of(name: str, **params: float) -> tuple[Problem, StageModel, CandidateRollouts]:
    """Return a problem of receding horizons, its model, and rollouts, which take a second to build."""
    problem = Receding.of(get(name, **params)).problem
    model = StageModel(problem, problem.exact_step)
    return problem, model, CandidateRollouts(model)


class Horizon:
    """Rollout of a problem under the exact law with random inputs."""

    def __init__(self, name: str, seed: int, **params: float) -> None:
        self.problem, self.model, self.rollouts = model_of(name, **params)
        table = self.problem.parameters.values
        x0, self.u_before, low, high = (np.array(v).ravel() for v in self.problem.limits(table)[:4])
        self.p = np.zeros((self.model.N + 1, len(self.model.names)))
        self.p[:, self.model.of_problem] = table
        rng, scales = np.random.default_rng(seed), self.problem.scales
        k = scales.u * rng.standard_normal((1, self.model.N, self.model.nu))
        K = np.zeros((1, self.model.N, self.model.nu, self.model.nx))
        self.plan, self.merit, *_ = self.rollouts.roll_out(x0, K, k, self.u_before, (low, high), self.p)

    def linearised(self, plan: Plan) -> tuple[np.ndarray, Linearised]:
        at = self.model.evaluate(plan, self.u_before, self.p)
        closed = ActiveSets(self.model).of(plan)
        return closed, linearise(self.model, plan, at, LinearClosure.from_active_set(plan, closed))


@pytest.mark.one_case_in(8)
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", ["soft-walls", "finger-disc"])
def test_linearised_steps_are_those_of_the_implicit_function(name: str, seed: int) -> None:
    """They agree where no pair is near both zeros, and the affine term is zero along a rolled-out plan."""
    made = Horizon(name, seed)
    plan, model = made.plan, made.model
    _, lin = made.linearised(plan)
    step = StepFunction(model.step, threads=1)
    own = made.p[0, model.of_step]
    _, by_x, by_u = step.derivatives(plan.x[:-1], plan.u, own)
    lam, gap = (side / size for side, size in zip((plan.lam, plan.gap), model.sizes, strict=True))
    strict = (np.maximum(lam, gap) > 1e-3).all(axis=1)
    assert strict.any(), "draws with decided contacts"
    scale = 1 + abs(by_x).max()
    assert abs(lin.x_next.value).max() < 1e-6
    assert abs(lin.x_next.by_x - by_x)[strict].max() < 1e-5 * scale
    assert abs(lin.x_next.by_u - by_u)[strict].max() < 1e-5 * scale


@pytest.mark.cheap_cases("0")
@pytest.mark.parametrize("seed", range(3))
def test_friction_has_one_closure_for_each_motion(seed: int) -> None:
    """Slip pairs are always closed; a contact without force slides, and one that sticks closes both friction pairs."""
    made = Horizon("finger-disc", seed)
    sets = ActiveSets(made.model)
    closed = sets.of(made.plan)
    [contact] = sets.contacts
    f, normal = list(contact.friction), closed[:, contact.normal]
    assert closed[:, contact.slip].all()
    assert closed[:, f].any(axis=1).all()
    assert (closed[~normal][:, f].sum(axis=1) == 1).all()
    slip = made.plan.lam[:, contact.slip]
    sticks = closed[:, f].all(axis=1)
    assert (slip[sticks] <= 1e-6).all()
    for which in np.eye(made.model.n, dtype=bool):
        other = sets.exchange(closed, np.broadcast_to(which, closed.shape))
        assert other[:, contact.slip].all()
        assert other[:, f].any(axis=1).all()
        assert not other[:, f][~other[:, contact.normal]].all(axis=1).any()


def regular(nx: int, nu: int, N: int, seed: int) -> Linearised:
    """Draw a linear-quadratic horizon with random matrices."""
    rng = np.random.default_rng(seed)
    A, B = rng.standard_normal((N, nx, nx)), rng.standard_normal((N, nx, nu))
    root = rng.standard_normal((N, nx + 2 * nu, nx + 2 * nu))
    H = np.einsum("kij,klj->kil", root, root) + np.eye(nx + 2 * nu)
    H[:, nx : nx + nu], H[:, :, nx : nx + nu] = 0.0, 0.0
    nothing = Affine(np.zeros((N, 0)), np.zeros((N, 0, nx)), np.zeros((N, 0, nu)))
    empty = np.zeros((N, nx, 0))
    return Linearised(
        Affine(np.zeros((N, nx)), A, B),
        nothing,
        nothing,
        nothing,
        np.zeros((N, nx + 2 * nu)),
        H,
        (np.zeros(nx), np.eye(nx)),
        empty,
        empty,
        empty,
    )


@pytest.mark.one_case_in(3)
@pytest.mark.parametrize("seed", range(3))
def test_the_regulator_is_the_quadratic_program_without_constraints(seed: int) -> None:
    """The solution of the quadratic program satisfies ``du_k = K_k dx_k``."""
    problem = Receding.of(get("soft-walls", N=6)).problem
    model = StageModel(problem, problem.exact_step)
    lin = regular(model.nx, model.nu, model.N, seed)
    dx0 = np.random.default_rng(seed + 10).standard_normal(model.nx)
    free = np.full((model.N, model.nu), np.inf)
    found = HorizonQP(model, 0).solve(lin, lin.rows, dx0, (-free, free))
    K = regulator_gains(lin)
    assert found.solved
    assert np.einsum("kij,kj->ki", K, found.dx[:-1]) == pytest.approx(found.du, rel=1e-5, abs=1e-6)


def test_the_regulator_converges_to_the_algebraic_riccati_equation() -> None:
    rng = np.random.default_rng(3)
    A, B = rng.standard_normal((3, 3)) * 0.6, rng.standard_normal((3, 2))
    N, H = 200, np.zeros((7, 7))
    H[:3, :3], H[5:, 5:] = np.eye(3), np.eye(2)
    lin = regular(3, 2, N, 0)
    lin.x_next = Affine(np.zeros((N, 3)), np.tile(A, (N, 1, 1)), np.tile(B, (N, 1, 1)))
    lin.hessian = np.tile(H, (N, 1, 1))
    V = solve_discrete_are(A, B, np.eye(3), np.eye(2))
    K = -np.linalg.solve(np.eye(2) + B.T @ V @ B, B.T @ V @ A)
    assert regulator_gains(lin)[0] == pytest.approx(K, abs=1e-7)


def test_negative_curvature_is_set_to_zero() -> None:
    matrix = np.array([[1.0, 2.0], [2.0, 1.0]])
    assert project_psd(matrix[None])[0] == pytest.approx(np.full((2, 2), 1.5))
    convex = np.array([[[2.0, 1.0], [1.0, 2.0]]])
    assert np.array_equal(project_psd(convex), convex)
