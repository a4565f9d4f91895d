"""A mechanical system with contact, before a law closes its contact."""

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
    """The system solved for the next state: ``x_next = a + B lam``.

    ``a`` (nx, 1), ``B`` (nx, nlam), ``z`` (nlam, 1) the gap at ``lam = 0`` and ``F``
    (nlam, nlam) its derivative by lam are expressions in the state, the input and the parameters
    alone. Where ``affine``, ``gap = z + F lam`` for every lam. Elsewhere the derivative is taken at
    ``x_next = x``, where bodies have not turned and F is the symmetric ``J M^-1 J'`` of a
    linearised gap, whose value at ``lam = 0`` is ``z_linear``.
    """

    a: ca.SX
    B: ca.SX
    z: ca.SX
    F: ca.SX
    z_linear: ca.SX
    affine: bool


@dataclass(frozen=True, eq=False)
class ContactSystem:
    """One implicit step of a system: ``residual(x, u, x_next, lam, p) = 0`` and ``lam ⟂ gap``.

    ``residual`` (nx, 1) and ``gap`` (nlam, 1) are expressions in the symbols ``x`` (nx, 1), ``u``
    (nu, 1), ``x_next`` (nx, 1), ``lam`` (nlam, 1) and the parameters. The law of contact, which
    closes ``0 <= lam ⟂ gap >= 0``, is chosen later (:mod:`dynamics.contact`).

    ``phi`` are the true signed distances [m] as an expression in ``x`` alone, for the audit: a gap
    may be a linearisation of one. ``mu_per_kappa`` converts the log-barrier weight kappa [1/J] to
    the central-path parameter, ``mu = mu_per_kappa / kappa``.

    ``pairs`` give the meaning of each entry of ``lam``, by default the normal impulse of a contact
    of its own; ``forces`` add them up where there is friction, ``book`` has energy and momentum.

    Where the Jacobian of ``residual`` by ``x_next`` depends on the state, as where a mass matrix
    does, it must have positive leading minors, as a mass matrix has.

    ``sharp`` leads to the sharpest contact that is known for the system, see :attr:`most_exact`.
    ``refinable``: h only discretises, and ``h / 4`` is the same system, sampled more often.
    ``mass`` and ``stiffness`` are what must be positive definite, expressions in x and the
    parameters, where the system has them: M (nq, nq), of quasi-dynamics that of the free
    coordinates alone, and its actuators' K. ``scene``: bodies, pushers and obstacles of a scene
    with true gaps make it, so that the default route may search over pushes (:mod:`ocp.search.push_search`).
    ``machine``: what it was built from, where that was a machine.

    ``turning`` are the places in x of quaternions, and of origins that turn with one about another
    point: their rows of the residual are ``x_next[i] - f`` with f an expression in (x, u) and the
    other entries of x_next, and need not be affine.

    Raises ``ValueError`` when a dimension does not fit or a symbol is not declared.
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
            if twice := sorted({name for name in names if names.count(name) > 1}):
                raise ValueError(f"system {self.name!r}: two {plural} have the name {twice[0]!r}; rename one")
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
        """Number of contacts."""
        return len(self.contacts)

    @cached_property
    def _referee_model(self) -> RefereeModel | None:
        return by_true_distance(self) if self.referee_model is None else self.referee_model

    @cached_property
    def most_exact(self) -> ContactSystem:
        """The same system under the sharpest contact known for it, or the system itself.

        True gaps at the next position and Coulomb friction with maximum dissipation, where the
        model has expanded gaps or convex friction: same x, u, x_next, h and parameters, its own lam
        and gap.
        """
        sharp = self._referee_model
        return self if sharp is None or sharp.build is None else sharp.build()

    @property
    def referee_note(self) -> str | None:
        """Improvement of :attr:`most_exact` over the model; None for a system without geometry."""
        return None if self._referee_model is None else self._referee_model.note

    @property
    def gap_kind(self) -> str | None:
        """``"true"`` or ``"linearised"``, what the model's own gaps are; None without distances."""
        if self.phi is None or not self.phi.numel() or self._referee_model is None:
            return None
        return "linearised" if TRUE_GAPS in self._referee_model.note else "true"

    @cached_property
    def distance_names(self) -> tuple[str, ...]:
        """Names of the entries of ``phi``: those of the contacts, then those of joint limits."""
        count = 0 if self.phi is None else self.phi.numel()
        kinds = [(pair.kind, signal.name) for pair, signal in zip(self.pairs, self.contacts, strict=True)]
        points = [name for kind, name in kinds if kind == "normal"]
        points = points if self.forces is None else list(self.forces.names)
        names = (*points, *(name for kind, name in kinds if kind == "limit"))
        return names if len(names) == count else tuple(f"distance {i}" for i in range(count))

    @cached_property
    def deciding_pairs(self) -> list[int]:
        """For every pair the number of the pair whose gap decides its mu."""
        return deciding_pairs(self.pairs)

    @cached_property
    def without_rotations(self) -> tuple[ca.SX, ca.SX]:
        """Residual and gap with x_next's quaternions taken out of both.

        Where they turn, the residual has its expansion about no motion, and the gap has what the
        other entries make of them: the residual is affine in (x_next, lam), and its quaternions
        decide nothing else.
        """
        if not self.rotating_entries:
            return self.residual, self.gap
        rows, integrated = list(self.rotating_entries), self.integrate_rotations(self.x_next)
        others = [i for i in range(self.nx) if i not in self.rotating_entries]
        still = self.expansion_state[others]
        slope = ca.jacobian(integrated, self.x_next[others])
        at_still, slope = ca.substitute([integrated, slope], [self.x_next[others]], [still])
        residual = ca.SX(self.residual)
        residual[rows] = self.x_next[rows] - at_still - slope @ (self.x_next[others] - still)
        return residual, ca.substitute(self.gap, self.x_next[rows], integrated)

    @cached_property
    def expansion_state(self) -> ca.SX:
        """x_next about which gaps are expanded (nx, 1): x, without the velocities that turn."""
        start, rows = ca.SX(self.x), self.residual[list(self.rotating_entries)]
        for i in range(self.nx):
            if i not in self.rotating_entries and ca.depends_on(rows, self.x_next[i]):
                start[i] = 0
        return start

    def integrate_rotations(self, x_next: ca.SX) -> ca.SX:
        """Quaternions of the next state (n, 1) from its other entries."""
        rows = list(self.rotating_entries)
        quaternions = self.x_next[rows] - self.residual[rows]
        return ca.substitute(quaternions, self.x_next, x_next)

    @cached_property
    def _by_state(self) -> ca.SX:
        """Jacobian of the residual by x_next (nx, nx)."""
        return ca.jacobian(self.without_rotations[0], self.x_next)

    @cached_property
    def has_variable_inertia(self) -> bool:
        """Whether the inertia of the step depends on the state that it starts from."""
        return bool(self.rotating_entries) or ca.depends_on(self._by_state, ca.vertcat(self.x, self.u))

    @cached_property
    def is_lcp(self) -> bool:
        """Whether contact is a linear complementarity problem with a P-matrix of small graphs."""
        affine = self.reduced.affine and not self.has_variable_inertia
        if not affine:
            return False
        step_symbols = [self.x, self.u, self.parameters.vector]
        contact = ca.Function("contact", step_symbols, [self.reduced.F, self.reduced.z])
        return not has_open_multipliers(self.pairs, contact, self.parameters.values)

    @cached_property
    def reduced(self) -> ReducedContact:
        """The step solved for the next state, see :class:`ReducedContact`.

        Raises ``ValueError`` where the residual is not affine in ``(x_next, lam)``.
        """
        nx, nothing = self.nx, ca.SX.zeros(self.nlam)
        unknown, (residual, gap) = ca.vertcat(self.x_next, self.lam), self.without_rotations
        jacobian = ca.jacobian(residual, unknown)
        if ca.depends_on(jacobian, unknown):
            raise ValueError(f"system {self.name!r}: the step is not affine in (x_next, lam)")
        constant = ca.substitute(residual, unknown, ca.SX.zeros(unknown.numel()))
        solve = solve_without_pivoting if self.has_variable_inertia else ca.solve
        solved = -solve(jacobian[:, :nx], ca.horzcat(constant, jacobian[:, nx:]))
        # What is put in for a symbol must have an entry even where it is zero.
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
        """The next state (nx, 1) in terms of (x, u, lam, p); raises as :attr:`reduced` does."""
        if not self.has_variable_inertia:
            return self.reduced.a + self.reduced.B @ self.lam
        at_zero = ca.substitute(self.without_rotations[0], self.x_next, ca.SX.zeros(self.nx))
        solution = -solve_without_pivoting(self._by_state, ca.densify(at_zero))
        solution[list(self.rotating_entries)] = self.integrate_rotations(solution)
        return solution

    @cached_property
    def motion(self) -> ca.SX:
        """The residual in a form whose Jacobian by x_next has positive leading minors (nx, 1)."""
        return self.residual if self.has_variable_inertia else self.x_next - self.x_next_expr


def check_shape(system: str, argument: str, expression: ca.SX, shape: tuple[int, int]) -> None:
    """Raise ``ValueError`` where a builder's argument has another shape than documented."""
    if ca.SX(expression).shape != shape:
        raise ValueError(f"system {system!r}: {argument} has shape {ca.SX(expression).shape}, expected {shape}")
