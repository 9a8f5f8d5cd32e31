"""Time schemes: the stress resultants of a step, and a nodal rule for the rates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate
from typing import TYPE_CHECKING, Any

from fx_beam.errors import SceneError, as_float, check_takes, is_number, is_one_of, require, shown
from fx_beam.scene.law import Law
from fx_beam.scene.parameters import is_parameter, refused
from fx_beam.symbolic import Expr, ufl

from .kinematics import Step
from .rates import AtRest, MidPointRates, NewmarkRates, NodalRates
from .resultants import (
    AtEnds,
    Decaying,
    Resultants,
    WeightedResultants,
    at_mid_step,
    averaged,
    with_exact_work,
)

if TYPE_CHECKING:
    from fx_beam.scene.ufl_symbols import Parameter

#: Sub-steps that the loop over time steps has room for (c/tables.h).
MOST_SUB_STEPS = 32
_S = 1 / (4 - 4 ** (1 / 3))
Strains = Callable[[Step, Expr, Expr], Sequence[Expr]]
# Suzuki's composition of order four; its third sub-step goes back in time.
_FRACTIONS = {2: (1.0,), 4: (_S, _S, 1 - 4 * _S, _S, _S)}


@dataclass(frozen=True, repr=False)
class Scheme:
    """A time scheme: its stress resultants and its rule for the rates.

    Parameters
    ----------
    name : str
        Name in reports and pictures.
    resultants : callable
        ``resultants(step, law)`` gives the `Resultants` of a step as UFL expressions, or the
        `WeightedResultants` of its two ends.
    rates : MidPointRates, NewmarkRates, NodalRates or AtRest
        Nodal rule that gives velocities and accelerations from the increment.
    fractions : tuple of float, optional
        Lengths of the sub-steps of a composition, relative to the step; some may go back in time.
        They must end inside the step or at its end. The scheme must be symmetric in time, with
        forces at mid-step, unless its rates are `NodalRates`. By default a step has no sub-steps.
    strains : callable, optional
        ``strains(step, u, psi)`` gives axial strain, shear strain and curvature of a configuration
        as UFL expressions, by default those of Reissner's theory (eqs 9, 10 and 12). They are the
        strains of `Step`, of stored energies and of internal variables.
    energy : callable, optional
        ``energy(law, eps, gamma, kappa)`` gives the stored energy per length [J/m], by default
        ``law.energy(eps, gamma, kappa)``.

    Notes
    -----
    For a beam theory of your own, derive a class from `Resultants` with another
    `Resultants.virtual_work`. Give its `strains`, and its `energy` if N, Q and M are not the
    derivatives of the energy of the law: energies of solutions are then those of your theory.

    Examples
    --------
    A scheme of your own: the mid-point rule with a constant tension of 10 N in all beams.

    >>> import fx_beam as fb
    >>> def with_tension(step, law):
    ...     r = fb.MidPoint().resultants(step, law)
    ...     return r._replace(N=r.N + 10.0)
    >>> def energy(law, eps, gamma, kappa):
    ...     return law.energy(eps, gamma, kappa) + 10.0 * eps
    >>> scheme = fb.Scheme("with tension", with_tension, fb.MidPointRates(), energy=energy)
    >>> scheme.rates
    MidPointRates()
    """

    name: str
    resultants: Callable[[Step, Law], Resultants | WeightedResultants]
    rates: MidPointRates | NewmarkRates | NodalRates | AtRest
    fractions: tuple[float, ...] = (1.0,)
    strains: Strains | None = None
    energy: Callable[..., Expr] | None = None
    #: The call that made it, if it was one of those below; `replace` forgets it.
    _call: str = field(default="", init=False, compare=False)

    def __repr__(self):
        function = getattr(self.resultants, "__name__", repr(self.resultants))
        rest = f", {self.fractions!r}" if len(self.fractions) > 1 else ""
        return self._call or f"Scheme({self.name!r}, {function}, {self.rates!r}{rest})"

    def __post_init__(self):
        require(isinstance(self.name, str), "Scheme: name", self.name, "a string")
        check_takes(self.resultants, "step, law", "Scheme: resultants")
        ok = type(self.rates) in (MidPointRates, NewmarkRates, NodalRates, AtRest)
        expected = "MidPointRates(), NewmarkRates(...), AtRest(), or NodalRates(rule) of your own"
        require(ok, "Scheme: rates", self.rates, expected)
        expected = f"a tuple of at most {MOST_SUB_STEPS} numbers with the sum 1 and partial sums "
        expected += "between 0 and 1"
        require(_divide_a_step(self.fractions), "Scheme: fractions", self.fractions, expected)
        if isinstance(self.rates, NodalRates):
            if len(self.rates.rules) not in (1, len(self.fractions)):
                raise SceneError(
                    f"Scheme: {self.name} has {len(self.fractions)} sub-steps, but its NodalRates "
                    f"have {len(self.rates.rules)} rules. Give one rule, or one for each fraction"
                )
        elif len(self.fractions) > 1 and self.rates.level != 0.5:
            raise SceneError(
                f"Scheme: sub-steps need a scheme that is symmetric in time, but the forces of "
                f"{self.name} are at level {self.rates.level:g} of a step. Use MidPointRates()"
            )
        if self.strains is not None:
            _check_strains(self.strains)
        if self.energy is not None:
            check_takes(self.energy, "law, eps, gamma, kappa", "Scheme: energy")

    def written(self, format: str = "text") -> str:
        """Write the weak form of a step as on paper, by the functions that are compiled.

        Indices 0, m and 1 are the start, the middle and the end of a step; Delta is an increment
        over the step, delta a virtual quantity. X' is the reference tangent, t the director, W a
        rotation by 90 degrees, and ' the derivative along the reference arc length. `a` is the
        acceleration in the equation of motion, as a function of the increment D of displacements;
        in mid-point schemes D is 2 tan(Delta_psi/2) for rotations. The resultants are written for
        linear elasticity.

        Parameters
        ----------
        format : {"text", "unicode", "latex"}
            Names in ASCII, Greek letters, or LaTeX, which notebooks show as formulas.

        Returns
        -------
        str
            The formulas, one on each line; delta_W is per length. Formulas that depend on the
            degree are those of degree 1.

        Examples
        --------
        >>> import fx_beam as fb
        >>> print(fb.MidPoint().written().splitlines()[-1])
        a         = 2 (D/Delta_t - v_0)/Delta_t
        """
        from .written import Paper

        paper = Paper()
        paper.define()
        paper.add(self.resultants)
        paper.add_inertia(self.rates)
        return paper.in_style(format)

    @property
    def has_own_energy(self) -> bool:
        """Whether members do not store the energy of their sections in Reissner's strains."""
        return self.strains is not None or self.energy is not None

    @property
    def parameters(self) -> list[Parameter]:
        """Parameters in the resultants that are not in the law."""
        damping: Any = getattr(self.resultants, "damping", None)
        return [damping] if isinstance(self.resultants, Decaying) and is_parameter(damping) else []

    @property
    def balances_energy(self) -> bool:
        """Whether each step balances energy exactly, and holds none for the next step."""
        is_exact = self.resultants is _exact and not self.has_own_energy
        return is_exact and self.rates.mean_based

    @property
    def key(self) -> tuple[str, str]:
        """Facts of a scheme that is `built_in` on which forms depend."""
        resultants: Any = self.resultants
        if self.parameters:
            resultants = replace(resultants, damping=resultants.damping.name)
        return getattr(resultants, "__name__", repr(resultants)), repr(self.rates)

    @property
    def built_in(self) -> bool:
        """Whether resultants and rates are of this package, so that their UFL never changes."""
        is_own = self.resultants in (at_mid_step, averaged, _exact)
        is_own = is_own or type(self.resultants) in (AtEnds, Decaying)
        return is_own and not self.rates.user_defined and not self.has_own_energy


