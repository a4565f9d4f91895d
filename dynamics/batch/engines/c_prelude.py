"""The fixed part of the emitted C code: types of vectors or doubles, their functions, and copies of rows.

A `V` is one SIMD register of `W` doubles, one sample per lane. Every operation acts on all lanes
alike, and the last register of a batch is padded with copies of the last row, so that a sample's
result does not depend on its lane, the block or the thread.
"""

from __future__ import annotations

import re

from dynamics.batch.engines.compiler import TWO_ARGUMENTS, VECTOR_FUNCTIONS, Compiler

_TYPES = """\
typedef double V __attribute__((vector_size(8 * W)));
typedef long long M __attribute__((vector_size(8 * W)));
typedef unsigned long long Q __attribute__((vector_size(8 * W)));
typedef double VU __attribute__((vector_size(8 * W), aligned(8)));
typedef long long i64;
#define UNROLL _Pragma("GCC unroll 16")
#define LANES UNROLL for (int l = 0; l < W; l++)
#define UNUSED __attribute__((unused))
#define INLINE static inline __attribute__((always_inline, unused))
#define NOINLINE __attribute__((noinline))
#define SPLAT(c) ((c) - (V){})
#define NOT(m) (~(m))
#define EVERYWHERE (~(M){})
#define DIFFER(a, b) ((M)(a) != (M)(b))
#define LANE(a, l) ((a)[l])
#define SET_LANE(a, l, value) ((a)[l] = (value))
#define INFINITE __builtin_inf()
#define NOT_A_NUMBER __builtin_nan("")
#if defined(__clang__) || __GNUC__ >= 12
#define SHUFFLE(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#else
#define SHUFFLE(a, b, ...) __builtin_shuffle(a, b, (M){__VA_ARGS__})
#endif
void *aligned_alloc(__SIZE_TYPE__, __SIZE_TYPE__);
void free(void *);
INLINE V pick(M m, V a, V b) { return (V)((m & (M)a) | (~m & (M)b)); }
INLINE V keep(M m, V a) { return (V)(m & (M)a); }
INLINE V truth(M m) { return keep(m, SPLAT(1.0)); }
INLINE int any(M m) { i64 r = 0; LANES r |= m[l]; return r != 0; }
INLINE V vfabs(V a) { return (V)((M)a & 0x7fffffffffffffffLL); }
INLINE V vcopysign(V a, V b) {
  return (V)(((M)a & 0x7fffffffffffffffLL) | ((M)b & ~0x7fffffffffffffffLL));
}
INLINE V vsign(V a) { return pick(a < 0.0, SPLAT(-1.0), pick(a > 0.0, SPLAT(1.0), a)); }
INLINE V vfmin(V a, V b) { return pick((a < b) | (b != b), a, b); }
INLINE V vfmax(V a, V b) { return pick((a > b) | (b != b), a, b); }
INLINE V vfloor(V a) { V r; LANES r[l] = __builtin_floor(a[l]); return r; }
INLINE V vceil(V a) { V r; LANES r[l] = __builtin_ceil(a[l]); return r; }
INLINE V vfmod(V a, V b) { V r; LANES r[l] = __builtin_fmod(a[l], b[l]); return r; }
INLINE V vremainder(V a, V b) { V r; LANES r[l] = __builtin_remainder(a[l], b[l]); return r; }
"""

# Compiler builtins for one instruction, as (builtin, width, call): a loop over lanes compiles to the
# same instruction, but takes the compiler ten times as long.
_SQRT = (
    ("__builtin_elementwise_sqrt", 0, "__builtin_elementwise_sqrt(a)"),
    ("__builtin_ia32_sqrtpd512_mask", 8, "__builtin_ia32_sqrtpd512_mask(a, a, -1, 4)"),
    ("__builtin_ia32_sqrtpd256", 4, "__builtin_ia32_sqrtpd256(a)"),
    ("__builtin_ia32_sqrtpd", 2, "__builtin_ia32_sqrtpd(a)"),
)
_FUSED = (
    ("__builtin_elementwise_fma", 0, "__builtin_elementwise_fma(a, b, c)"),
    ("__builtin_ia32_vfmaddpd512_mask", 8, "__builtin_ia32_vfmaddpd512_mask(a, b, c, -1, 4)"),
    ("__builtin_ia32_vfmaddpd256", 4, "__builtin_ia32_vfmaddpd256(a, b, c)"),
    ("__builtin_ia32_vfmaddpd", 2, "__builtin_ia32_vfmaddpd(a, b, c)"),
)
# Minimum and maximum of two numbers; where one is NaN, the result depends on the processor.
_LARGER, _SMALLER = (
    (
        (f"__builtin_ia32_{name}pd512_mask", 8, f"__builtin_ia32_{name}pd512_mask(a, b, a, -1, 4)"),
        (f"__builtin_ia32_{name}pd256", 4, f"__builtin_ia32_{name}pd256(a, b)"),
        (f"__builtin_ia32_{name}pd", 2, f"__builtin_ia32_{name}pd(a, b)"),
    )
    for name in ("max", "min")
)
_PROBE = "#ifndef __has_builtin\n#define __has_builtin(x) 0\n#endif\n"

