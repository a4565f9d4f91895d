"""Multiple shooting: states and inputs are variables, contact is solved inside each step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca
import numpy as np

from dynamics.contact import Step
from ocp.policy import Policy
from ocp.problem import Problem
from ocp.programs.layout import Layout
from ocp.transcription.common import Graph, constraint_names
from ocp.transcription.direct import (
    add_rows,
    interval_locals,
    policy_constraint,
    trajectory_variables,
    whole,
)
from ocp.transcription.nlp import NLP
from ocp.transcription.stage import Compile, Stage


@dataclass(frozen=True)
class MultipleShooting:
    """``x_{k+1} = step(x_k, u_k)`` as constraints, the step solved by the path solver.

    Derivatives of the step, first and second, come from the implicit function theorem at its
    solution.
    """

    name: ClassVar[str] = "multiple-shooting"
    summary: ClassVar[str] = "states and inputs are variables, contact is solved inside each step"

    def transcribe(
        self,
        problem: Problem,
        step: Step,
        policy: Policy,
        form: str = "product",
        compiled: Compile | None = None,
    ) -> NLP:
        """Build the NLP; ``form`` is of no concern here, the step closes the contact itself."""
        graph = Graph(problem, step, policy)
        variables, constraints = trajectory_variables(graph, pairs=False), Layout()
        S, N = graph.scenarios, problem.N
        symbols, positions = interval_locals(graph, variables)
        parts = [
            ("dynamics", problem.system.x_next - step.following, graph.component_names("x")),
            ("policy", policy_constraint(graph), graph.component_names("u")),
            ("path", graph.path_constraints(), constraint_names(problem.path)),
        ]
        expression, where = add_rows(constraints, parts, S, N)
        w = ca.vertcat(*symbols)
        solve = graph.contact_solve(w, problem.system.u)
        stage = Stage(
            "interval", w, graph.p, graph.stage_cost(), expression,
            np.concatenate([p.reshape(S * N, -1) for p in positions], axis=1), where, 1 / S,
            step.inner, step.differentiable_relation, step.relation_jacobian,
            compiled(solve) if compiled else solve, step.held,
        )  # fmt: skip
        contacts = _contacts(graph, stage, variables.size, graph.data().size)
        return whole(self.name, graph, variables, constraints, stage, compiled, contacts=contacts)


def _contacts(graph: Graph, stage: Stage, n: int, n_data: int) -> ca.Function:
    """Map ``(x, p)`` of the NLP to lam and gap of all steps, each (n, S N)."""
    step, n_p = graph.step, graph.p.numel()
    picked = graph.picked(stage.w, graph.problem.system.u)
    x, full = ca.MX.sym("x", n), ca.MX.sym("p", n_p + n_data)
    source = ca.vertcat(x, full[n_p:])
    w = ca.reshape(source[stage.index.ravel().tolist()], -1, stage.copies)
    arguments = picked.map(stage.copies)(w, ca.repmat(full[:n_p], 1, stage.copies))
    _, lam, gap, _ = step.solve.map(stage.copies)(*arguments)
    return ca.Function("contacts", [x, full], [lam, gap])
