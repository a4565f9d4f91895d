"""The randomized contact law: the average of another law's step over noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca
import numpy as np

from dynamics.contact.closure import Branch, Closure, Schedule
from dynamics.contact.exact import Exact
from dynamics.contact.law import ContactLaw, by_sigma, law_parameter
from dynamics.contact.step import Step
from dynamics.errors import InputError
from dynamics.settings import setting
from dynamics.systems import ContactSystem, ParameterTable

# Names of the rules by which nodes of the noise are drawn.
SCHEMES = ("sobol", "monte-carlo", "gauss-hermite")
DEFAULT_SAMPLES = 16
"""Default number of nodes."""
DEFAULT_NODES_PER_AXIS = 5
"""Default number of Gauss-Hermite nodes per axis."""
MAX_SAMPLES = 4096
"""Maximum number of nodes."""
MAX_NODES_PER_AXIS = 64
"""Maximum number of Gauss-Hermite nodes per axis."""


@dataclass(eq=False, repr=False)
class Randomized(ContactLaw):
    """Contact law ``x_next = sum_j w_j f(x, u + sigma e_j)``, with f the step under another law, ``base``.

    The nodes e_j are standard normal and common to every step, state and iteration, so that the averaged map is
    one deterministic function. ``scheme`` is ``"monte-carlo"`` or a scrambled ``"sobol"`` set (both with an
    even number of ``samples``, mirrored so that odd moments vanish), or the tensor ``"gauss-hermite"`` rule
    with ``samples`` nodes per axis. ``noise`` is on the ``"input"`` or the ``"state"``. Contacts are solved at
    every node; ``lam`` has the multipliers of all nodes.
    """

    name: ClassVar[str] = "randomized"
    summary: ClassVar[str] = "average of another law over noise on the input or the state"

    sigma: float = setting(0.1, "standard deviation of the noise", "SI", above=0)
    samples: int | None = setting(
        None,
        f"nodes, an even number; {DEFAULT_SAMPLES} if not given. gauss-hermite: an axis, {DEFAULT_NODES_PER_AXIS}",
        least=2,
        most=MAX_SAMPLES,
    )
    seed: int = setting(0, "random seed of the nodes", least=0, most=2**31 - 1)
    scheme: str = setting("sobol", "rule of the nodes", words=SCHEMES)
    noise: str = setting("input", "where the noise is added", words=("input", "state"))
    base: ContactLaw | None = setting(None, "law that is averaged, exact if not given; its settings are base.NAME")

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.base, Randomized):
            raise InputError("randomized: the base law must not be randomized itself")
        is_tensor = self.scheme == "gauss-hermite"
        if self.samples is None:
            self.samples = DEFAULT_NODES_PER_AXIS if is_tensor else DEFAULT_SAMPLES
        if is_tensor and self.samples > MAX_NODES_PER_AXIS:
            raise InputError(f"randomized: samples must be at most {MAX_NODES_PER_AXIS} an axis, got {self.samples}")
        if not is_tensor and self.samples % 2:
            raise InputError(f"randomized: samples must be even, got {self.samples}")
        self.base = self.base_law

    @property
    def base_law(self) -> ContactLaw:
        """Law that is averaged; the exact law by default."""
        return self.base or Exact()

    @property
    def exact(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Whether the base law is exact, so that contact at every node is complementary."""
        return self.base_law.exact

    @property
    def frozen(self) -> bool:
        """Whether gradients treat the base law's mu as a constant."""
        return self.base_law.frozen

    def schedule(self, impulse: float, gap: float) -> Schedule:
        """Return the homotopy along ``contact.sigma``."""
        return by_sigma(gap)

    def settings(self) -> dict[str, float | int | str]:
        """Return the settings, and the base law's settings as ``base.<name>``, for the record of the run."""
        own_settings = {key: value for key, value in vars(self).items() if key != "base"}
        base_settings = {f"base.{key}": value for key, value in self.base_law.settings().items()}
        return {**own_settings, "base": self.base_law.name, **base_settings}

    def at(self, **values: float) -> Randomized:
        """Return the same law with other values of its settings or of the base law's parameters."""
        settings = dict(vars(self))
        base_values = {name: value for name, value in values.items() if name not in settings}
        if base_values:
            settings["base"] = self.base_law.at(**base_values)
        own_values = {name: value for name, value in values.items() if name in settings}
        return Randomized(**{**settings, **own_values})  # pyright: ignore[reportArgumentType]

    def parameters(self, system: ContactSystem) -> ParameterTable:
        """Return ``contact.sigma`` and the base law's parameters."""
        sigma_parameter = law_parameter(
            "sigma", self.sigma, "SI", f"standard deviation of the noise on the {self.noise}"
        )
        base_parameters = self.base_law.parameters(system)
        if "contact.sigma" in base_parameters:
            raise ValueError("randomized: the base law has a sigma of its own; use barrier or exact")
        return ParameterTable([sigma_parameter]) + base_parameters

    def close_at_nodes(self, system: ContactSystem, law: Closure, p: ParameterTable, nodes: tuple[Branch, ...]) -> Step:
        """Return the base law's step, solved at all nodes."""
        return self.base_law.close_at_nodes(system, law, p, nodes)

    def target(self, system: ContactSystem, z: ca.SX, F: ca.SX, p: ParameterTable) -> ca.SX:
        """Return the base law's mu at one node, shape (n, 1)."""
        return self.base_law.target(system, z, F, p)

    def nodes(self, system: ContactSystem, p: ParameterTable) -> list[Branch]:
        """Return the nodes' disturbances of state or input, with their weights."""
        dimension = system.nu if self.noise == "input" else system.nx
        assert self.samples is not None
        points, weights = standard_normal_nodes(dimension, self.samples, self.seed, self.scheme)
        sigma = p["contact.sigma"]
        branches = []
        for point, weight in zip(points, weights, strict=True):
            shift = sigma * ca.SX(ca.DM(point))
            on_x = shift if self.noise == "state" else ca.SX.zeros(system.nx)
            on_u = shift if self.noise == "input" else ca.SX.zeros(system.nu)
            branches.append(Branch(float(weight), on_x, on_u))
        return branches


