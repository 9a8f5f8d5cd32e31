"""Time schemes: stress resultants of a step, and a nodal rule for the rates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from fx_beam.errors import SceneError
from fx_beam.scene.section import Law
from fx_beam.validation import is_number, require

from .kinematics import Step
from .rates import AtRest, MidPointRates, NewmarkRates, Rates
from .resultants import (
    Resultants,
    WeightedResultants,
    at_ends,
    at_mid_step,
    averaged,
    with_exact_work,
)


@dataclass(frozen=True)
class Scheme:
    """A time scheme: what it takes for the resultants, and its rule for the rates.

    Parameters
    ----------
    name : str
        Name in reports and pictures.
    resultants : callable
        ``resultants(step, law)`` gives the `Resultants` of a step as UFL expressions, or the
        `WeightedResultants` of its ends.
    rates : Rates
        Nodal rule that gives velocities and accelerations from the increment.
    """

    name: str
    resultants: Callable[[Step, Law], Resultants | WeightedResultants]
    rates: Rates

    def __post_init__(self):
        for name, fits, wanted in (
            ("name", isinstance(self.name, str), "a string"),
            ("resultants", callable(self.resultants), "a function of step and law"),
            ("rates", _are_rates(self.rates), "fx_beam.Rates such as MidPointRates()"),
        ):
            require(fits, f"Scheme: {name}", getattr(self, name), wanted)


def _are_rates(rates) -> bool:
    return not isinstance(rates, type) and hasattr(rates, "level") and hasattr(rates, "end")


def MidPoint() -> Scheme:
    """Mid-point rule (eq. 31): second order, conserves both momenta.

    Returns
    -------
    Scheme
        The scheme.
    """
    return Scheme("MidPoint", at_mid_step, MidPointRates())


def ModifiedMidPoint() -> Scheme:
    """Modified mid-point scheme as published (eqs 39 to 41 and 47).

    Second order; conserves both momenta, and energy up to an error of the element size.

    Returns
    -------
    Scheme
        The scheme.
    """
    return Scheme("ModifiedMidPoint", averaged, MidPointRates())


def EnergyMomentum() -> Scheme:
    """Modified mid-point scheme with resultants that conserve energy exactly.

    Second order; conserves energy and both momenta to solver accuracy. For degree 1 in closed
    form. For degree 2 and 3 the resultants have a pole where all strains of a Gauss point stand
    still while its element turns and bends: on coarse meshes a step in a hundred may have to be
    halved for it. No node may turn by more than 2 rad in a step, after all halvings, which is
    where light strings that whip and very fast spins end it.

    Returns
    -------
    Scheme
        The scheme.
    """
    return Scheme("EnergyMomentum", _exact, MidPointRates())


def Newmark(beta: float = 0.25, gamma: float = 0.5) -> Scheme:
    """Newmark's scheme; by default the average acceleration (trapezoidal) rule.

    Parameters
    ----------
    beta, gamma : float
        Newmark's parameters.

    Returns
    -------
    Scheme
        The scheme; second order for gamma = 1/2, conserves linear momentum.
    """
    _check_parameter("Newmark", "beta", beta, 0, 1, low_open=True)
    _check_parameter("Newmark", "gamma", gamma, 0, 1)
    return _newmark_family("Newmark", NewmarkRates(float(beta), float(gamma)))


def HHT(alpha: float = -0.1) -> Scheme:
    """Hilber-Hughes-Taylor scheme: forces (1 + alpha) f_1 - alpha f_0.

    Parameters
    ----------
    alpha : float
        In [-1/3, 0]; 0 is the trapezoidal rule, smaller damps high frequencies more.

    Returns
    -------
    Scheme
        The scheme, with beta = (1 - alpha)^2/4 and gamma = 1/2 - alpha; second order.

    References
    ----------
    Hilber, Hughes & Taylor (1977), doi 10.1002/eqe.4290050306.
    """
    _check_parameter("HHT", "alpha", alpha, -1 / 3, 0)
    rates = NewmarkRates((1 - alpha) ** 2 / 4, 0.5 - alpha, alpha_f=-alpha)
    return _newmark_family("HHT", rates)


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
    """
    _check_parameter("GeneralizedAlpha", "rho_inf", rho_inf, 0, 1)
    alpha_m, alpha_f = (2 * rho_inf - 1) / (rho_inf + 1), rho_inf / (rho_inf + 1)
    beta, gamma = (1 - alpha_m + alpha_f) ** 2 / 4, 0.5 - alpha_m + alpha_f
    return _newmark_family("GeneralizedAlpha", NewmarkRates(beta, gamma, alpha_m, alpha_f))


def Equilibrium() -> Scheme:
    """Equilibrium at the end of each step, without inertia: what statics takes for a scheme.

    Returns
    -------
    Scheme
        The scheme, for `static` and not for `simulate`.
    """
    return Scheme("Equilibrium", at_ends(1.0), AtRest())


def _exact(step: Step, law: Law) -> Resultants:
    return with_exact_work(step, averaged(step, law))


def _newmark_family(name: str, rates: NewmarkRates) -> Scheme:
    return Scheme(name, at_ends(rates.level), rates)


def _check_parameter(scheme, name, value, low, high, low_open=False):
    inside = is_number(value) and (low < value <= high or (value == low and not low_open))
    if not inside:
        raise SceneError(
            f"{scheme}: {name} = {value!r} must lie in {'(' if low_open else '['}{low:.4g}, {high}]"
        )
