"""Starting points of a step's path: the impulses of the step before, or many other points.

All are starts on the true gap, whose s is the gap that belongs to the impulses, lifted where it is
small; the first of the others is the path of the linearised gap, from ones.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynamics.contact.path import Path

COUNT = 128
"""How many other starts there are."""
# Pairs of the step before in scaled units are at least this, for the iteration to move both ways.
_MIN_PAIR_ENTRY = 1e-2
# Next to no impulse, what a body in the air feels, is the first guess; the exponents of the others
# are even, or a Kronecker sequence, which fills the cube evenly however many there are.
_N_TINY_STARTS = 4
# Impulses of these starts, in scaled units.
_TINY_IMPULSE = 1e-6
# Smallest impulse of the other starts, as a power of ten in scaled units.
_MIN_EXPONENT = -4.0
# Powers of ten from there to the largest impulse.
_EXPONENT_SPAN = 5.0
# Smallest scaled gaps of a start, in turn.
_GAP_LIFTS = (1e-3, 1e-1, 1.0)


def warm_start(path: Path) -> ca.Function:
    """``(lam, data) -> pair`` at the impulses lam (n, 1) [N s] of the step before."""
    lam_before = ca.SX.sym("before", path.n)
    lam = ca.fmax(lam_before / (path.data_parts["c"] * path.data_parts["D"]), _MIN_PAIR_ENTRY)
    gap, _ = path.gap_at(lam, ca.SX(1))
    outputs = [path.pack_pair(lam, ca.fmax(gap, _MIN_PAIR_ENTRY))]
    return ca.Function("warm", [lam_before, path.data], outputs)


def further_start(path: Path) -> ca.Function:
    """``(k, data) -> pair`` of start number k = 0, 1, ..."""
    k, n = ca.SX.sym("k"), path.n
    shared = k * float(np.sqrt(2.0))
    separate = k * ca.DM(irrational_numbers(n))
    sequence = ca.if_else(ca.fmod(k, 2) > 0, shared, separate)
    exponent = _MIN_EXPONENT + _EXPONENT_SPAN * (sequence - ca.floor(sequence))
    lam = ca.if_else(k < _N_TINY_STARTS, _TINY_IMPULSE, ca.exp(float(np.log(10.0)) * exponent))
    gap, _ = path.gap_at(lam, ca.SX(1))
    lift = ca.SX(_GAP_LIFTS[0])
    for i, value in enumerate(_GAP_LIFTS):
        lift = ca.if_else(ca.fmod(k, len(_GAP_LIFTS)) == i, value, lift)
    start = path.pack_pair(lam, ca.fmax(gap, lift))
    return ca.Function("further", [k, path.data], [ca.if_else(k > 0, start, 1)])


def irrational_numbers(n: int) -> np.ndarray:
    """Square roots of the first n primes: no sum of multiples of them is a whole number."""
    primes: list[int] = []
    candidate = 2
    while len(primes) < n:
        if all(candidate % prime for prime in primes):
            primes.append(candidate)
        candidate += 1
    return np.sqrt(primes)
