"""C source of the counter-based normal random numbers of `dynamics.batch.random`, and of the moments of a chunk."""

from __future__ import annotations

from collections.abc import Sequence

from dynamics.batch.engines.c_source import c_double
from dynamics.batch.random import INCREMENTS, MULTIPLIERS, ROUNDS

# C code of Philox4x32. A 64-bit product of all lanes takes at least three multiplications without
# AVX-512; the product of the lower halves is one instruction, which gcc uses only if the source names it.
_PHILOX = """\
typedef int H __attribute__((vector_size(8 * W)));
#if __has_builtin(__builtin_ia32_pmuludq512_mask) && W == 8
INLINE Q product(Q a, Q b) {
  return (Q)__builtin_ia32_pmuludq512_mask((H)a, (H)b, (M){}, -1);
}
#elif __has_builtin(__builtin_ia32_pmuludq256) && W == 4
INLINE Q product(Q a, Q b) { return (Q)__builtin_ia32_pmuludq256((H)a, (H)b); }
#elif __has_builtin(__builtin_ia32_pmuludq128) && W == 2
INLINE Q product(Q a, Q b) { return (Q)__builtin_ia32_pmuludq128((H)a, (H)b); }
#else
INLINE Q product(Q a, Q b) { return (a & 0xffffffffull) * (b & 0xffffffffull); }
#endif
enum { ROUNDS = %(rounds)d };
static UNUSED void schedule(i64 key0, i64 key1, Q *keys) {
  unsigned k0 = (unsigned)key0, k1 = (unsigned)key1;
  for (int r = 0; r < ROUNDS; r++, k0 += %(i0)du, k1 += %(i1)du) {
    keys[2 * r] = (Q){} + (unsigned long long)k0;
    keys[2 * r + 1] = (Q){} + (unsigned long long)k1;
  }
}
/* Four words, each the lower half of its lane; what the upper halves hold means nothing. */
INLINE void philox(i64 sample, i64 quadruple, const Q *keys, Q *words) {
  const Q m0 = (Q){} + %(m0)dull, m1 = (Q){} + %(m1)dull;
  Q index;
  LANES index[l] = (unsigned long long)(sample + l);
  Q c0 = index, c1 = index >> 32, c2 = (Q){} + (unsigned long long)quadruple, c3 = (Q){};
  UNROLL for (int r = 0; r < ROUNDS; r++) {
    Q p0 = product(c0, m0), p1 = product(c2, m1);
    c0 = (p1 >> 32) ^ c1 ^ keys[2 * r];
    c2 = (p0 >> 32) ^ c3 ^ keys[2 * r + 1];
    c1 = p1;
    c3 = p0;
  }
  words[0] = c0, words[1] = c1, words[2] = c2, words[3] = c3;
}
"""

# C code of Box and Muller's transform. 32 random bits below an exponent are a number in [1, 2) or [4, 8), from
# which a constant is subtracted exactly. The logarithm of u = 2^e m is e ln 2 + ln m, where m is within a
# factor sqrt(2) of 1 and ln m = 2 artanh s with s = (m - 1)/(m + 1). Adding 1.5 * 2^52 rounds to the nearest
# integer, in the low bits: the angle in quarter turns is exactly a quadrant and a remainder within pi/4.
_NORMALS = """\
INLINE V mantissa(Q word, unsigned long long exponent) {
  return (V)(((word << 32) >> 12) | exponent);
}
INLINE V minus_twice_log(V u) {
  const Q lowest = (Q){} + 0x3fe6a09e667f3bcdull;
  Q shifted = (Q)u - lowest + (64ull << 52);
  V m = (V)((shifted & 0x000fffffffffffffull) + lowest);
  V e = (V)((shifted >> 52) | 0x4330000000000000ull) - (0x1p52 + 64);
  V s = (m - 1.0) / (m + 1.0), s2 = s * s, p;
%(log)s
  return fused(s, p, e * %(minus_two_ln_2)s);
}
INLINE void box_muller(Q a, Q b, V *even, V *odd) {
  V radius = vsqrt(minus_twice_log(mantissa(a, 0x3ff0000000000000ull) - (1.0 - 0x1p-33)));
  V quarters = mantissa(b, 0x4010000000000000ull), shifted = quarters + (0x1.8p52 - 4);
  M quadrant = (M)shifted;
  V y = (quarters - (shifted - (0x1.8p52 - 4))) * %(half_pi)s, y2 = y * y, s, c;
%(sine)s
%(cosine)s
  s *= y;
  M swap = (quadrant << 63) < 0;
  V sine = pick(swap, c, s), cosine = pick(swap, s, c);
  *odd = (V)((M)(radius * sine) ^ ((quadrant & 2) << 62));
  *even = (V)((M)(radius * cosine) ^ (((quadrant + 1) & 2) << 62));
}
INLINE void four_normals(i64 sample, i64 quadruple, const Q *keys, V *z) {
  Q words[4];
  philox(sample, quadruple, keys, words);
  box_muller(words[0], words[1], z, z + 1);
  box_muller(words[2], words[3], z + 2, z + 3);
}
"""

