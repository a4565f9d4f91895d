"""Equations, units and symbols as pages and terminals show them."""

from __future__ import annotations

import re

_TOKEN = re.compile(
    r'"(?P<text>[^"]*)"'
    r"|(?P<sum>sum_\((?P<index>\w+)=[^)]*\)\^\([^)]*\))"
    r"|(?P<word>[A-Za-z]+(?:\.[a-z]+)*)"
    r"|(?P<fraction> */ *| *\\/ *)"
    r"|(?P<other>.)"
)
"""Tokens of typst's mathematics."""
_PLAIN_WORDS = {
    "lambda": "lam",
    "perp": "⟂",
    "quad": "",
    "min": "minimise ",
    "max": "maximise ",
    "tilde": "~",
    "infinity": "∞",
    "dots": "...",
    "plus.minus": "±",
    "top": "'",
    "dot": "·",
    "delta": "d",
    "dif": "d",
}
"""Names of typst's mathematics in plain characters."""
_AROUND = {"norm": "||", "abs": "||", "dot": " '", "macron": "  "}
"""Text before and behind a function's argument, instead of its name and brackets."""


def plain(line: str) -> str:
    """Write ``line`` of typst's mathematics as a terminal shows it: ``abs(x)^2`` as ``|x|²``."""
    tokens, open_brackets = [], []
    brackets = ""
    for match in _TOKEN.finditer(line):
        token = match.group()
        if match["text"] is not None:
            token = match["text"]
        elif match["sum"]:
            token = f"sum_{match['index']}"
        elif match["word"] and line[match.end() : match.end() + 1] == "(" and token in _AROUND:
            brackets, token = _AROUND[token], ""
        elif match["word"]:
            token = _PLAIN_WORDS.get(token, token)
        elif match["fraction"]:
            token = "/"
        elif token == "(":
            open_brackets.append(brackets or "()")
            token, brackets = open_brackets[-1][0].strip(), ""
        elif token == ")" and open_brackets:
            token = open_brackets.pop()[1].strip()
        tokens.append(token)
    return _tidy("".join(tokens))


def _tidy(text: str) -> str:
    """Write powers as superscripts, derivatives as ``dF/dx``, and a difference as one word."""
    for sign, replacement in (
        ("^2", "²"),
        ("^4", "⁴"),
        ("^+", "+"),
        ("^-", "-"),
        ("^±", "±"),
        ("^'", "'"),
        ("_+", "+"),
        ("_-", "-"),
        ("_±", "±"),
    ):
        text = text.replace(sign, replacement)
    text = re.sub(r"\(d (\w+)\)", r"d\1", text)
    return re.sub(r"\bd (?=[a-z]_|q\b)", "d", text).strip()


_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
"""Translation of digits into superscripts."""
GREEK = {
    "alpha": "α",
    "beta": "β",
    "gamma": "γ",
    "delta": "δ",
    "epsilon": "ε",
    "eta": "η",
    "theta": "θ",
    "kappa": "κ",
    "mu": "μ",
    "nu": "ν",
    "rho": "ρ",
    "sigma": "σ",
    "tau": "τ",
    "phi": "φ",
    "psi": "ψ",
    "omega": "ω",
}
"""Greek letters by name."""
_LAW_SYMBOLS = (("lam", "λ"), ("mu", "μ"), ("<=", "≤"), (">=", "≥"))
"""Words in the summaries of laws, with their symbols."""


def powers(unit: str) -> str:
    """Write ``m/s^2`` as ``m/s²``, ``1/m^2`` as ``m⁻²`` and the unit of a number as ""."""
    if unit == "1":
        return ""
    if reciprocal := re.fullmatch(r"1/([A-Za-z]+)(?:\^(\d+))?", unit):
        return reciprocal[1] + f"-{reciprocal[2] or 1}".translate(_SUPERSCRIPTS)
    return re.sub(r"\^(-?\d+)", lambda power: power[1].translate(_SUPERSCRIPTS), unit)


def label(name: str, unit: str) -> str:
    """Return the label of an axis: a name with its unit in brackets."""
    unit_text = powers(unit)
    return f"{name} [{unit_text}]" if unit_text else name


def symbol(name: str) -> str:
    """Write ``contact.mu`` as ``μ`` and ``nu`` as ``ν``; other names stay as they are typed."""
    last = name.rpartition(".")[2]
    return GREEK.get(last, last)


def in_symbols(line: str) -> str:
    """Replace names in the summary of a law by symbols: ``lam gap = mu`` by ``λ gap = μ``."""
    for word, sign in _LAW_SYMBOLS:
        line = re.sub(rf"(?<!\w){re.escape(word)}(?!\w)", sign, line)
    return line