# C code of erfinv: Halley's method for erf(y) = x near 0 and for erfc(y) = 1 - |x| (exact there)
# elsewhere, from Winitzki's closed form; three iterations are enough for every double.
_ERFINV_LANE = """\
static double erfinv_lane(double x) {
  double a = __builtin_fabs(x), c = 1.0 - a;
  if (!(a < 1.0)) return a == 1.0 ? x * INFINITE : NOT_A_NUMBER;
  if (a < 1e-8) return x * 0.88622692545275801365;
  double g = __builtin_log1p(-a * a), h = 4.3307467508 + 0.5 * g;
  double y = __builtin_sqrt(__builtin_sqrt(h * h - g * 6.8027210884) - h);
  for (int k = 0; k < 3; k++) {
    double e = a < 0.5 ? __builtin_erf(y) - a : c - __builtin_erfc(y);
    double s = e * 0.88622692545275801365 * __builtin_exp(y * y);
    y -= s / (1.0 + y * s);
  }
  return __builtin_copysign(y, x);
}
"""
_ERFINV = "INLINE V verfinv(V a) { V r; LANES r[l] = erfinv_lane(a[l]); return r; }\n"

# C code that copies rows of the caller's (n_samples, size) arrays to vectors and back. Rows past the
# end repeat the last one. Whole W x W tiles are transposed in registers, the rest goes lane by lane.
_ROWS = """\
INLINE i64 row_at(i64 row, i64 end) { return row < end ? row : end - 1; }
static UNUSED void load_rows(const double *a, i64 size, i64 row, i64 end, V *out, i64 step) {
  i64 k = 0;
  const double *r[W];
  LANES r[l] = a + row_at(row + l, end) * size;
  for (; k + W <= size; k += W) {
    V t[W];
    LANES t[l] = *(const VU *)(r[l] + k);
    transpose(t);
    LANES out[(k + l) * step] = t[l];
  }
  for (; k < size; k++) { V t; LANES t[l] = r[l][k]; out[k * step] = t; }
}
static UNUSED void store_rows(double *a, i64 size, i64 row, i64 end, const V *in, i64 step) {
  i64 k = 0;
  double *r[W];
  LANES r[l] = a + row_at(row + l, end) * size;
  if (row + W <= end)
    for (; k + W <= size; k += W) {
      V t[W];
      LANES t[l] = in[(k + l) * step];
      transpose(t);
      LANES *(VU *)(r[l] + k) = t[l];
    }
  for (; k < size; k++) { V t = in[k * step]; LANES if (row + l < end) r[l][k] = t[l]; }
}
static UNUSED void load_shared(const double *a, i64 size, V *out, i64 step) {
  for (i64 k = 0; k < size; k++)
    for (i64 j = 0; j < step; j++) out[k * step + j] = SPLAT(a[k]);
}
INLINE i64 count_rows(M m, i64 row, i64 end) {
  i64 n = 0;
  LANES n += row + l < end && m[l];
  return n;
}
"""


# Definitions of the same macros and functions for one sample at a time, in C11 with no header but <math.h>.
_SCALAR = {
    "INLINE": "static",
    "NOINLINE": "",
    "SPLAT(c)": "(c)",
    "NOT(m)": "(!(m))",
    "EVERYWHERE": "1",
    "DIFFER(a, b)": "((a) != (b) && ((a) == (a) || (b) == (b)))",
    "W": "1",
    "LANE(a, l)": "((void)(l), (a))",
    "SET_LANE(a, l, value)": "((void)(l), (a) = (value))",
    "INFINITE": "((double)INFINITY)",
    "NOT_A_NUMBER": "((double)NAN)",
    "any(m)": "(m)",
    "pick(m, a, b)": "((m) ? (a) : (b))",
    "keep(m, a)": "((m) ? (a) : 0.0)",
    "truth(m)": "((double)(m))",
    "fused(a, b, c)": "((a) * (b) + (c))",
    "vsign(a)": "((a) < 0.0 ? -1.0 : (a) > 0.0 ? 1.0 : (a))",
    "vfmin(a, b)": "((a) < (b) || (b) != (b) ? (a) : (b))",
    "vfmax(a, b)": "((a) > (b) || (b) != (b) ? (a) : (b))",
    "vlarger(a, b)": "((a) > (b) ? (a) : (b))",
    "vsmaller(a, b)": "((a) < (b) ? (a) : (b))",
    **{f"v{name}": name for name in (*VECTOR_FUNCTIONS, "sqrt", "fabs", "copysign", "floor", "ceil", "fmod")},
    "vremainder": "remainder",
    "verfinv": "erfinv_lane",
}


