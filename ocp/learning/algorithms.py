"""Every algorithm by name."""

from __future__ import annotations

from ocp.learning.ars import ARS
from ocp.learning.mbpo.algorithm import MBPO
from ocp.learning.protocol import Algorithm
from ocp.learning.total_propagation import TotalPropagation
from ocp.learning.unrolls.gradients import FOPG, ZOPG, AoBG

ALGORITHMS: dict[str, type[Algorithm]] = {
    algorithm.name: algorithm for algorithm in (FOPG, ZOPG, ARS, AoBG, TotalPropagation, MBPO)
}
