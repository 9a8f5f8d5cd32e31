"""Finite elements: from a scene to a mesh, fields, and compiled terms of forces.

The way from UFL to C: `forms.Forms` has the terms of a scene, of beams (`beam_forms.BeamForms`) and
at points (`point_forces.PointForces`). A term of beams is a `compiled_forms.MeshTerm`: degrees of
freedom, data by name (`beam_data`) and a compiled form, which `weak_form.WeakForm` writes in UFL,
and its derivatives `weak_form.DerivedForm`. A term at points is a `PlacedForce`: the same of a law,
which is a `compiled_laws.CompiledLaw`, with values and slopes. `compiled_forms` has the C of both;
only `ffcx_api` calls FFCx, and only `elements` knows whose the finite elements are. Numbers come
from the scene by `forms.SceneArrays`, plain or with slopes. `beam_forms.BeamSlopes` and
`point_values` differentiate the terms in many steps at once.
"""
