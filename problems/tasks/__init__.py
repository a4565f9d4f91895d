"""Registry of the tasks for which policies are trained, and parts shared by several tasks."""
