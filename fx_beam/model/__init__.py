"""The waist of the house: a scene and a scheme as matrices, unknowns and equations.

What lies below builds it; time steps, load steps and modes above work on nothing else.
"""
