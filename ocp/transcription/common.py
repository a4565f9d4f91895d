"""Parts common to all transcriptions: parameters of the graph and local symbols of a stage."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from dynamics.contact import Step
from dynamics.contact.learned_step import LearnedStep
from ocp.errors import InputError
from ocp.problem.policy import Feedback, Policy
from ocp.problem.problem import Problem
from ocp.programs.layout import Layout
from ocp.programs.program import PENALTY, RELAXATION
from ocp.transcription.eliminated import Compile, EliminatedUnknowns, Implicit, ModelOutputs


@dataclass(eq=False)
class Graph:
    """A problem, the step of a contact law and a policy, before transcription by a method.

    ``names`` are the names of all scalar parameters, ``p`` their symbols in the same order: parameters of
    the problem, parameters of the law, then ``penalty`` and ``relaxation``.

    Raises :class:`~ocp.errors.InputError` if the problem's cost or constraints depend on contact
    impulses that the law does not compute.
    """

    problem: Problem
    step: Step
    policy: Policy

    def __post_init__(self) -> None:
        if self.problem.uses_impulses and isinstance(self.step, LearnedStep):
            raise InputError(
                f"{self.problem.name}: the cost or a path constraint depends on contact impulses,"
                " which a learned law does not compute; choose another law"
            )
        table = self.problem.parameters + self.step.p
        self.penalty, self.relaxation = ca.SX.sym("penalty"), ca.SX.sym("relaxation")
        self.names = [*table.names, PENALTY, RELAXATION]
        self.p = ca.vertcat(table.vector, self.penalty, self.relaxation)
        self.K = ca.SX.sym("K", self.nu, self.nx)
        self.k = ca.SX.sym("k", self.nu)
        self.u_before = ca.SX.sym("u_before", self.nu)

    @property
    def nx(self) -> int:
        """Number of states."""
        return self.problem.system.nx

    @property
    def nu(self) -> int:
        """Number of inputs."""
        return self.problem.system.nu

    @property
    def scenarios(self) -> int:
        """Number of scenarios."""
        return self.problem.scenarios.n

    @property
    def feedback(self) -> bool:
        """Whether inputs are given by feedback gains."""
        return isinstance(self.policy, Feedback)

    @property
    def gain_steps(self) -> int:
        """Number of distinct gains over the horizon: 1 for stationary gains, else N."""
        return 1 if isinstance(self.policy, Feedback) and self.policy.stationary else self.problem.N

    def stage_cost(self) -> ca.SX:
        """Return the stage cost without constant terms, with ``u - u_before`` for du, plus the law's extra cost."""
        problem, cost = self.problem, self.with_impulses(self.problem.changeable_costs[0])
        if problem.du is not None:
            cost = ca.substitute(cost, problem.du, problem.system.u - self.u_before)
        return cost + self.step.extra_stage_cost

    def with_impulses(self, expression: ca.SX) -> ca.SX:
        """Return ``expression`` with the system's multipliers replaced by the mean of the step's over branches."""
        if not self.problem.uses_impulses:
            return expression
        return ca.substitute(expression, self.problem.system.lam, self.step.impulses)

    def path_constraints(self) -> ca.SX:
        """Return the path constraint expressions, stacked."""
        path = ca.vertcat(ca.SX(0, 1), *(c.expression for c in self.problem.path))
        return self.with_impulses(path)

    def terminal_constraints(self) -> ca.SX:
        """Return the terminal constraint expressions, stacked."""
        return ca.vertcat(ca.SX(0, 1), *(c.expression for c in self.problem.terminal))

    def data(self) -> Layout:
        """Return the layout of the initial data in the parameter vector."""
        layout = Layout()
        layout.add("x0", (self.scenarios, self.nx))
        layout.add("u_before", (self.nu,))
        return layout

    def add_gains(self, variables: Layout) -> None:
        """Append gains and offsets to the variables."""
        if self.feedback:
            variables.add("K", (self.gain_steps, self.nu, self.nx))
            variables.add("k", (self.gain_steps, self.nu))

    def gain_symbols(self) -> list[ca.SX]:
        """Return the gain symbols of a stage, K row by row, then k; empty for open loop."""
        return [ca.vec(self.K.T), self.k] if self.feedback else []

    def gain_index(self, variables: Layout) -> np.ndarray:
        """Return the indices of each step's gains in the variables, (N, nu nx + nu), or (N, 0) for open loop."""
        if not self.feedback:
            return np.zeros((self.problem.N, 0), dtype=int)
        K = variables["K"].index.reshape(self.gain_steps, -1)
        indices = np.concatenate([K, variables["k"].index], axis=1)
        return np.broadcast_to(indices, (self.problem.N, indices.shape[1]))

    def pick_function(self, w: ca.SX, u: ca.SX) -> ca.Function:
        """Return a function from a stage's local variables ``w`` and all parameters to x, ``u`` and the step's p."""
        return ca.Function("pick", [w, self.p], [self.problem.system.x, u, self.step.p.vector])

    def eliminated(self, w: ca.SX, u: ca.SX | None = None, make: Compile | None = None) -> EliminatedUnknowns:
        """Return the unknowns that the step determines at a stage's local variables ``w``; ``u`` replaces the input."""
        step, input_symbol = self.step, self.problem.system.u

        def closed(*expressions: ca.SX) -> list[ca.SX]:
            return list(expressions) if u is None else ca.substitute(list(expressions), [input_symbol], [u])

        if isinstance(step, LearnedStep):
            return ModelOutputs(step, closed(step.queries)[0], w, self.p)
        relation, jacobian = closed(step.differentiable_relation, step.relation_jacobian)
        held_values = (step.held_mu[0], closed(step.held_mu[1])[0]) if step.held_mu else None
        local, p = ca.MX.sym("w", w.numel()), ca.MX.sym("p", self.p.numel())
        solved = step.solve_inner(*self.pick_function(w, input_symbol if u is None else u)(local, p))
        solve = ca.Function("contact_solve", [local, p], [solved], ["w", "p"], ["inner"])
        return Implicit(step.inner, relation, jacobian, make(solve) if make else solve, held_values)

    def component_names(self, kind: str) -> tuple[str, ...]:
        """Return the names of the states ("x"), inputs ("u") or contacts ("lam")."""
        system = self.problem.system
        signals = {"x": system.states, "u": system.inputs, "lam": self.step.contacts}[kind]
        return tuple(signal.name for signal in signals)


def constraint_names(constraints: object) -> tuple[str, ...]:
    """Return a name for each entry of a problem's path or terminal constraints."""
    names = []
    for constraint in constraints:  # pyright: ignore[reportGeneralTypeIssues]
        size = constraint.expression.numel()
        names += [constraint.name] if size == 1 else [f"{constraint.name}[{i}]" for i in range(size)]
    return tuple(names)
