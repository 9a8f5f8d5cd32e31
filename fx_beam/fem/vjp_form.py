"""Derivatives of a step's energies, resultants, and of the work of its forces on given weights."""

from __future__ import annotations

from fx_beam.symbolic import Expr, Form, Written, ufl

from .beam_data import NATURAL, Kind
from .weak_form import WeakForm


class DerivedForm(WeakForm):
    """Quantities of a step, and their derivatives by all that they depend on."""

    def __init__(self, kind: Kind):
        super().__init__(kind)
        self._works: dict[str, tuple[list[Expr], Form, dict[str, Form]]] = {}
        #: Zero, added to the parameters of each element.
        self._more: Expr = None
        if self.symbols.parameters is not None:
            self._more = self.fields.symbols.data(1, self.symbols.parameters.ufl_shape)
            self.named[self._more] = "more"

    def derivatives(self, name: str) -> Written:
        """Derivatives of an energy, or of "resultants", by name.

        The latter are at the Gauss points, each times the weight of its point.
        """
        if name == "resultants":
            quantity = self._at_points(
                self.laws.resultants, ufl.TestFunction(self.fields.internal(3))
            )
        else:
            quantity = self._energies[name]
        forms = self._derived(quantity)[1]
        tests = ["resultants"] * (name == "resultants")
        return Written(forms, self.named, {"spaces": {x: [*tests, x] for x in forms}})

    def _work(self, forces: str) -> tuple[list[Expr], Form, dict[str, Form]]:
        """Weights w, the work w.f of "internal forces" or "drag" f, and its derivatives by name.

        With internal variables, their increments times further weights are added.
        """
        if forces in self._works:
            return self._works[forces]
        forms = {self.fields.test: self._drag_work if forces == "drag" else self._residual}
        if self.symbols.width and forces != "drag":
            forms[ufl.TestFunction(self.fields.internal(self.symbols.width))] = self._increments()
        make = self.fields.symbols.coefficient
        weights = {test: make(test.ufl_function_space()) for test in forms}
        self.named |= {weight: f"weight {k}" for k, weight in enumerate(weights.values())}
        work = sum(ufl.replace(form, {test: weights[test]}) for test, form in forms.items())
        self._works[forces] = [*weights.values()], *self._derived(work)
        return self._works[forces]

    def work(self, forces: str) -> Written:
        """Names of the derivatives of the work on weights, as a fact."""
        return Written({}, {}, {"derivatives": [*self._work(forces)[2]]})

    def slopes(self, forces: str, *names: str) -> Written:
        """The work itself, as "work 0", and derivatives by these names and by each weight."""
        weights, work, derivatives = self._work(forces)
        slopes, spaces = {"work 0": work}, dict[str, list[str]]()
        for name in names:
            for number, weight in enumerate(weights):
                slope = ufl.derivative(derivatives[name], weight)
                if not _is_empty(slope):
                    slopes[f"{name} {number}"] = slope
                    spaces[f"{name} {number}"] = [name, f"weight {number}"]
        return Written(slopes, self.named, {"spaces": spaces})

    def _derived(self, quantity: Form) -> tuple[Form, dict[str, Form]]:
        """A quantity, with `more` parameters, and its derivatives that are not zero, by name."""
        fields = self.fields
        if self.symbols.parameters is not None:
            quantity = ufl.replace(
                quantity, {self.symbols.parameters: self.symbols.parameters + self._more}
            )
        symbols = {name: symbol for symbol, name in self.named.items()}
        nodal = "increment", "start", "q_previous"
        names = *nodal, "internal", *NATURAL, *self.symbols.data
        used = {name: symbols.get(name) for name in names} | {"parameters": self._more}
        used = {name: field for name, field in used.items() if field in quantity.coefficients()}
        forms = {name: ufl.derivative(quantity, field) for name, field in used.items()}
        X, position_space = fields.coordinates
        argument = ufl.Argument(position_space, len(quantity.arguments()))
        forms["coordinates"] = ufl.derivative(quantity, X, argument)
        return quantity, {name: form for name, form in forms.items() if not _is_empty(form)}


def _is_empty(form: Form) -> bool:
    """Whether a form is zero once its derivatives are taken."""
    return ufl.algorithms.expand_derivatives(form).empty()
