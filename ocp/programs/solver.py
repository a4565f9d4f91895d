"""Runs of a named NLP solver on an NLP, and their statuses."""

from __future__ import annotations

import ctypes
import json
import logging
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr, suppress
from dataclasses import dataclass, replace
from enum import Enum
from io import StringIO
from pathlib import Path
from types import FrameType
from typing import Any

import casadi as ca
import numpy as np

from ocp.errors import InputError, choose
from ocp.programs.options import ABANDONS, INTERFACE, ShortSteps, check_options
from ocp.programs.program import Program
from ocp.programs.scaled import Point, Scaled


class Status(Enum):
    """Outcome of a solve; the value is the sentence that users see."""

    SOLVED = "solved: feasible by the audit, and certified stationary"
    NOT_OPTIMAL = "feasible, not optimal"
    UNDECIDED = "feasible, but whether it is optimal was not decided"
    UNBOUNDED = "not solved: the cost decreases without bound"
    INEXACT = "not solved: the solver stopped, but the audited residuals are above tolerance"
    NO_PROGRESS = "no-progress: it does no better than standing still"
    ITERATION_LIMIT = "not converged: the iteration limit was reached"
    TIME_LIMIT = "not converged: the time limit was reached"
    INFEASIBLE = "not converged: the constraints could not be satisfied from this guess"
    DIVERGED = "not converged: the iterates diverged or a function returned NaN or infinity"
    INTERRUPTED = "interrupted: this is the best point so far; continue with --from its run"
    FAILED = "not converged: the solver stopped without a solution"

    @property
    def label(self) -> str:
        """Short name of the status, as used in JSON."""
        return self.name.lower().replace("_", "-")


logger = logging.getLogger(__name__)
SOLVERS = {
    "ipopt": "interior point, exact Hessian, MUMPS or SPRAL inside (the default)",
    "fatrop": "interior point for staged problems",
    "uno": "barrier and SQP methods of the Uno family",
    "sleqp": "sequential linear programming with equality-constrained steps",
}
"""Mapping from names of solvers to descriptions."""
IPOPT_DEFAULTS: dict[str, Any] = {
    "print_level": 0,
    "sb": "yes",
    "tol": 1e-9,
    "constr_viol_tol": 1e-9,
    "compl_inf_tol": 1e-9,
    "dual_inf_tol": 1e-4,
    "acceptable_iter": 10,
    "acceptable_tol": 1e-5,
    "acceptable_obj_change_tol": 1e-10,
    "acceptable_constr_viol_tol": 1e-9,
    "max_iter": 1000,
    "bound_relax_factor": 0.0,
    "honor_original_bounds": "yes",
    "mumps_mem_percent": 200,
}
"""Default options of IPOPT."""
USUAL: dict[str, dict[str, Any]] = {
    "ipopt": IPOPT_DEFAULTS,
    "fatrop": {"print_level": 0, "max_iter": 200},
    "sleqp": {"print_level": 1, "max_iter": 300},
    "uno": {"logger": "SILENT", "primal_tolerance": 1e-9, "dual_tolerance": 1e-9},
}
"""Default options of each solver: no output, tolerances no looser than the audit's, iteration limits."""
TIMED_OUT = ("Maximum_CpuTime_Exceeded", "Maximum_WallTime_Exceeded", "time limit")
"""Return statuses of runs that ended at a time limit; there is no limit unless the user sets one."""
_STATUS = {
    **dict.fromkeys(TIMED_OUT, Status.TIME_LIMIT),
    "Solve_Succeeded": Status.SOLVED,
    "Solved_To_Acceptable_Level": Status.SOLVED,
    "Maximum_Iterations_Exceeded": Status.ITERATION_LIMIT,
    "Infeasible_Problem_Detected": Status.INFEASIBLE,
    "Diverging_Iterates": Status.DIVERGED,
    "Invalid_Number_Detected": Status.DIVERGED,
    "iteration limit": Status.ITERATION_LIMIT,
    "infeasible": Status.INFEASIBLE,
    "Converged with infeasible stationary point": Status.INFEASIBLE,
    "Terminated with infeasible small step": Status.INFEASIBLE,
}
"""Mapping from return statuses of solvers to :class:`Status`; for others the solver's success flag is used."""


