"""The registry of tasks that policies are trained for, and what several of them share."""
