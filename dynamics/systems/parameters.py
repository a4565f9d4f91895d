"""Named symbols with units: what a state, an input, a contact or a parameter is called."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import casadi as ca
import numpy as np


@dataclass(frozen=True)
class Signal:
    """One component of a state, an input or a contact vector: its name, unit and meaning."""

    name: str
    unit: str
    description: str = ""


@dataclass(frozen=True, eq=False)
class Parameter:
    """A scalar that a study may turn: a symbol in the graph with a default value."""

    name: str
    value: float
    unit: str = "1"
    description: str = ""
    symbol: ca.SX | None = None

    def __post_init__(self) -> None:
        if self.symbol is None:
            object.__setattr__(self, "symbol", ca.SX.sym(self.name))


class ParameterTable:
    """An ordered set of parameters, read by name, as one symbolic vector or as its values."""

    def __init__(self, parameters: Iterable[Parameter] = ()) -> None:
        self._by_name = {parameter.name: parameter for parameter in parameters}

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self._by_name.values())

    def __len__(self) -> int:
        return len(self._by_name)

    def __contains__(self, name: object) -> bool:
        return name in self._by_name

    def __getitem__(self, name: str) -> ca.SX:
        """Return the symbol called ``name``."""
        symbol = self._by_name[name].symbol
        assert symbol is not None
        return symbol

    def __add__(self, other: ParameterTable) -> ParameterTable:
        clash = set(self._by_name) & set(other._by_name)
        same = all(self._by_name[name] is other._by_name[name] for name in clash)
        if not same:
            raise ValueError(f"two different parameters share the name {sorted(clash)[0]!r}")
        return ParameterTable([*self, *other])

    @property
    def names(self) -> list[str]:
        """Names, in order."""
        return list(self._by_name)

    @property
    def vector(self) -> ca.SX:
        """All symbols as one column, shape (n, 1)."""
        return ca.vertcat(ca.SX(0, 1), *(self[name] for name in self._by_name))

    @property
    def values(self) -> np.ndarray:
        """Default values, shape (n,)."""
        return np.array([parameter.value for parameter in self], dtype=float)

    def index(self, name: str) -> int:
        """Return the position of ``name`` in :attr:`vector`."""
        return self.names.index(name)

    def get(self, name: str) -> Parameter:
        """Return the parameter called ``name``."""
        return self._by_name[name]


def signals(text: str) -> tuple[Signal, ...]:
    """Read ``"x [m] position; v [m/s] velocity"`` into signals."""
    found = []
    for item in text.split(";"):
        name, _, rest = item.strip().partition("[")
        unit, _, description = rest.partition("]")
        found.append(Signal(name.strip(), unit.strip() or "1", description.strip()))
    return tuple(found)
