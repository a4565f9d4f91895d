"""LLVM IR of one step: in closed form, or around the inner loops that solve for contact.

A lane that has come to rest keeps its value, so that a sample does not depend on its neighbours;
a vector leaves a loop once all its lanes rest.
"""

from __future__ import annotations

import casadi as ca
from llvmlite import ir

from dynamics.batch import llvm_source
from dynamics.batch.inner import InnerLoop
from dynamics.batch.llvm_source import run_kernel
from dynamics.batch.llvm_vectors import POINTER, Machine, Value, Writer
from dynamics.batch.tape import tape_of, with_shared_reciprocals

_INNER_GRAPHS = ("opening", "newton", "settled", "path", "followed", "closing")
_VOID = ir.VoidType()


def graph(module: ir.Module, machine: Machine, fn: ca.Function, name: str) -> None:
    """Write a CasADi function as the kernel `name`."""
    llvm_source.kernel(module, machine, with_shared_reciprocals(tape_of(fn)), name)


def one_step(module: ir.Module, machine: Machine, forward: ca.Function | InnerLoop) -> None:
    """Write the kernel `one_step: (x, theta, w, p) -> (x_next, lam, cost)`."""
    if not isinstance(forward, InnerLoop):
        graph(module, machine, forward, "one_step")
        return
    for name in _INNER_GRAPHS:
        graph(module, machine, getattr(forward, name), name)
    _follow_path(module, machine, forward)
    _solve_branch(module, machine, forward)
    w = Writer(module, machine, "one_step", [POINTER] * 8)
    given, results = w.arguments[:4], w.arguments[4:7]
    lam, data = w.array(forward.branches * forward.n), w.array(forward.branches * forward.n_data)
    run_kernel(w, "opening", *given, lam, data)
    for k in range(forward.branches):
        place = w.at(lam, k * forward.n), w.at(data, k * forward.n_data)
        w.call("solve_branch", *place, result=_VOID)
    run_kernel(w, "closing", *given, lam, *results)
    w.b.ret_void()


def _solve_branch(module: ir.Module, machine: Machine, loop: InnerLoop) -> None:
    """Newton's method on `lam`, in place; where it does not come to rest, the path."""
    w = Writer(module, machine, "solve_branch", [POINTER, POINTER])
    lam, data = w.arguments
    moved, unrest, still = w.array(loop.n), w.array(1), w.array(1, w.M)
    w.b.store(ir.Constant(w.M, [1] * w.lanes), still)
    with w.loop(0, loop.newton_iterations) as again:
        again.leave_if(w.b.not_(w.any(w.b.load(still, typ=w.M))))
        run_kernel(w, "newton", lam, data, moved, unrest)
        active = w.b.load(still, typ=w.M)
        _replace(w, lam, moved, active, loop.n)
        w.b.store(w.b.and_(active, w.nonzero(w.load(unrest))), still)
    run_kernel(w, "settled", lam, data, moved)
    _replace(w, lam, moved, None, loop.n)
    active = w.b.load(still, typ=w.M)
    with w.b.if_then(w.any(active), likely=False):
        _run_path(w, lam, data, active)
    w.b.ret_void()


def _run_path(w: Writer, lam: Value, data: Value, active: Value) -> None:
    """Call `follow_path`, which takes the mask as numbers, in memory as all else."""
    wanted = w.array(1)
    w.store(w.pick(active, w.splat(1.0), w.splat(0.0)), wanted)
    w.call("follow_path", lam, data, wanted, result=_VOID)


def _follow_path(module: ir.Module, machine: Machine, loop: InnerLoop) -> None:
    """Follow the path from its start, and put its end into `lam` where `wanted` is not 0."""
    w = Writer(module, machine, "follow_path", [POINTER] * 3, attribute="noinline")
    lam, data, wanted = w.arguments
    pair, moved, end = w.array(loop.n_pair), w.array(loop.n_pair), w.array(loop.n)
    for k in range(loop.n_pair):
        w.store(w.splat(1.0), pair, k)
    with w.loop(0, loop.path_iterations) as again:
        run_kernel(w, "path", pair, data, moved)
        again.leave_if(w.b.not_(_differ(w, pair, moved, loop.n_pair)))
        _replace(w, pair, moved, None, loop.n_pair)
    run_kernel(w, "followed", pair, data, end)
    _replace(w, lam, end, w.nonzero(w.load(wanted)), loop.n)
    w.b.ret_void()


def _replace(w: Writer, old: Value, new: Value, where: Value | None, size: int) -> None:
    for k in range(size):
        value = w.load(new, k)
        w.store(value if where is None else w.pick(where, value, w.load(old, k)), old, k)


def _differ(w: Writer, one: Value, other: Value, size: int) -> Value:
    """Whether any bit differs; NaN, which differs from itself as a number, so comes to rest."""
    changed: Value = ir.Constant(w.M, [0] * w.lanes)
    for k in range(size):
        bits = (w.load(a, k, w.Q) for a in (one, other))
        changed = w.b.or_(changed, w.b.icmp_unsigned("!=", *bits))
    return w.any(changed)
