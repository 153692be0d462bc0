"""A run in the browser (extra `view`).

`viewer` holds what is open and tells layers and panels of it; `layers` lists what is drawn into the scene, `panels` what stands
beside it.
"""
