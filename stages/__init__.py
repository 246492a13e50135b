"""The stages: pure functions from artifacts to artifacts.

Parameters of one name mean the same everywhere, and docstrings explain them where there is more to say:
`cover`, `plan`, `scene`, `seen`, `tiles` and `voxels` are artifacts of these kinds; `sigma` is the level of
ellipsoids in standard deviations; `jobs` is a number of threads, 0 for all processors, on which no result
depends; `progress` is a `Progress`, called from time to time; `seed` is that of all randomness. A stage that
reads values of a scenario needs a completed one.
"""
