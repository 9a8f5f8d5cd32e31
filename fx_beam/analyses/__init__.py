"""The analyses: `simulate`, `static` and `modes`.

Each builds a model of a scene, solves its equations and returns the results.
"""
