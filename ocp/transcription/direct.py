"""Direct transcription: states, inputs, multipliers and gaps are all variables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import casadi as ca
import numpy as np

from dynamics.contact.learned_step import LearnedStep
from ocp.errors import InputError
from ocp.problem.policy import Feedback
from ocp.programs.layout import Layout
from ocp.programs.program import closure_rows
from ocp.transcription.common import Graph, constraint_names
from ocp.transcription.eliminated import Compile
from ocp.transcription.nlp import NLP
from ocp.transcription.stage import ROUNDABLE, Stage, assemble

if TYPE_CHECKING:
    from ocp.transcription.pieces import PiecewiseNLP


@dataclass(frozen=True)
class Direct:
    """Direct transcription: each step's residual, gap and complementarity are constraints.

    Per step and scenario: ``residual(x, u, x_next, lam) = 0``, ``gap(x, u, x_next, lam) = s``, and the
    complementarity of ``lam`` and ``s`` by ``reformulation`` (:class:`~ocp.programs.program.Program`).
    A learned step has neither ``lam`` nor ``s``: ``x_next = g(x, u)``. The reformulation "pieces" is "none" with the
    sides of kinks as data (:mod:`ocp.transcription.pieces`).
    """

    name: ClassVar[str] = "direct"
    summary: ClassVar[str] = "states, inputs, multipliers and gaps are variables"

    def transcribe(self, graph: Graph, reformulation: str = "product", compiled: Compile | None = None) -> NLP:
        """Build the NLP; raise ``InputError`` for a law whose gradient is frozen."""
        step = graph.step
        if step.law.frozen:
            raise InputError(
                "direct: a frozen gradient needs the step map; use method single-shooting or"
                " multiple-shooting, or gradient=total"
            )
        if isinstance(step, LearnedStep):
            variables, constraints = trajectory_variables(graph, pairs=False), Layout()
            interval = solved_interval(graph, variables, constraints, compiled)
            return build_nlp(self.name, graph, variables, constraints, interval, compiled)
        variables, constraints = trajectory_variables(graph, pairs=True), Layout()
        interval = _interval(graph, variables, constraints, reformulation)
        pairs = np.stack([variables["lam"].index.ravel(), variables["gap"].index.ravel()])
        if reformulation == "pieces":
            return build_pieces(self.name, graph, variables, constraints, interval, compiled, pairs)
        return build_nlp(
            self.name, graph, variables, constraints, interval, compiled, reformulation=reformulation, pairs=pairs
        )


def build_nlp(
    method: str,
    graph: Graph,
    variables: Layout,
    constraints: Layout,
    interval: Stage,
    compiled: Compile | None,
    **nlp_fields: Any,
) -> NLP:
    """Build the NLP from its intervals, terminal stage, periodicity and gain penalty."""
    stages = _all_stages(graph, variables, constraints, interval)
    if graph.step.exact and nlp_fields.get("reformulation", "none") != "none":
        stages = _rounded(graph, variables, constraints, stages)
    functions = assemble(stages, variables.size, graph.data().size, constraints.size, len(graph.names), compiled)
    return NLP.of(graph, method, variables, constraints, functions, stages=stages, **nlp_fields)


def build_pieces(
    method: str,
    graph: Graph,
    variables: Layout,
    constraints: Layout,
    interval: Stage,
    compiled: Compile | None,
    pairs: np.ndarray,
) -> PiecewiseNLP:
    """Build the NLP whose kinks have sides that may be fixed; its contacts are on a branch."""
    from ocp.transcription.pieces import PiecewiseNLP, fix_sides

    data = graph.data().size
    stages = _all_stages(graph, variables, constraints, interval)
    fixed, n_sides = fix_sides(stages, constraints, variables.size + data)
    functions = assemble(fixed, variables.size, data + n_sides, constraints.size, len(graph.names), compiled)
    fields = {"reformulation": "none", "pairs": pairs, "stages": stages}
    return PiecewiseNLP.of(graph, method, variables, constraints, functions, **fields)


def _rounded(graph: Graph, variables: Layout, constraints: Layout, stages: list[Stage]) -> list[Stage]:
    """Return the stages of a relaxation with kinks of costs and constraints rounded; branches have the kinks."""
    if not any(stage.operations & ROUNDABLE for stage in stages):
        return stages
    # Imported here, since most problems have no kinks.
    from ocp.transcription.kinks import round_kinks

    blocks = [constraints[name].index.ravel() for name in ("path", "terminal") if name in constraints]
    rows = np.concatenate([np.zeros(0, dtype=int), *blocks])
    scales, table = graph.problem.scales, graph.problem.parameters + graph.step.p
    scale_of = {"x0": scales.x, "x": scales.x, "u": scales.u, "k": scales.u, "lam": scales.impulse, "gap": scales.gap}
    sizes = variables.pack({name: size for name, size in scale_of.items() if name in variables})
    p = np.array([table.defaults.get(name, 0.0) for name in graph.names])
    source = np.concatenate([sizes, np.zeros(graph.data().size)])
    return [
        round_kinks(stage, np.flatnonzero(np.isin(stage.rows[0], rows)), source[stage.index].max(axis=0), p)
        for stage in stages
    ]


def _all_stages(graph: Graph, variables: Layout, constraints: Layout, interval: Stage) -> list[Stage]:
    last_states = state_index(graph, variables)[:, -1]
    last_stage = terminal_stage(graph, constraints, graph.problem.system.x, last_states)
    periodic_stages = periodicity(graph, variables, constraints)
    return [interval, last_stage, *periodic_stages, *gain_penalty(graph, variables)]


def trajectory_variables(graph: Graph, pairs: bool) -> Layout:
    """Return the layout of variables: states, inputs, gains of a feedback policy and, with ``pairs``, lam and gap."""
    layout, (S, N, n) = Layout(), (graph.scenarios, graph.problem.N, graph.step.n)
    if graph.problem.start is not None:
        layout.add("x0", (1, 1, graph.nx), graph.component_names("x"))
    layout.add("x", (S, N, graph.nx), graph.component_names("x"))
    layout.add("u", (S if graph.feedback else 1, N, graph.nu), graph.component_names("u"))
    for name in ("lam", "gap") if pairs else ():
        layout.add(name, (S, N, n), graph.component_names("lam"))
    graph.add_gains(layout)
    return layout


def state_index(graph: Graph, variables: Layout) -> np.ndarray:
    """Return the indices of x_0..x_N in [x; data], (S, N+1, nx); x_0 is data, or a variable if it is optimised."""
    start = variables.size + np.arange(graph.scenarios * graph.nx)
    if graph.problem.start is not None:
        start = variables["x0"].index
    first = start.reshape(graph.scenarios, 1, graph.nx)
    return np.concatenate([first, variables["x"].index], axis=1)


def interval_locals(graph: Graph, variables: Layout) -> tuple[list[ca.SX], list[np.ndarray]]:
    """Return local symbols (x, [u_before], u, x_next, gains) of an interval, and their indices (S, N, .)."""
    system = graph.problem.system
    x, S, N, nu = state_index(graph, variables), graph.scenarios, graph.problem.N, graph.nu
    u = np.broadcast_to(variables["u"].index, (S, N, nu))
    symbols, positions = [system.x], [x[:, :-1]]
    if graph.problem.uses_du:
        # u_{-1} is data, after the initial states.
        first = variables.size + S * graph.nx + np.arange(nu)
        symbols.append(graph.u_before)
        positions.append(np.concatenate([np.broadcast_to(first, (S, 1, nu)), u[:, :-1]], axis=1))
    symbols += [system.u, system.x_next]
    positions += [u, x[:, 1:]]
    gains = graph.gain_index(variables)
    symbols += graph.gain_symbols()
    positions.append(np.broadcast_to(gains, (S, N, gains.shape[1])))
    return symbols, positions


def policy_constraint(graph: Graph) -> ca.SX:
    """Return ``u - K x - k`` (nu, 1), empty for open loop."""
    system = graph.problem.system
    return system.u - graph.K @ system.x - graph.k if graph.feedback else ca.SX(0, 1)


def add_rows(
    constraints: Layout, blocks: list[tuple[str, ca.SX, tuple[str, ...]]], S: int, N: int
) -> tuple[ca.SX, np.ndarray]:
    """Add constraint blocks (S, N, size); return their stacked expressions and row indices (S N, total)."""
    rows = [
        constraints.add(name, (S, N, expression.numel()), components).index.reshape(S * N, -1)
        for name, expression, components in blocks
        if expression.numel()
    ]
    stacked = ca.vertcat(ca.SX(0, 1), *(expression for _, expression, _ in blocks))
    return stacked, np.concatenate([np.zeros((S * N, 0), dtype=int), *rows], axis=1)


def _interval(graph: Graph, variables: Layout, constraints: Layout, reformulation: str) -> Stage:
    step, S, N = graph.step, graph.scenarios, graph.problem.N
    gap = ca.SX.sym("gap", step.n)
    symbols, positions = interval_locals(graph, variables)
    symbols += [step.lam, gap]
    positions += [variables["lam"].index, variables["gap"].index]
    names = graph.component_names
    closed = closure_rows(reformulation, step.lam, gap, step.mu, graph.relaxation)
    blocks = [
        ("dynamics", step.residual, names("x")),
        ("gap_definition", step.gap - gap, names("lam")),
        *((name, row, names("lam")) for name, row in closed),
        ("policy", policy_constraint(graph), names("u")),
        ("path", graph.path_constraints(), constraint_names(graph.problem.path)),
    ]
    expression, rows = add_rows(constraints, blocks, S, N)
    cost = graph.stage_cost()
    if reformulation in ("none", "pieces"):
        cost += graph.penalty * ca.dot(step.lam, gap)
    index = np.concatenate([p.reshape(S * N, -1) for p in positions], axis=1)
    w = ca.vertcat(*symbols)
    return Stage("interval", w, graph.p, cost, expression, index, rows, 1 / S)


def solved_interval(graph: Graph, variables: Layout, constraints: Layout, compiled: Compile | None) -> Stage:
    """Return the interval stage ``x_next = step(x, u)`` with the step solved internally, without lam and gap."""
    problem, S, N = graph.problem, graph.scenarios, graph.problem.N
    symbols, positions = interval_locals(graph, variables)
    blocks = [
        ("dynamics", problem.system.x_next - graph.step.x_next_expr, graph.component_names("x")),
        ("policy", policy_constraint(graph), graph.component_names("u")),
        ("path", graph.path_constraints(), constraint_names(problem.path)),
    ]
    expression, rows = add_rows(constraints, blocks, S, N)
    index = np.concatenate([p.reshape(S * N, -1) for p in positions], axis=1)
    w = ca.vertcat(*symbols)
    eliminated = graph.eliminated(w, make=compiled)
    return Stage("interval", w, graph.p, graph.stage_cost(), expression, index, rows, 1 / S, eliminated)


def terminal_stage(graph: Graph, constraints: Layout, w: ca.SX, index: np.ndarray) -> Stage:
    """Return the stage of terminal cost and constraints on x_N of all scenarios; ``index`` (S, nw) locates ``w``."""
    problem, S = graph.problem, graph.scenarios
    blocks = [("terminal", graph.terminal_constraints(), constraint_names(problem.terminal))]
    expression, rows = add_rows(constraints, blocks, S, 1)
    return Stage("terminal", w, graph.p, problem.changeable_costs[1], expression, index, rows, 1 / S)


def periodicity(graph: Graph, variables: Layout, constraints: Layout) -> list[Stage]:
    """Return the stage of constraints ``x_N[i] - x_0[i] = 0`` on periodic states; empty if there are none."""
    start = graph.problem.start
    if start is None or not start.periodic:
        return []
    states, periodic = state_index(graph, variables), list(start.periodic)
    first, last = ca.SX.sym("first", len(periodic)), ca.SX.sym("last", len(periodic))
    names = tuple(graph.component_names("x")[i] for i in periodic)
    expression, rows = add_rows(constraints, [("periodic", last - first, names)], 1, 1)
    index = np.concatenate([states[:, 0, periodic], states[:, -1, periodic]], axis=1)
    w = ca.vertcat(first, last)
    return [Stage("periodicity", w, graph.p, ca.SX(0), expression, index, rows)]


def gain_penalty(graph: Graph, variables: Layout) -> list[Stage]:
    """Return the stage of the cost ``penalty |K_t|²``, in characteristic costs; empty for open loop or no penalty."""
    if not isinstance(graph.policy, Feedback) or graph.policy.penalty == 0:
        return []
    index = variables["K"].index.reshape(graph.gain_steps, -1)
    gains = ca.SX.sym("gains", index.shape[1])
    repeats = graph.problem.N / graph.gain_steps
    cost = graph.problem.scales.cost * graph.policy.penalty * repeats * ca.sumsqr(gains)
    rows = np.zeros((graph.gain_steps, 0), dtype=int)
    return [Stage("gains", gains, graph.p, cost, ca.SX(0, 1), index, rows)]


@dataclass(frozen=True)
class MultipleShooting:
    """Multiple shooting: ``x_{k+1} = step(x_k, u_k)`` are constraints, and each step is solved internally.

    First and second derivatives of the step come from the implicit function theorem at its solution.
    """

    name: ClassVar[str] = "multiple-shooting"
    summary: ClassVar[str] = "states and inputs are variables, contact is solved inside each step"

    def transcribe(self, graph: Graph, reformulation: str = "product", compiled: Compile | None = None) -> NLP:
        """Build the NLP; ``reformulation`` is ignored, since each step solves its contact."""
        variables, constraints = trajectory_variables(graph, pairs=False), Layout()
        interval = solved_interval(graph, variables, constraints, compiled)
        contacts = _contacts(graph, interval, variables.size, graph.data().size)
        return build_nlp(self.name, graph, variables, constraints, interval, compiled, contacts=contacts)


def _contacts(graph: Graph, stage: Stage, n: int, n_data: int) -> ca.Function:
    """Return a function from ``(x, p)`` of the NLP to lam and gap of all steps, each (n, S N)."""
    step, n_p = graph.step, graph.p.numel()
    picked = graph.pick_function(stage.w, graph.problem.system.u)
    x, full = ca.MX.sym("x", n), ca.MX.sym("p", n_p + n_data)
    source = ca.vertcat(x, full[n_p:])
    w = ca.reshape(source[stage.index.ravel().tolist()], -1, stage.copies)
    arguments = picked.map(stage.copies)(w, ca.repmat(full[:n_p], 1, stage.copies))
    _, lam, gap, _ = step.solve.map(stage.copies)(*arguments)
    return ca.Function("contacts", [x, full], [lam, gap])
