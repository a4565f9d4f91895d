"""Transcription methods: from a problem with a contact law and a policy to one NLP."""

from ocp.transcription.direct import Direct, MultipleShooting
from ocp.transcription.nlp import NLP
from ocp.transcription.single_shooting import SingleShooting

Method = Direct | MultipleShooting | SingleShooting
METHODS: dict[str, type[Method]] = {method.name: method for method in (Direct, MultipleShooting, SingleShooting)}
"""Mapping from names to transcription methods."""

__all__ = ["METHODS", "NLP", "Direct", "Method", "MultipleShooting", "SingleShooting"]
