"""Material laws: stored energies, the forces that are their derivatives, internal variables."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

from fx_beam.errors import IS_DATA, SceneError, as_float, fields_in, refuse_fields_in, require
from fx_beam.symbolic import Expr, derivatives_taken, is_zero, parts_of, ufl

from .parameters import new_variables, parameters_in, refused, scalar_of, symbols_of

Energy = Callable[..., Expr]

# Strains at which a stored energy is compared with its value at zero strain; curvatures are small
# if the unit of length is small.
_SIZES = 1e-12, 1e-9, 1e-6, 1e-3, 1e-2, 0.1, 1.0, 10.0
# Share of a load step after which a variable that flows from the start on has changed.
_SHORTLY = 1e-3
# UFL's names of comparisons of two numbers, which conditions consist of.
_COMPARISONS = {"EQ", "GE", "GT", "LE", "LT", "NE"}
# What pictures and files have along members besides internal variables.
_OF_MEMBERS = {"N", "Q", "M", "stress", "strain energy", "speed", "velocity", "displacement"}
_OF_MEMBERS |= {"rotation", "spin", "beam"}
_OF_MEMBERS |= {"natural axial strain", "natural shear strain", "natural curvature"}


@dataclass(frozen=True)
class Law:
    """Stored energy per length as a UFL function of (eps, gamma, kappa).

    Parameters
    ----------
    energy : callable
        ``energy(eps, gamma, kappa)``, the stored energy per length [J/m].
    quadratic : bool
        Whether the energy is quadratic; the resultants at the mean strain are then the discrete
        gradient.
    data : tuple
        Functions and constants in the energy: stiffnesses of the sections.
    ends : tuple of two Laws, optional
        With internal variables, the laws with their values at the start and at the end of the step;
        the law itself has their mean.

    Examples
    --------
    >>> import ufl, fx_beam as fb
    >>> law = fb.Law(lambda eps, gamma, kappa: 50 * (eps**2 + gamma**2 + kappa**2), quadratic=True)
    >>> N, Q, M = law.resultants(*map(ufl.as_ufl, (0.01, 0.0, 0.1)))
    >>> round(N(()), 6), round(M(()), 6)
    (1.0, 10.0)
    """

    energy: Energy
    quadratic: bool
    data: tuple = ()
    ends: tuple[Law, Law] | None = None

    @property
    def start(self) -> Law:
        """The law at the start of the step."""
        return self if self.ends is None else self.ends[0]

    @property
    def end(self) -> Law:
        """The law at the end of the step."""
        return self if self.ends is None else self.ends[1]

    def resultants(self, eps, gamma, kappa):
        """Material stress resultants: the derivatives of the stored energy (eq. 11).

        Parameters
        ----------
        eps, gamma, kappa : ufl scalar
            Axial strain, shear strain and curvature [1/m].

        Returns
        -------
        tuple of ufl scalars
            N [N], Q [N] and M [N m].
        """
        e = [ufl.variable(x) for x in (eps, gamma, kappa)]
        W = self.energy(*e)
        return tuple(ufl.diff(W, x) for x in e)

    def linear(self, strains):
        """Stress resultants of small strains about the undeformed section.

        Parameters
        ----------
        strains : sequence of three ufl scalars
            Axial strain, shear strain and curvature [1/m].

        Returns
        -------
        tuple of ufl scalars
            N [N], Q [N] and M [N m]: the second derivatives of the stored energy, at zero strain,
            times the strains.
        """
        if self.quadratic and self.data and self.ends is None:  # else there may be forces at rest
            return self.resultants(*strains)
        e = [ufl.variable(ufl.as_ufl(0.0)) for _ in range(3)]
        forces = [ufl.diff(self.energy(*e), x) for x in e]
        return tuple(
            sum(ufl.diff(force, x) * strain for x, strain in zip(e, strains, strict=True))
            for force in forces
        )


def quadratic_law(stiffness) -> Law:
    """Law of linear elasticity (eq. 11); `stiffness` is the UFL vector (EA, GA, EI)."""

    def energy(eps, gamma, kappa):
        membrane = stiffness[0] * eps**2 / 2
        shear = stiffness[1] * gamma**2 / 2
        bending = stiffness[2] * kappa**2 / 2
        return membrane + shear + bending

    return Law(energy, quadratic=True, data=tuple(fields_in(stiffness)))


def own_law(energy: Energy) -> Law:
    """Law of a stored energy of the user, a function of the three strains."""

    def along_a_line(s):
        return energy(0.3 + 0.7 * s, 0.2 - 1.1 * s, 0.5 + 1.3 * s)

    return Law(energy, is_quadratic(along_a_line))


def is_quadratic(energy: Energy) -> bool:
    """Whether the third derivative of a function of one variable is zero, and it has no pieces."""
    s = ufl.variable(ufl.as_ufl(0.1))
    third = ufl.as_ufl(energy(s))
    if switches(third):
        return False  # between two pieces no derivative tells of the other
    for _ in range(3):
        third = ufl.diff(third, s)
    return is_zero(derivatives_taken(third))


def switches(expression: Expr) -> list[Expr]:
    """Values that change their sign where pieces of an expression meet."""
    values = []
    for part in parts_of(ufl.as_ufl(expression)):
        operands, kind = part.ufl_operands, type(part).__name__
        if kind == "Abs":
            values.append(operands[0])
        elif kind in _COMPARISONS | {"MaxValue", "MinValue"}:
            values.append(operands[0] - operands[1])
    return values


def slope(function: Callable[[Expr], Expr], x: Expr) -> Expr:
    """Derivative of a function of a number or a vector."""
    x = ufl.variable(x)
    return ufl.diff(function(x), x)


def has_pieces(energy: Energy) -> bool:
    """Whether the stored energy of a section, without internal variables, has pieces."""
    strains = [ufl.variable(ufl.as_ufl(0.1)) for _ in range(3)]
    return bool(switches(energy(*strains)))


def check_energy(
    strain_energy: Energy | None,
    internal: InternalVariables | None,
    part: str = "Section",
    strains: tuple[str, ...] = ("eps", "gamma", "kappa"),
    name: str = "strain_energy",
) -> None:
    """Refuse a stored energy that is no scalar UFL expression of all its arguments.

    Refuse internal variables of another type, or without a stored energy.
    """
    ok = internal is None or isinstance(internal, InternalVariables)
    require(ok, f"{part}: internal", internal, "an fx_beam.InternalVariables")
    if strain_energy is None:
        expected = f"None: internal variables need a strain_energy({', '.join(strains)}, a)"
        require(internal is None, f"{part}: internal", internal, expected)
        return
    count, variables = len(strains), () if internal is None else internal.names

    def energy(*arguments: Expr) -> Expr:
        a = [ufl.as_vector(arguments[count:])] if variables else []
        return strain_energy(*arguments[:count], *a)

    call = f"{part}: {name}({', '.join(strains)}{', a' * bool(variables)})"
    W, e = scalar_of(energy, count + len(variables), call)
    met = set(parts_of(W))
    missing = [n for n, x in zip((*strains, *variables), e, strict=True) if x not in met]
    if missing:
        raise SceneError(f"{part}: {name} does not depend on {missing}. Use ufl.cos, not math.cos")
    if count == 3:
        used = sorted(_OF_MEMBERS & {*variables})
        require(not used, f"{part}: internal", used, "names that pictures and files do not use")
        _check_convexity(W, e[:3], f"{part}: {name}", strains)
    if internal is not None:
        check_dissipation(strain_energy, internal, count)


def _check_convexity(W: Expr, e: list[Expr], subject: str, strains: tuple[str, ...]) -> None:
    """Refuse a stored energy that falls along a strain, from zero on and without an end."""
    from .ufl_symbols import SCALARS

    symbols = SCALARS[: len(e)]
    energy = ufl.replace(W, dict(zip(e, symbols, strict=True)))

    def at(name: str, value: float) -> float:
        """The energy at a value of one strain; all other strains are zero."""
        values = [value if name == strain else 0.0 for strain in strains]
        try:
            return float(energy((), dict(zip(symbols, values, strict=True))))
        except (ArithmeticError, ValueError, TypeError):
            return math.nan  # it is not defined there

    start = at(strains[0], 0.0)
    for name in strains:
        falls = all(at(name, sign * size) <= start for size in _SIZES for sign in (1, -1))
        slopes = ((at(name, x) + at(name, -x) - 2 * start) / x**2 for x in _SIZES)
        # Changes that are round-off are zero.
        if falls and (slope := next(filter(None, slopes), 0.0)):
            raise SceneError(
                f"{subject} falls as {name} grows in either direction: at zero strain its second "
                f"derivative by {name} is {slope:.6g}, which must be positive. Check the signs"
            )


def functions_of_energy(
    energy: Energy | None, internal: InternalVariables | None, strains: int
) -> Iterator[tuple[str, Expr]]:
    """Expressions of a stored energy and its internal variables, by kind."""
    if energy is None:
        return
    from .ufl_symbols import SCALARS

    e0, e, dt = SCALARS[:strains], SCALARS[3 : 3 + strains], SCALARS[6]
    a = [] if internal is None else [_vector(len(internal.names))]
    yield "strain_energy", ufl.as_ufl(energy(*e, *a))
    if internal is not None:
        yield "update", internal.updated(a[0], e0, e, dt)


@functools.cache
def _vector(size: int) -> Expr:
    from .ufl_symbols import Symbol

    return ufl.as_vector([Symbol() for _ in range(size)])


@dataclass(frozen=True)
class InternalVariables:
    """Internal variables of a section at each Gauss point, or of a spring, and their changes.

    The variables a are zero at the start. They are the last argument of the stored energy,
    ``strain_energy(eps, gamma, kappa, a)`` of a section or ``strain_energy(x, a)`` of a `Spring`.
    The resultants are the derivatives of this energy with respect to the strains. The update of a
    reduces the energy; this part is dissipated.

    The update is an implicit Euler step, as an explicit formula without iterations: it gives the
    new variables from the old ones and the new strains. It is computed from the start of a step to
    a `level` in it, and then extrapolated linearly to the end of the step. In statics the level is
    the end of each load step.

    Parameters
    ----------
    names : tuple of str
        A name for each variable, such as "plastic curvature". Names of other quantities in pictures
        and files, such as "M" or "speed", are not allowed in a section.
    update : callable
        ``update(old, strains0, strains, dt)`` gives the new variables as UFL expressions, one for
        each name: from `old`, the variables at the start of the step, `strains0`, the strains
        (eps, gamma, kappa) at the start, `strains`, the strains at the time of the new variables,
        and `dt`, the time between [s]. A spring has the single strain (x,), its coordinate. In load
        steps of `static`, `dt` is the increment of the load factor, with arc-length continuation
        zero.
    level : float, optional
        Fraction of a step after which the update holds, from 1/2 to 1. With 1/2 smooth changes, as
        of a viscous material, are of second order in time, and no step gains energy. With 1, sudden
        changes, as of a material that yields, cause no oscillation; but a step in which plastic
        flow reverses its direction may gain energy: use smaller steps. By default 1/2 if the update
        depends on `dt`, otherwise 1.

    Raises
    ------
    SceneError
        For names that are not different texts. `Section` and `Spring` raise this error for an
        update with other arguments or results, and if the update adds energy.

    References
    ----------
    Simo & Hughes (1998), Computational inelasticity, for updates in closed form (return maps).

    Examples
    --------
    A Zener material: of the bending moment EI kappa, a third relaxes in the time tau = 0.5 s. The
    variable `a` is the curvature of the dashpot.

    >>> import fx_beam as fb
    >>> tau = 0.5
    >>> def energy(eps, gamma, kappa, a):
    ...     return 500 * eps**2 + 200 * gamma**2 + 2 * kappa**2 + (kappa - a[0]) ** 2
    >>> def relax(old, strains0, strains, dt):
    ...     return [(old[0] + dt / tau * strains[2]) / (1 + dt / tau)]
    >>> variables = fb.InternalVariables(("dashpot",), relax)
    >>> section = fb.Section(strain_energy=energy, internal=variables)

    A beam that is bent and then held. Its moment falls from 6 to 4 times the curvature.

    >>> scene = fb.Scene()
    >>> beam = scene.add_beam([(0, 0), (1, 0)], section, elements=1)
    >>> scene.clamp(beam.start)
    >>> scene.prescribe(beam.end, rotation=lambda t: min(t / 0.1, 1.0) * 0.1)
    >>> solution = fb.simulate(scene, dt=0.05, t_end=5.0)
    >>> solution.resultants(beam).M[[2, -1], 0].round(2)
    array([0.44, 0.4 ])
    >>> solution.internal(beam, "dashpot")[-1].round(3)
    array([0.1])
    """

    names: tuple[str, ...]
    update: Callable[..., Sequence[Expr]] = field(metadata=IS_DATA)
    level: float = None  # type: ignore[assignment]  # it is set below

    def __post_init__(self):
        names = self.names
        ok = isinstance(names, tuple) and all(isinstance(n, str) and n for n in names)
        ok = ok and 0 < len(set(names)) == len(names)
        require(ok, "InternalVariables: names", names, 'different names such as ("creep",)')
        expected = "a function of old, strains0, strains and dt"
        require(callable(self.update), "InternalVariables: update", self.update, expected)
        ok = self.level is None or 0.5 <= as_float(self.level) <= 1
        require(ok, "InternalVariables: level", self.level, "a number from 0.5 to 1, or None")
        takes_time = self._check_update()
        level = (0.5 if takes_time else 1.0) if self.level is None else as_float(self.level)
        object.__setattr__(self, "level", level)

    def _check_update(self) -> bool:
        """Refuse an update that does not fit; returns whether it depends on dt."""
        try:
            return self._takes_time(3)  # the strains of a section
        except SceneError:
            with suppress(SceneError):
                return self._takes_time(1)  # that of a spring
            raise

    def _takes_time(self, strains_of_part: int) -> bool:
        old = new_variables(len(self.names))
        strains0, strains = (tuple(new_variables(strains_of_part)) for _ in range(2))
        (dt,) = new_variables(1)
        updated = self.updated(ufl.as_vector(old), strains0, strains, dt)
        allowed = parameters_in(updated) + symbols_of([*old, *strains0, *strains, dt])
        refuse_fields_in(updated, "InternalVariables: update", allowed)
        for i, name in enumerate(self.names):
            if not {*old, *strains0, *strains} & set(parts_of(updated[i])):
                raise SceneError(
                    f"InternalVariables: the update of {name!r} depends neither on old variables "
                    "nor on strains. Use ufl.exp, not math.exp"
                )
        return dt in set(parts_of(updated))

    def updated(self, old, strains0, strains, dt):
        """The variables that belong to given strains, as a UFL vector.

        Parameters
        ----------
        old : ufl vector
            The variables at the start of the step.
        strains0, strains : sequence of ufl scalars
            Axial strain, shear strain and curvature [1/m] at the start, and at the time of the new
            variables; of a spring its coordinate [m or rad].
        dt : ufl scalar
            Time between them [s].

        Returns
        -------
        ufl vector
            The variables.
        """
        name = "InternalVariables: update(old, strains0, strains, dt)"
        with refused(
            f"{name} must give a UFL expression for each of {list(self.names)}. Use "
            "ufl.conditional, ufl.sqrt, ... in place of if, math or NumPy"
        ):
            updated = [ufl.as_ufl(value) for value in self.update(old, strains0, strains, dt)]
        if len(updated) != len(self.names) or any(value.ufl_shape for value in updated):
            raise SceneError(
                f"{name} must give {len(self.names)} scalars, one for each of "
                f"{list(self.names)}; it gave {len(updated)} of the shapes "
                f"{[value.ufl_shape for value in updated]}"
            )
        return ufl.as_vector(updated)


def evolved(variables: InternalVariables, old, e0, e1, dt, static: bool) -> tuple[Expr, Expr, Expr]:
    """Internal variables at both ends of a step, and in statics shortly after its start."""
    level = 1.0 if static else variables.level

    def after(share: float) -> Expr:
        """Variables after a share of the step: the update to its level, extended linearly."""
        part = level * share
        strains = tuple((1 - part) * a + part * b for a, b in zip(e0, e1, strict=True))
        return old + (variables.updated(old, e0, strains, part * dt) - old) / level

    return old, after(1.0), after(_SHORTLY) if static else old


def law_of_step(energy: Energy, old, new) -> Law:
    """The law at the mean of the internal variables, with laws at `old` and at `new`."""

    def at(a) -> Energy:
        return lambda *strains: energy(*strains, a)

    law = own_law(at((old + new) / 2))
    start, end = (replace(law, energy=at(a)) for a in (old, new))
    return replace(law, ends=(start, end))


def evolution_loss(energy: Energy, level: float, variables, strains, static: bool):
    """Energy that the evolution takes: per length, or of a spring.

    In motions the work N.(E1 - E0) + M (K1 - K0) less the gain of stored energy. In statics the
    work of the forces that drive the variables: of their mean over both ends if they flow from the
    start on, else at the `level` of the update. `variables` as of `evolved`, `strains` at the ends.
    """
    (old, new, early), (e0, e1) = variables, strains

    def drive(e, state):
        return -slope(lambda a: energy(*e, a), state)

    if static:
        change = new - old
        flows = ufl.gt(ufl.dot(early - old, change), _SHORTLY / 100 * ufl.dot(change, change))
        weight = ufl.conditional(flows, 0.5, 1 - level)
        return ufl.dot(weight * drive(e0, old) + (1 - weight) * drive(e1, new), change)
    mean = (old + new) / 2
    return energy(*e1, mean) - energy(*e1, new) + energy(*e0, old) - energy(*e0, mean)


def frozen(variables: InternalVariables | None) -> InternalVariables | None:
    """The variables with an update that keeps their values."""
    return variables and replace(variables, update=_held)


def _held(old, strains0, strains, dt):
    """The old values, as expressions with derivatives: FFCx makes no code of a constant."""
    return [ufl.conditional(ufl.lt(dt, 0), 0.0, variable) for variable in old]


def check_dissipation(energy: Callable, variables: InternalVariables, strains_of_part: int) -> None:
    """Refuse an update that gives energy to the motion, on a path of strains of several sizes.

    A section has three strains, a spring one.
    """
    unit = "J/m" if strains_of_part == 3 else "J"
    for size in (1e-4, 1e-2, 1.0):
        for dt in (1e-2, 1e2):
            old = [0.0] * len(variables.names)
            for strains in _PATH:
                scaled = [size * strain for strain in strains[-strains_of_part:]]
                old, lost, moved = _update(energy, variables, old, scaled, dt)
                if not lost >= -1e-9 * moved:
                    raise SceneError(
                        f"InternalVariables: the update gives energy to the motion: {-lost:.3g} "
                        f"{unit} in a step of {dt:g} s to the strains "
                        f"{[float(f'{e:.3g}') for e in scaled]}. The variables "
                        f"{list(variables.names)} must change in the direction in which the "
                        "stored energy decreases"
                    )


#: Loading, unloading and reversal, of all strains.
_PATH = [
    (0.1, -0.2, 0.4),
    (0.5, -0.6, 1.0),
    (1.0, -1.0, 0.7),
    (0.8, 0.1, -0.6),
    (-0.3, 0.9, -1.0),
    (-1.0, 0.6, 0.2),
    (0.0, 0.0, 0.0),
]


def _update(energy, variables, old, strains, dt) -> tuple[list[float], float, float]:
    """New variables, the energy that the update takes, and the size of terms of this energy."""
    e = tuple(map(ufl.as_ufl, strains))
    updated = variables.updated(ufl.as_vector([*map(ufl.as_ufl, old)]), e, e, ufl.as_ufl(dt))
    new = [float(updated[i](())) for i in range(len(old))]
    slopes = slope(lambda a: energy(*e, a), ufl.as_vector([*map(ufl.as_ufl, new)]))
    terms = [-float(slopes[i](())) * (new[i] - old[i]) for i in range(len(old))]
    return new, sum(terms), sum(map(abs, terms))
