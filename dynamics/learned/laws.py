"""Learned contact laws: the exponentially weighted distance average of data, and networks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, runtime_checkable

import casadi as ca

from dynamics.contact.closure import Branch, Closure
from dynamics.contact.law import ContactLaw
from dynamics.contact.learned_step import CasadiMap, LearnedMap, LearnedStep
from dynamics.contact.step import Step
from dynamics.errors import InputError
from dynamics.settings import setting
from dynamics.systems import LAW_PREFIX, ContactSystem, Parameter, ParameterTable

if TYPE_CHECKING:
    from dynamics.learned.transitions import DataOrigin


@runtime_checkable
class StepModel(LearnedMap, Protocol):
    """Interface of a model from state and input to the next state, with the origin of its data."""

    kind: ClassVar[str]

    @property
    def origin(self) -> DataOrigin:
        """Names and units of inputs and outputs, and problem, parameters and hash of the training data."""
        ...


@dataclass(eq=False, repr=False)
class LearnedLaw(ContactLaw):
    """Contact law ``x_next = g(x, u)`` of a model g learned from transitions; the step has no multipliers.

    ``model`` is the model or the path of its file. Raises ``ValueError`` for a file that does not
    contain such a model.
    """

    model: Any = setting(None, "file of a model, made by ocp learn; required")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.model is None:
            raise InputError(f"{self.name}: a learned law needs its model; give model=FILE, made by ocp learn")
        self._stated = self.model
        # Imported here: no other law reads files.
        from dynamics.learned.files import read_model

        loaded: StepModel = read_model(Path(self.model)) if isinstance(self.model, str | Path) else self.model
        if loaded.kind != self.name:
            raise InputError(
                f"{self.name}: {self.model} is a model of kind {loaded.kind}; use --contact"
                f" {loaded.kind}, or learn one with --model {self.name}"
            )
        self.model = loaded
        self._map = CasadiMap(loaded)

    def settings(self) -> dict[str, float | int | str]:
        """Return the path of the model's file, or the hash of its data if it was not read from a file."""
        from_file = isinstance(self._stated, (str, Path))
        return {"model": str(self._stated) if from_file else self.model.origin.data_hash}

    def at(self, **values: Any) -> ContactLaw:
        """Return the same law with other values of its settings."""
        return type(self)(**{**self.settings(), "model": self._stated, **values})

    def parameters(self, system: ContactSystem) -> ParameterTable:
        """Return an empty table; raise ``ValueError`` unless the model has the states and inputs of ``system``."""
        for kind, trained_signals, system_signals in (
            ("states", self.model.origin.y, system.states),
            ("inputs", self.model.origin.inputs, system.inputs),
        ):
            if [s.name for s in trained_signals] != [s.name for s in system_signals]:
                raise ValueError(
                    f"{self.name}: the model was trained on {kind}"
                    f" {', '.join(s.name for s in trained_signals)}, but {system.name} has"
                    f" {', '.join(s.name for s in system_signals)}; give a model of this problem"
                )
        return ParameterTable()

    def learned_at(self, system: ContactSystem, values: Mapping[str, float]) -> dict[str, tuple[float, float]]:
        """Return a dict of the motion parameters changed since training: name to (trained value, current value)."""
        motion_symbols = {str(symbol) for symbol in ca.symvar(ca.vertcat(system.residual, system.gap))}
        training_parameters = self.model.origin.parameters
        return {
            name: (float(training_parameters[name]), values[name])
            for name in system.parameters.names
            if name in motion_symbols
            and isinstance(training_parameters.get(name), int | float)
            and training_parameters[name] != values[name]
        }

    def target(self, system: ContactSystem, z: ca.SX, F: ca.SX, p: ParameterTable) -> ca.SX:
        """Return an empty mu (0, 1), since a learned step has no contact pairs."""
        return ca.SX(0, 1)

    def close_at_nodes(self, system: ContactSystem, law: Closure, p: ParameterTable, nodes: tuple[Branch, ...]) -> Step:
        """Return the step of the learned model."""
        name = LAW_PREFIX + "trust"
        trust = p[name] if name in p.names else None
        return LearnedStep(system, law, p, nodes, self._map, trust)


@dataclass(eq=False, repr=False)
class Ewda(LearnedLaw):
    """Contact law given by the exponentially weighted distance average of transitions (Suh et al., "noising", eq. 11).

    ``trust`` adds ``-trust log p_sigma(x, u)`` to the stage cost, so that plans stay near the data; p_sigma is the
    density of the data smoothed by the same noise, in normalised units.
    """

    name: ClassVar[str] = "ewda"
    summary: ClassVar[str] = "distance-weighted average of transitions, from a model file"

    trust: float = setting(0.0, "weight of -log p of the data in the stage cost", least=0)

    def settings(self) -> dict[str, float | int | str]:
        """Return the model's file and the weight ``trust``, for the record of the run."""
        return {**super().settings(), "trust": self.trust}

    def parameters(self, system: ContactSystem) -> ParameterTable:
        """Return the parameter ``contact.trust``; raise ``ValueError`` as :meth:`LearnedLaw.parameters` does."""
        meaning = "weight of -log p of the data in the stage cost"
        weight = Parameter(LAW_PREFIX + "trust", self.trust, "1", meaning)
        return super().parameters(system) + ParameterTable([weight])


@dataclass(eq=False, repr=False)
class Mlp(LearnedLaw):
    """Contact law given by a network trained on clean or noised transitions (Suh et al., "noising", eq. 3)."""

    name: ClassVar[str] = "mlp"
    summary: ClassVar[str] = "network trained on transitions, from a model file"
