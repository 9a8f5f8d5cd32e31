"""Finite elements: from a scene to a mesh, fields and compiled weak forms.

Only `ffcx_api` calls FFCx, and only `elements` knows whose the finite elements are.
"""
