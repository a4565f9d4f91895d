"""The planar hopper of Dojo: machine, problem and task."""
