"""Do step lengths that differ between phases of constant contact make plans survive finer steps?

``python -m tests.benchmarks.ocp.phase_lengths`` solves plans of named problems again, with their contacts fixed and one
step length for each phase as a variable, replays them at a quarter of each length, and rewrites the site's table.
"""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from docs.generator.measured import write_table
from ocp import solve
from ocp.judge.step_size import step_size_kind
from ocp.mpc.stages import StageModel
from ocp.solve.best_gains import plan_of

PROBLEMS = ("ball-bounce", "cart-walls", "hopper")
SHORTEST, LONGEST, FINER = 0.25, 2.0, 4
"""Bounds of step lengths, over the problem's own, and the number of steps that replace one in a replay."""


class Lengths(NamedTuple):
    """Step lengths of phases [s], inputs (N, nu), the plan's cost, and seconds of processor time."""

    lengths: np.ndarray
    u: np.ndarray
    cost: float
    seconds: float


class Phases:
    """A plan whose contacts are fixed, and the phases in which they are constant."""

    def __init__(self, name: str) -> None:
        solution = solve(name, "exact", effort="quick")
        self.problem = problem = solution.problem
        self.step, self.N = problem.exact_step, problem.N
        evaluation, plan = plan_of(solution, self.step)
        self.plan, self.limits = plan, evaluation.limits
        impulse, gap = StageModel(problem, self.step).sizes
        self.closed = plan.lam[0] / impulse > plan.gap[0] / gap
        self.phase = np.cumsum([False, *(self.closed[1:] != self.closed[:-1]).any(axis=1)])
        name_of_h, names = step_size_kind(problem.system).parameter, problem.parameters.names
        self.h = float(evaluation.values[name_of_h])
        self.of_cost = np.array([evaluation.values[name] for name in names]), names.index(name_of_h)
        names = self.step.p.names
        self.of_step = np.array([evaluation.values[name] for name in names]), names.index(name_of_h)

    def solved(self) -> Lengths:
        """Return the optimum over states, inputs, impulses and the lengths of phases, of the same total time."""
        system, step, plan = self.problem.system, self.step, self.plan
        arguments = [system.x, system.u, system.x_next, step.lam, step.p.vector]
        rows = ca.Function("rows", arguments, [step.residual, step.gap])
        _, u_before, u_low, u_high, x_low, x_high = self.limits
        count = int(self.phase[-1]) + 1
        lengths = ca.MX.sym("lengths", count)
        variables, guess = [lengths], [np.full(count, self.h)]
        bounds = [(np.full(count, SHORTEST * self.h), np.full(count, LONGEST * self.h))]
        constraints: list[Any] = [ca.dot(ca.DM(np.bincount(self.phase)), lengths)]
        limits, cost = [(np.array([self.N * self.h]),) * 2], ca.MX(0)
        x, before = ca.MX(plan.x[0, 0]), ca.MX(u_before)
        for k, closed in enumerate(self.closed):
            u, x_next, lam = (ca.MX.sym("v", n) for n in (system.nu, system.nx, step.n))
            zeros, h = np.zeros(step.n), lengths[int(self.phase[k])]
            variables += [u, x_next, lam]
            guess += [plan.u[0, k], plan.x[0, k + 1], plan.lam[0, k]]
            bounds += [(u_low, u_high), (x_low, x_high), (zeros, np.where(closed, np.inf, 0.0))]
            constraints += rows(x, u, x_next, lam, _with(self.of_step, h))
            limits += [(np.zeros(system.nx),) * 2, (zeros, np.where(closed, 0.0, np.inf))]
            p = _with(self.of_cost, h)
            cost += self.problem.cost_terms(x, u, u - before, lam, p)[0]
            x, before = x_next, u
            if k == self.N - 1:
                cost += self.problem.cost_terms(x, u, ca.MX.zeros(system.nu), lam, p)[1]
        nlp = {"x": ca.vertcat(*variables), "f": cost, "g": ca.vertcat(*constraints)}
        solver = ca.nlpsol("phases", "ipopt", nlp, {"ipopt.print_level": 0, "print_time": 0, "ipopt.sb": "yes"})
        (lbx, ubx), (lbg, ubg) = ([np.concatenate(v) for v in zip(*pairs, strict=True)] for pairs in (bounds, limits))
        began = time.process_time()
        result = solver(x0=np.concatenate(guess), lbx=lbx, ubx=ubx, lbg=lbg, ubg=ubg)
        seconds = time.process_time() - began
        if not solver.stats()["success"]:
            raise RuntimeError(f"{self.problem.name}: {solver.stats()['return_status']}")
        point = np.array(result["x"]).ravel()
        inputs = point[count:].reshape(self.N, -1)[:, : system.nu]
        return Lengths(point[:count], inputs, float(result["f"]), seconds)

    def replayed_cost(self, lengths: np.ndarray, u: np.ndarray) -> float:
        """Return the cost of inputs (N, nu), each held over :data:`FINER` steps of a quarter of its length."""
        x, before, cost = self.plan.x[0, 0], self.limits[1], 0.0
        impulse, p = np.zeros(self.step.n), self.of_cost[0]
        for k, phase in enumerate(self.phase):
            start, impulse, h = x, np.zeros(self.step.n), float(lengths[phase])
            for _ in range(FINER):
                x, lam = (np.array(v).ravel() for v in self.step.solve(x, u[k], _number(self.of_step, h / FINER))[:2])
                impulse += lam
            p = _number(self.of_cost, h)
            cost += float(self.problem.cost_terms(start, u[k], u[k] - before, impulse, p)[0])
            before = u[k]
        return cost + float(self.problem.cost_terms(x, u[-1], np.zeros_like(before), impulse, p)[1])


def _with(values: tuple[np.ndarray, int], h: ca.MX) -> ca.MX:
    p = ca.MX(values[0])
    p[values[1]] = h
    return p


def _number(values: tuple[np.ndarray, int], h: float) -> np.ndarray:
    p = values[0].copy()
    p[values[1]] = h
    return p


def row(name: str) -> list[str]:
    """Return the table's row of a problem."""
    phases = Phases(name)
    solved = phases.solved()
    even = np.full(len(solved.lengths), phases.h)
    shares = solved.lengths / phases.h
    cells = [name, str(len(shares)), f"{phases.plan.cost:.4g}", f"{phases.replayed_cost(even, phases.plan.u[0]):.4g}"]
    cells += [f"{solved.cost:.4g}", f"{phases.replayed_cost(solved.lengths, solved.u):.4g}"]
    cells += [f"{shares.min():.2g} to {shares.max():.2g}", f"{solved.seconds:.2g}"]
    print(*cells, flush=True)
    return cells


def main() -> None:
    """Measure all problems and write the table."""
    write_table(
        "phase-lengths",
        title="Step lengths of phases",
        command="python -m tests.benchmarks.ocp.phase_lengths",
        columns=["problem", "phases", "plan", "at h/4", "with lengths", "at a quarter", "lengths / h", "s"],
        rows=[row(name) for name in PROBLEMS],
        note=f"One step length for each phase of constant contact, within {SHORTEST:g} to {LONGEST:g} h, of the same"
        " total time, contacts as in the plan. *At h/4*, *at a quarter*: cost of the inputs at a quarter of each step.",
    )


if __name__ == "__main__":
    main()
