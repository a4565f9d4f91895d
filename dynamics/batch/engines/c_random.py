"""C source of the counter-based normals of `dynamics.batch.random`."""

from __future__ import annotations

import math

from dynamics.batch.engines.c_source import number
from dynamics.batch.random import INCREMENTS, MULTIPLIERS, ROUNDS, taylor

_PHILOX = """\
INLINE void philox(i64 sample, i64 quadruple, i64 key0, i64 key1, Q *words) {
  const Q low = (Q){} + 0xffffffffull;
  Q index;
  LANES index[l] = (unsigned long long)(sample + l);
  Q c0 = index & low, c1 = index >> 32, c2 = (Q){} + (unsigned long long)quadruple, c3 = (Q){};
  unsigned k0 = (unsigned)key0, k1 = (unsigned)key1;
  for (int r = 0; r < %(rounds)d; r++) {
    Q p0 = c0 * %(m0)dull, p1 = c2 * %(m1)dull;
    c0 = (p1 >> 32) ^ c1 ^ (unsigned long long)k0;
    c2 = (p0 >> 32) ^ c3 ^ (unsigned long long)k1;
    c1 = p1 & low;
    c3 = p0 & low;
    k0 += %(i0)du;
    k1 += %(i1)du;
  }
  words[0] = c0, words[1] = c1, words[2] = c2, words[3] = c3;
}
"""

# Box and Muller. 32 bits under the exponent of 1 are a number in [1, 2); adding 1.5 * 2^52 rounds
# to the nearest integer and leaves it in the low bits. The angle in quarter turns so splits exactly
# into a quadrant and a rest within pi/4, where Taylor's series reach double precision.
_NORMALS = """\
INLINE V unit(Q word) { return (V)((word << 20) | 0x3ff0000000000000ull) - 1.0; }
INLINE void box_muller(Q a, Q b, V *even, V *odd) {
  V radius = vsqrt(-2.0 * vlog(unit(a) + 0x1p-33));
  V quarters = unit(b) * 4.0, shifted = quarters + 0x1.8p52;
  M quadrant = (M)shifted;
  V y = (quarters - (shifted - 0x1.8p52)) * %(half_pi)s, y2 = y * y, s, c;
%(series)s
  M swap = (quadrant & 1) != 0;
  V sine = pick(swap, c, s * y), cosine = pick(swap, s * y, c);
  *odd = (V)((M)(radius * sine) ^ ((quadrant & 2) << 62));
  *even = (V)((M)(radius * cosine) ^ (((quadrant + 1) & 2) << 62));
}
INLINE void four_normals(i64 sample, i64 quadruple, i64 key0, i64 key1, V *z) {
  Q words[4];
  philox(sample, quadruple, key0, key1, words);
  box_muller(words[0], words[1], z, z + 1);
  box_muller(words[2], words[3], z + 2, z + 3);
}
"""


def source() -> str:
    """C text of `four_normals`, the counter-based normals of `dynamics.batch.random`."""
    return _PHILOX % {
        **{"rounds": ROUNDS, "m0": MULTIPLIERS[0], "m1": MULTIPLIERS[1]},
        **{"i0": INCREMENTS[0], "i1": INCREMENTS[1]},
    } + _NORMALS % {"half_pi": number(math.pi / 2), "series": _series()}


def _series() -> str:
    """Taylor series in y2 = y^2, by Horner: s = sin(y) / y and c = cos(y)."""
    lines = []
    for name, first in (("s", 1), ("c", 0)):
        coefficients = taylor(first)
        lines.append(f"  {name} = SPLAT({number(coefficients[0])});")
        lines += [
            f"  {name} = fused({name}, y2, SPLAT({number(value)}));" for value in coefficients[1:]
        ]
    return "\n".join(lines)
