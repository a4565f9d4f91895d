"""Starting points of a step's interior-point path: the impulses of the previous step, and many others.

From these points the path follows the true gap; s is the gap at the impulses of the starting point, raised if it is
small. Only the path from start number 0, where all unknowns are 1, first follows the linearised gap.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynamics.contact.path import Path

COUNT = 128
"""Number of starts in addition to the start at the impulses of the previous step."""
# Minimum of lam and s at the start from the previous step, in scaled units, so that both can increase and
# decrease.
_MIN_PAIR_ENTRY = 1e-2
# Number of first starts with almost no impulse, as for bodies in the air. The exponents of the others
# are equal for all pairs, or a Kronecker sequence, which fills the cube evenly for any number of starts.
_N_TINY_STARTS = 4
TINY_IMPULSE = 1e-6
"""Impulses of starts with almost no impulse, in scaled units."""
MIN_EXPONENT = -4.0
"""Smallest impulse of the other starts, as a power of ten in scaled units."""
# Number of powers of ten from the smallest to the largest impulse.
_EXPONENT_SPAN = 5.0
# Minimum scaled gaps of the starts, which the starts use in turn.
_GAP_LIFTS = (1e-3, 1e-1, 1.0)


def warm_start(path: Path) -> ca.Function:
    """Return the function ``(lam, data) -> pair`` that starts at the impulses lam (n, 1) [N s] of the previous step."""
    lam_before = ca.SX.sym("before", path.n)
    lam = ca.fmax(lam_before / (path.data_parts["c"] * path.data_parts["D"]), _MIN_PAIR_ENTRY)
    gap, _ = path.gap_at(lam, ca.SX(1))
    outputs = [path.pack_pair(lam, ca.fmax(gap, _MIN_PAIR_ENTRY))]
    return ca.Function("warm", [lam_before, path.data], outputs)


def other_start(path: Path) -> ca.Function:
    """Return the function ``(k, data) -> pair`` of the starting points with numbers k = 0, 1, ..."""
    k, n = ca.SX.sym("k"), path.n
    shared = k * float(np.sqrt(2.0))
    separate = k * ca.DM(irrational_numbers(n))
    sequence = ca.if_else(ca.fmod(k, 2) > 0, shared, separate)
    exponent = MIN_EXPONENT + _EXPONENT_SPAN * (sequence - ca.floor(sequence))
    lam = ca.if_else(k < _N_TINY_STARTS, TINY_IMPULSE, ca.exp(float(np.log(10.0)) * exponent))
    gap, _ = path.gap_at(lam, ca.SX(1))
    lift = ca.SX(_GAP_LIFTS[0])
    for i, value in enumerate(_GAP_LIFTS):
        lift = ca.if_else(ca.fmod(k, len(_GAP_LIFTS)) == i, value, lift)
    start = path.pack_pair(lam, ca.fmax(gap, lift))
    return ca.Function("other_start", [k, path.data], [ca.if_else(k > 0, start, 1)])


def irrational_numbers(n: int) -> np.ndarray:
    """Return the square roots of the first n primes; with 1 they are linearly independent over the rationals."""
    primes: list[int] = []
    candidate = 2
    while len(primes) < n:
        if all(candidate % prime for prime in primes):
            primes.append(candidate)
        candidate += 1
    return np.sqrt(primes)
