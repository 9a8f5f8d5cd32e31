"""Where the forces of a model may bend: contact, flow, and functions of a user."""

from __future__ import annotations

import numpy as np

from fx_beam.content_cache import shallow_copy
from fx_beam.fem.forms import Forms
from fx_beam.results.state import State
from fx_beam.scene.law import has_pieces
from fx_beam.scene.scene import Scene


class Kinks:
    """Conditions on which slopes of the forces depend besides small changes of the state."""

    def __init__(self, scene: Scene, forms: Forms, at_rest: bool):
        self._forms, points = forms, forms.points
        energies = [beam.section.strain_energy for beam in scene.beams]
        #: Whether members or springs have internal variables.
        self.flows = forms.internal_shape[-1] > 0 or points.flows
        #: Whether members or virtual works have functions of a user, which may have kinks.
        self.bend = any(energies) or bool(scene.virtual_works)
        #: Whether there are obstacles or stops.
        self.has_contact = points.any_have("unilateral")
        own = any(force.force for force in scene.forces_between)
        #: Whether all forces have a potential in statics: nothing follows the motion or flows.
        self.potential = not (forms.has_added or own or self.flows)
        sudden = points.any_have("needs_line_search")
        #: Whether slopes of forces may change at once: flow, contact, functions of a user.
        self.any = self.bend or sudden or self.flows or self.has_contact
        #: Whether corrections of Newton's method may be far too long. In motions the force of a
        #: contact over a step is smooth and convex.
        self.overshoot = forms.internal_shape[-1] > 0 or sudden or (at_rest and self.has_contact)
        # Friction, contact with a loss, and dampers with laws of a user lose quickly.
        quick = (law.iteration_memory or (law.loss and law.user_defined) for law in points.laws)
        pieced = (energy is not None and has_pieces(energy) for energy in energies)
        #: Whether forces change quickly where no switch tells: sections' laws, flow, losses.
        self.unseen = self.flows or any(quick) or any(pieced)

    def on(self, forms: Forms) -> Kinks:
        """The same conditions on the forces of another scene with this structure."""
        other = shallow_copy(self)
        other._forms = forms
        return other

    def switches(self, state: State) -> np.ndarray:
        """Values that change their sign where a contact opens or closes, or a law switches."""
        self._forms.parameters.use(state.parameters)
        return self._forms.compiled_points.switches(state.q, state.slides)

    def flowed(self, start: State, end: State) -> bool:
        """Whether something flows, or sticks, between two states."""
        names = "internal", "spring_internal"
        return not all(np.array_equal(getattr(start, n), getattr(end, n)) for n in names)

    def switched(self, start: State, end: State) -> bool:
        """Whether a contact opens or closes, or a law switches: members that are near may touch."""
        members = self._forms.points.members
        first, last = (np.sign(self.switches(state)) for state in (start, end))
        return (members is not None and members.are_near) or not np.array_equal(first, last)

    def begin(self, start: State, end: State) -> bool:
        """Whether flow or contact may begin or end in a step, which its predictor does not know."""
        return self.flowed(start, end) or (self.has_contact and self.switched(start, end))
