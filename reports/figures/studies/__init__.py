"""Drawings of the studies, by the study's identifier."""

from problems import studies
from reports.figures.studies import in_the_loop, learned_laws, noising, pathologies, policies, smoothing
from reports.figures.studies.panels import Drawing

_MODULES = (in_the_loop, learned_laws, noising, pathologies, policies, smoothing)
"""Modules with drawings, each named after its study in lower case."""
_DRAWINGS = {
    name: drawing for module in _MODULES for name, drawing in vars(module).items() if isinstance(drawing, Drawing)
}
"""Drawings by their names in the modules."""
DRAWINGS = {identifier: _DRAWINGS[identifier.lower()] for identifier in studies.ids()}
"""Drawing of each study by its identifier."""
