"""The base class of contact laws, which replace the complementarity of a system by a smoothed relation."""

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
    """Return the homotopy along a central-path parameter; its first value is the characteristic impulse times gap."""
    return Schedule(LAW_PREFIX + parameter, impulse * gap, 0.2, parameter == "mu")


def by_sigma(gap: float) -> Schedule:
    """Return the homotopy along the standard deviation of the noise, in small steps since Gaussian tails are thin."""
    return Schedule(LAW_PREFIX + "sigma", 3 * gap, 0.55)


class ContactLaw(Configured, Closure):
    """Base class of contact laws, which have settings and parameters and close a system to a step.

    A law is a dataclass whose settings are declared by :func:`dynamics.settings.setting`.

    Its :meth:`parameters` have names ``contact.<name>`` and are parameters of every graph.
    """

    summary: ClassVar[str]
    source: ClassVar[str | None] = None
    """The user's file that defines the law; None for laws of the workbench."""
    source_digest: ClassVar[str | None] = None
    """SHA-256 of the user's file and of the files that it imports; None for laws of the workbench."""

    @abstractmethod
    def parameters(self, system: ContactSystem) -> ParameterTable:
        """Return the parameters of the law for this system, with units and values."""

    def settings(self) -> dict[str, float | int | str]:
        """Return the settings that are not None, for the record of the run."""
        return {key: value for key, value in vars(self).items() if value is not None}

    def __repr__(self) -> str:
        plain_types = int | float | str | ContactLaw
        plain_settings = ((key, value) for key, value in vars(self).items() if isinstance(value, plain_types))
        arguments = ", ".join(f"{key}={value!r}" for key, value in plain_settings)
        return f"{type(self).__name__}({arguments})"

    def close(self, system: ContactSystem) -> Step:
        """Return the step of ``system`` closed by this law; raise ``ValueError`` if the law does not apply to it."""
        p = self.parameters(system)
        return self.close_at_nodes(system, self, p, tuple(self.nodes(system, p)))

    def close_at_nodes(self, system: ContactSystem, law: Closure, p: ParameterTable, nodes: tuple[Branch, ...]) -> Step:
        """Return the step of ``system`` under ``law``, which is this law or an average of it, solved at ``nodes``."""
        step_class = AffineStep if system.is_lcp else ImplicitStep
        return step_class(system, law, p, nodes)

    def at(self, **values: float) -> ContactLaw:
        """Return the same law with other values of its settings."""
        arguments = {**self.settings(), **values}
        return type(self)(**arguments)  # pyright: ignore[reportCallIssue]


def law_parameter(name: str, value: float, unit: str, description: str) -> Parameter:
    """Return the parameter ``contact.<name>`` of a law; raise ``ValueError`` unless it is positive and finite."""
    if not (math.isfinite(value) and value > 0):
        raise InputError(f"contact: {name} must be positive and finite, got {value}")
    return Parameter(LAW_PREFIX + name, float(value), unit, description)
