"""Robots, one per folder or file: the machine, the problems and the task of each."""
