"""Compiled sample of a receding-horizon controller: linearisation, quadratic programs, and rollouts of candidates."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from dynamics.batch.engines.c_candidates import CANDIDATES
from dynamics.batch.engines.c_flat import CompiledEngine, data_address
from dynamics.batch.engines.c_horizon import ALGEBRA
from dynamics.batch.engines.c_linearise import LINEARISE
from dynamics.batch.engines.c_program import program_source
from dynamics.batch.engines.c_steps import JOB
from dynamics.batch.engines.compiler import load_library
from dynamics.batch.engines.rollout_engines import CompiledRolloutEngine

_FEEDBACK = """\
static const double penalties[] = {PENALTIES}, shares[CANDIDATES] = {SHARES};
static answer *run_program(sample *s, answer *to, double penalty, double residual, double gap, i64 separate) {
  i64 left = s->budget - s->iterations, sizes[4 + M];
  double options[5 + NU] = {s->cost, penalty, PENALTY_CURVATURE * penalty, residual, gap};
  const double *in[] = {s->b, s->A, s->B, s->row, s->row_by_x, s->row_by_u, s->g, s->H, s->end_g, s->end_H, s->dx0,
                        s->lower_du, s->upper_du};
  double *const out[] = {to->dx, to->du, to->costates, to->rows, to->counted};
  sizes[0] = s->steps, sizes[1] = left < MAX_ITERATIONS ? left : MAX_ITERATIONS, sizes[2] = separate ? LIMITS + 1 : 1;
  for (i64 j = 0; j < M; j++) sizes[3 + j] = separate && j >= M - LIMITS ? j - M + LIMITS + 1 : 0;
  for (i64 i = 0; i < NU; i++) options[5 + i] = s->proximal[i];
  to->residual = residual;
  to->status = solve_program(s->work, sizes, options, in, out);
  s->programs++, s->iterations += (i64)to->counted[1];
  return to;
}
/* If rows are violated, programs with separate slacks and larger penalties follow; after a violation the next sample
   begins with these, which have the same optimum without one. */