def _check_strains(function: Strains) -> None:
    """Refuse strains that are no three scalars in UFL."""
    from fx_beam.scene.ufl_symbols import STEP

    check_takes(function, "step, u, psi", "Scheme: strains")
    with refused("Scheme: strains(step, u, psi) must give three UFL expressions"):
        shapes = [ufl.as_ufl(x).ufl_shape for x in function(STEP, STEP.u0, STEP.psi0)]
    expected = "the shapes of three scalars: axial strain, shear strain and curvature"
    require(shapes == 3 * [()], "Scheme: strains(step, u, psi)", shapes, expected)


def _divide_a_step(fractions) -> bool:
    if not isinstance(fractions, tuple) or not all(map(is_number, fractions)):
        return False
    ends = list(accumulate(fractions))
    are_inside = all(-1e-12 <= end <= 1 + 1e-12 for end in ends)
    ok = bool(ends) and len(ends) <= MOST_SUB_STEPS
    return ok and are_inside and 0 not in fractions and abs(ends[-1] - 1) < 1e-12


def _composed(order: int, scheme: Scheme) -> Scheme:
    """A scheme of second order that is symmetric in time, or its composition of order 4."""
    require(is_one_of(order, (2, 4)), f"{scheme.name}: order", order, "2 or 4")
    if order == 2:
        return _called(scheme, scheme.name)
    name = f"{scheme.name}(order=4)"
    return _called(replace(scheme, name=name, fractions=_FRACTIONS[4]), scheme.name, order=4)


