"""Many runs of one scene: designs, their runs on all cores or a cluster, tables of all results.

Nothing here is imported by a single run. Dask, xarray, pandas and what else is needed are loaded
where they are used (:mod:`multicell.host.extras`).
"""
