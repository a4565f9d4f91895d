"""N0: what noised data make of a function, computed where its theory can be checked."""

from __future__ import annotations

import xarray as xr

from problems.studies.study import CODE, StudyParams, quantity_of, setting
from problems.studies.theory_of_noising import convergence, ends, lemmas, neighbours


class Params(StudyParams):
    """Parameters of N0; the paper's text has none."""

    rho: float = setting(0.99, "1", "slope of the pusher's step in contact", above=0, most=1)
    sigma: float = setting(0.1, "m", "noise of the networks and of the rollouts", CODE, above=0)
    epochs: int = setting(1500, "1", "steps in which a network is trained", least=1)
    repeats: int = setting(5, "1", "draws of pairs, each for another network", least=1)
    n_samples: int = setting(100_000, "1", "data in many dimensions", least=100)


def run(params: Params) -> xr.Dataset:
    """Lemmas, walls, ends, networks and neighbours, each by two independent ways."""
    rho, sigma, seed = params.rho, params.sigma, params.seed
    found = {
        # First what may be missing, so that nobody waits to hear of it.
        **convergence.networks(rho, sigma, params.epochs, params.repeats, seed),
        **lemmas.uniform_data(),
        **lemmas.risks(rho, seed),
        **lemmas.score(seed),
        **ends.walls(),
        **ends.climbing(sigma, seed),
        **ends.near_the_ends(rho),
        **neighbours.uniform_cloud(params.n_samples, seed),
        **neighbours.along_the_task(params.n_samples, seed),
    }
    coordinates = {
        "command": quantity_of("command", lemmas.COMMANDS, "1", "slope of the step in contact"),
        "width": quantity_of("width", lemmas.WIDTHS, "m", "sigma"),
        "place": quantity_of("place", lemmas.PLACES, "1", "of the kink between two data"),
        "spacing": quantity_of("spacing", lemmas.SPACINGS, "1", "of the data over sigma"),
        "case": ("case", list(lemmas.CASES)),
        "change": quantity_of("change", lemmas.CHANGES, "m", "perturbation, root mean square"),
        "candidate": ("candidate", list(lemmas.CANDIDATES)),
        "dimension": quantity_of("dimension", lemmas.DIMENSIONS, "1", "coordinates"),
        "spread": quantity_of("spread", lemmas.SPREADS, "1", "sigma over the data's deviation"),
        "gap": quantity_of("gap", ends.GAPS, "m", "distance of the walls"),
        "depth": quantity_of("depth", ends.DEPTHS, "1", "penetration over sigma"),
        "sample": quantity_of("sample", ends.SAMPLES, "1", "random states between the walls"),
        "end": ("end", list(ends.ENDS)),
        "distance": quantity_of("distance", ends.DISTANCES, "1", "from the data's end over sigma"),
        "units": quantity_of("units", convergence.UNITS, "1", "in each of two layers"),
        "pairs": quantity_of("pairs", convergence.PAIRS, "1", "noised pairs trained on"),
        "dim": quantity_of("dim", neighbours.DIMENSIONS, "1", "coordinates"),
        "normalised": quantity_of("normalised", neighbours.SPREADS, "1", "sigma over deviation"),
        "problem": ("problem", list(neighbours.PROBLEMS)),
        "drawn": ("drawn", list(neighbours.DRAWN)),
    }
    return xr.Dataset(found, coordinates)