def standard_normal_nodes(dimension: int, samples: int, seed: int, scheme: str) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes (n, dimension) and weights (n,) of averages over N(0, I).

    Raises ``ValueError`` if a Gauss-Hermite tensor would have more than :data:`MAX_SAMPLES` nodes.
    """
    from scipy.stats import norm, qmc

    if scheme == "gauss-hermite":
        if samples**dimension > MAX_SAMPLES:
            raise ValueError(
                f"randomized: {samples} Gauss-Hermite nodes an axis in {dimension} dimensions are"
                f" {samples**dimension}, more than {MAX_SAMPLES}; use scheme=sobol"
            )
        nodes, weights = np.polynomial.hermite_e.hermegauss(samples)
        weights = weights / weights.sum()
        grids = np.meshgrid(*[nodes] * dimension, indexing="ij")
        products = np.meshgrid(*[weights] * dimension, indexing="ij")
        points = np.stack([grid.ravel() for grid in grids], axis=1)
        return points, np.prod([product.ravel() for product in products], axis=0)
    n_drawn = samples // 2
    if scheme == "sobol":
        exponent = int(np.ceil(np.log2(n_drawn)))
        uniform = qmc.Sobol(dimension, rng=np.random.default_rng(seed)).random_base2(exponent)
        points_drawn = norm.ppf(uniform[:n_drawn])
    else:
        points_drawn = np.random.default_rng(seed).standard_normal((n_drawn, dimension))
    return np.concatenate([points_drawn, -points_drawn]), np.full(samples, 1 / samples)
