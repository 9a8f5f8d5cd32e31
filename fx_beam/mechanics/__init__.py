"""The mechanics of the planar Reissner beam: kinematics, stress resultants, rates, time schemes.

UFL and NumPy only; each equation is in one place.
"""
