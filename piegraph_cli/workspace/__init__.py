"""Artifacts on disk: schema, atomic write, cache key, fresh or stale, resume, parallel run. The only HDF5 writer."""
