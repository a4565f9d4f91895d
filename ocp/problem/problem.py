"""Optimal control problem: a system with a horizon, costs, constraints and a start."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from pydantic import InstanceOf

from dynamics.contact import Exact, Step
from dynamics.systems import ContactSystem, ParameterTable
from ocp.errors import InputError
from ocp.problem.checks import BY_PARAMETERS, check_guess, check_problem_symbols
from ocp.problem.cost_sizes import natural_cost_unit, split_constant
from ocp.problem.free_time import FreeStep, with_free_step
from ocp.problem.parts import Constraint, FreeStart, Origin, Scales, Scaling, Scenarios, column, repeat_bound
from ocp.problem.sizes import GAP_SHARE, derive_sizes, gap_changes, residual_changes
from ocp.programs.units import ORDINARY_ROWS, solver_unit
from ocp.validation import Count, Name, validated

__all__ = ["Constraint", "FreeStart", "Guess", "Problem", "Scales", "Scaling", "Scenarios"]

SWEPT = "way between nodes"
"""Name of the path constraint that prevents penetration between nodes in a ``swept`` problem."""
SHARES = (0.25, 0.5, 0.75)
"""Positions between two nodes, as fractions of the step, at which a swept problem prevents penetration."""
DEPTH = 0.05
"""Largest penetration between nodes in a swept problem, in characteristic gaps: half of the referee's tolerance."""
Guess = Callable[["Problem", np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Function from (problem, parameter values) to guessed states (N+1, nx) and inputs (N, nu)."""

_FIELD_TYPES: dict[str, Any] = {
    "name": Name,
    "system": InstanceOf[ContactSystem],
    "N": Count,
    "parameters": InstanceOf[ParameterTable],
    "path": tuple[InstanceOf[Constraint], ...],
    "terminal": tuple[InstanceOf[Constraint], ...],
    "scenarios": InstanceOf[Scenarios],
    "start": InstanceOf[FreeStart] | None,
    "guess": Callable[..., Any] | None,
    "scaling": InstanceOf[Scaling],
    "origin": InstanceOf[Origin],
}
"""Mapping from fields to the types that their values must have."""


@dataclass(frozen=True, eq=False, repr=False)
class Problem:
    """Problem of minimising the mean over scenarios of ``sum_k l(x_k, u_k, du_k) + l_N(x_N)``, k < N.

    ``stage_cost`` is an expression in ``system.x``, ``system.u``, ``du`` (the symbol for u_k - u_{k-1}, with u_{-1} =
    ``u_before``), ``system.lam`` (the impulses of contact of the step from x_k to x_{k+1}; the mean over the branches
    of a law that averages) and the parameters, ``terminal_cost`` in ``system.x`` and the parameters, and ``path``
    constraints in the symbols of the stage cost without ``du``, and in ``system.x_next``. ``x0`` (nx,), ``u_before``
    (nu,), and all bounds are expressions in the parameters. With ``h=free(lower, upper)`` the step size is the last
    state, and the final time is free (:func:`~ocp.problem.free_time.free`). With ``swept`` an additional path
    constraint also prevents penetration between nodes. ``origin`` is the problem's provenance, which its runs store.

    Raises :class:`~ocp.errors.InputError` if a dimension does not fit.
    """

    name: str
    system: ContactSystem
    N: int
    stage_cost: ca.SX
    terminal_cost: ca.SX
    x0: ca.SX
    parameters: ParameterTable
    du: ca.SX | None = None
    u_before: ca.SX | None = None
    u_lower: ca.SX | float = -ca.inf
    u_upper: ca.SX | float = ca.inf
    x_lower: ca.SX | float = -ca.inf
    x_upper: ca.SX | float = ca.inf
    path: Sequence[Constraint] = ()
    terminal: Sequence[Constraint] = ()
    scenarios: Scenarios = field(default_factory=Scenarios)
    start: FreeStart | None = None
    guess: Guess | None = None
    scaling: Scaling = field(default_factory=Scaling)
    origin: Origin = field(default_factory=Origin)
    h: FreeStep | None = None
    swept: bool = False

    def __post_init__(self) -> None:
        for field_name, field_type in _FIELD_TYPES.items():
            owners = {"name": "a problem's name", "N": f"{self.name}: the horizon N"}
            owner = owners.get(field_name, f"{self.name}: {field_name}")
            self._set(field_name, validated(owner, getattr(self, field_name), field_type))
        nx, nu = self.system.nx, self.system.nu
        sizes = {
            "x0": (nx,),
            "du": (nu,),
            "u_before": (nu,),
            "u_lower": (nu, 1),
            "u_upper": (nu, 1),
            "x_lower": (nx, 1),
            "x_upper": (nx, 1),
            "stage_cost": (1,),
            "terminal_cost": (1,),
        }
        for field_name, allowed in sizes.items():
            value = getattr(self, field_name)
            if value is not None or field_name not in ("du", "u_before"):
                self._set(field_name, column(f"{self.name}: {field_name}", value, *allowed))
        if (self.du is None) != (self.u_before is None):
            raise InputError(f"{self.name}: a cost on du needs both du and u_before, or neither")
        if self.scenarios.n > 1 and len(self.scenarios.std) != nx:
            raise InputError(
                f"{self.name}: scenarios.std has {len(self.scenarios.std)} entries, expected one per state, {nx}"
            )
        if self.start is not None and self.scenarios.n > 1:
            raise InputError(f"{self.name}: a free start needs a single scenario")
        if self.start is not None:
            self.start.check(self.name, nx)
        check_problem_symbols(self)
        if self.h is not None:
            stretched_fields = with_free_step(self, validated(f"{self.name}: h", self.h, InstanceOf[FreeStep]))
            for field_name, value in {**stretched_fields, "h": None}.items():
                self._set(field_name, value)
        if self.swept and all(row.name != SWEPT for row in self.path):
            self._set("path", (*self.path, self._sweep()))

    def __repr__(self) -> str:
        from ocp.problem.summary import summary

        return summary(self)

    def _sweep(self) -> Constraint:
        """Return the constraint on true distances at three points of the straight line between two nodes."""
        system = self.system
        if system.phi is None:
            raise InputError(
                f"{self.name}: swept needs the distances of its contacts, and the system gives no phi; leave swept out"
            )
        states_between = (system.x + share * (system.x_next - system.x) for share in SHARES)
        gaps = ca.vertcat(*(ca.substitute(system.phi, system.x, state) for state in states_between))
        lowest_gap = -DEPTH * self.scales.gap
        return Constraint(SWEPT, gaps, lowest_gap, ca.inf)

    def _set(self, field_name: str, value: Any) -> None:
        object.__setattr__(self, field_name, value)

    @property
    def uses_du(self) -> bool:
        """Whether the cost depends on input increments ``u_k - u_{k-1}``."""
        return self.du is not None

    @cached_property
    def uses_impulses(self) -> bool:
        """Whether the stage cost or a path constraint depends on contact impulses."""
        stacked = ca.vertcat(self.stage_cost, *(row.expression for row in self.path))
        return bool(ca.depends_on(stacked, self.system.lam))

    @cached_property
    def exact_step(self) -> Step:
        """Step of the system under the exact law, for audits and replays."""
        return Exact().close(self.system)

    @cached_property
    def referee_step(self) -> Step:
        """Step of the system's most exact contact model under the exact law, used by the referee to replay plans."""
        referee_system = self.system.most_exact
        return self.exact_step if referee_system is self.system else Exact().close(referee_system)

    @cached_property
    def most_exact(self) -> Problem:
        """The same problem with the system's most exact contact model; unchanged if it already uses this model.

        Raises :class:`~ocp.errors.InputError` if cost or path constraints depend on impulses that the most
        exact model splits differently.
        """
        referee_system = self.system.most_exact
        if referee_system is self.system:
            return self
        if not self.uses_impulses:
            return replace(self, system=referee_system)
        names, referee_names = (
            [contact.name for contact in system.contacts] for system in (self.system, referee_system)
        )
        if names != referee_names:
            raise InputError(
                f"{self.name}: its cost or constraints depend on impulses of its own contact model, which the most"
                " exact contact model does not have"
            )

        def with_impulses(expression: ca.SX) -> ca.SX:
            return ca.substitute(expression, self.system.lam, referee_system.lam)

        path = tuple(replace(row, expression=with_impulses(row.expression)) for row in self.path)
        return replace(self, system=referee_system, stage_cost=with_impulses(self.stage_cost), path=path)

    @cached_property
    def signed_distance(self) -> ca.Function | None:
        """Function from ``(x, p)`` to the true signed distance phi of every contact, or None if unknown."""
        if self.system.phi is None:
            return None
        inputs = [self.system.x, self.parameters.vector]
        return ca.Function("phi", inputs, [ca.densify(self.system.phi)], ["x", "p"], ["phi"])

    @cached_property
    def limits(self) -> ca.Function:
        """Function from ``p`` to ``(x0, u_before, u_lower, u_upper, x_lower, x_upper)``."""
        nx, nu = self.system.nx, self.system.nu
        u_before = ca.SX.zeros(nu) if self.u_before is None else self.u_before
        values = (self.x0, u_before, self.u_lower, self.u_upper, self.x_lower, self.x_upper)
        sizes = (nx, nu, nu, nu, nx, nx)
        outputs = [ca.densify(repeat_bound(value, size)) for value, size in zip(values, sizes, strict=True)]
        return ca.Function("limits", [self.parameters.vector], outputs, ["p"], [*BY_PARAMETERS])

    @cached_property
    def start_limits(self) -> ca.Function:
        """Function from ``p`` to the bounds of x_0, each (nx, 1); both are ``x0`` if the start is fixed."""
        nx, free = self.system.nx, self.start
        ends = (self.x0, self.x0) if free is None else (free.lower, free.upper)
        outputs = [ca.densify(repeat_bound(end, nx)) for end in ends]
        return ca.Function("start_limits", [self.parameters.vector], outputs)

    @cached_property
    def cost_terms(self) -> ca.Function:
        """Function from ``(x, u, du, lam, p)`` to ``(stage cost, terminal cost at x)``."""
        costs = [self.stage_cost, self.terminal_cost]
        names = ["x", "u", "du", "lam", "p"], ["stage", "terminal"]
        return ca.Function("cost_terms", self.symbols, costs, *names)

    @cached_property
    def changeable_costs(self) -> tuple[ca.SX, ca.SX]:
        """Stage and terminal cost without their constant terms, which no plan can change."""
        return self.split_costs[0][0], self.split_costs[1][0]

    @cached_property
    def split_costs(self) -> list[tuple[ca.SX, ca.SX]]:
        """Stage and terminal cost, each split into the part that a plan can change and its constant terms."""
        moving = ca.vertcat(*self.symbols[:4])
        return [split_constant(cost, moving) for cost in (self.stage_cost, self.terminal_cost)]

    @cached_property
    def state_slopes(self) -> ca.Function:
        """Function from ``(x, u, du, lam, p)`` to gradients of the costs.

        These are the gradients of stage and terminal cost in x, (nx, 1), and of the stage cost in lam, (nlam, 1).
        """
        x, lam = self.system.x, self.system.lam
        derivatives = (self.stage_cost, x), (self.terminal_cost, x), (self.stage_cost, lam)
        slopes = [ca.densify(ca.gradient(cost, symbol)) for cost, symbol in derivatives]
        return ca.Function("state_slopes", self.symbols, slopes)

    @property
    def symbols(self) -> list[ca.SX]:
        """Symbols ``(x, u, du, lam, p)`` of the costs, with a new symbol for du if the cost does not depend on it."""
        system = self.system
        du = ca.SX.sym("du", system.nu) if self.du is None else self.du
        return [system.x, system.u, du, system.lam, self.parameters.vector]

    @property
    def step_symbols(self) -> list[ca.SX]:
        """Symbols ``(x, u, x_next, lam, p)`` of the equations of a step."""
        system = self.system
        return [system.x, system.u, system.x_next, system.lam, self.parameters.vector]

    @cached_property
    def scales(self) -> Scales:
        """Characteristic sizes in SI, one per signal; sizes that are not stated are derived."""
        stated, units = self.scaling, self._units_of_signals
        states = None if stated.x is None else np.broadcast_to(stated.x * units.x, units.x.shape)
        derived = derive_sizes(self, states) if stated.derived else None

        def size(name: str) -> Any:
            multiple = getattr(stated, name)
            return getattr(derived, name) if multiple is None else multiple * getattr(units, name)

        sizes = Scales(size("impulse"), size("gap"), size("x"), size("u"))
        return replace(sizes, cost=stated.units.cost * natural_cost_unit(self, sizes.relative_to(units)))

    @cached_property
    def natural(self) -> Scales:
        """Units of states, inputs, impulses and gaps in a solver.

        These are ``scaling.units``; in SI, the unit of a derived size is the nearest power of two
        unless the size is ordinary (:func:`~ocp.programs.units.solver_unit`).
        """
        if not (self.scaling.units.is_si and self.scaling.derived):
            return self._units_of_signals
        names = self.scaling.derived
        return replace(self._units_of_signals, **{name: solver_unit(getattr(self.scales, name)) for name in names})

    @cached_property
    def natural_scales(self) -> Scales:
        """Characteristic sizes as multiples of :attr:`natural`."""
        return self.scales.relative_to(self.natural)

    @cached_property
    def pair_units(self) -> np.ndarray:
        """Units (nlam,) of the pairs' gaps, as multiples of the natural unit; multipliers have the inverse units.

        The units are powers of two: 1 unless the change of a gap, as states change by their sizes, is far from
        the characteristic gap, for example if distances are computed in nanometres.
        """
        changes = gap_changes(self, self.scales.x)
        return solver_unit(np.nan_to_num(changes * GAP_SHARE / self.scales.gap), ORDINARY_ROWS)

    @cached_property
    def residual_units(self) -> np.ndarray:
        """Units (nx,) of the rows of the step's residual: powers of two, 1 for ordinary rows."""
        return solver_unit(residual_changes(self, self.natural.x), ORDINARY_ROWS)

    @cached_property
    def _units_of_signals(self) -> Scales:
        """Natural units of all signals, from their dimensions."""
        units = self.scaling.units
        states, inputs = (
            np.array([units.of(signal.unit) for signal in signals])
            for signals in (self.system.states, self.system.inputs)
        )
        return Scales(units.of("N s"), units.of("m"), states, inputs, units.cost)

    @cached_property
    def physics(self) -> ca.Function:
        """Function from ``(x, p)`` to step size, mass, stiffness and friction; those that do not exist are empty."""
        system = self.system
        friction = None if system.forces is None else system.forces.friction
        expressions = (
            ca.SX() if expression is None else expression for expression in (system.mass, system.stiffness, friction)
        )
        arguments = [system.x, self.parameters.vector]
        return ca.Function(
            "physics", arguments, [ca.SX(system.h), *(ca.densify(expression) for expression in expressions)]
        )

    def initial_states(self, p: np.ndarray) -> np.ndarray:
        """Return the initial states (scenarios, nx) of all scenarios at parameter values p."""
        nominal = np.array(self.limits(p)[0]).ravel()
        return nominal + self.scenarios.offsets(self.system.nx)

    def initial_guess(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return guessed states (N+1, nx) and inputs (N, nu), by default a state of rest.

        Raises :class:`~ocp.errors.InputError` for a ``guess`` with other shapes or with values that are not finite.
        """
        if self.guess is not None:
            return check_guess(self, self.guess(self, p))
        x0, u_before = (np.array(v).ravel() for v in self.limits(p)[:2])
        return np.tile(x0, (self.N + 1, 1)), np.tile(u_before, (self.N, 1))
