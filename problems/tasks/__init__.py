"""Registry of the tasks for which policies are trained, and parts that several tasks share."""
