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
    gain_penalty,
    interval_locals,
    periodicity,
    policy_constraint,
    terminal_stage,
)
from ocp.transcription.nlp import NLP
from ocp.transcription.stage import Compile, Stage, assemble


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
        variables, constraints = Layout(), Layout()
        S, N = graph.scenarios, problem.N
        graph.add_start(variables)
        variables.add("x", (S, N, graph.nx), graph.component_names("x"))
        rows = S if graph.feedback else 1
        variables.add("u", (rows, N, graph.nu), graph.component_names("u"))
        graph.add_gains(variables)
        symbols, positions = interval_locals(graph, variables)
        parts = [
            ("dynamics", problem.system.x_next - step.following, graph.component_names("x")),
            ("policy", policy_constraint(graph), graph.component_names("u")),
            ("path", graph.path_constraints(), constraint_names(problem.path)),
        ]
        expression, where = add_rows(constraints, parts, S, N)
        w = ca.vertcat(*symbols)
        solve = contact_solve(graph, w, step)
        stage = Stage(
            "interval", w, graph.p, graph.stage_cost(), expression,
            np.concatenate([p.reshape(S * N, -1) for p in positions], axis=1), where, 1 / S,
            step.inner, step.differentiable_relation, step.relation_jacobian,
            compiled(solve) if compiled else solve, step.held,
        )  # fmt: skip
        stages = [stage, terminal_stage(graph, variables, constraints)]
        stages += periodicity(graph, variables, constraints)
        stages += gain_penalty(graph, variables)
        data = graph.data()
        made = assemble(stages, variables.size, data.size, constraints.size, len(graph.names),
                        compiled)  # fmt: skip
        return NLP(
            problem, step, policy, self.name, variables, constraints, graph.names, data,
            made.f_g, made.gradient, made.jacobian, made.hessian,
            contacts=_contacts(graph, stage, variables.size, data.size),
        )  # fmt: skip


def _contacts(graph: Graph, stage: Stage, n: int, n_data: int) -> ca.Function:
    """Map ``(x, p)`` of the NLP to lam and gap of all steps, each (n, S N)."""
    step, n_p = graph.step, graph.p.numel()
    picked = ca.Function(
        "pick", [stage.w, graph.p], [graph.problem.system.x, graph.problem.system.u, step.p.vector]
    )
    x, full = ca.MX.sym("x", n), ca.MX.sym("p", n_p + n_data)
    source = ca.vertcat(x, full[n_p:])
    w = ca.reshape(source[stage.index.ravel().tolist()], -1, stage.copies)
    arguments = picked.map(stage.copies)(w, ca.repmat(full[:n_p], 1, stage.copies))
    _, lam, gap, _ = step.solve.map(stage.copies)(*arguments)
    return ca.Function("contacts", [x, full], [lam, gap])


def contact_solve(graph: Graph, w: ca.SX, step: Step) -> ca.Function:
    """Map a stage's locals and all parameters to the step's solved inner unknowns."""
    picked = ca.Function(
        "pick", [w, graph.p], [graph.problem.system.x, graph.problem.system.u, step.p.vector]
    )
    local, p = ca.MX.sym("w", w.numel()), ca.MX.sym("p", graph.p.numel())
    solved = step.solve_inner(*picked(local, p))
    return ca.Function("contact_solve", [local, p], [solved], ["w", "p"], ["inner"])
