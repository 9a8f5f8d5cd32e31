"""One scene on many processes: each evaluates its part, and PETSc solves.

The first process has the whole scene, takes the steps and makes the solution.
"""
