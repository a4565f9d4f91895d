"""A mechanical system with contact, before any law says how the contact closes."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import casadi as ca

from dynamics.systems.parameters import ParameterTable, Signal


@dataclass(frozen=True, eq=False)
class AffineContact:
    """The system solved for the next state: ``x_next = a + B lam`` and ``gap = z + F lam``.

    ``a`` (nx, 1), ``B`` (nx, nlam), ``z`` (nlam, 1) the gap at ``lam = 0``, ``F`` (nlam, nlam);
    all are expressions in the state, the input and the parameters alone.
    """

    a: ca.SX
    B: ca.SX
    z: ca.SX
    F: ca.SX


@dataclass(frozen=True, eq=False)
class ContactSystem:
    """One implicit step of a system: ``residual(x, u, x_next, lam, p) = 0`` and ``lam ⟂ gap``.

    ``residual`` (nx, 1) and ``gap`` (nlam, 1) are expressions in the symbols ``x`` (nx, 1), ``u``
    (nu, 1), ``x_next`` (nx, 1), ``lam`` (nlam, 1) and the parameters. The law of contact, which
    closes ``0 <= lam ⟂ gap >= 0``, is chosen later (:mod:`dynamics.contact`).

    ``phi`` is the true signed distance [m] of each contact as an expression in ``x`` alone, for
    the audit: a gap may be a linearisation of it. ``mu_per_kappa`` converts the log-barrier
    weight kappa [1/J] to the central-path parameter, ``mu = mu_per_kappa / kappa``.

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
    citation: str = ""

    def __post_init__(self) -> None:
        expected = {
            "x": (self.x, len(self.states), "states"),
            "x_next": (self.x_next, len(self.states), "states"),
            "residual": (self.residual, len(self.states), "states"),
            "u": (self.u, len(self.inputs), "inputs"),
            "lam": (self.lam, len(self.contacts), "contacts"),
            "gap": (self.gap, len(self.contacts), "contacts"),
        }
        for what, (expression, size, of) in expected.items():
            if expression.numel() != size:
                raise ValueError(
                    f"system {self.name!r}: {what} has {expression.numel()} entries, but there are"
                    f" {size} named {of}; give {what} one entry for each"
                )
        known = ca.vertcat(self.x, self.u, self.x_next, self.lam, self.parameters.vector)
        undeclared = _free_symbols(ca.vertcat(self.residual, self.gap), known)
        if undeclared:
            raise ValueError(
                f"system {self.name!r}: residual or gap uses {', '.join(undeclared)}, which is no"
                " state, input, contact or declared parameter; declare it as a parameter"
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
    def affine(self) -> AffineContact:
        """The step solved for the next state, see :class:`AffineContact`.

        Raises ``ValueError`` where residual or gap is not affine in ``(x_next, lam)``.
        """
        unknown = ca.vertcat(self.x_next, self.lam)
        relations = ca.vertcat(self.residual, self.gap)
        jacobian = ca.jacobian(relations, unknown)
        if ca.depends_on(jacobian, unknown):
            raise ValueError(f"system {self.name!r}: the step is not affine in (x_next, lam)")
        constant = ca.substitute(relations, unknown, ca.SX.zeros(unknown.numel()))
        nx = self.nx
        solved = -ca.solve(jacobian[:nx, :nx], ca.horzcat(constant[:nx], jacobian[:nx, nx:]))
        a, B = solved[:, 0], solved[:, 1:]
        z = constant[nx:] + jacobian[nx:, :nx] @ a
        F = jacobian[nx:, nx:] + jacobian[nx:, :nx] @ B
        return AffineContact(a, B, z, F)


def check_shape(system: str, what: str, expression: ca.SX, shape: tuple[int, int]) -> None:
    """Raise ``ValueError`` where a builder's argument has another shape than its docstring says."""
    if ca.SX(expression).shape != shape:
        raise ValueError(
            f"system {system!r}: {what} has shape {ca.SX(expression).shape}, expected {shape}"
        )


def _free_symbols(expression: ca.SX, known: ca.SX) -> list[str]:
    names = {str(symbol): symbol for symbol in ca.symvar(expression)}
    declared = [str(symbol) for symbol in ca.symvar(known)]
    return sorted(set(names) - set(declared))
