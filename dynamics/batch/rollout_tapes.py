"""The short graphs that a rollout repeats: step, inner iteration, adjoint of the step, costs.

The forward pass of one step under a policy and noise w is

    u = law(x, theta) + w,    lam solves lam (z + F lam) = mu,    x_next = f(x, u, lam, p)

with z, F, mu functions of (x, u, p). The adjoint pass goes through the solution by the implicit
function theorem: with s = z + F lam,

    (diag(s) + diag(lam) F) d lam = d mu - diag(lam) (d z + d F lam)

where the exact law has in place of lam and s the active set (1 where lam > s) and its complement.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import casadi as ca

from dynamics.batch.policy import RolloutPolicy
from dynamics.contact import interior_point
from dynamics.contact.elimination import solve_without_pivoting


_UNDERFLOW = 1e-200


class StepDefinition(Protocol):
    """What a rollout reads of a one-step relation: SX symbols, and SX expressions in them.

    Symbols `x` (nx), `u` (nu), `p` (np), `lam` (nlam); expressions in x, u, p: `z` (nlam), `F`
    (nlam, nlam), `mu` (nlam); `x_next` (nx) in all four. `exact` is true where mu is zero.
    """

    x: ca.SX
    u: ca.SX
    p: ca.SX
    lam: ca.SX
    z: ca.SX
    F: ca.SX
    mu: ca.SX
    x_next: ca.SX
    exact: bool


@dataclass(frozen=True)
class InnerLoop:
    """The contact solve of several contacts: iterate until nothing changes, at most `iterations`.

    `opening: (x, theta, w, p) -> (state, data)`, `body: (state, data) -> state`,
    `closing: (x, theta, w, p, state, data) -> (x_next, lam, cost)`.
    """

    opening: ca.Function
    body: ca.Function
    closing: ca.Function
    iterations: int


@dataclass(frozen=True)
class RolloutTapes:
    """CasADi functions of one step; all SX, all arguments dense columns.

    - `forward: (x, theta, w, p) -> (x_next, lam, cost)`, or an `InnerLoop` where there is no
      closed form for lam
    - `adjoint: (x, theta, w, p, lam, xbar) -> (xbar_before, thetabar)`
    - `score: (x, theta, w) -> thetabar`, the product D_theta law(x, theta)' w
    - `terminal: (x, p) -> cost` and `terminal_adjoint: (x, p) -> xbar`
    """

    nx: int
    nu: int
    np: int
    nlam: int
    n_theta: int
    forward: ca.Function | InnerLoop
    adjoint: ca.Function
    score: ca.Function
    terminal: ca.Function
    terminal_adjoint: ca.Function


def build_tapes(
    step: StepDefinition,
    stage_cost: ca.Function,
    terminal_cost: ca.Function,
    policy: RolloutPolicy,
) -> RolloutTapes:
    """Close the step under the policy and differentiate it once.

    `stage_cost: (x, u, p) -> l` and `terminal_cost: (x, p) -> l` are scalar. Raises `ValueError`
    where the dimensions of costs, policy and step do not fit.
    """
    _check(step, stage_cost, terminal_cost, policy)
    return _Closed(step, stage_cost, terminal_cost, policy).tapes()


def _check(
    step: StepDefinition,
    stage_cost: ca.Function,
    terminal_cost: ca.Function,
    policy: RolloutPolicy,
) -> None:
    nx, nu, np = step.x.numel(), step.u.numel(), step.p.numel()
    expected = (
        ("stage cost", stage_cost, (nx, nu, np), "(x, u, p)"),
        ("terminal cost", terminal_cost, (nx, np), "(x, p)"),
        ("policy", policy.law, (nx, policy.n_theta), "(x, theta)"),
    )
    for what, fn, sizes, arguments in expected:
        given = tuple(fn.numel_in(k) for k in range(fn.n_in()))
        if given != sizes:
            raise ValueError(
                f"the {what} must be a function of {arguments} with sizes {sizes}, "
                f"but '{fn.name()}' takes sizes {given}"
            )
    for what, fn, size in (
        ("stage cost", stage_cost, 1),
        ("terminal cost", terminal_cost, 1),
        ("policy", policy.law, nu),
    ):
        if fn.n_out() != 1 or fn.numel_out(0) != size:
            raise ValueError(f"the {what} '{fn.name()}' must have one output with {size} entries")


class _Closed:
    """One step closed by a policy, in fresh symbols."""

    def __init__(
        self,
        step: StepDefinition,
        stage_cost: ca.Function,
        terminal_cost: ca.Function,
        policy: RolloutPolicy,
    ) -> None:
        self.step, self.policy = step, policy
        self.stage_cost, self.terminal_cost = _expanded(stage_cost), _expanded(terminal_cost)
        self.law = _expanded(policy.law)
        self.n = step.lam.numel()
        self.theta = ca.SX.sym("theta", policy.n_theta)
        self.w = ca.SX.sym("w", step.u.numel())
        self.u = self.law(step.x, self.theta) + self.w
        self.arguments = [step.x, self.theta, self.w, step.p]

    def tapes(self) -> RolloutTapes:
        step = self.step
        terminal = self.terminal_cost(step.x, step.p)
        at_end = [step.x, step.p]
        law = self.law(step.x, self.theta)
        return RolloutTapes(
            nx=step.x.numel(),
            nu=step.u.numel(),
            np=step.p.numel(),
            nlam=self.n,
            n_theta=self.policy.n_theta,
            forward=self._forward() if self.n <= 1 else self._inner_loop(),
            adjoint=self._adjoint(),
            score=_function(
                "score", [step.x, self.theta, self.w], [ca.jtimes(law, self.theta, self.w, True)]
            ),
            terminal=_function("terminal", at_end, [terminal]),
            terminal_adjoint=_function(
                "terminal_adjoint", at_end, [ca.gradient(terminal, step.x)]
            ),
        )

    def _closed(self, *expressions: ca.SX) -> list[ca.SX]:
        """Expressions in the step's own (x, u, p), with the policy's input put in for u."""
        return ca.substitute(list(expressions), [self.step.u], [self.u])

    def _effects(self, lam: ca.SX) -> list[ca.SX]:
        """Next state, multiplier and stage cost, given the multiplier."""
        step = self.step
        x_next = ca.substitute(step.x_next, step.lam, lam)
        cost = self.stage_cost(step.x, step.u, step.p)
        return [*self._closed(x_next), lam, *self._closed(cost)]

    def _forward(self) -> ca.Function:
        step = self.step
        if self.n == 0:
            lam = ca.SX(0, 1)
        else:
            z, F, mu = self._closed(step.z, step.F, step.mu)
            solve = interior_point.exact_scalar_solution(z, F)
            lam = solve if step.exact else _scalar_solution(z, F, mu)
        return _function("forward", self.arguments, self._effects(lam))

    def _inner_loop(self) -> InnerLoop:
        n, exact = self.n, self.step.exact
        z, F, mu = self._closed(self.step.z, self.step.F, self.step.mu)
        D, c = interior_point.scaling(z, F, 0 * mu if exact else mu)
        F_scaled = ca.sparsify(ca.diag(D) @ F @ ca.diag(D))
        mu_scaled = ca.SX.ones(n) * interior_point.MU_EXACT if exact else mu / c**2
        pattern = F_scaled.sparsity()
        prepared = [z * D / c, F_scaled.nz[:], mu_scaled, D, c]
        state, data = ca.SX.sym("state", 2 * n), ca.SX.sym("data", 3 * n + pattern.nnz() + 1)
        ends = [0, n, n + pattern.nnz(), 2 * n + pattern.nnz(), 3 * n + pattern.nnz()]
        z_, F_, mu_, D_, c_ = ca.vertsplit(data, [*ends, data.numel()])
        problem = (z_, ca.SX(pattern, F_), mu_)
        moved = interior_point.iteration(n)(state[:n], state[n:], *problem)
        solved = interior_point._finish(n, exact)(state[:n], state[n:], *problem, D_, c_)
        return InnerLoop(
            opening=_function(
                "opening", self.arguments, [ca.SX.ones(2 * n), ca.vertcat(*prepared)]
            ),
            body=_function("body", [state, data], [ca.vertcat(*moved)]),
            closing=_function(
                "closing", [*self.arguments, state, data], self._effects(solved[0])
            ),
            iterations=interior_point.ITERATIONS,
        )

    def _adjoint(self) -> ca.Function:
        step = self.step
        xbar = ca.SX.sym("xbar", step.x.numel())
        value = self.stage_cost(step.x, step.u, step.p) + ca.dot(xbar, step.x_next)
        frozen, meant = [ca.SX(0, 1)], [ca.SX(0, 1)]
        if self.n:
            frozen, meant, through_contact = self._implicit(ca.gradient(value, step.lam))
            value += through_contact
        value = self._closed(value)[0]
        bars = [ca.gradient(value, step.x), ca.gradient(value, self.theta)]
        bars = ca.substitute(bars, frozen, self._closed(*meant))
        return _function("adjoint", [*self.arguments, step.lam, xbar], bars)

    def _implicit(self, lambar: ca.SX) -> tuple[list[ca.SX], list[ca.SX], ca.SX]:
        """What contact adds to the function whose gradient is the adjoint.

        The symbols to hold constant while differentiating, the expressions they stand for, and
        the function `v' (mu - diag(lam) (z + F lam))`, v the solution of the transposed system.
        """
        step, lam, n = self.step, self.step.lam, self.n
        if step.exact:
            on = lam > step.z + step.F @ lam
            weights, slack, rate = on, 1 - on, ca.SX(n, 1)
        else:
            weights, slack, rate = lam, self._slack(), ca.SX.ones(n)
        matrix = ca.diag(slack) + step.F.T @ ca.diag(weights)
        v = solve_without_pivoting(matrix, lambar)
        frozen = [ca.SX.sym(name, n) for name in ("v", "weights")]
        gap = step.z + step.F @ lam
        return frozen, [v, weights], ca.dot(frozen[0], rate * step.mu - frozen[1] * gap)

    def _slack(self) -> ca.SX:
        """The gap s = z + F lam of the softened law."""
        step = self.step
        s = step.z + step.F @ step.lam
        if self.n == 1:
            return s
        # With several contacts the sum may cancel; lam s = mu does not, until mu underflows.
        usable = step.mu > _UNDERFLOW
        return ca.if_else(usable, step.mu / ca.if_else(usable, step.lam, 1), s)


def _scalar_solution(z: ca.SX, F: ca.SX, mu: ca.SX) -> ca.SX:
    """`interior_point.scalar_solution` with one division for both signs of z."""
    apart = z > 0
    q = ca.fabs(z) + ca.sqrt(z * z + 4 * F * mu)
    return ca.if_else(apart, 2 * mu, q) / ca.if_else(apart, q, 2 * F)


def _expanded(fn: ca.Function) -> ca.Function:
    return fn if fn.is_a("SXFunction") else fn.expand()


def _function(name: str, arguments: list[ca.SX], results: list[ca.SX]) -> ca.Function:
    return ca.Function(name, arguments, [ca.densify(result) for result in results])
