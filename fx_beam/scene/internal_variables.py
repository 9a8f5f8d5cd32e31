"""Internal variables of materials whose state depends on the past."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import ufl
from ufl.corealg.traversal import unique_pre_traversal

from fx_beam.errors import SceneError, as_float, fields_in, refuse_fields, require

from .parameters import parameters_in
from .symbols import not_numbers


@dataclass(frozen=True)
class InternalVariables:
    """Internal variables of a section at each Gauss point, or of a spring, and their changes.

    They are zero at the start. The stored energy has them as its last argument,
    ``strain_energy(eps, gamma, kappa, a)`` of a section or ``strain_energy(x, a)`` of a `Spring`.
    The resultants are its derivatives with respect to the strains, and its decrease by the update
    is dissipated.

    The update is an implicit Euler step, as an explicit formula without iterations: it gives the
    new variables from the old ones and the new strains. It is computed from the start of a step to
    a `level` in it, and then extrapolated linearly to the end of the step. In statics the level is
    the end of each load step.

    Parameters
    ----------
    names : tuple of str
        A name for each variable, such as "plastic curvature".
    update : callable
        ``update(old, strains0, strains, dt)`` gives the new variables as UFL expressions, one for
        each name: from `old`, the variables at the start of the step, `strains0`, the strains
        (eps, gamma, kappa) at the start, `strains`, those that they belong to, and `dt`, the time
        between them [s]. A spring has the single strain (x,), its coordinate. In load steps of
        `static`, `dt` is the increment of the load factor, with arc-length continuation zero.
    level : float, optional
        Fraction of a step after which the update holds, from 1/2 to 1. With 1/2 smooth changes, as
        of a viscous material, are of second order in time, and no step gains energy. With 1, sudden
        changes, as of a material that yields, cause no oscillation; but a step that begins with
        plastic flow and ends with flow in the other direction may gain energy: it is too large. By
        default 1/2 if the update depends on `dt`, otherwise 1.

    Raises
    ------
    SceneError
        For names that are not different texts. `Section` and `Spring` raise it for an update that
        does not fit them, and if the update gives energy to the motion.

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
    >>> beam = scene.add_beam([(0, 0), (1, 0)], section)
    >>> scene.clamp(beam.start)
    >>> scene.prescribe(beam.end, rotation=lambda t: min(t / 0.1, 1.0) * 0.1)
    >>> solution = fb.simulate(scene, dt=0.05, t_end=5.0)
    >>> solution.resultants(beam).M[[2, -1], 0].round(2)
    array([0.44, 0.4 ])
    >>> solution.internal(beam, "dashpot")[-1].round(3)
    array([0.1])
    """

    names: tuple[str, ...]
    update: Callable[[Any, Any, Any, Any], Sequence]
    level: float = None  # type: ignore[assignment]  # it is set below

    def __post_init__(self):
        names = self.names
        fits = isinstance(names, tuple) and all(isinstance(n, str) and n for n in names)
        fits = fits and 0 < len(set(names)) == len(names)
        require(fits, "InternalVariables: names", names, 'different names such as ("creep",)')
        wanted = "a function of old, strains0, strains and dt"
        require(callable(self.update), "InternalVariables: update", self.update, wanted)
        fits = self.level is None or 0.5 <= as_float(self.level) <= 1
        require(fits, "InternalVariables: level", self.level, "a number from 0.5 to 1, or None")
        takes_time = self._check_update()
        level = (0.5 if takes_time else 1.0) if self.level is None else as_float(self.level)
        object.__setattr__(self, "level", level)

    def _check_update(self) -> bool:
        """Refuse an update that does not fit; returns whether it depends on dt."""
        try:
            return self._takes_time(3)  # the strains of a section
        except SceneError as error:
            try:
                return self._takes_time(1)  # that of a spring
            except SceneError:
                raise error from None

    def _takes_time(self, strains_of_part: int) -> bool:
        old = [ufl.variable(ufl.as_ufl(0.0)) for _ in self.names]
        strains0, strains = (
            tuple(ufl.variable(ufl.as_ufl(size * e)) for e in _PATH[0][-strains_of_part:])
            for size in (1, 2)
        )
        dt = ufl.variable(ufl.as_ufl(1.0))
        updated = self.updated(ufl.as_vector(old), strains0, strains, dt)
        refuse_fields(fields_in(updated), "InternalVariables: update", parameters_in(updated))
        for i, name in enumerate(self.names):
            if not {*old, *strains0, *strains} & set(unique_pre_traversal(updated[i])):
                raise SceneError(
                    f"InternalVariables: the update of {name!r} depends neither on old variables "
                    "nor on strains. Use ufl.exp, not math.exp"
                )
        return dt in set(unique_pre_traversal(updated))

    def updated(self, old, strains0, strains, dt):
        """The variables that belong to given strains, as a UFL vector.

        Parameters
        ----------
        old : ufl vector
            The variables at the start of the step.
        strains0, strains : sequence of ufl scalars
            Axial strain, shear strain and curvature [1/m] at the start, and those given; of a
            spring its coordinate [m or rad].
        dt : ufl scalar
            Time between them [s].

        Returns
        -------
        ufl vector
            The variables.
        """
        what = "InternalVariables: update(old, strains0, strains, dt)"
        try:
            with not_numbers():
                updated = [ufl.as_ufl(value) for value in self.update(old, strains0, strains, dt)]
        except Exception as error:
            raise SceneError(
                f"{what} must give a UFL expression for each of {list(self.names)}. Use "
                f"ufl.conditional, ufl.sqrt, ... in place of if, math or NumPy. It raised {error!r}"
            ) from error
        if len(updated) != len(self.names) or any(value.ufl_shape for value in updated):
            raise SceneError(
                f"{what} must give {len(self.names)} scalars, one for each of "
                f"{list(self.names)}; it gave {len(updated)} of the shapes "
                f"{[value.ufl_shape for value in updated]}"
            )
        return ufl.as_vector(updated)


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
    """New variables, the energy that they take, and the size of its terms."""
    e = tuple(map(ufl.as_ufl, strains))
    updated = variables.updated(ufl.as_vector([*map(ufl.as_ufl, old)]), e, e, ufl.as_ufl(dt))
    new = [float(updated[i](())) for i in range(len(old))]
    a = [ufl.variable(ufl.as_ufl(value)) for value in new]
    W = energy(*e, ufl.as_vector(a))
    forces = [float(-ufl.diff(W, value)(())) for value in a]
    terms = [f * (n - o) for f, n, o in zip(forces, new, old, strict=True)]
    return new, sum(terms), sum(map(abs, terms))
