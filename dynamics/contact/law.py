"""The protocol of a contact law: how it closes the complementarity of a system."""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import ClassVar

from dynamics.contact.affine_step import AffineStep
from dynamics.contact.closure import Branch, Closure, Schedule
from dynamics.contact.implicit_step import ImplicitStep
from dynamics.contact.step import Step
from dynamics.errors import InputError
from dynamics.settings import Configured
from dynamics.systems import LAW_PREFIX, ContactSystem, Parameter, ParameterTable


def by_mu(parameter: str, impulse: float, gap: float) -> Schedule:
    """Follow a central-path parameter from where impulse and gap have their own sizes."""
    return Schedule(LAW_PREFIX + parameter, impulse * gap, 0.2, parameter == "mu")


def by_sigma(gap: float) -> Schedule:
    """Follow a width of noise, gently: its tail is Gaussian, so narrow noise sees nothing far."""
    return Schedule(LAW_PREFIX + "sigma", 3 * gap, 0.55)


class ContactLaw(Configured, Closure):
    """A closure with settings, its parameters, and the step that it makes.

    A law is a dataclass whose settings are declared by :func:`dynamics.settings.setting`.

    Each of its :meth:`parameters` is named ``contact.<name>`` and a parameter of every graph.
    """

    summary: ClassVar[str]
    source: ClassVar[str | None] = None
    """File of a user that defines the law; None for laws of the workbench."""
    source_digest: ClassVar[str | None] = None
    """SHA-256 of that file and of what it imports."""

    @abstractmethod
    def parameters(self, system: ContactSystem) -> ParameterTable:
        """Parameters of the law for this system, with units and values."""

    def settings(self) -> dict[str, float | int | str]:
        """Return what was chosen, for the run's record."""
        return {key: value for key, value in vars(self).items() if value is not None}

    def __repr__(self) -> str:
        plain_types = int | float | str | ContactLaw
        plain_settings = ((key, value) for key, value in vars(self).items() if isinstance(value, plain_types))
        arguments = ", ".join(f"{key}={value!r}" for key, value in plain_settings)
        return f"{type(self).__name__}({arguments})"

    def close(self, system: ContactSystem) -> Step:
        """Close the contact of ``system``; raises ``ValueError`` where the law cannot take it."""
        p = self.parameters(system)
        return self.close_at_nodes(system, self, p, tuple(self.nodes(system, p)))

    def close_at_nodes(self, system: ContactSystem, law: Closure, p: ParameterTable, nodes: tuple[Branch, ...]) -> Step:
        """The step that this law makes at ``nodes``, for ``law``: itself, or its average."""
        step_class = AffineStep if system.is_lcp else ImplicitStep
        return step_class(system, law, p, nodes)

    def at(self, **values: float) -> ContactLaw:
        """Return the same law with other values of its settings."""
        arguments = {**self.settings(), **values}
        return type(self)(**arguments)  # pyright: ignore[reportCallIssue]


def law_parameter(name: str, value: float, unit: str, description: str) -> Parameter:
    """Make the parameter ``contact.<name>`` of a law.

    Raises ``ValueError`` unless ``value`` is positive and finite.
    """
    if not (math.isfinite(value) and value > 0):
        raise InputError(f"contact: {name} must be positive and finite, got {value}")
    return Parameter(LAW_PREFIX + name, float(value), unit, description)
