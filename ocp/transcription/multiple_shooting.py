"""Multiple shooting: states and inputs are variables, contact is solved inside each step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from ocp.programs.program import Layout
from ocp.transcription.common import Graph
from ocp.transcription.direct import solved_interval, trajectory_variables, whole
from ocp.transcription.hidden import Compile
from ocp.transcription.nlp import NLP
from ocp.transcription.stage import Stage


@dataclass(frozen=True)
class MultipleShooting:
    """``x_{k+1} = step(x_k, u_k)`` as constraints, the step solved by the path solver.

    Derivatives of the step, first and second, come from the implicit function theorem at its
    solution.
    """

    name: ClassVar[str] = "multiple-shooting"
    summary: ClassVar[str] = "states and inputs are variables, contact is solved inside each step"

    def transcribe(
        self, graph: Graph, reformulation: str = "product", compiled: Compile | None = None
    ) -> NLP:
        """Build the NLP; ``reformulation`` is ignored, since the step closes the contact itself."""
        variables, constraints = trajectory_variables(graph, pairs=False), Layout()
        interval = solved_interval(graph, variables, constraints, compiled)
        contacts = _contacts(graph, interval, variables.size, graph.data().size)
        return whole(self.name, graph, variables, constraints, interval, compiled,
                     contacts=contacts)  # fmt: skip


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
