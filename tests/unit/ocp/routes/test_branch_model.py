"""The predicted costs of neighbouring branches are those of quadratic programs, solved by linear algebra."""

from __future__ import annotations

import itertools

import casadi as ca
import numpy as np
import pytest

from ocp.judge.certificate import certify
from ocp.mpcc import MPCC
from ocp.mpcc.programs import programs_of
from ocp.programs.program import PENALTY, RELAXATION
from ocp.programs.solver import Point, Solver
from ocp.routes.branches import NEIGHBOUR, Branches
from ocp.routes.homotopy import Homotopy
from ocp.routes.schedules import MAX_FAILURES, MAX_UNLIKELY, WORTHWHILE_GAIN, BranchModel, improve_schedule

PAIRS, FREE, ROWS = 5, 4, 6
N = 2 * PAIRS + FREE


def held_of(active: np.ndarray) -> np.ndarray:
    return np.arange(PAIRS) + PAIRS * active


class QuadraticProgram:
    """``min v'Qv/2 + c'v`` subject to ``A v = b`` and ``0 <= v[i] ⟂ v[PAIRS + i] >= 0``, with random data.

    On the branch ``active`` the solution is ``v`` by construction, without other active bounds.
    """

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        root = rng.normal(size=(N, N))
        self.Q, self.A = root @ root.T / N + 0.1 * np.eye(N), rng.normal(size=(ROWS, N))
        self.active, self.v = rng.random(PAIRS) < 0.5, rng.uniform(0.05, 0.3, N)
        self.v[held := held_of(self.active)] = 0.0
        multipliers = np.zeros(N)
        multipliers[held] = rng.normal(size=PAIRS)
        self.b = self.A @ self.v
        self.c = multipliers - self.Q @ self.v - self.A.T @ rng.normal(size=ROWS)

    def solved(self, zeros: np.ndarray) -> tuple[float, np.ndarray]:
        """Return cost and point with the entries ``zeros`` at zero, and no other bound."""
        rows = np.vstack([self.A, np.eye(N)[zeros]])
        m = len(rows)
        K = np.block([[self.Q, rows.T], [rows, np.zeros((m, m))]])
        v = np.linalg.solve(K, np.concatenate([-self.c, self.b, np.zeros(len(zeros))]))[:N]
        return float(v @ self.Q @ v / 2 + self.c @ v), v

    def branches(self, steep: float = 0.0) -> Branches:
        """Return the branches of the program, with one more variable of cost ``steep w²/2`` that starts at 1."""
        v, w = ca.SX.sym("v", N), ca.SX.sym("w")
        cost = ca.bilin(ca.DM(self.Q), v, v) / 2 + ca.dot(ca.DM(self.c), v) + steep * w**2 / 2
        g = ca.mtimes(ca.DM(self.A), v) - self.b
        mpcc = MPCC(ca.vertcat(v, w) if steep else v, cost, v[:PAIRS], v[PAIRS : 2 * PAIRS], g=g)
        programs = programs_of(mpcc, np.zeros(0), np.append(np.zeros(N), 1.0)[: N + bool(steep)])
        return Branches(Homotopy(programs, Solver("ipopt"), {PENALTY: 0.0, RELAXATION: 0.0}))


def test_predicted_costs_are_those_of_the_neighbours() -> None:
    compared = kept_closed = 0
    for seed in range(8):
        problem = QuadraticProgram(seed)
        branches, held = problem.branches(), held_of(problem.active)
        cost, v = problem.solved(held)
        np.testing.assert_allclose(v, problem.v, atol=1e-9)
        result = branches.solve(Point(np.zeros(N)), problem.active, mu_init=1e-2)
        assert result.ok and result.f == pytest.approx(cost, abs=1e-6)
        model = BranchModel(branches, result, problem.active, np.arange(PAIRS))
        for changed in ([0], [3], [1, 2], [0, 4]):
            flips = np.isin(np.arange(PAIRS), changed)
            zeros = held_of(problem.active ^ flips)
            after, moved = problem.solved(zeros)
            while (closed := held[flips][moved[held[flips]] < -1e-9]).size:
                zeros, kept_closed = np.concatenate([zeros, closed]), kept_closed + 1
                after, moved = problem.solved(zeros)
            assert model.change(flips) == pytest.approx(after - cost, rel=1e-5, abs=1e-6)
            compared += 1
    assert compared > 20 and kept_closed > 1