def _called(scheme: Scheme, function: str, **arguments: Any) -> Scheme:
    """The scheme, which from now on says by which call it was made."""
    text = ", ".join(f"{name}={value!r}" for name, value in arguments.items())
    object.__setattr__(scheme, "_call", f"{function}({text})")
    return scheme


def MidPoint(order: int = 2) -> Scheme:
    """Mid-point rule (eq. 31); conserves linear and angular momentum.

    Parameters
    ----------
    order : {2, 4}
        Order of convergence, as for `EnergyMomentum`.

    Returns
    -------
    Scheme
        The scheme.

    Examples
    --------
    >>> import fx_beam as fb
    >>> fb.MidPoint().name
    'MidPoint'
    """
    return _composed(order, Scheme("MidPoint", at_mid_step, MidPointRates()))


def ModifiedMidPoint(order: int = 2) -> Scheme:
    """Modified mid-point scheme as published (eqs 39 to 41 and 47).

    Conserves linear and angular momentum; the energy error decreases with the element size.

    Parameters
    ----------
    order : {2, 4}
        Order of convergence, as for `EnergyMomentum`.

    Returns
    -------
    Scheme
        The scheme.

    Examples
    --------
    >>> import fx_beam as fb
    >>> fb.ModifiedMidPoint().name
    'ModifiedMidPoint'
    """
    return _composed(order, Scheme("ModifiedMidPoint", averaged, MidPointRates()))


def EnergyMomentum(order: int = 2) -> Scheme:
    """Modified mid-point scheme with a virtual rotation that conserves energy exactly.

    Conserves energy, linear and angular momentum to solver accuracy, for elements of every degree.
    No node may rotate by more than 2 rad in a step; a larger step is halved. Very fast spins and
    whipping light strings may exceed this limit even after all halvings.

    Parameters
    ----------
    order : {2, 4}
        Order of convergence. A step of order 4 is a composition of five sub-steps of order 2, with
        0.41, 0.41, -0.66, 0.41 and 0.41 times its length (Suzuki 1990). Use it for small errors in
        smooth motions. Kinks and jumps of loads over time must be at ends of steps, otherwise
        the order is lower: choose `dt` or `breaks` accordingly. Dampers are accurate if their
        damping rate is below 1 / dt; near 3 / dt the sub-step that goes back amplifies the motion,
        which is reported in the log. Forces are means over the whole step.

    Returns
    -------
    Scheme
        The scheme.

    References
    ----------
    Suzuki (1990), doi 10.1016/0375-9601(90)90962-N.

    Examples
    --------
    A free bar that spins keeps its energy.

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> section = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.1)
    >>> bar = scene.add_beam([(-1, 0), (1, 0)], section, elements=2)
    >>> scene.set_velocity(bar, lambda x, y: (-y, x), spin=1.0)
    >>> solution = fb.simulate(scene, fb.EnergyMomentum(), dt=0.1, t_end=2.0)
    >>> bool(abs(solution.energy.balance_error).max() < 1e-9)
    True
    """
    return _composed(order, Scheme("EnergyMomentum", _exact, MidPointRates()))


