"""Time steps, load steps and arc-length steps by Newton's method.

This is the reference implementation in Python; `compiled` does time steps in C.
"""
