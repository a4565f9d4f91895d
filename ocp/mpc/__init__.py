"""Receding-horizon controllers (model-predictive control) and their closed-loop simulation on a plant."""

from ocp.mpc.controller import Command, Controller
from ocp.mpc.phases import PHASES
from ocp.mpc.plants import PLANTS, Disturbance
from ocp.mpc.simulate import ClosedLoop, simulate

__all__ = ["PHASES", "PLANTS", "ClosedLoop", "Command", "Controller", "Disturbance", "simulate"]
