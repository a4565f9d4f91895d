"""Mapping from identifiers of studies to their drawings."""

from problems import studies
from reports.figures.studies import in_the_loop, learned_laws, noising, pathologies, policies, smoothing
from reports.figures.studies.panels import Drawing

_MODULES = (in_the_loop, learned_laws, noising, pathologies, policies, smoothing)
"""Modules with drawings; a drawing is called like its study's identifier in lower case."""
_DRAWINGS = {
    name: drawing for module in _MODULES for name, drawing in vars(module).items() if isinstance(drawing, Drawing)
}
"""Mapping from names in the modules to drawings."""
DRAWINGS = {identifier: _DRAWINGS[identifier.lower()] for identifier in studies.ids()}
"""Mapping from the identifier of each study to its drawing."""