static answer *solve_programs(sample *s) {
  answer *best = 0;
  double smallest = __builtin_inf();
  if (!s->violated) {
    best = run_program(s, s->answers, penalties[0], s->tolerance[0], s->tolerance[1], 0);
    if (!LIMITS || (best->status == 1 && best->counted[0] < larger(MET_TOLERANCE, s->tolerance[0]))) return best;
  }
  for (i64 i = 0; i < (i64)(sizeof penalties / 8) && s->iterations < s->budget; i++) {
    answer *trial = run_program(s, s->answers + (best == s->answers), penalties[i], TIGHT_RESIDUAL, TIGHT_GAP, 1);
    if (!best) best = trial;
    if (trial->status != 1 || !(trial->counted[0] < PENALTY_FALL * smallest)) break;
    best = trial, smallest = trial->counted[0];
    if (smallest < MET_TOLERANCE) break;
  }
  s->violated = MET_TOLERANCE <= smallest && smallest < __builtin_inf();
  return best;
}
/* Whether the pairs of a step with both sides at zero may be exchanged alone. */
static void find_touching(const sample *s, const answer *d, i64 k, i64 *touching) {
  const i64 *closed = s->closed + k * PAIRS;
  for (i64 i = 0; i < PAIRS; i++) {
    i64 r = k * M + i;
    double value = s->row[r];
    for (i64 j = 0; j < NX; j++) value += s->row_by_x[r * NX + j] * d->dx[k * NX + j];
    for (i64 j = 0; j < NU; j++) value += s->row_by_u[r * NU + j] * d->du[k * NU + j];
    touching[i] = value <= larger(ACTIVE_TOLERANCE, d->residual) && !s->frictionless[k * PAIRS + i];
  }
  for (i64 c = 0; c < CONTACTS; c++) {
    const i64 *pair = s->contacts + (FRICTION + 2) * c;
    i64 count = 0;
    for (i64 i = 1; i <= FRICTION; i++) count += closed[pair[i]];
    i64 fixed = count == 1 || (FRICTION > 2 && count == FRICTION);
    for (i64 i = 1; i <= FRICTION; i++) touching[pair[i]] &= !fixed || !closed[pair[i]];
    touching[pair[FRICTION + 1]] = 0;
  }
}
/* Minus the derivative of the program's optimum with respect to the side of a pair that is fixed at zero. */
static double exchange_gain(const sample *s, const answer *d, i64 k, i64 pair) {
  const double *z = s->by_step + k * (NX + PAIRS) * COLUMNS + COLUMNS - PAIRS + pair, *rows = d->rows + k * M;
  const double *gap = s->by_gap + k * PAIRS * COLUMNS + COLUMNS - PAIRS + pair;
  const double *limit = s->by_limit + k * LIMITS * COLUMNS + COLUMNS - PAIRS + pair;
  const i64 *closed = s->closed + k * PAIRS;
  double sum = 0.0;
  for (i64 i = 0; i < NX; i++) sum += d->costates[k * NX + i] * z[i * COLUMNS];
  for (i64 i = 0; i < PAIRS; i++)
    sum += rows[i] * (closed[i] ? z[(NX + i) * COLUMNS] / s->lam_size[i] : gap[i * COLUMNS] / s->gap_size[i]);
  for (i64 i = 0; i < LIMITS; i++) sum += rows[PAIRS + i] * limit[i * COLUMNS];
  return sum * (closed[pair] ? s->gap_size[pair] : s->lam_size[pair]) / s->cost;
}
static void choose_exchange(sample *s, const answer *d) {
  i64 touching[PAIRS + 1];
  for (i64 k = 0; k < s->steps; k++) {
    find_touching(s, d, k, touching);
    for (i64 i = 0; i < PAIRS; i++) {
      i64 pays = touching[i] && exchange_gain(s, d, k, i) > MIN_EXCHANGE_GAIN;
      s->exchanged[k * PAIRS + i] = pays, s->has_exchange |= pays;
      s->closed_before[k * PAIRS + i] = s->closed[k * PAIRS + i];
    }
  }
}
/* Rolls out the plan without and with the regulator's feedback, and with shares of the step d if there is one. */
static i64 roll_out_candidates(sample *s, const answer *d, double penalty) {
  counts z = {d ? CANDIDATES : FULL_STEP, s->steps, NX, NU, PAIRS, MULTIPLIERS, LIMITS, PARAMETERS};
  double low[NU], high[NU];
  for (i64 i = 0; i < NU; i++) {
    low[i] = larger(s->lower[i], -s->input_limit[i]);
    high[i] = s->upper[i] < s->input_limit[i] ? s->upper[i] : s->input_limit[i];
  }
  const double *of[] = {s->gains, s->x, s->u, d ? d->dx : s->x, d ? d->du : s->u, shares};
  double *to[] = {s->K, s->k};
  steer_candidates(&z, of, to);
  const double *in[] = {s->state, s->K, s->k, low, high, s->u_before, s->p, s->p_step};
  double *out[] = {s->states, s->merits, s->inputs, s->multipliers, s->violations, s->gaps, s->space};
  if (roll_candidates(&z, s->functions, penalty * s->cost, in, out)) return -1;
  s->best = 0;
  for (i64 i = 1; i < z.S; i++) if (s->merits[i] < s->merits[s->best]) s->best = i;
  return 0;
}
/* The next tolerances follow the largest difference of the states that the program predicts and of their rollout. */
static void update_tolerance(sample *s, const answer *d) {
  const double *x = s->states + FULL_STEP * (s->steps + 1) * NX;
  double error = 0.0;
  for (i64 i = 0; i < (s->steps + 1) * NX; i++)
    error = larger(error, __builtin_fabs(x[i] - s->x[i] - d->dx[i]) / s->x_size[i % NX]);
  if (!(error < MAX_LINEARISATION_ERROR)) error = MAX_LINEARISATION_ERROR;
  s->tolerance[0] = larger(TIGHT_RESIDUAL, RESIDUAL_SHARE * error);
  s->tolerance[1] = larger(TIGHT_GAP, error);
}
/* Solves the program at the prepared plan and chooses the best rollout; returns 1 if none is finite. */
i64 answer_sample(sample *s);
i64 answer_sample(sample *s) {
  i64 n = s->steps;
  double largest = 0.0;
  for (i64 i = 0; i < NX; i++) s->dx0[i] = s->state[i] - s->x[i];
  for (i64 i = 0; i < n * NU; i++) {
    s->lower_du[i] = s->lower[i % NU] - s->u[i];
    s->upper_du[i] = s->upper[i % NU] - s->u[i];
  }
  s->has_exchange = 0;
  const answer *d = solve_programs(s);
  s->status = d->status;
  for (i64 k = 0; d->status >= 0 && k < n; k++)
    for (i64 j = M - LIMITS; j < M; j++) largest = larger(largest, __builtin_fabs(d->rows[k * M + j]));
  if (roll_out_candidates(s, d->status < 0 ? 0 : d, larger(MIN_PENALTY, 2.0 * largest / s->cost))) return -1;
  if (!(s->merits[s->best] < __builtin_inf())) return 1;
  for (i64 i = 0; i < NU * NX; i++) s->gain[i] = s->gains[(n - 1) * NU * NX + i];
  if (d->status == 1) update_tolerance(s, d);
  if (d->status == 1 && EXCHANGES) choose_exchange(s, d);
  s->breaks_limits = 0;
  for (i64 i = 0; i < n * LIMITS; i++) s->breaks_limits |= s->violations[s->best * n * LIMITS + i] > MET_TOLERANCE;
  return 0;
}
i64 roll_out_start(sample *s);
i64 roll_out_start(sample *s) { return roll_out_candidates(s, 0, MIN_PENALTY); }
/* Shifts the exchange that the last sample chose by a step; a step that is appended has none. */
void shift_exchange(sample *s);
void shift_exchange(sample *s) {
  i64 size = s->steps * PAIRS, last = size - PAIRS;
  for (i64 i = 0; i < size; i++) {
    s->exchanged[i] = i < last ? s->exchanged[i + PAIRS] : 0;
    s->closed_before[i] = s->closed_before[i < last ? i + PAIRS : i];
  }
}
i64 sample_bytes(void);
i64 sample_bytes(void) { return sizeof(sample); }
"""


class SampleSizes(NamedTuple):
    """Sizes of a sample: steps, states, inputs, pairs, constraint rows, contacts, distances, parameters, candidates.

    ``friction`` is the number of friction forces of a contact. ``parameters``, ``step_parameters`` and ``physical``
    are the numbers of parameters of a stage, of the rollouts and of the distances. ``before`` is true if the cost has
    the input before, ``costs_impulses`` if it has multipliers, ``product`` for the law ``lam gap = mu``.
    """

    N: int
    nx: int
    nu: int
    pairs: int
    limits: int
    contacts: int
    friction: int
    distances: int
    parameters: int
    step_parameters: int
    physical: int
    candidates: int
    before: bool
    costs_impulses: bool
    product: bool

    @property
    def rows(self) -> int:
        """Number of rows of the program in a step."""
        return self.limits + self.pairs * (not self.product)


class CompiledSample:
    """Memory of a sample, whose entries are arrays by name, and the compiled functions that work on it.

    ``rollout`` has the policy ``clip(K x + k, low, high)``. ``engines`` are cost, violations, gaps and terminal cost of
    steps, their values and derivatives, and distances with their derivatives in x if there are any. ``constants`` are
    those of the method by their names in C.
    """

    def __init__(
        self,
        rollout: CompiledRolloutEngine,
        engines: tuple[CompiledEngine, ...],
        sizes: SampleSizes,
        constants: Mapping[str, float | str],
    ) -> None:
        self.sizes = sizes
        fields, multipliers = sample_fields(sizes, rollout.nlam), rollout.nlam
        text = sample_source(sizes, multipliers, constants, fields)
        self._library = library = load_library(text, ["prepare_plan", "answer_sample", "sample_bytes"], level=3)
        library.sample_bytes.restype = ctypes.c_int64
        self._memory = np.zeros(library.sample_bytes() // 8)
        self._pointer = ctypes.c_void_p(data_address(self._memory))
        self._engines = rollout, *engines
        self.arrays, begin = {}, 0
        for name, (kind, size) in fields.items():
            array = self._memory[begin : begin + size]
            self.arrays[name] = array.view(np.int64) if kind == "i64" else array
            begin += max(size, 1)
        addresses = [engine.address for engine in self._engines]
        self.arrays["functions"].view(np.int64)[: len(addresses)] = addresses

    def prepare(self) -> bool:
        """Linearise the plan and store its program; return False if a step has no linearisation."""
        return self._checked(self._library.prepare_plan(self._pointer)) == 0

    def answer(self) -> bool:
        """Solve the program and choose the best rollout; return False if no rollout is finite."""
        return self._checked(self._library.answer_sample(self._pointer)) == 0

    def roll_out_start(self) -> None:
        """Roll out the plan without and with feedback."""
        self._checked(self._library.roll_out_start(self._pointer))

    def shift_plan(self) -> None:
        """Shift the plan by a step, and extend it with the last feedback gain."""
        self._library.shift_plan(self._pointer)

    def take_step(self, u: np.ndarray) -> np.ndarray:
        """Return the next state (nx,) under an input; the state itself if the step has no solution."""
        u, x_next = np.ascontiguousarray(u), np.empty(self.sizes.nx)
        self._library.take_step(self._pointer, ctypes.c_void_p(data_address(u)), ctypes.c_void_p(data_address(x_next)))
        return x_next

    def move_out(self) -> None:
        """Move the state out of contact by the smallest change."""
        self._library.move_out(self._pointer)

    def shift_exchange(self) -> None:
        """Shift the exchange of sides that the last answer chose by a step."""
        self._library.shift_exchange(self._pointer)

    @staticmethod
    def _checked(status: int) -> int:
        if status < 0:
            raise MemoryError("no memory for the work arrays of a sample")
        return status


FLAGS = (
    *("steps", "budget", "programs", "iterations", "violated", "has_exchange", "is_exchanged", "best", "status"),
    "breaks_limits",
)
"""Fields of a sample that are one integer: counts, indices and truth values."""
_ANSWER = """\
typedef struct {
  double dx[(HORIZON + 1) * NX], du[HORIZON * NU], costates[HORIZON * NX], rows[HORIZON * M + 1], counted[2], residual;
  i64 status;
} answer;
"""


def sample_source(
    sizes: SampleSizes, multipliers: int, constants: Mapping[str, float | str], fields: dict[str, tuple[str, int]]
) -> str:
    """Return the C text of a sample with these fields; ``multipliers`` is their number in a step of the rollouts."""
    macros = {
        **{"HORIZON": sizes.N, "PAIRS": sizes.pairs, "LIMITS": sizes.limits, "CONTACTS": sizes.contacts},
        **{"PARAMETERS": sizes.parameters, "MULTIPLIERS": multipliers, "PRODUCT": int(sizes.product)},
        **{"FRICTION": sizes.friction, "DISTANCES": sizes.distances, "COSTS_IMPULSES": int(sizes.costs_impulses)},
        **{"CANDIDATES": sizes.candidates, **constants},
    }
    entries = (
        f"  {kind} {name};\n" if name in (*FLAGS, "cost", "ignored") else f"  {kind} {name}[{max(size, 1)}];\n"
        for name, (kind, size) in fields.items()
    )
    structure = ("typedef struct {\n", *entries, "  answer answers[2];\n  stage work[HORIZON + 1];\n} sample;\n")
    return "".join(
        (
            *(f"#define {name} {value}\n" for name, value in macros.items()),
            program_source(sizes.nx, sizes.nu, sizes.rows, 1 + sizes.limits, sizes.before),
            ALGEBRA,
            JOB,
            CANDIDATES,
            _ANSWER,
            *structure,
            LINEARISE,
            _FEEDBACK,
        )
    )


def sample_fields(sizes: SampleSizes, multipliers: int) -> dict[str, tuple[str, int]]:
    """Return the C type and the number of entries of each field of a sample, before those of its programs."""
    N, nx, nu, pairs, limits, contacts, friction, _, parameters, step_parameters, physical, S, *_ = sizes
    rows, columns, ng = sizes.rows, 1 + nx + nu + pairs, nx + 2 * nu
    values, nf, z = nx + 2 * pairs + limits, ng + pairs * sizes.costs_impulses, nx + nu
    space = S + S * N * (nu * (nx + 3) + multipliers + 2 * nx + nu + parameters + 2)
    doubles = {
        **{"cost": 1, "lam_size": pairs, "gap_size": pairs, "compliance": pairs, "x_size": nx, "proximal": nu},
        **{"input_limit": nu, "state": nx, "u_before": nu, "lower": nu, "upper": nu, "p": (N + 1) * parameters},
        **{
            "p_step": step_parameters,
            "physical": physical,
            "ignored": 1,
            "x": (N + 1) * nx,
            "u": N * nu,
            "lam": N * pairs,
            "gap": N * pairs,
        },
        **{"tolerance": 2, "gain": nu * nx, "before": N * nu, "values": N * values, "gradient": N * nf},
        **{"jacobian": N * values * (2 * nx + nu + pairs), "hessian": N * nf * nf, "end_gradients": N * nx},
        **{"end_hessians": N * nx * nx, "residual": N * nx, "mu": N * pairs, "limits": N * limits},
        **{"closure": 4 * N * pairs, "by_step": N * (nx + pairs) * columns, "by_gap": N * pairs * columns},
        **{"by_limit": N * limits * columns, "matrix": (nx + pairs) ** 2, "b": N * nx, "A": N * nx * nx},
        **{"B": N * nx * nu, "row": N * rows, "row_by_x": N * rows * nx, "row_by_u": N * rows * nu, "g": N * ng},
        **{"H": N * ng * ng, "end_g": nx, "end_H": nx * nx, "dx0": nx, "lower_du": N * nu, "upper_du": N * nu},
        **{"gains": N * nu * nx, "scratch": nx * nx + 2 * nx * z + 2 * z * z, "K": S * N * nu * nx, "k": S * N * nu},
        **{"states": S * (N + 1) * nx, "merits": S, "inputs": S * N * nu, "multipliers": S * N * pairs},
        **{"violations": S * N * limits, "gaps": S * N * pairs, "space": space},
    }
    masks = dict.fromkeys(("closed", "closed_before", "exchanged", "changed", "frictionless"), N * pairs)
    integers = {**dict.fromkeys(FLAGS, 1), **masks, "contacts": (friction + 2) * contacts}
    return {
        "functions": ("void *", 4),
        **{name: ("i64", size) for name, size in integers.items()},
        **{name: ("double", size) for name, size in doubles.items()},
    }
