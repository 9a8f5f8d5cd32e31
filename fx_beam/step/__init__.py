"""The step: a scene and a scheme as unknowns and equations, and what solves these.

`model.py` puts them together. The files in `c` take the steps; the Python files compile them,
hand the scene over as tables, and record the rows.
"""