def EnergyDecaying(damping: float | Parameter = 0.1, order: int = 2) -> Scheme:
    """Energy-momentum scheme that damps fast vibrations and conserves both momenta.

    For stiff mechanisms, in which axial vibrations do not decay with conserving schemes. To the
    stress resultants of `EnergyMomentum` it adds damping/2 C (dE - r dE_before). Here dE are the
    increments of the strains in the step, dE_before those of the step before, C is the stiffness of
    the undeformed section, and r the length of the step over that of the step before, at most 1.
    The energy of the motion plus damping/4 dE.C dE never increases, for any step.

    Parameters
    ----------
    damping : float or Parameter
        Factor of the added resultants, in (0, 1]. The damping is largest for vibrations whose
        angular frequency times the step is about 2/damping; slow vibrations are hardly damped. A
        `Parameter` has the value that the scene gives it by `Scene.add_parameter`, constant in
        time.
    order : {1, 2}
        Order of convergence. With order 1, r is 0: the energy itself never increases, and slow
        motions lose more energy.

    Returns
    -------
    Scheme
        The scheme.

    Examples
    --------
    An axial vibration that the step does not resolve dies out; the balance of energy closes.

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> rod = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e6, GA=1e6, EI=1e4))
    >>> scene.clamp(rod.start)
    >>> mass = scene.add_mass(rod.end, 1.0)
    >>> scene.set_velocity(rod.end, (1.0, 0.0))
    >>> energy = fb.simulate(scene, fb.EnergyDecaying(), dt=0.01, t_end=1.0).energy
    >>> bool(energy.kinetic[-1] < 0.01 * energy.kinetic[0])
    True
    >>> bool(abs(energy.balance_error).max() < 1e-12)
    True
    """
    if not is_parameter(damping):
        damping = _checked("EnergyDecaying", "damping", damping, 0, 1, low_open=True)
    require(is_one_of(order, (1, 2)), "EnergyDecaying: order", order, "1 or 2")
    name = "EnergyDecaying" if order == 2 else "EnergyDecaying(order=1)"
    scheme = Scheme(name, Decaying(damping, int(order)), MidPointRates())
    lower = {"order": 1} if order == 1 else {}
    return _called(scheme, "EnergyDecaying", damping=damping, **lower)


def Newmark(beta: float = 0.25, gamma: float = 0.5) -> Scheme:
    """Newmark's scheme; by default the average acceleration (trapezoidal) rule.

    With gamma = 1/2 joint forces on bodies that turn may alternate from row to row, however short
    the steps are. `HHT` damps this oscillation; it does not occur with `EnergyMomentum`.

    Parameters
    ----------
    beta, gamma : float
        Newmark's parameters.

    Returns
    -------
    Scheme
        The scheme; second order for gamma = 1/2, conserves linear momentum.

    Examples
    --------
    >>> import fx_beam as fb
    >>> fb.Newmark().rates.beta
    0.25
    """
    beta = _checked("Newmark", "beta", beta, 0, 1, low_open=True)
    gamma = _checked("Newmark", "gamma", gamma, 0, 1)
    return _newmark_family("Newmark", NewmarkRates(beta, gamma), beta=beta, gamma=gamma)


