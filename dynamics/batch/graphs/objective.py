"""Objectives of rollouts: sums of costs over the steps, and the variables by which they extend the state."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from dynamics.contact import Step
from dynamics.systems import Parameter, ParameterTable

# Name of the discount factor in the table of parameters.
DISCOUNT_NAME = "discount"


class Objective(ABC):
    """A sum of costs over the steps of a rollout; an objective may add variables to the system's state."""

    @cached_property
    @abstractmethod
    def carried(self) -> ca.SX:
        """Symbols (n_carried, 1) of the variables that a rollout carries from step to step besides the state."""

    @cached_property
    def parameters(self) -> ParameterTable:
        """Parameters of the objective in addition to the step's; none by default."""
        return ParameterTable()

    @property
    def end_entry(self) -> int | None:
        """Index of the entry of `carried` that is zero once a rollout has ended early; None if none can end early."""
        return None

    @abstractmethod
    def check(self, step: Step) -> None:
        """Raise `ValueError` if the dimensions of the objective's functions do not fit the step."""

    @abstractmethod
    def step_outcome(self, step: Step, x_next_expr: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return next state and carried variables (nx + n_carried, 1) for `x_next_expr` (nx, 1), and the stage cost.

        Both are expressions in (x, u, carried, p) and in the symbols of `x_next_expr`.
        """

    @abstractmethod
    def terminal(self, step: Step) -> ca.SX:
        """Return the cost at the end of the rollout, an expression in (x, carried, p)."""

    def carry_cotangent(self, bars: ca.SX, xbar: ca.SX) -> ca.SX:
        """Return the cotangent of state and carried variables before a step.

        `bars` is this cotangent for a rollout that has not ended, `xbar` is the cotangent after the step.
        """
        return bars

    def mask_finished(self, bars: ca.SX) -> ca.SX:
        """Return the terms `bars` of one step in gradient or score, set to zero if the rollout is over."""
        return bars


@dataclass(frozen=True, eq=False)
class Costs(Objective):
    """Sum of costs `sum_{t<N} stage(x_t, u_t, p) + final(x_N, p)`.

    A stage cost may have two more arguments: after u_t the change u_t - u_{t-1}, for which the previous input
    is added to the state; and before p the contact impulses (nlam, 1), if that argument is called ``lam``.
    """

    stage: ca.Function
    final: ca.Function

    @property
    def with_change(self) -> bool:
        """Whether the stage cost depends on the change of inputs."""
        return self.stage.n_in() == 4 + self.with_impulses

    @property
    def with_impulses(self) -> bool:
        """Whether the stage cost depends on the contact impulses."""
        return "lam" in self.stage.name_in()

    @cached_property
    def carried(self) -> ca.SX:
        """Symbols (nu, 1) of the previous input, empty if the stage cost does not depend on changes."""
        return ca.SX.sym("before", self.stage.numel_in(2) if self.with_change else 0)

    def check(self, step: Step) -> None:
        """Raise `ValueError` if the arguments or outputs of the costs do not fit the step."""
        nx, nu, np = step.system.nx, step.system.nu, len(step.p)
        extra_sizes = {"du": nu} if self.with_change else {}
        extra_sizes |= {"lam": step.system.nlam} if self.with_impulses else {}
        require_sizes(
            "stage cost",
            self.stage,
            (nx, nu, *extra_sizes.values(), np),
            f"({', '.join(('x', 'u', *extra_sizes, 'p'))})",
            1,
        )
        if self.with_impulses and step.n == 0:
            raise ValueError("the stage cost needs contact impulses, which the law does not have")
        require_sizes("terminal cost", self.final, (nx, np), "(x, p)", 1)

    def step_outcome(self, step: Step, x_next_expr: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the next state, followed by the input if the cost depends on changes, and the stage cost."""
        system, p = step.system, step.p.vector
        extra_arguments = [system.u - self.carried] if self.with_change else []
        extra_arguments += [step.impulses] if self.with_impulses else []
        cost = expand_function(self.stage)(system.x, system.u, *extra_arguments, p)
        return ca.vertcat(x_next_expr, system.u if self.with_change else ca.SX(0, 1)), cost

    def terminal(self, step: Step) -> ca.SX:
        """Return the terminal cost as an expression in (x, p)."""
        return expand_function(self.final)(step.system.x, step.p.vector)


def free_of_cost(step: Step) -> Costs:
    """Return costs that are zero, for functions that only need the step."""
    system, p, nothing = step.system, step.p.vector, ca.SX(0)
    return Costs(
        ca.Function("stage", [system.x, system.u, p], [nothing]),
        ca.Function("terminal", [system.x, p], [nothing]),
    )


@dataclass(frozen=True, eq=False)
class Episode(Objective):
    """Negative return of an episode, `-sum_t d^t a_t reward(x_t, u_t, x_{t+1}, p) - d^N a_N final(x_N, p)`.

    d is the parameter `discount`. a_t is 1 until the first state x_t, t > 0, at which `done(x, p)` is
    not zero, and 0 from that step on: the state then does not change, and rewards and gradients are zero.
    Each function takes as p the first parameters of the step, as many as its argument has.
    """

    reward: ca.Function
    final: ca.Function
    done: ca.Function

    @cached_property
    def carried(self) -> ca.SX:
        """Symbols of the reward's weight `d^t a_t`, and of the number of steps before the end of the episode."""
        return ca.vertcat(ca.SX.sym("weight"), ca.SX.sym("lived"))

    @cached_property
    def parameters(self) -> ParameterTable:
        """Parameter table with the discount factor d."""
        return ParameterTable([Parameter(DISCOUNT_NAME, 1.0, "1", "worth of a reward one step later")])

    def check(self, step: Step) -> None:
        """Raise `ValueError` if the arguments or outputs of the functions do not fit the step."""
        nx, nu = step.system.nx, step.system.nu
        for role, fn, sizes, arguments in (
            ("reward", self.reward, (nx, nu, nx), "(x, u, x_next, p)"),
            ("final", self.final, (nx,), "(x, p)"),
            ("done", self.done, (nx,), "(x, p)"),
        ):
            np = min(len(step.p), fn.numel_in(fn.n_in() - 1))
            require_sizes(role, fn, (*sizes, np), arguments, 1)

    def step_outcome(self, step: Step, x_next_expr: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the next state (the current state once the episode is over), and minus the weighted reward."""
        x, u, p = step.system.x, step.system.u, step.p.vector
        weight, lived = ca.vertsplit(self.carried)
        is_done = call_with_first(self.done, x_next_expr, p=p) != 0
        weight_after = ca.if_else(is_done, 0, self.parameters[DISCOUNT_NAME] * weight)
        stays = [
            ca.if_else(self.is_alive, new, old)
            for new, old in zip(ca.vertsplit(x_next_expr), ca.vertsplit(x), strict=True)
        ]
        gain = ca.if_else(self.is_alive, weight * call_with_first(self.reward, x, u, x_next_expr, p=p), 0)
        carried_weight = ca.if_else(self.is_alive, weight_after, 0)
        return ca.vertcat(*stays, carried_weight, lived + self.is_alive), -gain

    def terminal(self, step: Step) -> ca.SX:
        """Return minus the weighted terminal reward, zero for episodes that ended before the last step."""
        gain = call_with_first(self.final, step.system.x, p=step.p.vector)
        return -ca.if_else(self.is_alive, self.carried[0] * gain, 0)

    @property
    def end_entry(self) -> int:
        """Index of the reward's weight in `carried`, which is zero once the episode is over."""
        return 0

    @property
    def is_alive(self) -> ca.SX:
        """Expression that is 1 until the episode has ended, then 0."""
        return self.carried[0] > 0

    def carry_cotangent(self, bars: ca.SX, xbar: ca.SX) -> ca.SX:
        """Return the cotangent before a step: once the episode is over, zero for `carried` and `xbar` for the state."""
        n = bars.numel() - self.carried.numel()
        state_bars = [ca.if_else(self.is_alive, bars[k], xbar[k]) for k in range(n)]
        return ca.vertcat(*state_bars, ca.SX.zeros(self.carried.numel()))

    def mask_finished(self, bars: ca.SX) -> ca.SX:
        """Return the terms `bars` of one step, set to zero once the episode is over, even if they are not finite."""
        return ca.vertcat(ca.SX(0, 1), *(ca.if_else(self.is_alive, bar, 0) for bar in ca.vertsplit(ca.densify(bars))))


def expand_function(fn: ca.Function) -> ca.Function:
    """Return the function expanded to scalar operations (SX)."""
    return fn if fn.is_a("SXFunction") else fn.expand()


def require_sizes(role: str, fn: ca.Function, sizes: tuple[int, ...], arguments: str, n_out: int) -> None:
    """Raise `ValueError` unless a function has arguments of these sizes and one output with `n_out` entries."""
    argument_sizes = tuple(fn.numel_in(k) for k in range(fn.n_in()))
    if argument_sizes != sizes:
        raise ValueError(
            f"the {role} must be a function of {arguments} with sizes {sizes}, but '{fn.name()}' takes sizes"
            f" {argument_sizes}"
        )
    if fn.n_out() != 1 or fn.numel_out(0) != n_out:
        raise ValueError(f"the {role} '{fn.name()}' must have one output with {n_out} entries")


def call_with_first(fn: ca.Function, *arguments: ca.SX, p: ca.SX) -> ca.SX:
    """Return `fn(*arguments, p)`, with p cut to the length of the function's last argument."""
    return ca.densify(expand_function(fn)(*arguments, p[: fn.numel_in(fn.n_in() - 1)]))
