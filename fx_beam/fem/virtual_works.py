"""Virtual works of a user's forces, checked and summed."""

from __future__ import annotations

from collections.abc import Sequence

import ufl
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.check_arities import check_integrand_arity

from fx_beam.errors import SceneError
from fx_beam.mechanics.kinematics import Step
from fx_beam.scene.scene import Scene
from fx_beam.validation import fields_in, refuse_fields

from .dolfinx_api import REFUSALS
from .mesh import Mesh
from .section_fields import on_beam


def added_virtual_work(scene: Scene, mesh: Mesh, step: Step, test, known: Sequence):
    """Virtual work per length of all added forces, in UFL; None without such forces.

    `test` is the test function; dolfinx functions and constants that are not `known` are refused.
    """
    total = None
    for number, work in enumerate(scene.virtual_works, start=1):
        what = f"virtual work {number}"
        try:
            term = ufl.as_ufl(work.term(step))
        except Exception as error:
            raise SceneError(f"{what}: calling it with the step raised {error!r}") from error
        refuse_fields(fields_in(term), what, known)
        if term.ufl_shape != () or ufl.algorithms.extract_arguments(term) != [test]:
            raise SceneError(
                f"{what}: the result must be a scalar UFL expression linear in step.virtual_u and "
                f"step.virtual_psi, not {term}"
            )
        try:
            check_integrand_arity(apply_algebra_lowering(term), (test,))
        except REFUSALS as error:
            raise SceneError(
                f"{what}: the result must be linear in step.virtual_u and step.virtual_psi; {error}"
            ) from error
        if work.beam is not None:
            term = term * on_beam(mesh, scene, work.beam)
        total = term if total is None else total + term
    return total
