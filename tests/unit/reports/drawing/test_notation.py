"""Notation: typst and the terminal show the same symbols."""

from __future__ import annotations

import re

import pytest

from problems.registry import named, names, objective_names
from reports.drawing.notation import plain

_MARKUP = re.compile(r'["\\^]|\b(quad|norm|abs|lambda|perp|dif|delta|macron)\b')


@pytest.mark.parametrize(
    ("typst", "shown"),
    [
        ('w tilde "N"(0, sigma^2)', "w ~ N(0, sigma²)"),
        ("0 <= lambda perp x^+ >= 0", "0 <= lam ⟂ x+ >= 0"),
        ('M / h q_u^+ = lambda, quad abs(u) <= u_"max"', "M/h q_u+ = lam,  |u| <= u_max"),
        ('min sum_(k=0)^(N-1) w norm(q_k - q_"goal")^2', "minimise  sum_k w |q_k - q_goal|²"),
        ("dot(theta)_0 = (v, dot(p))", "theta'_0 = (v, p')"),
        ("macron(H)_nu (2 t \\/ nu, (1 + (a)))", "H_nu (2 t/nu, (1 + (a)))"),
        ("w_(delta u) delta u_k^2, (dif F) / (dif theta)", "w_du du_k², dF/dtheta"),
        ("lambda_plus.minus, J^top beta^- delta q", "lam±, J' beta- dq"),
        ('c "the cart, norm(x) quad"', "c the cart, norm(x) quad"),
    ],
)
def test_a_line_in_plain_characters(typst: str, shown: str) -> None:
    assert plain(typst) == shown


@pytest.mark.parametrize("name", [*names(), *objective_names()])
def test_no_markup_is_left_and_no_bracket_lost(name: str) -> None:
    for line in named(name).equations:
        shown = plain(line)
        assert not re.search(r'["\\^]|\b(quad|norm|abs|lambda|perp|dif|delta|macron)\b', shown), shown
        assert shown.count("(") == shown.count(")")
        assert shown.count("|") % 2 == 0
        words = {word for text in re.findall('"([^"]*)"', line) for word in text.split()}
        assert all(word in shown for word in words)
