"""The laws in UFL and NumPy: kinematics, stress resultants, rates, time schemes, forces at points.

Each equation is in one place.
"""
