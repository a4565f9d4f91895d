"""Many jobs side by side: here, over processes of this computer, or over a Dask cluster."""
