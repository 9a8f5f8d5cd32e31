"""The mechanics of the planar Reissner beam: kinematics, stress resultants, rates, time schemes.

UFL and numpy only; each equation stands in one place.
"""
