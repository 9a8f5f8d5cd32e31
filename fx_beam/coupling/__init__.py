"""Joints as couplings of degrees of freedom: from all of them to the unknowns.

Also springs and dampers in joints, and the check that every part has mass or support.
"""
