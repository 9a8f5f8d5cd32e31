"""One step after another: Newton's method, time steps, load steps and arc length.

The reference in Python; `compiled` does the same in C.
"""