def scalar_prelude(text: str) -> str:
    """Return the definitions that the C text `text` (kernels over single doubles) uses, to be placed before it."""
    erfinv = _ERFINV_LANE.replace("__builtin_", "") if "verfinv" in text else ""
    lines = ["#include <math.h>", "#define V double", "#define M int"]
    used = set(re.findall(r"\w+", text + erfinv))
    for word, meaning in _SCALAR.items():
        if word.partition("(")[0] in used:
            lines.append(f"#define {word} {meaning}".rstrip())
    return "\n".join((*lines, erfinv))


def vector_prelude(compiler: Compiler) -> str:
    """Return the C text at the beginning of every vectorised source, for this compiler and CPU."""
    functions = "".join(_vector_function(name, compiler) for name in VECTOR_FUNCTIONS)
    return "".join(
        (
            f"#define W {compiler.width}\n",
            _TYPES,
            _PROBE,
            _instruction("vsqrt", "V a", _SQRT, "__builtin_sqrt(a[l])"),
            _fused(compiler),
            _instruction("vlarger", "V a, V b", _LARGER, "a[l] > b[l] ? a[l] : b[l]"),
            _instruction("vsmaller", "V a, V b", _SMALLER, "a[l] < b[l] ? a[l] : b[l]"),
            functions,
            f"UNUSED {_ERFINV_LANE}{_ERFINV}",
            _transpose(compiler.width),
            _ROWS,
        )
    )


def _fused(compiler: Compiler) -> str:
    """Return the C function `fused`, a*b + c with one rounding, or with two if the CPU lacks the instruction."""
    if not compiler.has_fma:
        return "INLINE V fused(V a, V b, V c) { return a * b + c; }\n"
    return _instruction("fused", "V a, V b, V c", _FUSED, "__builtin_fma(a[l], b[l], c[l])")


def _instruction(name: str, parameters: str, variants: tuple[tuple[str, int, str], ...], lane: str) -> str:
    """Return an inline C function: the first builtin for this vector width (0: any), else a loop over lanes."""
    lines = []
    for k, (builtin, width, call) in enumerate(variants):
        condition = f"__has_builtin({builtin})" + (f" && W == {width}" if width else "")
        lines += [
            f"{'#elif' if k else '#if'} {condition}",
            f"INLINE V {name}({parameters}) {{ return {call}; }}",
        ]
    lines += ["#else", f"INLINE V {name}({parameters}) {{ V r; LANES r[l] = {lane}; return r; }}"]
    return "\n".join((*lines, "#endif\n"))


def _vector_function(name: str, compiler: Compiler) -> str:
    symbol = compiler.vector_math.get(name)
    if symbol is not None:
        parameters = "V, V" if name in TWO_ARGUMENTS else "V"
        return f"extern V {symbol}({parameters});\n#define v{name} {symbol}\n"
    if name in TWO_ARGUMENTS:
        return f"INLINE V v{name}(V a, V b) {{ V r; LANES r[l] = __builtin_{name}(a[l], b[l]); return r; }}\n"
    return f"INLINE V v{name}(V a) {{ V r; LANES r[l] = __builtin_{name}(a[l]); return r; }}\n"


def _transpose(width: int) -> str:
    """Return a C function that transposes W x W doubles in log2(W) rounds of pairwise shuffles."""
    lines = ["INLINE void transpose(V *t) {", "  V a, b;"]
    distance = 1
    while distance < width:
        low = [i if not i & distance else width + i - distance for i in range(width)]
        high = [i + distance if not i & distance else width + i for i in range(width)]
        for i in range(width):
            if not i & distance:
                j = i + distance
                lines += [
                    f"  a = t[{i}]; b = t[{j}];",
                    f"  t[{i}] = SHUFFLE(a, b, {', '.join(map(str, low))});",
                    f"  t[{j}] = SHUFFLE(a, b, {', '.join(map(str, high))});",
                ]
        distance *= 2
    return "\n".join((*lines, "}\n"))
