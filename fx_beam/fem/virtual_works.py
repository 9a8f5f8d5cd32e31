"""Virtual works of a user's forces, checked and summed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import ufl
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.check_arities import check_integrand_arity

from fx_beam.errors import SceneError
from fx_beam.laws.kinematics import Step
from fx_beam.scene.loads import VirtualWork
from fx_beam.scene.parameters import replaced
from fx_beam.validation import fields_in, refuse_fields

from .dolfinx_api import REFUSALS
from .fields import Fields


def added_virtual_work(
    works: Sequence[VirtualWork],
    indicators: Sequence,
    step: Step,
    fields: Fields,
    parameters: Mapping[str, Any],
):
    """Virtual work per length of all added forces, in UFL.

    An indicator is 1 where a force acts. Functions and constants of the user are refused, but for
    `parameters`, which come with what is in their place.
    """
    total = 0
    for number, (work, inside) in enumerate(zip(works, indicators, strict=True), start=1):
        what = f"virtual work {number}"
        term = replaced(work.of(step, what), parameters)
        known = [field for value in parameters.values() for field in fields_in(value)]
        refuse_fields(fields_in(term), what, [*fields.known, *known])
        if term.ufl_shape != () or ufl.algorithms.extract_arguments(term) != [fields.test]:
            raise SceneError(
                f"{what}: the result must be a scalar UFL expression linear in step.virtual_u and "
                f"step.virtual_psi, not {term}"
            )
        try:
            check_integrand_arity(apply_algebra_lowering(term), (fields.test,))
        except REFUSALS as error:
            raise SceneError(
                f"{what}: the result must be linear in step.virtual_u and step.virtual_psi; {error}"
            ) from error
        total += term if work.beam is None else term * inside
    return total
