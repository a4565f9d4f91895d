"""One program a sample with the active set of the plan before."""

from __future__ import annotations

from ocp.mpc.phases.qpcc import QPCC


class FixedActiveSet(QPCC):
    """The program of :class:`QPCC` without exchanges: contacts stay as the plan has them."""

    exchanges = 0
