"""Names, units and symbols of states, inputs, contacts and parameters."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from dynamics.systems.checks import parse_number, require_items, require_text

LAW_PREFIX = "contact."
"""Prefix of the names of a contact law's parameters; parameters of problems do not have it."""


@dataclass(frozen=True)
class Signal:
    """One component of a state, an input or a contact vector: its name, unit and meaning.

    Raises ``ValueError`` for an empty name and for unprintable characters.
    """

    name: str
    unit: str
    description: str = ""

    def __post_init__(self) -> None:
        for field, content in (("name", self.name), ("unit", self.unit), ("meaning", self.description)):
            if not content.isprintable():
                raise ValueError(f"the {field} {content!r} of a signal has unprintable characters")
        if not self.name:
            raise ValueError("a signal has no name; write it as 'x [m] position'")


@dataclass(frozen=True, eq=False)
class Parameter:
    """A scalar that studies may vary: a symbol of the expression graph with a default value.

    Raises ``ValueError`` for an empty name and a value that is not a finite number.
    """

    name: str
    value: float
    unit: str = "1"
    description: str = ""
    symbol: ca.SX | None = None

    def __post_init__(self) -> None:
        require_text("the name of a parameter", self.name)
        if parse_number(f"the value of parameter {self.name!r}", self.value) is None:
            raise ValueError(f"the value of parameter {self.name!r} must be a number, not a symbol")
        if self.symbol is None:
            object.__setattr__(self, "symbol", ca.SX.sym(self.name))


def matrix_parameters(name: str, values: ArrayLike, unit: str = "1") -> list[Parameter]:
    """Return a parameter for each entry of a matrix, called ``name[i,j]``, or ``name[i]`` for a vector."""
    return [
        Parameter(f"{name}[{','.join(map(str, index))}]", float(value), unit)
        for index, value in np.ndenumerate(np.asarray(values))
    ]


class ParameterTable:
    """An ordered set of named parameters, also available as a symbolic vector and its values.

    :meth:`pack` converts a mapping from names to values into the vector, :meth:`unpack` converts
    back. Parameters of a contact law are called ``contact.<name>``; the entries of a matrix,
    ``F[i,j]``, can also be read and set together as ``F``.

    Raises ``ValueError`` for an item that is not a :class:`Parameter`, and for two parameters of the same name.
    """

    def __init__(self, parameters: Iterable[Parameter] = ()) -> None:
        self._by_name: dict[str, Parameter] = {}
        for parameter in require_items("the parameters of a table", Parameter, parameters):
            if self._by_name.setdefault(parameter.name, parameter) is not parameter:
                raise ValueError(f"two different parameters share the name {parameter.name!r}; rename one")

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self._by_name.values())

    def __len__(self) -> int:
        return len(self._by_name)

    def __contains__(self, name: object) -> bool:
        return name in self._by_name

    def __getitem__(self, name: str) -> ca.SX:
        """Return the symbol called ``name``, or the matrix of the symbols called ``name[i,j]``."""
        if name in self._by_name:
            symbol = self._by_name[name].symbol
            assert symbol is not None
            return symbol
        entries = {_entry(n)[1]: self[n] for n in self._by_name if _entry(n)[0] == name}
        if not entries:
            raise KeyError(f"no parameter {name!r}; available: {', '.join(self.names)}")
        matrix = ca.SX(*(1 + np.max(list(entries), axis=0)))
        for index, symbol in entries.items():
            matrix[index] = symbol
        return matrix

    def __add__(self, other: ParameterTable) -> ParameterTable:
        return ParameterTable([*self, *other])

    @property
    def names(self) -> list[str]:
        """Names of the parameters, in the order of :attr:`vector`."""
        return list(self._by_name)

    @property
    def vector(self) -> ca.SX:
        """Symbols of all parameters as one column, shape (n, 1)."""
        return ca.vertcat(ca.SX(0, 1), *(self[name] for name in self._by_name))

    @property
    def values(self) -> np.ndarray:
        """Default values of all parameters, shape (n,)."""
        return np.array([parameter.value for parameter in self], dtype=float)

    @property
    def units(self) -> dict[str, str]:
        """Mapping from each parameter's name to its unit."""
        return {parameter.name: parameter.unit for parameter in self}

    @property
    def defaults(self) -> dict[str, float]:
        """Mapping from each parameter's name to its default value."""
        return self.unpack(self.values)

    def pack(self, values: Mapping[str, ArrayLike] | None = None, **law: ArrayLike) -> np.ndarray:
        """Return the mapping ``values`` from names to values as a vector (n,); missing parameters have their defaults.

        ``law`` are parameters of a contact law, named without the prefix ``contact.``. Values may be arrays
        over samples, (k,) for a number or (k, rows, columns) for a matrix; then the result is (k, n). Unknown
        names in ``values`` are ignored, unknown names in ``law`` raise ``KeyError``.
        """
        for name in law:
            if LAW_PREFIX + name not in self:
                raise KeyError(f"no law parameter {name!r}; available: {', '.join(self.names)}")
        given_values = {**(values or {}), **{LAW_PREFIX + name: value for name, value in law.items()}}
        packed = [self._value_of(parameter, given_values) for parameter in self]
        try:
            return np.array(packed, dtype=float).T
        except ValueError:
            # Some values are numbers, others are arrays over samples.
            return np.array(np.broadcast_arrays(*packed), dtype=float).T

    def unpack(self, vector: ArrayLike) -> dict[str, float]:
        """Return a mapping from names to the values in a vector (n,)."""
        return dict(zip(self._by_name, np.asarray(vector, float).ravel().tolist(), strict=True))

    @staticmethod
    def _value_of(parameter: Parameter, values: Mapping[str, ArrayLike]) -> ArrayLike:
        if parameter.name in values:
            return values[parameter.name]
        matrix_name, index = _entry(parameter.name)
        return np.asarray(values[matrix_name])[..., *index] if matrix_name in values else parameter.value

    def get(self, name: str) -> Parameter:
        """Return the parameter called ``name``."""
        return self._by_name[name]


def _entry(name: str) -> tuple[str, tuple[int, ...]]:
    """Split a name such as ``A[0,1]`` into the matrix's name and the index; the index of other names is empty."""
    matrix_name, bracket, indices = name.partition("[")
    return matrix_name, tuple(int(index) for index in indices.rstrip("]").split(",")) if bracket else ()


def signals(definition: str) -> tuple[Signal, ...]:
    """Parse signals from a text such as ``"x [m] position; v [m/s] velocity"``.

    Raises ``ValueError`` for text of any other form.
    """
    require_text("signals", definition)
    parsed = []
    for item in definition.split(";"):
        name, opened, after_bracket = item.strip().partition("[")
        unit, closed, description = after_bracket.partition("]")
        # A single word is a name without unit; with several words, one of them may be intended as the
        # unit.
        if opened != "[" * len(closed) or (not opened and len(name.split()) > 1):
            raise ValueError(
                f"signals: {item.strip()!r} needs its unit in brackets; write it as 'x [m]"
                " position', with [1] where there is none"
            )
        parsed.append(Signal(name.strip(), unit.strip() or "1", description.strip()))
    return tuple(parsed)
