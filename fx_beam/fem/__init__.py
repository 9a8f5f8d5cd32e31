"""Finite elements: from a scene to a mesh, fields and compiled weak forms.

Every call into dolfinx goes through `dolfinx_api`.
"""