@pytest.mark.costly_cases("1000000.0")
@pytest.mark.parametrize("steep", [1e6, 1e8])
def test_a_cost_that_falls_far_below_its_unit_is_minimised_as_well_as_one_near_it(steep: float) -> None:
    for seed in range(4):
        problem = QuadraticProgram(seed)
        branches, near = problem.branches(steep), problem.branches()
        assert branches.program.natural.f > 1e3
        result = branches.solve(Point(np.append(np.full(N, 0.1), 1.0)), problem.active)
        cost, v = problem.solved(held_of(problem.active))
        assert result.f == pytest.approx(cost, rel=1e-5)
        np.testing.assert_allclose(result.point.x, np.append(v, 0.0), atol=1e-4)
        # Multipliers are in the unit of the cost, and still tell which pairs should change sides.
        reference = near.bound_multipliers(near.solve(Point(v), problem.active), problem.active)
        changes = branches.bound_multipliers(result, problem.active) > branches.min_multiplier
        np.testing.assert_array_equal(changes, reference > 1e-3)


def test_a_search_of_limited_patience_ends_that_soon_after_its_last_worthwhile_gain() -> None:
    for seed in range(6):
        problem = QuadraticProgram(seed)
        branches = problem.branches()
        start, trace = branches.solve(Point(problem.v), problem.active), branches.follower.trace
        before, limit = trace.iterations, 0.5 * trace.iterations
        best = improve_schedule(branches, start, patience=0.5)
        records = [record for record in trace.records if record.label == NEIGHBOUR]
        spent, cost = 0, start.f
        for record in records:
            assert spent <= limit
            gains = record.accepted and record.cost < cost - WORTHWHILE_GAIN * abs(record.cost)
            spent, cost = (0, record.cost) if gains else (spent + record.iterations, cost)
        assert best.f <= start.f and trace.iterations - before == sum(record.iterations for record in records)


def test_a_search_in_vain_ends_after_few_unlikely_neighbours_and_one_that_gains_finds_the_best_flip() -> None:
    gained = vain = 0
    for seed in range(12):
        problem = QuadraticProgram(seed)
        branches = problem.branches()
        start, trace = branches.solve(Point(problem.v), problem.active), branches.follower.trace
        best = improve_schedule(branches, start, patience=10.0)
        tried = [record for record in trace.records if record.label == NEIGHBOUR]
        if best is start:
            vain += 1
            model = BranchModel(branches, start, problem.active, np.arange(PAIRS))
            likely = sum(model.change(flip) < -1e-7 * abs(start.f) for flip in np.eye(PAIRS, dtype=bool))
            assert len(tried) <= likely + MAX_UNLIKELY < MAX_FAILURES
        else:
            gained += 1
            assert best.f < start.f
        ended = branches.program.active_sets(best.point.x)[-1]
        for flip in np.eye(PAIRS, dtype=bool):
            neighbour = branches.solve(best.point, ended ^ flip)
            assert not neighbour.ok or neighbour.f > best.f - 1e-6 * abs(best.f)
    assert gained > 2 and vain > 0


def test_exchanges_end_where_no_choice_of_the_pairs_at_zero_costs_less(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every pair's held member has the positive target, so that the first branch ends with all pairs at (0, 0)."""
    for seed in range(6):
        rng = np.random.default_rng(seed)
        active, v = rng.random(PAIRS) < 0.5, ca.SX.sym("v", 2 * PAIRS)
        targets = rng.uniform(-1.0, -0.2, 2 * PAIRS)
        targets[held_of(active)] *= -1.0
        root = rng.normal(size=(2 * PAIRS, 2 * PAIRS))
        Q = np.eye(2 * PAIRS) + 0.02 * root @ root.T
        cost = ca.bilin(ca.DM(Q), v - targets, v - targets) / 2
        mpcc = MPCC(v, cost, v[:PAIRS], v[PAIRS:], g=ca.sum1(v), lbg=-np.inf, ubg=100.0)
        programs = programs_of(mpcc, np.zeros(0), np.zeros(2 * PAIRS))
        branches = Branches(Homotopy(programs, Solver("ipopt"), {PENALTY: 0.0, RELAXATION: 0.0}))
        start = branches.solve(Point(np.zeros(2 * PAIRS)), active, mu_init=1e-2)
        assert np.abs(start.point.x).max() < 1e-3
        # A program too large to solve is no proof: the start remains, and its certificate says that it is not optimal.
        for limit in ("_EFFORT", "_EXCHANGE_EFFORT"):
            monkeypatch.setattr(f"ocp.routes.branches.{limit}", 0)
        assert branches.improve(start) is start
        p, bounds = np.zeros(branches.program.n_parameters), branches.limits
        assert certify(branches.program, start.point.x, p, bounds).stationarity == "not"
        monkeypatch.undo()
        best = branches.improve(start)
        assert best.f < 0.9 * start.f
        ended = best.point.x[: 2 * PAIRS].reshape(2, PAIRS)
        biactive = np.flatnonzero(ended.max(axis=0) < 1e-3)
        for sides in itertools.product([False, True], repeat=len(biactive)):
            other = ended[0] > ended[1]
            other[biactive] = sides
            assert branches.solve(best.point, other).f > best.f - 1e-6 * abs(best.f)
        assert certify(branches.program, best.point.x, p, bounds).stationarity == "B"
