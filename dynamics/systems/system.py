"""A mechanical system with contact; its definition does not depend on the contact law."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import casadi as ca

from dynamics.systems.elimination import solve_without_pivoting
from dynamics.systems.mechanism import Mechanism
from dynamics.systems.pairs import (
    TRUE_GAPS,
    ContactForces,
    EnergyBalance,
    Pair,
    RefereeModel,
    by_true_distance,
    deciding_pairs,
    has_open_multipliers,
)
from dynamics.systems.parameters import ParameterTable, Signal


@dataclass(frozen=True, eq=False)
class ReducedContact:
    """The step of a system solved for the next state: ``x_next = a + B lam``.

    ``a`` (nx, 1), ``B`` (nx, nlam), the gap ``z`` (nlam, 1) at ``lam = 0`` and its derivative ``F``
    (nlam, nlam) with respect to lam are expressions in the state, the input and the parameters only. If
    ``affine``, ``gap = z + F lam`` for every lam. Otherwise the derivative is taken at ``x_next = x``, before
    any rotation, so that F is the symmetric ``J M^-1 J'`` of a linearised gap, whose value at ``lam = 0`` is
    ``z_linear``.
    """

    a: ca.SX
    B: ca.SX
    z: ca.SX
    F: ca.SX
    z_linear: ca.SX
    affine: bool


@dataclass(frozen=True, eq=False)
class ContactSystem:
    """One implicit step of a mechanical system: ``residual(x, u, x_next, lam, p) = 0`` and ``0 <= lam ⟂ gap >= 0``.

    ``residual`` (nx, 1) and ``gap`` (nlam, 1) are expressions in the symbols ``x`` (nx, 1), ``u``
    (nu, 1), ``x_next`` (nx, 1), ``lam`` (nlam, 1) and the parameters. The contact law, which solves
    or smooths the complementarity, is not part of the system (:mod:`dynamics.contact`).

    ``phi`` are the true signed distances [m] as an expression in ``x`` only; the audit needs them since a gap may be
    a linearisation. ``mu_per_kappa`` converts the log-barrier weight kappa [1/J] to the central-path parameter, ``mu
    = mu_per_kappa / kappa``.

    ``pairs`` give the meaning of each entry of ``lam``, by default the normal impulse of a separate
    contact; ``forces`` are total impulses per contact, None without friction. ``energy_balance`` is None
    if the builder has no expressions for it.

    If the Jacobian of ``residual`` with respect to ``x_next`` depends on the state, it must have positive
    leading minors, like a mass matrix.

    ``referee_model`` is the most exact model known of the system, see :attr:`most_exact`. ``refinable`` says
    that h is only a step size, so that ``h / 4`` gives the same system with finer steps. ``mass`` M (nq, nq),
    in quasi-dynamics the mass matrix of the unactuated coordinates, and ``stiffness`` K of the actuators must
    be positive definite; they are expressions in x and the parameters, or None. ``scene`` says whether the
    system is a scene of bodies, pushers and obstacles with true gaps, for which the default route may search
    over pushes (:mod:`ocp.search.push_search`). ``machine`` is the machine that the system was built from, or
    None.

    ``rotating_entries`` are the indices into x of quaternions, and of origins that rotate about a
    centre of mass: their rows of the residual are ``x_next[i] - f`` with f an expression in (x, u)
    and the other entries of x_next; f need not be affine.

    Raises ``ValueError`` if a dimension does not fit or a symbol is not declared.
    """

    name: str
    x: ca.SX
    u: ca.SX
    x_next: ca.SX
    lam: ca.SX
    residual: ca.SX
    gap: ca.SX
    states: tuple[Signal, ...]
    inputs: tuple[Signal, ...]
    contacts: tuple[Signal, ...]
    h: ca.SX | float
    parameters: ParameterTable = field(default_factory=ParameterTable)
    phi: ca.SX | None = None
    mu_per_kappa: ca.SX | float | None = None
    gap_unit: str = "m"
    pairs: tuple[Pair, ...] = ()
    forces: ContactForces | None = None
    energy_balance: EnergyBalance | None = None
    referee_model: RefereeModel | None = None
    refinable: bool = False
    mass: ca.SX | None = None
    stiffness: ca.SX | None = None
    scene: bool = False
    machine: Mechanism | None = None
    rotating_entries: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if not self.pairs:
            normal_pairs = tuple(Pair("normal", i) for i in range(len(self.contacts)))
            object.__setattr__(self, "pairs", normal_pairs)
        expected = {
            "x": (self.x, len(self.states), "states"),
            "x_next": (self.x_next, len(self.states), "states"),
            "residual": (self.residual, len(self.states), "states"),
            "u": (self.u, len(self.inputs), "inputs"),
            "lam": (self.lam, len(self.contacts), "contacts"),
            "gap": (self.gap, len(self.contacts), "contacts"),
        }
        for name, (expression, size, plural) in expected.items():
            if expression.numel() != size:
                raise ValueError(
                    f"system {self.name!r}: {name} has {expression.numel()} entries, but there are"
                    f" {size} named {plural}; give {name} one entry for each"
                )
        for plural, signals in (("states", self.states), ("inputs", self.inputs), ("contacts", self.contacts)):
            names = [signal.name for signal in signals]
            if duplicates := sorted({name for name in names if names.count(name) > 1}):
                raise ValueError(f"system {self.name!r}: two {plural} have the name {duplicates[0]!r}; rename one")
        if len(self.pairs) != len(self.contacts):
            raise ValueError(
                f"system {self.name!r}: {len(self.pairs)} pairs for {len(self.contacts)} named"
                " contacts; give one for each entry of lam"
            )
        for signal, entry in zip(self.contacts, ca.vertsplit(ca.SX(self.gap)), strict=True):
            if entry.is_constant() and not float(entry) > 0:
                raise ValueError(
                    f"system {self.name!r}: the gap of {signal.name!r} is {float(entry):g} in every"
                    " state, so that its impulse is undetermined; make it depend on the state, or"
                    " leave the contact out"
                )
        symbols = (self.x, self.u, self.x_next, self.lam, self.parameters.vector)
        declared, used = (
            {str(symbol) for symbol in ca.symvar(ca.vertcat(*expressions))}
            for expressions in (symbols, (self.residual, self.gap))
        )
        if undeclared := sorted(used - declared):
            raise ValueError(
                f"system {self.name!r}: residual or gap uses {', '.join(undeclared)}, which is not"
                " a state, input, contact or declared parameter; declare it as a parameter"
            )

    @property
    def nx(self) -> int:
        """Number of states."""
        return len(self.states)

    @property
    def nu(self) -> int:
        """Number of inputs."""
        return len(self.inputs)

    @property
    def nlam(self) -> int:
        """Number of contact multipliers."""
        return len(self.contacts)

    @cached_property
    def _referee_model(self) -> RefereeModel | None:
        return by_true_distance(self) if self.referee_model is None else self.referee_model

    @cached_property
    def most_exact(self) -> ContactSystem:
        """The most exact model known of the same system, or the system itself.

        That model has true gaps at the next position in place of linearised gaps, and Coulomb friction with
        maximum dissipation in place of convex friction. Its x, u, x_next, h and parameters are the same; its
        lam and gap differ.
        """
        referee_model = self._referee_model
        return self if referee_model is None or referee_model.build is None else referee_model.build()

    @property
    def referee_note(self) -> str | None:
        """Improvement of :attr:`most_exact` over this system; None for a system without geometry."""
        return None if self._referee_model is None else self._referee_model.note

    @property
    def gap_kind(self) -> str | None:
        """Kind of the model's gaps, ``"true"`` or ``"linearised"``; None without distances."""
        if self.phi is None or not self.phi.numel() or self._referee_model is None:
            return None
        return "linearised" if TRUE_GAPS in self._referee_model.note else "true"

    @cached_property
    def distance_names(self) -> tuple[str, ...]:
        """Names of the entries of ``phi``: contacts first, then joint limits."""
        count = 0 if self.phi is None else self.phi.numel()
        kinds = [(pair.kind, signal.name) for pair, signal in zip(self.pairs, self.contacts, strict=True)]
        points = [name for kind, name in kinds if kind == "normal"]
        points = points if self.forces is None else list(self.forces.names)
        names = (*points, *(name for kind, name in kinds if kind == "limit"))
        return names if len(names) == count else tuple(f"distance {i}" for i in range(count))

    @cached_property
    def deciding_pairs(self) -> list[int]:
        """Index, for each pair, of the pair whose gap sets its mu."""
        return deciding_pairs(self.pairs)

    @cached_property
    def without_rotations(self) -> tuple[ca.SX, ca.SX]:
        """Residual that is affine in (x_next, lam), and gap, both without the rotating entries of x_next.

        The residual's rows of rotating entries are linearised at zero motion. In the gap these
        entries are replaced by their exact update from the other entries of x_next.
        """
        if not self.rotating_entries:
            return self.residual, self.gap
        rows, integrated = list(self.rotating_entries), self.integrate_rotations(self.x_next)
        other_entries = [i for i in range(self.nx) if i not in self.rotating_entries]
        expansion_point = self.expansion_state[other_entries]
        slope = ca.jacobian(integrated, self.x_next[other_entries])
        at_still, slope = ca.substitute([integrated, slope], [self.x_next[other_entries]], [expansion_point])
        residual = ca.SX(self.residual)
        residual[rows] = self.x_next[rows] - at_still - slope @ (self.x_next[other_entries] - expansion_point)
        return residual, ca.substitute(self.gap, self.x_next[rows], integrated)

    @cached_property
    def expansion_state(self) -> ca.SX:
        """The x_next (nx, 1) about which gaps are linearised: x, with velocities that rotate bodies set to zero."""
        start, rows = ca.SX(self.x), self.residual[list(self.rotating_entries)]
        for i in range(self.nx):
            if i not in self.rotating_entries and ca.depends_on(rows, self.x_next[i]):
                start[i] = 0
        return start

    def integrate_rotations(self, x_next: ca.SX) -> ca.SX:
        """Return the rotating entries (n, 1) of the next state, computed from its other entries."""
        rows = list(self.rotating_entries)
        quaternions = self.x_next[rows] - self.residual[rows]
        return ca.substitute(quaternions, self.x_next, x_next)

    @cached_property
    def _by_state(self) -> ca.SX:
        """Jacobian (nx, nx) of the residual with respect to x_next."""
        return ca.jacobian(self.without_rotations[0], self.x_next)

    @cached_property
    def has_variable_inertia(self) -> bool:
        """Whether the inertia of a step depends on the state that it starts from."""
        return bool(self.rotating_entries) or ca.depends_on(self._by_state, ca.vertcat(self.x, self.u))

    @cached_property
    def is_lcp(self) -> bool:
        """Whether contact is a linear complementarity problem with constant inertia and a P-matrix."""
        affine = self.reduced.affine and not self.has_variable_inertia
        if not affine:
            return False
        step_symbols = [self.x, self.u, self.parameters.vector]
        contact = ca.Function("contact", step_symbols, [self.reduced.F, self.reduced.z])
        return not has_open_multipliers(self.pairs, contact, self.parameters.values)

    @cached_property
    def reduced(self) -> ReducedContact:
        """The step solved for the next state, see :class:`ReducedContact`.

        Raises ``ValueError`` if the residual is not affine in ``(x_next, lam)``.
        """
        nx, nothing = self.nx, ca.SX.zeros(self.nlam)
        unknown, (residual, gap) = ca.vertcat(self.x_next, self.lam), self.without_rotations
        jacobian = ca.jacobian(residual, unknown)
        if ca.depends_on(jacobian, unknown):
            raise ValueError(f"system {self.name!r}: the step is not affine in (x_next, lam)")
        constant = ca.substitute(residual, unknown, ca.SX.zeros(unknown.numel()))
        solve = solve_without_pivoting if self.has_variable_inertia else ca.solve
        solved = -solve(jacobian[:, :nx], ca.horzcat(constant, jacobian[:, nx:]))
        # CasADi can replace a symbol only by an expression with an entry, even if this entry is zero.
        a, B = ca.densify(solved[:, 0]), solved[:, 1:]
        by_state, by_lam = (ca.jacobian(gap, symbols) for symbols in (self.x_next, self.lam))
        affine = not ca.depends_on(ca.vertcat(ca.vec(by_state), ca.vec(by_lam)), unknown)
        z = ca.substitute(gap, unknown, ca.vertcat(a, nothing))
        expansion_point = ca.vertcat(a if affine else self.expansion_state, nothing)
        gap, by_state, by_lam = ca.substitute([gap, by_state, by_lam], [unknown], [expansion_point])
        F = by_lam + by_state @ B
        return ReducedContact(a, B, z, F, z if affine else gap + by_state @ (a - self.expansion_state), affine)

    @cached_property
    def x_next_expr(self) -> ca.SX:
        """The next state (nx, 1), an expression in (x, u, lam, p); raises as :attr:`reduced` does."""
        if not self.has_variable_inertia:
            return self.reduced.a + self.reduced.B @ self.lam
        at_zero = ca.substitute(self.without_rotations[0], self.x_next, ca.SX.zeros(self.nx))
        solution = -solve_without_pivoting(self._by_state, ca.densify(at_zero))
        solution[list(self.rotating_entries)] = self.integrate_rotations(solution)
        return solution

    @cached_property
    def motion(self) -> ca.SX:
        """Residual (nx, 1) in a form whose Jacobian with respect to x_next has positive leading minors."""
        return self.residual if self.has_variable_inertia else self.x_next - self.x_next_expr


def check_shape(system: str, argument: str, expression: ca.SX, shape: tuple[int, int]) -> None:
    """Raise ``ValueError`` unless ``expression``, an argument of a builder, has this ``shape``."""
    if ca.SX(expression).shape != shape:
        raise ValueError(f"system {system!r}: {argument} has shape {ca.SX(expression).shape}, expected {shape}")
