"""Many samples at once: CasADi graphs over arrays, compiled where there is a compiler."""

from dynamics.batch.arguments import BatchWarning, NonFinite
from dynamics.batch.engines.compiler import CompilerError
from dynamics.batch.episodes import EpisodeFunction, EpisodeMoments, Episodes
from dynamics.batch.export import TabulatedPolicy, exported, identifier
from dynamics.batch.function import BatchFunction
from dynamics.batch.graphs.objective import Episode
from dynamics.batch.graphs.policy import (
    DensePolicy,
    RolloutPolicy,
    affine,
    constant,
    dense,
    open_loop,
)
from dynamics.batch.graphs.tape import UnsupportedOperation
from dynamics.batch.moments import Moments
from dynamics.batch.random import Gaussian
from dynamics.batch.rollout import RolloutFunction, RolloutMoments, Rollouts
from dynamics.batch.stepping import StepFunction, Steps

__all__ = [
    "BatchFunction",
    "BatchWarning",
    "CompilerError",
    "DensePolicy",
    "Episode",
    "EpisodeFunction",
    "EpisodeMoments",
    "Episodes",
    "Gaussian",
    "Moments",
    "NonFinite",
    "RolloutFunction",
    "RolloutMoments",
    "RolloutPolicy",
    "Rollouts",
    "StepFunction",
    "Steps",
    "TabulatedPolicy",
    "UnsupportedOperation",
    "affine",
    "constant",
    "dense",
    "exported",
    "identifier",
    "open_loop",
]
