"""A tape cut into parts, each short enough for a compiler, which pass values through memory."""

from __future__ import annotations

import casadi as ca

from dynamics.batch.graphs.tape import Operation, Tape, chosen, operands

# Integer powers up to this one are products, which the vector pow would only approximate.
LARGEST_PRODUCT = 4
# Divisors whose reciprocal is an ordinary double too; a division costs ten products.
MODERATE = (1e-300, 1e300)
_LEAVES = (ca.OP_INPUT, ca.OP_CONST)


class Parts:
    """The computed values of `tape` in turn, at most `size` a part.

    `parts[p]` lists the values of part p, `slots` the place in memory (`n_slots` places in all)
    of each value that a later part reads, and `ends[p]` the outputs (value, output, nonzero) that
    part p writes. A place is reused once its value is not read any more.
    """

    def __init__(self, tape: Tape, size: int) -> None:
        self.tape = tape
        self.counts = tape.use_counts()
        computed = [i for i, o in enumerate(tape.operations) if o.op not in _LEAVES]
        self.parts = [computed[k : k + size] for k in range(0, len(computed), size)] or [[]]
        self._part_of = {i: p for p, part in enumerate(self.parts) for i in part}
        self.slots: dict[int, int] = {}
        self.n_slots = 0
        self._spill()
        self.ends = self._output_parts()

    def reads(self, operation: Operation) -> tuple[int, ...]:
        """The values that an operation reads, those of `if_else` as one selection among them."""
        return operands(operation) + (chosen(self.tape, operation) or ())

    def factors(self, i: int, here: set[int]) -> tuple[int, int] | None:
        """The two factors of a product in the part `here` that is read once, else None."""
        operation = self.tape.operations[i]
        if i not in here or self.counts[i] != 1:
            return None
        if operation.op == ca.OP_MUL:
            return operation.args[0], operation.args[1]
        if operation.op == ca.OP_SQ:
            return operation.args[0], operation.args[0]
        return None

    def power(self, operation: Operation) -> int | None:
        """The exponent of `OP_CONSTPOW` where it is small and whole, else None."""
        exponent = self.tape.operations[operation.args[1]]
        whole = exponent.op == ca.OP_CONST and exponent.value in range(1, LARGEST_PRODUCT + 1)
        return int(exponent.value) if whole else None

    def reciprocal(self, operation: Operation) -> float | None:
        """The reciprocal of a division's divisor where that is a moderate constant, else None."""
        divisor = self.tape.operations[operation.args[1]]
        moderate = divisor.op == ca.OP_CONST and MODERATE[0] < abs(divisor.value) < MODERATE[1]
        return 1.0 / divisor.value if moderate else None

    def _spill(self) -> None:
        last = self._last_parts()
        free: list[int] = []
        for p, part in enumerate(self.parts):
            for i in part:
                if last.get(i, p) > p:
                    if not free:
                        free.append(self.n_slots)
                        self.n_slots += 1
                    self.slots[i] = free.pop()
            free += [self.slots[i] for i, end in last.items() if end == p and i in self.slots]

    def _last_parts(self) -> dict[int, int]:
        last: dict[int, int] = {}
        for i, p in self._part_of.items():
            for arg in self.reads(self.tape.operations[i]):
                if arg in self._part_of:
                    last[arg] = max(last.get(arg, -1), p)
        return last

    def _output_parts(self) -> list[list[tuple[int, int, int]]]:
        ends: list[list[tuple[int, int, int]]] = [[] for _ in self.parts]
        for k, row in enumerate(self.tape.outputs):
            for j, value in enumerate(row):
                ends[self._part_of.get(value, 0)].append((value, k, j))
        return ends