@dataclass(frozen=True)
class Result:
    """Result of a solver's run: point, cost, constraints, status, and the solver's return status ``word``.

    ``evaluation_s`` is the part of ``seconds`` spent on the NLP's functions and their derivatives; the rest was spent
    in the solver.
    """

    point: Point
    f: float
    g: np.ndarray
    status: Status
    word: str
    iterations: int
    seconds: float
    evaluation_s: float = 0.0

    @classmethod
    def at(
        cls, program: Program, point: Point, p: np.ndarray, status: Status, word: str, seconds: float = 0.0
    ) -> Result:
        """Return the result for a point that no solver has changed."""
        return cls(point, *program.values(point.x, p), status, word, 0, seconds)

    @property
    def ok(self) -> bool:
        """Whether the solver claims convergence."""
        return self.status is Status.SOLVED


class Solver:
    """An NLP solver with its options; compiled instances are cached in the NLP.

    ``options`` are options of the solver (for IPOPT without the ``ipopt.`` prefix). ``on_result`` may be a
    function that is called with the program and the result of each run; after a run that Ctrl-C
    ended, KeyboardInterrupt is then raised. Raises :class:`~ocp.errors.InputError` for an unknown name, a plugin
    that this CasADi lacks, or an option that the solver rejects.
    """

    def __init__(self, name: str = "ipopt", options: dict[str, Any] | None = None) -> None:
        choose("solver", name, SOLVERS)
        if not ca.has_nlpsol(name):
            raise InputError(f"this CasADi has no {name}; use --solver ipopt")
        self.name, self.options = name, check_options(name, options or {})
        self.on_result: Callable[[Program, Result], None] | None = None

    def run(self, nlp: Program, start: Point, p: np.ndarray, bounds: dict[str, np.ndarray], **overrides: Any) -> Result:
        """Solve ``nlp`` from ``start``; IPOPT uses the start's multipliers if ``warm_start_init_point`` is set."""
        function, monitor = self._compiled(nlp, overrides)
        if monitor is not None:
            monitor.calls = 0
        _check_bounds(nlp, bounds)
        scaled = Scaled(nlp)
        arguments: dict[str, Any] = {"p": p, **scaled.solver_arguments(start, bounds)}
        logger.debug("%s on %s starts", self.name, nlp.title)
        start_time = time.perf_counter()
        with record_interrupts() as signals:
            try:
                solved = function(**arguments)
            except RuntimeError as error:
                if signals:
                    raise KeyboardInterrupt from error
                return self._failed_result(nlp, start, p, error, time.perf_counter() - start_time)
        seconds = time.perf_counter() - start_time
        stats = function.stats()
        word = str(stats.get("return_status", "unknown"))
        word = "Short_Steps" if word == "User_Requested_Stop" and not signals else word
        succeeded = bool(stats.get("success", False))
        status = _STATUS.get(word, Status.SOLVED if succeeded else Status.FAILED)
        values = {key: np.array(solved[key]).ravel() for key in ("x", "lam_x", "lam_g", "g")}
        point, cost, g = scaled.unscale(float(solved["f"]), **values)
        if not np.all(np.isfinite(values["x"])):
            status = Status.DIVERGED
        # Wall time of f, g and their derivatives, as measured by CasADi around each call.
        evaluation_s = sum(float(v) for key, v in stats.items() if key.startswith("t_wall_nlp_"))
        iterations = int(stats.get("iter_count", 0))
        result = Result(point, cost, g, status, word, iterations, seconds, evaluation_s)
        logger.debug(
            "%s on %s: %s after %d it in %.4f s, %.4f s of it in functions; options %s",
            self.name,
            nlp.title,
            word,
            result.iterations,
            seconds,
            result.evaluation_s,
            {**self.options, **overrides},
        )
        return self._report(nlp, p, result, bool(signals))

    def _report(self, nlp: Program, p: np.ndarray, result: Result, is_interrupted: bool) -> Result:
        """Pass a run's result to ``on_result`` and return it; raise KeyboardInterrupt if Ctrl-C was pressed."""
        if is_interrupted:
            cost, g = nlp.values(result.point.x, p)
            result = replace(result, f=cost, g=g, status=Status.INTERRUPTED)
        if self.on_result is not None:
            self.on_result(nlp, result)
        if is_interrupted:
            raise KeyboardInterrupt
        return result

    def _failed_result(self, nlp: Program, start: Point, p: np.ndarray, error: RuntimeError, seconds: float) -> Result:
        """Return a failed result for a plugin's exception; raise InputError if the exception is about options."""
        message = str(error).strip().splitlines()[-1]
        if "option" in message or "logger" in message:
            raise InputError(f"{self.name} rejected its options {self.options}: {message}") from error
        return Result.at(nlp, start, p, Status.FAILED, message, seconds)

    def _compiled(self, nlp: Program, overrides: dict[str, Any]) -> tuple[ca.Function, ShortSteps | None]:
        options = {**self.options, **overrides}
        limits = [values["max_iter"] for values in (self.options, overrides) if "max_iter" in values]
        if limits:
            options["max_iter"] = min(limits)
        # Programs that share instances may have different scales, which are constants in an instance.
        key = json.dumps([self.name, options, nlp.natural.digest], sort_keys=True, default=str)
        if key not in nlp.solvers:
            # A solver refers to its monitor by address only, which must live as long.
            monitor = ShortSteps() if options.pop(ABANDONS, False) else None
            function = self._create(nlp, options, monitor)
            if monitor is not None:
                monitor.monitored = function
            nlp.solvers[key] = function, monitor
        return nlp.solvers[key]

    def _create(self, nlp: Program, options: dict[str, Any], monitor: ca.Callback | None) -> ca.Function:
        x, p = ca.MX.sym("x", nlp.n), ca.MX.sym("p", nlp.n_parameters)
        functions = Scaled(nlp).functions()
        f, g = functions["f_g"].call([x, p], True, False)
        common: dict[str, Any] = {
            "print_time": False,
            "calc_lam_p": False,
            "error_on_fail": False,
            "show_eval_warnings": False,
        }
        interface_options = INTERFACE.get(self.name, {})
        for name, value in {**USUAL[self.name], **options}.items():
            (common if name in interface_options else common.setdefault(self.name, {}))[name] = value
        if self.name == "ipopt":
            derivatives = {name: functions[name] for name in ("grad_f", "jac_g", "hess_lag")}
            common |= {"no_nlp_grad": True, **derivatives}
        if monitor is not None:
            common["iteration_callback"] = monitor
        try:
            return ca.nlpsol("solver", self.name, {"x": x, "p": p, "f": f, "g": g}, common)
        except RuntimeError as error:
            line = next((s for s in str(error).splitlines() if "ption" in s), str(error).strip())
            reason = line.rpartition(".cpp:")[2].partition(": ")[2].strip() or line.strip()
            raise InputError(f"{self.name} rejected its options: {reason}") from error