# Coefficients, highest power first, of polynomials accurate to double precision in their ranges:
# in s^2 for -2 ln(m)/s (FreeBSD's msun, e_log.c), in y^2 for sin(y)/y and cos(y) (Cephes, sin.c).
_LOG = (
    *(1.479819860511658591e-01, 1.531383769920937332e-01, 1.818357216161805012e-01),
    *(2.222219843214978396e-01, 2.857142874366239149e-01, 3.999999999940941908e-01),
    *(6.666666666666735130e-01, 2.0),
)
_SINE = (
    *(1.58962301576546568060e-10, -2.50507477628578072866e-8, 2.75573136213857245213e-6),
    *(-1.98412698295895385996e-4, 8.33333333332211858878e-3, -1.66666666666666307295e-1, 1.0),
)
_COSINE = (
    *(-1.13585365213876817300e-11, 2.08757008419747316778e-9, -2.75573141792967388112e-7),
    *(2.48015872888517045348e-5, -1.38888888888730564116e-3, 4.16666666666665929218e-2),
    *(-0.5, 1.0),
)
_HALF_PI = 1.5707963267948966
_LN_2 = 0.6931471805599453


def normals_source() -> str:
    """Return the C text of `four_normals`, the counter-based normals of `dynamics.batch.random`.

    The C function `schedule` computes the keys of all rounds from the two words of a seed's key.
    """
    return _PHILOX % {
        **{"rounds": ROUNDS, "m0": MULTIPLIERS[0], "m1": MULTIPLIERS[1]},
        **{"i0": INCREMENTS[0], "i1": INCREMENTS[1]},
    } + _NORMALS % {
        "half_pi": c_double(_HALF_PI),
        "minus_two_ln_2": c_double(-2.0 * _LN_2),
        "log": _horner("p", "s2", [-2.0 * value for value in _LOG]),
        "sine": _horner("s", "y2", _SINE),
        "cosine": _horner("c", "y2", _COSINE),
    }


def _horner(name: str, variable: str, coefficients: Sequence[float]) -> str:
    """Return C statements that assign the value of a polynomial in `variable` to `name`, by Horner's rule."""
    lines = [f"  {name} = SPLAT({c_double(coefficients[0])});"]
    lines += [f"  {name} = fused({name}, {variable}, SPLAT({c_double(value)}));" for value in coefficients[1:]]
    return "\n".join(lines)


# C code of one chunk's moments: sums of differences from the first register of samples, lane by lane;
# then the lanes are merged in order. Samples that are not finite, and the padding, are left out.
MOMENTS_SOURCE = """\
/* A sum is finite only if all its terms are; one that overflows counts as not finite too. */
typedef struct { V *pivot, *sum, *square; M count; } accumulator;
INLINE void add_up(const V *a, i64 n, V *sum) {
  for (i64 k = 0; k < n; k++)
    UNROLL for (int j = 0; j < U; j++) sum[j] += a[k * U + j];
}
static void accumulate(accumulator *c, i64 at, const V *value, i64 n, M ok, int starting) {
  if (starting) for (i64 k = 0; k < n; k++) c->pivot[at + k] = keep(ok, value[k * U]);
  for (i64 k = 0; k < n; k++) {
    V d = keep(ok, value[k * U] - c->pivot[at + k]);
    c->sum[at + k] += d;
    c->square[at + k] = fused(d, d, c->square[at + k]);
  }
}
static void finish(const accumulator *c, i64 n, double *out) {
  i64 total = 0;
  LANES total += -c->count[l];
  out[0] = (double)total;
  for (i64 k = 0; k < n; k++) {
    double mean = 0.0, m2 = 0.0, count = 0.0;
    for (int l = 0; l < W; l++) {
      double more = (double)-c->count[l];
      if (more == 0.0) continue;
      double sum = c->sum[k][l], here = c->square[k][l] - sum * sum / more;
      double difference = c->pivot[k][l] + sum / more - mean, all = count + more;
      mean += difference * (more / all);
      m2 += (here > 0.0 ? here : 0.0) + difference * difference * (count * more / all);
      count = all;
    }
    out[1 + k] = mean;
    out[1 + n + k] = m2;
  }
}
"""
