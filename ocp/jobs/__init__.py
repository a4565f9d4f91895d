"""Parallel jobs, such as the solves of a sweep: in this process, in several processes, or on a Dask cluster."""