def _check_bounds(nlp: Program, bounds: dict[str, np.ndarray]) -> None:
    for letter, layout in (("x", nlp.variables), ("g", nlp.constraints)):
        lower, upper = bounds[f"lb{letter}"], bounds[f"ub{letter}"]
        crossed = np.flatnonzero(~(lower <= upper) | (lower == np.inf) | (upper == -np.inf))
        if crossed.size:
            position = int(crossed[0])
            block, index = layout.locate(position)
            component = block.components[index[-1]] if block.components else str(index[-1])
            relation = "above" if lower[position] > upper[position] else "and there is no finite number below"
            raise InputError(
                f"{nlp.title}: the lower bound of {component} in {block.name} is"
                f" {lower[position]:g}, {relation} its upper bound {upper[position]:g}; exchange or widen them"
            )


@contextmanager
def record_interrupts() -> Iterator[list[int]]:
    """Yield a list to which every SIGINT is appended; the previous signal handler is also called.

    CasADi lets Python handle signals at every evaluation of a function. IPOPT's interface catches
    exceptions of the handler, stops, and returns its last iterate silently; other plugins propagate the
    exception. CasADi's warnings about it are not printed.
    """
    signals: list[int] = []
    previous_handler = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(previous_handler):
        yield signals
        return

    silence = ExitStack()

    def note(number: int, frame: FrameType | None) -> None:
        signals.append(number)
        silence.enter_context(redirect_stderr(StringIO()))
        previous_handler(number, frame)

    signal.signal(signal.SIGINT, note)
    try:
        yield signals
    finally:
        silence.close()
        signal.signal(signal.SIGINT, previous_handler)


_STDOUT_LOCK = threading.Lock()
"""Lock of file descriptor 1 while it is redirected."""


@contextmanager
def without_stdout() -> Iterator[None]:
    """Discard output on file descriptor 1, since HiGHS calls ``printf`` whatever its options are."""
    with _STDOUT_LOCK, Path(os.devnull).open("w") as nowhere:
        _flush()
        try:
            stdout_copy = os.dup(1)
        except OSError:
            stdout_copy = -1
        try:
            os.dup2(nowhere.fileno(), 1)
            yield
        finally:
            _flush()
            os.dup2(stdout_copy, 1) if stdout_copy >= 0 else os.close(1)
            with suppress(OSError):
                os.close(stdout_copy)


def _flush() -> None:
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).fflush(None)
