"""Equations, units and symbols in the notation of pages and terminals."""

from __future__ import annotations

import re

_TOKEN = re.compile(
    r'"(?P<text>[^"]*)"'
    r"|(?P<sum>sum_\((?P<index>\w+)=[^)]*\)\^\([^)]*\))"
    r"|(?P<word>[A-Za-z]+(?:\.[a-z]+)*)"
    r"|(?P<fraction> */ *| *\\/ *)"
    r"|(?P<other>.)"
)
"""Pattern of the tokens of mathematics in typst."""
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
"""Mapping from names in typst's mathematics to plain characters."""
_AROUND = {"norm": "||", "abs": "||", "dot": " '", "macron": "  "}
"""Mapping from functions of typst's mathematics to the two characters around their argument in plain text."""


def plain(line: str) -> str:
    """Return a line of mathematics in typst as plain text, such as ``|x|²`` for ``abs(x)^2``."""
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
    """Return the text with powers as superscripts, derivatives as ``dF/dx``, and ``dq`` for ``d q``."""
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
"""Translation table from digits and minus signs to superscripts."""
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
"""Mapping from names of Greek letters to the letters."""
_LAW_SYMBOLS = (("lam", "λ"), ("mu", "μ"), ("<=", "≤"), (">=", "≥"))
"""Mapping from words in the summaries of laws to symbols."""


def powers(unit: str) -> str:
    """Return a unit with superscripts, such as ``m/s²`` for ``m/s^2`` and ``m⁻²`` for ``1/m^2``; "" for "1"."""
    if unit == "1":
        return ""
    if reciprocal := re.fullmatch(r"1/([A-Za-z]+)(?:\^(\d+))?", unit):
        return reciprocal[1] + f"-{reciprocal[2] or 1}".translate(_SUPERSCRIPTS)
    return re.sub(r"\^(-?\d+)", lambda power: power[1].translate(_SUPERSCRIPTS), unit)


def label(name: str, unit: str) -> str:
    """Return the label of an axis: a name followed by its unit in brackets."""
    unit_text = powers(unit)
    return f"{name} [{unit_text}]" if unit_text else name


def symbol(name: str) -> str:
    """Return ``μ`` for ``contact.mu``, ``ν`` for ``nu``, and other names without their prefix."""
    last = name.rpartition(".")[2]
    return GREEK.get(last, last)


def in_symbols(line: str) -> str:
    """Return a law's summary with symbols for names, such as ``λ gap = μ`` for ``lam gap = mu``."""
    for name, sign in _LAW_SYMBOLS:
        line = re.sub(rf"(?<!\w){re.escape(name)}(?!\w)", sign, line)
    return line
