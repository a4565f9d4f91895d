"""Named tasks that policies are trained for, one a file; :mod:`problems.tasks.registry`."""
