"""Joints eliminate degrees of freedom: from all of them to the unknowns.

Also springs and dampers of joints, and the check for mechanisms without mass or support.
"""
