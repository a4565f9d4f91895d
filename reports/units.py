"""Units and symbols as a page shows them."""

from __future__ import annotations

import re

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_GREEK = {
    "alpha": "α", "beta": "β", "gamma": "γ", "delta": "δ", "epsilon": "ε", "eta": "η",
    "theta": "θ", "kappa": "κ", "mu": "μ", "nu": "ν", "rho": "ρ", "sigma": "σ", "tau": "τ",
    "phi": "φ", "psi": "ψ", "omega": "ω",
}  # fmt: skip
_LAW = (("lam", "λ"), ("mu", "μ"), ("<=", "≤"), (">=", "≥"))


def powers(unit: str) -> str:
    """Write ``m/s^2`` as ``m/s²``, ``1/m^2`` as ``m⁻²`` and that of a number as nothing."""
    if unit == "1":
        return ""
    if found := re.fullmatch(r"1/([A-Za-z]+)(?:\^(\d+))?", unit):
        return found[1] + f"-{found[2] or 1}".translate(_RAISED)
    return re.sub(r"\^(-?\d+)", lambda power: power[1].translate(_RAISED), unit)


def label(name: str, unit: str) -> str:
    """Axis label: a name with its unit in brackets."""
    shown = powers(unit)
    return f"{name} [{shown}]" if shown else name


def symbol(name: str) -> str:
    """Write ``contact.mu`` as ``μ`` and ``nu`` as ``ν``; other names stay as they are typed."""
    last = name.rpartition(".")[2]
    return _GREEK.get(last, last)


def in_symbols(line: str) -> str:
    """Write what a law says of itself, ``lam gap = mu``, with symbols: ``λ gap = μ``."""
    for word, sign in _LAW:
        line = re.sub(rf"(?<!\w){re.escape(word)}(?!\w)", sign, line)
    return line
