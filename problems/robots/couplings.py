"""Coupled joints of a compiled file: equality constraints that are linear in q."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from problems.robots.urdf import Mimic

EQUALITY_KINDS = ("connect", "weld", "joint", "tendon")
"""Kinds of equality constraints, in the order of MuJoCo's numbers; those of joints and fixed tendons are linear."""
EQUALITIES_DISABLED = 1 << 1
"""Bit of MuJoCo's ``disableflags`` that disables equality constraints."""
Equation = tuple[dict[int, float], float]
"""Linear equation of joints: mapping from joint number to coefficient (dependent joint first), and the sum."""


def equations(model: Any, mimics: Iterable[Mimic]) -> list[Equation]:
    """Return the equation ``sum(coefficient * q) = value`` of every active equality and of ``mimics``.

    Raises ``ValueError`` for a constraint that closes a loop, or is not linear.
    """
    rows: list[Equation] = []
    for k in _active(model):
        kind, name = int(model.eq_type[k]), model.equality(k).name
        if not 2 <= kind < len(EQUALITY_KINDS):
            element = EQUALITY_KINDS[kind] if kind < 2 else "constraint"
            raise ValueError(
                f"equality <{element}> {name!r} closes a loop, and joints form trees here; delete it to plan without it"
            )
        offset, slope, *curved = model.eq_data[k][:5].tolist()
        if any(curved):
            raise ValueError(f"equality {name!r} is not linear; give polycoef two numbers")
        first, second = (_length(model, kind, int(ids[k])) for ids in (model.eq_obj1id, model.eq_obj2id))
        coefficients = dict(first[0])
        for joint, coefficient in second[0].items():
            coefficients[joint] = coefficients.get(joint, 0.0) - slope * coefficient
        rows.append((coefficients, first[1] + offset - slope * second[1]))
    for mimic in mimics:
        row = {model.joint(mimic.joint).id: 1.0}
        if mimic.leader:
            row[model.joint(mimic.leader).id] = -mimic.multiplier
        rows.append((row, mimic.offset))
    return rows


def coupled_tendons(model: Any) -> set[int]:
    """Return the numbers of the tendons that are part of an active equality constraint."""
    ids = model.eq_obj1id, model.eq_obj2id
    return {int(of[k]) for k in _active(model) if model.eq_type[k] == 3 for of in ids}


def _active(model: Any) -> Iterator[int]:
    if model.opt.disableflags & EQUALITIES_DISABLED:
        return iter(())
    return (k for k in range(model.neq) if model.eq_active0[k])


def _length(model: Any, kind: int, number: int) -> tuple[Mapping[int, float], float]:
    """Return the coefficient of every joint in a coordinate (a joint or a fixed tendon), and its reference value."""
    if number < 0:
        return {}, 0.0
    if kind == 2:
        return {number: 1.0}, float(model.qpos0[model.jnt_qposadr[number]])
    start = int(model.tendon_adr[number])
    wraps = range(start, start + int(model.tendon_num[number]))
    if any(model.wrap_type[w] != 1 for w in wraps):
        raise ValueError(f"tendon {model.tendon(number).name!r} is coupled and not linear; delete the coupling")
    terms = {int(model.wrap_objid[w]): float(model.wrap_prm[w]) for w in wraps}
    return terms, sum(c * float(model.qpos0[model.jnt_qposadr[j]]) for j, c in terms.items())
