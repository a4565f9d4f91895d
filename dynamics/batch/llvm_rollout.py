"""LLVM IR of rollouts: the driver of `dynamics.batch.c_rollout`, loop for loop.

The horizon is an argument: the text does not depend on it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from llvmlite import ir

from dynamics.batch import llvm_chunks, llvm_moments, llvm_random, llvm_rows, llvm_step
from dynamics.batch.llvm_moments import Moments
from dynamics.batch.llvm_source import run_kernel
from dynamics.batch.llvm_vectors import F64, I64, POINTER, Machine, Value, Writer, index
from dynamics.batch.rollout_engines import Job
from dynamics.batch.rollout_tapes import RolloutTapes

_VOID = ir.VoidType()
_FIELDS = {field[0]: k for k, field in enumerate(Job._fields_)}
_GIVEN, _DRAWN = 1, 2


def module(tapes: RolloutTapes, block: int, machine: Machine) -> ir.Module:
    """A module whose `run(next, n, chunk, job)` rolls out n samples, chunk by chunk."""
    made = ir.Module("rollout")
    llvm_rows.functions(made, machine)
    llvm_random.four_normals(made, machine)
    llvm_moments.functions(made, machine)
    llvm_step.one_step(made, machine, tapes.forward)
    for name in ("adjoint", "score", "terminal", "terminal_adjoint"):
        llvm_step.graph(made, machine, getattr(tapes, name), name)
    w = Writer(made, machine, "roll_out", [I64, I64, I64, POINTER], I64)
    _Driver(w, tapes, max(1, block // machine.lanes)).write()
    llvm_chunks.run(made, machine, "roll_out", [POINTER])
    return made


class _Driver:
    """Writes `roll_out`. Work is done on blocks of `abreast` vectors, each with a lane of memory.

    Memory of vector j is entry `start + j * stride` on, where `stride` is 0 for what all samples
    share and else the size of such a lane.
    """

    def __init__(self, w: Writer, tapes: RolloutTapes, abreast: int) -> None:
        self.w, self.tapes, self.abreast = w, tapes, abreast
        self.begin, self.end, self.chunk, self.job = w.arguments
        b = w.b
        self.horizon, self.parts = self._field("horizon"), self._field("parts")
        self.nt = b.mul(self.parts, index(tapes.n_theta))
        self.nw = b.mul(self.horizon, index(tapes.nu))
        per_step = b.icmp_signed(">", self.parts, index(1))
        self.theta_step = b.select(per_step, index(tapes.n_theta), index(0))
        want, noise = self._field("want"), self._field("noise")
        self.gradient, self.score, self.in_moments = (
            b.icmp_signed("!=", b.and_(want, index(bit)), index(0)) for bit in (1, 2, 4)
        )
        self.given, self.drawn = (
            b.icmp_signed("==", noise, index(kind)) for kind in (_GIVEN, _DRAWN)
        )
        self.shared = {
            name: b.icmp_signed("!=", self._field(f"shared_{name}"), index(0))
            for name in ("x0", "theta", "p")
        }
        self.shared["w"] = b.not_(b.or_(self.given, self.drawn))
        kinds = b.add(b.zext(self.gradient, I64), b.zext(self.score, I64))
        self.n_values = b.add(index(1), b.mul(self.nt, kinds))
        self._lay_out()

    def _field(self, name: str, kind: ir.Type = I64) -> Value:
        return self.w.load(self.w.at(self.job, _FIELDS[name], I64), 0, kind)

    def _lay_out(self) -> None:
        """Where in a lane of memory everything begins, and how long a lane is."""
        b, tapes = self.w.b, self.tapes
        sizes = {
            "x": b.mul(b.add(self.horizon, index(1)), index(tapes.nx)),
            "lam": b.mul(self.horizon, index(tapes.nlam)),
            **{"w": self.nw, "theta": self.nt, "gradient": self.nt, "score": self.nt},
            **{"p": index(tapes.np), "cost": index(1)},
        }
        self.starts: dict[str, Value] = {}
        self.lane = index(0)
        for name, size in sizes.items():
            self.starts[name] = self.lane
            self.lane = b.add(self.lane, size)

    def _at(self, name: str, j: Value | int, k: Value | int = 0) -> Value:
        """The address of entry k of what vector j has under this name."""
        b = self.w.b
        stride = self.lane
        if name in self.shared:
            stride = b.select(self.shared[name], index(0), self.lane)
        start = b.add(self.starts[name], b.mul(index(j), stride))
        return self.w.at(self.memory, b.add(start, index(k)))

    def write(self) -> None:
        w, b = self.w, self.w.b
        lanes = b.mul(index(self.abreast), self.lane)
        room = b.add(lanes, b.mul(index(3), self.n_values))
        self.memory = w.allocate(room)
        self.moments = Moments(w, w.at(self.memory, lanes), self.n_values)
        self.moments.clear()
        self._load_shared()
        self.bad = w.array(1, I64)
        w.store(index(0), self.bad)
        with w.loop(self.begin, self.end, self.abreast * w.lanes) as block:
            self._block(block.i)
        with b.if_then(self.in_moments):
            row = b.mul(
                b.sdiv(self.begin, self.chunk), b.add(index(1), b.shl(self.n_values, index(1)))
            )
            self.moments.finish(w.at(self._field("moments", POINTER), row, F64))
        w.free(self.memory)
        b.ret(w.load(self.bad, 0, I64))

    def _rows(self, name: str, size: Value, row: Value, to: Value, shared: Value | None) -> None:
        stride = size if shared is None else self.w.b.select(shared, index(0), size)
        a = self._field(name, POINTER)
        self.w.call("load_rows", a, size, stride, row, self.end, to, result=_VOID)

    def _load_shared(self) -> None:
        w = self.w
        for name, size in (("theta", self.nt), ("p", index(self.tapes.np))):
            with w.b.if_then(self.shared[name]):
                self._rows(name, size, self.begin, self._at(name, 0), self.shared[name])
        with w.b.if_then(self.shared["w"]), w.loop(0, self.nw) as k:
            w.store(w.splat(0.0), self._at("w", 0, k.i))

    def _block(self, first: Value) -> None:
        w, b = self.w, self.w.b
        left = b.sub(self.end, first)
        vectors = b.sdiv(b.add(left, index(w.lanes - 1)), index(w.lanes))
        full = b.icmp_signed(">", vectors, index(self.abreast))
        self.vectors = b.select(full, index(self.abreast), vectors)
        with w.loop(0, self.vectors) as j:
            self._load(j.i, b.add(first, b.mul(j.i, index(w.lanes))))
        self._forward(first)
        with b.if_then(self.gradient):
            self._backward(first)
        with b.if_then(self.score):
            self._scores()
        with w.loop(0, self.vectors) as j:
            self._deliver(j.i, b.add(first, b.mul(j.i, index(w.lanes))), first)

    def _load(self, j: Value, row: Value) -> None:
        b, tapes = self.w.b, self.tapes
        self._rows("x0", index(tapes.nx), row, self._at("x", j), self.shared["x0"])
        for name, size in (("theta", self.nt), ("p", index(tapes.np))):
            with b.if_then(b.not_(self.shared[name])):
                self._rows(name, size, row, self._at(name, j), None)
        with b.if_then(self.given):
            self._rows("w", self.nw, row, self._at("w", j), None)
        with b.if_then(self.drawn):
            self._draw(j, row)

    def _draw(self, j: Value, row: Value) -> None:
        w, b = self.w, self.w.b
        sigma, sample = self._field("sigma", POINTER), b.add(self._field("first"), row)
        z = w.array(4)
        with w.loop(0, self.nw, 4) as m:
            key = self._field("key0"), self._field("key1")
            quadruple = b.sdiv(m.i, index(4))
            w.call("four_normals", sample, quadruple, *key, z, result=_VOID)
            last = b.sub(self.nw, m.i)
            with w.loop(0, b.select(b.icmp_signed("<", last, index(4)), last, index(4))) as k:
                at = b.add(m.i, k.i)
                scale = w.load(sigma, b.srem(at, index(self.tapes.nu)), F64)
                w.store(b.fmul(w.load(z, k.i), w.spread(scale)), self._at("w", j, at))

    @contextmanager
    def _time(
        self, first: Value | None = None, backward: bool = False
    ) -> Iterator[tuple[Value, Value]]:
        """A loop over steps t and, within, over vectors j of the block.

        With the block's first row, it meanwhile fetches what the next block reads or, backward,
        where this one's gradient goes.
        """
        w = self.w
        with w.loop(0, self.horizon) as t:
            if first is not None:
                self._fetch_meanwhile(first, t.i, backward)
            step = t.i
            if backward:
                step = w.b.sub(w.b.sub(self.horizon, index(1)), t.i)
            with w.loop(0, self.vectors) as j:
                yield step, j.i

    def _fetch_meanwhile(self, first: Value, t: Value, backward: bool) -> None:
        b = self.w.b
        if backward:
            self._fetch("gradient", self.nt, first, t, b.not_(self.in_moments), True)
            return
        ahead = b.add(first, index(self.abreast * self.w.lanes))
        self._fetch("theta", self.nt, ahead, t, b.not_(self.shared["theta"]), False)
        self._fetch("w", self.nw, ahead, t, self.given, False)

    def _fetch(
        self, name: str, size: Value, first: Value, t: Value, wanted: Value, write: bool
    ) -> None:
        b = self.w.b
        rows = b.sub(self.end, first)
        most = index(self.abreast * self.w.lanes)
        rows = b.select(b.icmp_signed("<", rows, most), rows, most)
        with b.if_then(b.and_(wanted, b.icmp_signed(">", rows, index(0)))):
            a = self.w.at(self._field(name, POINTER), b.mul(first, size), F64)
            llvm_rows.fetch(self.w, a, b.mul(rows, size), (t, self.horizon), write)

    def _step_arguments(self, t: Value, j: Value) -> list[Value]:
        """Addresses of x, theta and w of step t."""
        b, tapes = self.w.b, self.tapes
        x = self._at("x", j, b.mul(t, index(tapes.nx)))
        theta = self._at("theta", j, b.mul(t, self.theta_step))
        return [x, theta, self._at("w", j, b.mul(t, index(tapes.nu)))]

    def _end_arguments(self, j: Value) -> list[Value]:
        """Addresses of the last x and of p."""
        last = self.w.b.mul(self.horizon, index(self.tapes.nx))
        return [self._at("x", j, last), self._at("p", j)]

    def _lam(self, t: Value, j: Value) -> Value:
        return self._at("lam", j, self.w.b.mul(t, index(self.tapes.nlam)))

    def _forward(self, first: Value) -> None:
        w, stage = self.w, self.w.array(1)
        with w.loop(0, self.vectors) as j:
            w.store(w.splat(0.0), self._at("cost", j.i))
        with self._time(first) as (t, j):
            arguments = self._step_arguments(t, j)
            x_next = w.at(arguments[0], self.tapes.nx)
            run_kernel(w, "one_step", *arguments, self._at("p", j), x_next, self._lam(t, j), stage)
            self._add(stage, self._at("cost", j), 1)
        with w.loop(0, self.vectors) as j:
            run_kernel(w, "terminal", *self._end_arguments(j.i), stage)
            self._add(stage, self._at("cost", j.i), 1)

    def _add(self, values: Value, to: Value, size: int) -> None:
        for k in range(size):
            self.w.store(self.w.b.fadd(self.w.load(to, k), self.w.load(values, k)), to, k)

    def _clear(self, name: str, j: Value) -> None:
        with self.w.loop(0, self.nt) as k:
            self.w.store(self.w.splat(0.0), self._at(name, j, k.i))

    def _backward(self, first: Value) -> None:
        w, b, tapes = self.w, self.w.b, self.tapes
        bars, before = w.array(self.abreast * tapes.nx), w.array(tapes.nx)
        part = w.array(tapes.n_theta)
        with w.loop(0, self.vectors) as j:
            bar = w.at(bars, b.mul(j.i, index(tapes.nx)))
            run_kernel(w, "terminal_adjoint", *self._end_arguments(j.i), bar)
            self._clear("gradient", j.i)
        with self._time(first, backward=True) as (t, j):
            bar = w.at(bars, b.mul(j, index(tapes.nx)))
            arguments = [*self._step_arguments(t, j), self._at("p", j), self._lam(t, j), bar]
            run_kernel(w, "adjoint", *arguments, before, part)
            for k in range(tapes.nx):
                w.store(w.load(before, k), bar, k)
            to = self._at("gradient", j, b.mul(t, self.theta_step))
            self._add(part, to, tapes.n_theta)

    def _scores(self) -> None:
        w, b, tapes = self.w, self.w.b, self.tapes
        weighed, part = w.array(tapes.nu), w.array(tapes.n_theta)
        precision = self._field("precision", POINTER)
        with w.loop(0, self.vectors) as j:
            self._clear("score", j.i)
        with self._time() as (t, j):
            x, theta, noise = self._step_arguments(t, j)
            for k in range(tapes.nu):
                scale = w.spread(w.load(precision, k, F64))
                w.store(b.fmul(w.load(noise, k), scale), weighed, k)
            run_kernel(w, "score", x, theta, weighed, part)
            self._add(part, self._at("score", j, b.mul(t, self.theta_step)), tapes.n_theta)

    def _deliver(self, j: Value, row: Value, first: Value) -> None:
        """Count what is not finite, and store vector j's values or add them to the moments."""
        w, b = self.w, self.w.b
        cost, gradient, score = (self._at(name, j) for name in ("cost", "gradient", "score"))
        n_gradient = b.select(self.gradient, self.nt, index(0))
        n_score = b.select(self.score, self.nt, index(0))
        blocks = [(cost, index(1)), (gradient, n_gradient), (score, n_score)]
        finite, here = llvm_moments.finite(w, blocks), w.below(row, self.end)
        lost = w.how_many(b.and_(b.not_(finite), here))
        w.store(b.add(w.load(self.bad, 0, I64), lost), self.bad)
        with b.if_else(self.in_moments) as (add, keep):
            with add:
                gain = b.fsub(w.load(cost), w.spread(self._field("baseline", F64)))
                with w.loop(0, n_score) as k:
                    w.store(b.fmul(w.load(score, k.i), gain), score, k.i)
                starting = b.icmp_signed("==", row, self.begin)
                self.moments.add(blocks, b.and_(finite, here), starting)
            with keep:
                for name, (values, size) in zip(("cost", "gradient", "score"), blocks, strict=True):
                    with b.if_then(b.icmp_signed(">", size, index(0))):
                        a = self._field(name, POINTER)
                        w.call("store_rows", a, size, row, self.end, values, result=_VOID)