def HHT(alpha: float = -0.1) -> Scheme:
    """Hilber-Hughes-Taylor scheme: forces (1 + alpha) f_1 - alpha f_0.

    Parameters
    ----------
    alpha : float
        In [-1/3, 0]; 0 is the trapezoidal rule. Smaller values damp high frequencies more.

    Returns
    -------
    Scheme
        The scheme, with beta = (1 - alpha)^2/4 and gamma = 1/2 - alpha; second order.

    References
    ----------
    Hilber, Hughes & Taylor (1977), doi 10.1002/eqe.4290050306.

    Examples
    --------
    >>> import fx_beam as fb
    >>> round(fb.HHT(alpha=-0.1).rates.gamma, 6)
    0.6
    """
    alpha = _checked("HHT", "alpha", alpha, -1 / 3, 0)
    rates = NewmarkRates((1 - alpha) ** 2 / 4, 0.5 - alpha, alpha_f=-alpha)
    return _newmark_family("HHT", rates, alpha=alpha)


def GeneralizedAlpha(rho_inf: float = 0.9) -> Scheme:
    """Generalized-alpha scheme.

    Parameters
    ----------
    rho_inf : float
        Spectral radius at infinite frequency, in [0, 1].

    Returns
    -------
    Scheme
        The scheme; second order.

    References
    ----------
    Chung & Hulbert (1993), doi 10.1115/1.2900803.

    Examples
    --------
    >>> import fx_beam as fb
    >>> round(fb.GeneralizedAlpha(rho_inf=0.5).rates.alpha_f, 4)
    0.3333
    """
    rho_inf = _checked("GeneralizedAlpha", "rho_inf", rho_inf, 0, 1)
    alpha_m, alpha_f = (2 * rho_inf - 1) / (rho_inf + 1), rho_inf / (rho_inf + 1)
    beta, gamma = (1 - alpha_m + alpha_f) ** 2 / 4, 0.5 - alpha_m + alpha_f
    rates = NewmarkRates(beta, gamma, alpha_m, alpha_f)
    return _newmark_family("GeneralizedAlpha", rates, rho_inf=rho_inf)


def Equilibrium() -> Scheme:
    """Static equilibrium at the end of each step, without inertia; `static` uses it.

    Returns
    -------
    Scheme
        The scheme, for `static`, not for `simulate`.

    Examples
    --------
    >>> import fx_beam as fb
    >>> fb.Equilibrium().rates.at_rest
    True
    """
    return _called(Scheme("Equilibrium", AtEnds(1.0), AtRest()), "Equilibrium")


def _exact(step: Step, law: Law) -> Resultants:
    return with_exact_work(step, averaged(step, law))


def _newmark_family(name: str, rates: NewmarkRates, **arguments: float) -> Scheme:
    return _called(Scheme(name, AtEnds(rates.level), rates), name, **arguments)


def _checked(scheme: str, name: str, value, low: float, high: float, low_open=False) -> float:
    """A parameter as a number in its range."""
    number = as_float(value)
    is_inside = low < number <= high or (number == low and not low_open)
    if not is_inside:
        bracket = "(" if low_open else "["
        raise SceneError(
            f"{scheme}: {name} = {shown(value)} must lie in {bracket}{low:.4g}, {high}]"
        )
    return number


def order_and_constant(scheme: Scheme) -> tuple[int, float]:
    """Order p of a scheme, and local error by the difference between prediction and step.

    SceneError for a scheme of order 1.
    """
    rates, advice = scheme.rates, None
    if isinstance(rates, NewmarkRates):
        second = 0.5 - rates.alpha_m + rates.alpha_f
        advice = f"gamma = {second:g}" if abs(rates.gamma - second) > 1e-9 else None
    elif getattr(scheme.resultants, "order", 2) == 1:
        advice = "order=2"
    if advice:
        raise SceneError(
            f"tolerance: {scheme.name} is of order 1; its local errors are not known. Use "
            f"{advice}, or another scheme"
        )
    cubes = abs(sum(fraction**3 for fraction in scheme.fractions))
    if cubes > 1e-9:
        return 2, cubes / 12
    return 4, abs(sum(fraction**5 for fraction in scheme.fractions)) / 80
