"""The graphs that a rollout evaluates at every step: step, inner iteration, adjoint of the step, and costs.

The forward pass of one step under a policy and noise w is

    u = law(x, theta) + w,    lam solves lam (z + F lam) = mu,    x_next = f(x, u, lam, p)

with z, F, mu functions of (x, u, p). The adjoint pass goes through the solution by the implicit
function theorem: with s = z + F lam,

    (diag(s) + diag(lam) F) d lam = d mu - diag(lam) (d z + d F lam)

where under the exact law lam is replaced by the indicator of the active set (1 where lam > s), and s by 1 minus this
indicator. Where the contact is not an LCP, the adjoint goes through the relation of the step's inner unknowns.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import casadi as ca
import numpy as np

from dynamics.batch.graphs.hoisting import HoistedFunctions, carry_costly_values
from dynamics.batch.graphs.inner import InnerLoop, dense_function, newton_guess, solver_fields
from dynamics.batch.graphs.objective import Objective, call_with_first, expand_function, require_sizes
from dynamics.batch.graphs.policy import DensePolicy, RolloutPolicy
from dynamics.batch.graphs.step_graphs import (
    AdjointTapes,
    CostDependence,
    Layers,
    ModelStepGraphs,
    RolloutTapes,
    cost_dependence,
    stand_ins,
)
from dynamics.contact import AffineStep, Step, interior_point
from dynamics.contact.learned_step import LearnedStep
from dynamics.contact.path import Path
from dynamics.contact.reduced_path import path_of
from dynamics.systems import ParameterTable
from dynamics.systems.elimination import solve_without_pivoting


def parameters_of(step: Step, objective: Objective, policy: RolloutPolicy) -> ParameterTable:
    """Return all parameters of a rollout, of step, objective and policy."""
    return step.p + objective.parameters + policy.parameters


def _check(step: Step, policy: RolloutPolicy) -> None:
    nx, nu = step.system.nx, step.system.nu
    n = policy.law.numel_in(1)
    n_out = policy.actuate.numel_in(0) if policy.actuate else nu
    require_sizes("policy", policy.law, (nx, n), "(x, theta)", n_out)
    if policy.actuate is not None:
        require_sizes("actuation", policy.actuate, (n_out,), "(a,)", nu)
    if n_out != nu:
        raise ValueError(f"the policy has {n_out} actions for {nu} inputs")
    if isinstance(policy, DensePolicy):
        np = min(len(step.p), policy.observe.numel_in(1))
        require_sizes("observation", policy.observe, (nx, np), "(x, p)", policy.sizes[0])


class ClosedStep:
    """One step of a rollout, closed by a policy, as expressions in (x, theta, w, p).

    Its tapes take, in place of the parameters of the step, the objective and the policy, the values that
    `RolloutTapes.derived` computes from them. Raises `ValueError` if the dimensions of objective, policy and step do
    not fit.
    """

    def __init__(self, step: Step, objective: Objective, policy: RolloutPolicy) -> None:
        objective.check(step)
        _check(step, policy)
        system = step.system
        self.step, self.objective, self.policy = step, objective, policy
        self.law = expand_function(policy.law)
        self.p = parameters_of(step, objective, policy).vector
        self.theta = ca.SX.sym("theta", policy.law.nnz_in(1))
        self.w = ca.SX.sym("w", system.nu)
        self.x = ca.vertcat(system.x, objective.carried)
        self.x_next, self.stage_cost = objective.step_outcome(step, step.x_next_of_lam)
        self.terminal_cost = objective.terminal(step)
        self.arguments = [self.x, self.theta, self.w, self.p]

    @cached_property
    def tapes(self) -> RolloutTapes:
        """Graphs of costs and states alone."""
        return self._forward_tapes(self._hoisted.remaining())

    @cached_property
    def tapes_with_adjoint(self) -> RolloutTapes:
        """Graphs of costs, states and derivatives."""
        terminal_bar, functions = ca.gradient(self.terminal_cost, self.x), self._hoisted
        functions.add({"adjoint": (self._adjoint(), 3), **self._observe_graph(adjoint=True)})
        functions.add({"terminal_adjoint": (dense_function("terminal_adjoint", [self.x, self.p], [terminal_bar]), 1)})
        remaining = functions.remaining()
        adjoint = AdjointTapes(
            step=remaining["adjoint"],
            score=self._score(),
            terminal=remaining["terminal_adjoint"],
            observe=remaining.get("observe_adjoint"),
        )
        return replace(self._forward_tapes(remaining), adjoint=adjoint)

    @cached_property
    def _hoisted(self) -> HoistedFunctions:
        """Graphs of costs and states, to which the graphs of derivatives are added when they are needed."""
        at_end = dense_function("terminal", [self.x, self.p], [self.terminal_cost])
        functions = {"terminal": (at_end, 1), **self._observe_graph(adjoint=False)}
        loop = self._loop
        graphs = {"forward": self._forward()} if loop is None else {name: getattr(loop, name) for name in loop.with_p}
        hoisted = HoistedFunctions(self.p.numel())
        hoisted.add(functions | {name: (graph, 3) for name, graph in graphs.items()})
        return hoisted

    def _forward_tapes(self, remaining: dict[str, ca.Function]) -> RolloutTapes:
        """Return the graphs of costs and states, with expressions that depend only on parameters in `derived`."""
        derived, loop = self._hoisted.derived(), self._loop
        if loop is None:
            forward = last_graph = remaining["forward"]
        else:
            forward = replace(loop, **{name: remaining[name] for name in loop.with_p})
            last_graph = forward.closing
        layers, end_entry = None, self.objective.end_entry
        if isinstance(self.policy, DensePolicy):
            layers = Layers(self.policy.sizes, self.policy.n_theta, remaining["observe"])
        return RolloutTapes(
            nx=self.x.numel(),
            n_carried=self.objective.carried.numel(),
            nu=self.step.system.nu,
            np=derived.numel_out(0),
            nlam=last_graph.numel_out(1),
            n_theta=self.theta.numel(),
            forward=forward,
            terminal=remaining["terminal"],
            derived=derived,
            layers=layers,
            end_entry=None if end_entry is None else self.step.system.nx + end_entry,
        )

    def _score(self) -> ca.Function:
        law, noise = self.law(self.step.system.x, self.theta), self._effective_noise(self.cost_dependence)
        score = self.objective.mask_finished(ca.jtimes(law, self.theta, noise, True))
        return dense_function("score", [self.x, self.theta, self.w], [score])

    @cached_property
    def cost_dependence(self) -> CostDependence:
        """Entries of x and w that affect x_next and the costs, through contact and policy."""
        step, policy = self.step, self.policy
        if isinstance(step, LearnedStep):
            mixed_queries = _dependent_scalar(step.queries)
            unknown, relation_rows = step.inner, ca.repmat(mixed_queries, step.inner.numel(), 1)
        else:
            unknown, relation_rows = step.lam, step.eliminate_states(step.gap_expr) + ca.SX.sym("by_mu") * step.mu
        closed_expressions = self._substitute_policy(ca.vertcat(self.x_next, self.stage_cost), relation_rows)
        outputs = ca.substitute(closed_expressions[0], unknown, stand_ins(unknown, closed_expressions[1]))
        if isinstance(policy, DensePolicy):
            mixed_observation = _dependent_scalar(call_with_first(policy.observe, step.system.x, p=step.p.vector))
            outputs = ca.substitute(outputs, self.theta, ca.repmat(mixed_observation, self.theta.numel(), 1))
        return cost_dependence(outputs, self.terminal_cost, self.x, self.w)

    def _effective_noise(self, dependence: CostDependence) -> ca.SX:
        """Return the noise, with components set to zero in states where they have no effect on the cost."""
        noise = ca.vertsplit(self.w)
        for j, s in np.argwhere(dependence.gates).tolist():
            noise[j] = ca.if_else(self.x[s] != 0, noise[j], 0)
        return ca.vertcat(*noise)

    def _observe_graph(self, *, adjoint: bool) -> dict[str, tuple[ca.Function, int]]:
        """Return the graph of normalised observations or its adjoint, and the position of p; empty without layers."""
        policy = self.policy
        if not isinstance(policy, DensePolicy):
            return {}
        table, n = policy.parameters, policy.sizes[0]
        mean, scale = table.vector[:n], table.vector[n:]
        observation = (call_with_first(policy.observe, self.step.system.x, p=self.step.p.vector) - mean) / scale
        if not adjoint:
            return {"observe": (dense_function("observe", [self.x, self.p], [observation]), 1)}
        obar = ca.SX.sym("obar", n)
        state_bar = self.objective.mask_finished(ca.gradient(ca.dot(obar, observation), self.x))
        return {"observe_adjoint": (dense_function("observe_adjoint", [self.x, self.p, obar], [state_bar]), 1)}

    def _substitute_policy(self, *expressions: ca.SX) -> list[ca.SX]:
        """Return expressions in the step's (x, u, p), with the input of the policy substituted for u."""
        u = self.law(self.step.system.x, self.theta) + self.w
        if self.policy.actuate is not None:
            u = expand_function(self.policy.actuate)(u)
        return ca.substitute(list(expressions), [self.step.system.u], [u])

    def _effects(self, lam: ca.SX) -> list[ca.SX]:
        """Return next state, multipliers and stage cost for the multipliers ``lam``."""
        x_next, cost = self._substitute_policy(self.x_next, self.stage_cost)
        x_next, cost = ca.substitute([x_next, cost], [self.step.lam], [lam])
        return [x_next, lam, cost]

    def _contacts(self, step: AffineStep) -> list[tuple[ca.SX, ca.SX, ca.SX]]:
        """Return the contact problems (z, F, mu) of the branches, which are independent of each other."""
        z, F, mu = self._substitute_policy(step.z, step.F, step.mu)
        return [(z[rows], F[rows, rows], mu[rows]) for rows in step.rows]

    def _forward(self) -> ca.Function:
        step = self.step
        contacts = self._contacts(step) if step.n and isinstance(step, AffineStep) else []
        solved = [
            interior_point.exact_scalar_solution(z, F) if step.exact else interior_point.one_division_solution(z, F, mu)
            for z, F, mu in contacts
        ]
        return dense_function("forward", self.arguments, self._effects(ca.vertcat(ca.SX(0, 1), *solved)))

    @cached_property
    def _loop(self) -> InnerLoop | ModelStepGraphs | None:
        """Graphs of a step that needs a contact solver or a model; None if one graph is enough."""
        if isinstance(self.step, LearnedStep):
            return self._model_graphs(self.step)
        explicit = self.step.system.nlam <= isinstance(self.step, AffineStep)
        return None if explicit else self._inner_loop()

    def _model_graphs(self, step: LearnedStep) -> ModelStepGraphs:
        x_next, cost = self._substitute_policy(self.x_next, self.stage_cost)
        closing = [*self.arguments, step.model_outputs]
        return ModelStepGraphs(
            queries=dense_function("queries", self.arguments, self._substitute_policy(step.queries)),
            closing=dense_function("closing", closing, [x_next, step.model_outputs, cost]),
            model=step.learned.model,
        )

    def _inner_loop(self) -> InnerLoop:
        step, lam = self.step, self.step.lam
        if isinstance(step, AffineStep):
            problems = self._contacts(step)
            n = step.system.nlam
            path = Path(sum((F.sparsity() for _, F, _ in problems), ca.Sparsity(n, n)), step.exact)
            columns = [path.opening_data(*problem) for problem in problems]
        else:
            path = path_of(step.system, step.exact)
            columns = self._path_data(path)
        guesses = ca.vertcat(*[newton_guess(path, column) for column in columns])
        return InnerLoop(
            opening=dense_function("opening", self.arguments, [guesses, ca.vertcat(*columns)]),
            closing=dense_function("closing", [*self.arguments, lam], self._effects(lam)),
            branches=step.branches,
            **solver_fields(path),
        )

    def _path_data(self, path: Path) -> list[ca.SX]:
        """Return the data of the interior-point path for every branch."""
        step, system, mu = self.step, self.step.system, ca.SX.sym("mu", path.n)
        opening, data = path.opening_data_of(system, mu), []
        for node, rows in zip(step.nodes, step.rows, strict=True):
            symbols = ca.vertcat(system.x, system.u, mu)
            values = ca.vertcat(system.x + node.noise_x, system.u + node.noise_u, step.mu[rows])
            data += self._substitute_policy(ca.substitute(opening, symbols, values))
        return data

    def _adjoint(self) -> ca.Function:
        step = self.step
        xbar = ca.SX.sym("xbar", self.x.numel())
        if isinstance(step, LearnedStep):
            return self._adjoint_of_model(step, xbar)
        if not isinstance(step, AffineStep):
            return self._adjoint_of_relation(xbar)
        value = self.stage_cost + ca.dot(xbar, self.x_next)
        held_symbols, held_values = [ca.SX(0, 1)], [ca.SX(0, 1)]
        if step.n:
            held_symbols, held_values, contact_term = self._contact_term(step, ca.gradient(value, step.lam))
            value += contact_term
        value = self._substitute_policy(value)[0]
        bars = [ca.gradient(value, self.x), ca.gradient(value, self.theta)]
        # If contact moves no state, the cotangent of the multiplier has no entries.
        bars = ca.substitute(
            bars, held_symbols, [ca.densify(held_value) for held_value in self._substitute_policy(*held_values)]
        )
        return self._adjoint_function(step.lam, xbar, bars)

    def _adjoint_function(self, lam: ca.SX, xbar: ca.SX, bars: list[ca.SX]) -> ca.Function:
        carried_bar = self.objective.carry_cotangent(ca.densify(bars[0]), xbar)
        bars = [carried_bar, self.objective.mask_finished(bars[1])]
        return dense_function("adjoint", [*self.arguments, lam, xbar], bars)

    def _adjoint_of_model(self, step: LearnedStep, xbar: ca.SX) -> ca.Function:
        """Return the adjoint as the gradient of ``l + xbar' x_next + b' z``.

        b is the derivative of ``l + xbar' x_next`` with respect to the model's inputs z; it is held constant.
        """
        value = self.stage_cost + ca.dot(xbar, self.x_next)
        value, queries, query_bar = self._substitute_policy(value, step.queries, step.query_gradient(value))
        held_bar = ca.SX.sym("back", queries.numel())
        value += ca.dot(held_bar, queries)
        bars = [ca.gradient(value, self.x), ca.gradient(value, self.theta)]
        bars = ca.substitute(bars, [held_bar], [ca.densify(query_bar)])
        return self._adjoint_function(step.model_outputs, xbar, bars)

    def _adjoint_of_relation(self, xbar: ca.SX) -> ca.Function:
        """Return the adjoint as the gradient of ``l + xbar' x_next - v' R(inner)``.

        v solves the transposed linear system of the relation R, and is held constant.
        """
        step, inner = self.step, self.step.inner
        relation = step.differentiable_relation
        x_next, cost = self.objective.step_outcome(step, step.x_next_expr)
        cost_to_go = cost + ca.dot(xbar, x_next)
        by_inner = ca.densify(ca.gradient(cost_to_go, inner))
        v = step.solve_relation(by_inner, transposed=True)
        held_v = ca.SX.sym("v", inner.numel())
        value = self._substitute_policy(cost_to_go - ca.dot(held_v, relation))[0]
        bars = [ca.gradient(value, self.x), ca.gradient(value, self.theta)]
        held_values = [v]
        held_symbols = [held_v]
        if step.held_mu is not None:
            held_symbols.append(step.held_mu[0])
            held_values.append(step.held_mu[1])
        bars = ca.substitute(bars, [ca.vertcat(*held_symbols)], self._substitute_policy(ca.vertcat(*held_values)))
        bars = ca.substitute(bars, [step.states], self._substitute_policy(step.states_of_lam))
        return self._adjoint_function(step.lam, xbar, ca.cse(bars))

    def _contact_term(self, step: AffineStep, lambar: ca.SX) -> tuple[list[ca.SX], list[ca.SX], ca.SX]:
        """Return the term by which contact enters the function whose gradient is the adjoint.

        The result also lists the symbols to hold constant while differentiating, and their values. The term is
        `v' (mu - diag(lam) (z + F lam))`, where v solves the transposed system.
        """
        lam, gap = step.lam, step.z + step.F @ step.lam
        if step.exact:
            weights, diagonal = lam > gap, lam <= gap
        else:
            weights, diagonal = lam, gap
        if step.system.nlam == 1 and not step.exact:
            # At the solution diagonal + F lam is the square root of the forward step.
            v = lambar / interior_point.scalar_root(step.z, ca.diag(step.F), step.mu)
        else:
            v = solve_without_pivoting(ca.diag(diagonal) + step.F.T @ ca.diag(weights), lambar)
        held_v, held_weights = held_symbols = [ca.SX.sym(name, step.n) for name in ("v", "weights")]
        function = -ca.dot(held_v, held_weights * gap)
        if not (step.exact or step.law.frozen):
            function += ca.dot(held_v, step.mu)
        return held_symbols, [v, weights], function


def with_carried_values(tapes: RolloutTapes) -> RolloutTapes:
    """Return tapes whose forward step stores in `lam` costly values for the adjoint, unless an iteration finds lam."""
    if tapes.adjoint is None or not isinstance(tapes.forward, ca.Function):
        return tapes
    forward, step = carry_costly_values(tapes.forward, tapes.adjoint.step)
    return replace(tapes, forward=forward, nlam=step.numel_in(4), adjoint=replace(tapes.adjoint, step=step))


def _dependent_scalar(expressions: ca.SX) -> ca.SX:
    """Return a scalar that depends on all symbols in the expressions; only its sparsity matters."""
    return ca.dot(ca.SX.sym("weight", expressions.numel()), expressions)
