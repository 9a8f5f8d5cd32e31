"""UFL's symbols in functions of a user: fields of a step, and parameters."""

from __future__ import annotations

from typing import Any

from fx_beam.errors import SceneError, is_name, require, shown
from fx_beam.symbolic import Expr, ufl

from .functions import TimeValue, checked_value


class _Nowhere(ufl.domain.AbstractDomain):
    """A domain that is no mesh, as UFL asks for a domain of each symbol."""

    def __init__(self) -> None:
        super().__init__(1, 2)

    @property
    def meshes(self) -> tuple[_Nowhere]:
        """The domain itself."""
        return (self,)

    def ufl_cell(self) -> object:
        """An interval."""
        return ufl.interval

    def ufl_id(self) -> int:
        """No number of a mesh."""
        return -1

    def _ufl_sort_key_(self) -> tuple[int, str, int]:
        return 1, "nowhere", -1


#: Domain of symbols that belong to no mesh; a form replaces them by fields.
NOWHERE = _Nowhere()


# Fields of a step, by their shapes.
_VECTORS = "u0 Du u v virtual_u X t0 u_before director0 director1 director".split()
_STRAINS = """strains0 strains1 strain_increments strains_before
    total_strains0 total_strains1 natural0 natural1 natural_increments""".split()
_SCALARS = "psi0 Dpsi psi omega virtual_psi h t dt load_factor psi_before memory".split()


class Symbol(ufl.Constant):
    """A symbol that varies along a beam, so that UFL keeps its derivatives; it is no number."""

    def __init__(self, *shape: int):
        super().__init__(NOWHERE, shape=shape)

    def evaluate(self, x, mapping, component, index_values, derivatives=()):
        """Value in a mapping; TypeError without, where UFL would not end."""
        if mapping and self in mapping:
            return mapping[self]
        raise TypeError("a UFL symbol is not a number")

    def is_cellwise_constant(self) -> bool:
        """False."""
        return False


class StepSymbols:
    """An `fx_beam.Step` whose fields are symbols of the same shape, on no mesh."""

    degree, nodes = 1, None

    def __init__(self) -> None:
        self.__dict__ |= {name: Symbol(2) for name in _VECTORS}
        self.__dict__ |= {name: Symbol() for name in _SCALARS}
        self.__dict__ |= {name: (Symbol(), Symbol(), Symbol()) for name in _STRAINS}

    def prime(self, field: Expr) -> Expr:
        """Derivative along the reference arc length."""
        return ufl.dot(ufl.grad(field), self.__dict__["t0"])


#: The symbols, made once: with the same symbols functions can be compared.
STEP: Any = StepSymbols()
SCALARS = tuple(Symbol() for _ in range(8))


# Numbers of constants in UFL, by name: all parameters of a name have one number.
_NUMBERS: dict[str, int] = {}


class Parameter(ufl.Constant):
    """A named number in a function of your own, in UFL, which changes without compilation.

    Other numbers in such a function are compiled, and each new value takes a second or two. A
    parameter may be in the strain energy of a `Section` or `Spring`, in the update of
    `InternalVariables`, in the law of a `Damper`, of `SmoothFriction` or of an obstacle, in a force
    between points and in a virtual work. `Scene.parameters` has the parameters of a scene by name,
    and changes them.

    Parameters
    ----------
    name : str
        Name of the parameter p; in a scene a name has one value.
    value : float, callable or Input
        Value at the beginning: a number; a function ``value(t)`` of time [s], which may also look
        the value up in a table; or an `Input` of one number.

    Raises
    ------
    SceneError
        For an empty name, or a value that is neither a number, nor a function of time, nor an
        `Input`.

    Notes
    -----
    The change of a stored energy W(strains, p) by p(t) is work. In a step from t0 to t1 the forces
    are computed with p_m, the value of p in the middle of the step, and

        W(E1, p(t1)) - W(E1, p_m) + W(E0, p_m) - W(E0, p(t0))

    is added to `Energy.work`, so that the balance of energy stays exact.

    Examples
    --------
    A beam with a stored energy of its own, in which the stiffness is varied. Only the first run
    compiles anything.

    >>> import fx_beam as fb
    >>> k = fb.Parameter("stiffness", 1e4)
    >>> section = fb.Section(strain_energy=lambda e, g, c: k / 2 * (e**2 + g**2 + c**2 / 100))
    >>> scene = fb.Scene()
    >>> beam = scene.add_beam([(0, 0), (1, 0)], section, elements=4)
    >>> scene.clamp(beam.start)
    >>> load = scene.add_force(beam.end, (1.0, 0.0))
    >>> round(float(fb.static(scene).displacement(beam.end)[-1, 0]), 6)
    0.0001
    >>> scene.parameters["stiffness"] = 2e4
    >>> round(float(fb.static(scene).displacement(beam.end)[-1, 0]), 6)
    5e-05

    A muscle whose force is an input:

    >>> u = fb.Parameter("activation", fb.Input("muscle"))
    >>> pull = scene.add_force_between(beam.end, (1, 1), force=lambda r, rate, t: 3 * u * r)
    >>> list(scene.parameters)
    ['stiffness', 'activation']
    """

    def __init__(self, name: str, value: TimeValue):
        require(is_name(name), "Parameter: name", name, "a text that is not empty")
        #: What was given as the value.
        self.given = value
        #: The value as a function of time.
        self.function = checked_value(name, value)
        self.name = name
        super().__init__(NOWHERE, count=_NUMBERS.get(name))
        _NUMBERS[name] = self.count()
        self._repr = f"Parameter({name!r}, {shown(value)})"

    def __setattr__(self, name: str, value: object) -> None:
        """Refuse what constants of dolfinx have: a value is that in a scene."""
        if name == "value":
            assignment = f"scene.parameters[{self.name!r}] = {shown(value)}"
            raise SceneError(f"the parameter {self.name!r} has a value in each scene: {assignment}")
        super().__setattr__(name, value)

    def __str__(self):
        return self.name

    def __reduce__(self):
        return Parameter, (self.name, self.given)

    def _ufl_compute_hash_(self):
        return hash(self.name)  # as for UFL parameters of one name are equal

    def __float__(self):
        raise TypeError(
            f"the parameter {self.name!r} is a UFL symbol, not a number: use ufl.sqrt, ufl.exp, ..."
        )

    def evaluate(self, x, mapping, component, index_values, derivatives=()):
        """The value by name in a mapping, or else at the beginning; UFL calls it."""
        if derivatives:
            return 0.0
        return float(mapping[self] if mapping and self in mapping else self.function(0.0)[0])
