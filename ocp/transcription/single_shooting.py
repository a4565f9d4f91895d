"""Single shooting: only inputs (or gains) are variables, and states are computed by a rollout.

The stage is that of multiple shooting, differentiated once, with states eliminated (condensed): with
``M_k = d xi_k / d theta`` the sensitivities of the rollout and ``H_k`` the stage's Hessian of the
Lagrangian, including adjoints, the exact Hessian is ``sum_k Y_k' H_k Y_k``, ``Y_k = [M_k; E_k]``,
where E_k selects the inputs or gains of step k from theta.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import casadi as ca
import numpy as np

from ocp.errors import InputError
from ocp.problem.policy import Feedback
from ocp.programs.layout import Layout
from ocp.programs.program import Functions
from ocp.transcription.common import Graph, constraint_names
from ocp.transcription.direct import add_rows, terminal_stage
from ocp.transcription.eliminated import Compile
from ocp.transcription.nlp import NLP
from ocp.transcription.stage import Stage


@dataclass(frozen=True)
class SingleShooting:
    """Single shooting over ``theta``, inputs or gains: ``xi_{k+1} = (step(x_k, u_k), u_k)`` from x_0."""

    name: ClassVar[str] = "single-shooting"
    summary: ClassVar[str] = "only inputs or gains are variables, states follow"

    def transcribe(self, graph: Graph, reformulation: str = "product", compiled: Compile | None = None) -> NLP:
        """Build the NLP; ``reformulation`` is ignored, since each step solves its contact.

        Raises :class:`~ocp.errors.InputError` if the initial state is optimised.
        """
        problem = graph.problem
        if problem.start is not None:
            raise InputError(
                f"single-shooting: {problem.name} chooses its start, and a rollout needs one; use"
                " method direct or multiple-shooting"
            )
        variables, constraints = Layout(), Layout()
        if graph.feedback:
            graph.add_gains(variables)
        else:
            variables.add("u", (1, problem.N, graph.nu), graph.component_names("u"))
        condensed = _Condensed(graph, variables, constraints, compiled)
        functions, trajectories = condensed.functions()
        inputs = [ca.MX.sym(name, *trajectories.size_in(name)) for name in ("theta", "p")]
        _, _, lam, gap = trajectories(*inputs)
        contacts = ca.Function("contacts", inputs, [lam, gap])
        return NLP.of(graph, self.name, variables, constraints, functions, trajectories=trajectories, contacts=contacts)


class _First(NamedTuple):
    """First derivatives of the NLP (gradient, Jacobian) and of each stage (the module's Y, Jacobian, gradient)."""

    gradient: ca.MX
    jacobian: ca.MX
    Y: list[ca.MX]
    J: list[ca.MX]
    J_end: list[ca.MX]
    gradients: ca.MX
    gradients_end: ca.MX


class _Condensed:
    """Builder of the condensed functions of one problem."""

    def __init__(self, graph: Graph, variables: Layout, constraints: Layout, compiled: Compile | None) -> None:
        self.graph, self.variables, self.constraints = graph, variables, constraints
        self.make = compiled or (lambda function: function)
        problem = graph.problem
        self.S, self.N = graph.scenarios, problem.N
        self.theta_index = graph.gain_index(variables) if graph.feedback else variables["u"].index.reshape(self.N, -1)
        self._stage_expressions()
        index = np.zeros((self.S, self.xi.numel()), dtype=int)
        self.terminal = terminal_stage(graph, constraints, self.xi, index)
        self.end_rows = self.terminal.rows
        # Order that moves all rows, computed for stages and then for ends, to their places in g.
        self.places = np.argsort(np.concatenate([self.rows.ravel(), self.end_rows.ravel()])).tolist()

    def _stage_expressions(self) -> None:
        graph, problem, step = self.graph, self.graph.problem, self.graph.step
        system = problem.system
        bounded_u = graph.feedback and _is_finite(problem.u_lower, problem.u_upper)
        bounded_x = _is_finite(problem.x_lower, problem.x_upper)
        theta = ca.vertcat(*graph.gain_symbols()) if graph.feedback else system.u
        self.xi = ca.vertcat(system.x, *([graph.u_before] if problem.uses_du else []))
        u = graph.K @ system.x + graph.k if graph.feedback else system.u

        def closed(expression: ca.SX) -> ca.SX:
            return ca.substitute(expression, system.u, u) if graph.feedback else expression

        x_next = closed(step.x_next_expr)
        xi_next = ca.vertcat(x_next, *([u] if problem.uses_du else []))
        path_rows = ca.substitute(graph.path_constraints(), system.x_next, step.x_next_expr)
        extra = [
            ("u_bound", u if bounded_u else ca.SX(0, 1), graph.component_names("u")),
            ("x_bound", x_next if bounded_x else ca.SX(0, 1), graph.component_names("x")),
            ("path", closed(path_rows), constraint_names(problem.path)),
        ]
        expression, self.rows = add_rows(self.constraints, extra, self.S, self.N)
        outputs = ca.vertcat(xi_next, expression)
        w = ca.vertcat(self.xi, theta)
        eliminated = graph.eliminated(w, u if graph.feedback else None, self.make)
        self.stage = Stage(
            "shooting",
            w,
            graph.p,
            closed(graph.stage_cost()),
            outputs,
            np.zeros((self.N * self.S, w.numel()), dtype=int),
            self.rows,
            1 / self.S,
            eliminated,
        )
        self.solve = eliminated.solve
        gap = closed(step.gap_expr)
        self.gap = ca.Function("gap", [w, graph.p, eliminated.symbols], [gap, u])

    def _rollout(self, theta: ca.MX, p: ca.MX, data: ca.MX) -> tuple[ca.MX, ca.MX, ca.MX]:
        """Return states xi (nxi, S (N+1)), local variables w (nw, S N) and solved unknowns of all scenarios."""
        stage, graph = self.stage, self.graph
        w, q = ca.MX.sym("w", stage.w.numel()), ca.MX.sym("p", graph.p.numel())
        values = self.make(stage.values())
        lam = self.solve(w, q)
        x_next = values(w, q, lam)[1][: self.xi.numel()]
        xi, local = ca.MX.sym("xi", self.xi.numel()), ca.MX.sym("t", w.numel() - self.xi.numel())
        step_function = ca.Function("advance", [w, q], [x_next, lam])
        x_after, solved = step_function(ca.vertcat(xi, local), q)
        advance = ca.Function("advance", [xi, local, q], [x_after, solved])
        chain = advance.mapaccum("rollout", self.N)
        locals_ = ca.reshape(theta[self.theta_index.ravel().tolist()], -1, self.N)
        states, ws, lams = [], [], []
        for scenario in range(self.S):
            x0 = data[scenario * graph.nx : (scenario + 1) * graph.nx]
            u_before = data[self.S * graph.nx :] if graph.problem.uses_du else ca.MX(0, 1)
            start = ca.vertcat(x0, u_before)
            x_after, lam_all = chain(start, locals_, ca.repmat(p, 1, self.N))
            xi_all = ca.horzcat(start, x_after)
            states.append(xi_all)
            ws.append(ca.vertcat(xi_all[:, : self.N], locals_))
            lams.append(lam_all)
        return ca.horzcat(*states), ca.horzcat(*ws), ca.horzcat(*lams)

    def functions(self) -> tuple[Functions, ca.Function]:
        """Return the functions of the program, and ``trajectories`` of the :class:`~ocp.transcription.nlp.NLP`."""
        graph, n = self.graph, self.variables.size
        theta, full = ca.MX.sym("x", n), ca.MX.sym("p", graph.p.numel() + graph.data().size)
        p, data = full[: graph.p.numel()], full[graph.p.numel() :]
        xi, w, lam = self._rollout(theta, p, data)
        ends = [(s + 1) * (self.N + 1) - 1 for s in range(self.S)]
        f, g = self._values(theta, p, xi[:, ends], w, lam)
        first = self._first(theta, p, xi[:, ends], w, lam)
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", self.constraints.size)
        hess = self._hessian(theta, p, xi[:, ends], w, lam, lam_f, lam_g, first)
        gap, u = self.gap.map(self.N * self.S)(w, ca.repmat(p, 1, self.N * self.S), lam)
        impulses = lam[lam.shape[0] - graph.step.n :, :] if graph.step.n else lam[:0, :]
        dense = ca.Sparsity.dense(self.constraints.size, n)
        jac = ca.project(first.jacobian, dense) if self.constraints.size else ca.MX(0, n)
        trajectories = ca.Function(
            "trajectories",
            [theta, full],
            [xi[: graph.nx, :], u, impulses, gap],
            ["theta", "p"],
            ["x", "u", "lam", "gap"],
        )
        symbols = (theta, full, lam_f, lam_g)
        return Functions.of(symbols, (f, g), (f, first.gradient), (g, jac), hess), trajectories

    def _values(self, theta: ca.MX, p: ca.MX, end: ca.MX, w: ca.MX, lam: ca.MX) -> tuple[ca.MX, ca.MX]:
        stage = self.make(self.stage.values())
        cost, out = stage.map("stage_map", "serial", self.N * self.S, [1], [])(w, p, lam)
        last = self.terminal.values().map("end_map", "serial", self.S, [1], [])
        cost_end, c_end = last(end, p, ca.MX(0, self.S))
        f = ca.sum2(cost) + ca.sum2(cost_end) + self._gain_cost(theta)
        g = ca.vertcat(ca.vec(out[self.xi.numel() :, :]), ca.vec(c_end))
        return f, g[self.places] if self.places else ca.MX(0, 1)

    def _gain_cost(self, theta: ca.MX) -> ca.MX:
        policy = self.graph.policy
        if not isinstance(policy, Feedback):
            return ca.MX(0)
        weight = self.graph.problem.scales.cost * policy.penalty * self.N / self.graph.gain_steps
        return weight * ca.sumsqr(theta[self.variables["K"].index.ravel().tolist()])

    def _first(self, theta: ca.MX, p: ca.MX, end: ca.MX, w: ca.MX, lam: ca.MX) -> _First:
        nxi, n = self.xi.numel(), self.variables.size
        function, pattern = self.stage.first()
        mapped = self.make(function).map("first_map", "serial", self.N * self.S, [1], [])
        _, _, gradients, entries = mapped(w, p, lam)
        last, pattern_end = self.terminal.first()
        _, _, gradients_end, entries_end = last.map("end_first", "serial", self.S, [1], [])(end, p, ca.MX(0, self.S))
        gradient = ca.MX.zeros(1, n)
        rows, end_rows, Y_all, blocks, ends = [], [], [], [], []
        identity = ca.DM.eye(n)
        picks = [identity[index.tolist(), :] for index in self.theta_index]
        for s in range(self.S):
            M = ca.MX(nxi, n)
            for k in range(self.N):
                column = s * self.N + k
                J = ca.MX(pattern, entries[:, column])
                Y = ca.vertcat(ca.densify(M), picks[k])
                gradient += gradients[:, column].T @ Y
                propagated = J @ Y
                M = propagated[:nxi, :]
                rows.append(propagated[nxi:, :])
                Y_all.append(Y)
                blocks.append(J)
            gradient += gradients_end[:, s].T @ M
            J_end = ca.MX(pattern_end, entries_end[:, s])
            end_rows.append(J_end @ M)
            Y_all.append(M)
            ends.append(J_end)
        gradient += ca.gradient(self._gain_cost(theta), theta).T if self.graph.feedback else 0
        stacked = ca.vertcat(ca.MX(0, n), *rows, *end_rows)
        jacobian = stacked[self.places, :] if self.places else stacked
        return _First(ca.densify(gradient.T), jacobian, Y_all, blocks, ends, gradients, gradients_end)

    def _hessian(
        self, theta: ca.MX, p: ca.MX, end: ca.MX, w: ca.MX, lam: ca.MX, lam_f: ca.MX, lam_g: ca.MX, first: _First
    ) -> ca.MX:
        multipliers, multipliers_end = (
            ca.reshape(lam_g[rows.ravel().tolist()], rows.shape[1], rows.shape[0])
            for rows in (self.rows, self.end_rows)
        )
        adjoints = self._adjoints(lam_f, multipliers, multipliers_end, first)
        function, pattern = self.stage.second()
        copies = self.N * self.S
        mapped = self.make(function).map("second_map", "serial", copies, [1], [])
        scale = ca.repmat(lam_f, 1, copies)
        arguments = [w, p, lam, scale, ca.vertcat(adjoints, multipliers)]
        entries = mapped(*arguments, *self.stage.curvature_values(arguments, copies))
        last, pattern_end = self.terminal.second()
        entries_end = last.map("end_second", "serial", self.S, [1], [])(
            end, p, ca.MX(0, self.S), ca.repmat(lam_f, 1, self.S), multipliers_end
        )
        sensitivities, weighted = [], []
        for s in range(self.S):
            for k in range(self.N + 1):
                Y = first.Y[s * (self.N + 1) + k]
                H = ca.MX(pattern, entries[:, s * self.N + k]) if k < self.N else ca.MX(pattern_end, entries_end[:, s])
                sensitivities.append(ca.densify(Y))
                weighted.append(ca.densify(ca.triu2symm(H) @ Y))
        hessian = ca.vertcat(*sensitivities).T @ ca.vertcat(*weighted)
        if self.graph.feedback:
            hessian += lam_f * ca.hessian(self._gain_cost(theta), theta)[0]
        return ca.triu(hessian)

    def _adjoints(self, lam_f: ca.MX, multipliers: ca.MX, multipliers_end: ca.MX, first: _First) -> ca.MX:
        """Return the adjoints of ``lam_f f + lam_g' g`` with respect to xi_1..xi_N, (nxi, S N)."""
        nxi, columns = self.xi.numel(), []
        for s in range(self.S):
            nu = lam_f * first.gradients_end[:, s] + first.J_end[s].T @ multipliers_end[:, s]
            adjoints = [nu]
            for k in reversed(range(1, self.N)):
                column = s * self.N + k
                J = first.J[column]
                back = J.T @ ca.vertcat(nu, multipliers[:, column])
                nu = (lam_f * first.gradients[:, column] + back)[:nxi]
                adjoints.append(nu)
            columns += reversed(adjoints)
        return ca.horzcat(*columns)


def _is_finite(*bounds: ca.SX | float) -> bool:
    """Return whether any bound may be finite; infinite bounds need no constraint."""
    return any(not ca.SX(v).is_constant() or np.isfinite(np.array(ca.DM(ca.SX(v)))).any() for v in bounds)
