"""The half-cheetah of Dojo: machine, problem and task."""
