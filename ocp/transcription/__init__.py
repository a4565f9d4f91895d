"""Methods that turn a problem under a law and a policy into one NLP."""

from ocp.transcription.direct import Direct, MultipleShooting
from ocp.transcription.nlp import NLP
from ocp.transcription.single_shooting import SingleShooting

Method = Direct | MultipleShooting | SingleShooting
METHODS: dict[str, type[Method]] = {method.name: method for method in (Direct, MultipleShooting, SingleShooting)}
"""Transcriptions by name."""

__all__ = ["METHODS", "NLP", "Direct", "Method", "MultipleShooting", "SingleShooting"]
