"""Evaluation of CasADi functions, steps and rollouts for many samples, compiled if there is a C compiler."""

from dynamics.batch.arguments import BatchWarning, NonFinite
from dynamics.batch.engines.compiler import CompilerError
from dynamics.batch.export import TabulatedPolicy, c_identifier, export_step
from dynamics.batch.function import BatchFunction, StepFunction, Steps
from dynamics.batch.graphs.objective import Episode
from dynamics.batch.graphs.policy import (
    DensePolicy,
    RolloutPolicy,
    affine_policy,
    constant_policy,
    dense_policy,
    open_loop,
)
from dynamics.batch.graphs.tape import UnsupportedOperation
from dynamics.batch.random import Gaussian
from dynamics.batch.rolling import Moments, RolloutMoments
from dynamics.batch.rollout import EpisodeFunction, Episodes, RolloutFunction, Rollouts

__all__ = [
    "BatchFunction",
    "BatchWarning",
    "CompilerError",
    "DensePolicy",
    "Episode",
    "EpisodeFunction",
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
    "affine_policy",
    "c_identifier",
    "constant_policy",
    "dense_policy",
    "export_step",
    "open_loop",
]
