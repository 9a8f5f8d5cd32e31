"""Fields along the members: what colours a shape and is written for ParaView."""

from __future__ import annotations

import functools
from typing import Any

import ufl

import numpy as np

from fx_beam.scene.beam import arc_lengths, lagrange

RESULTANTS = ("N", "Q", "M")
_STIFFNESSES = ("EA", "GA", "EI")
#: What can be had along a member, and its unit.
QUANTITIES = dict(
    zip((*RESULTANTS, "strain energy", "speed"), ("N", "N", "N m", "J/m", "m/s"), strict=True)
)


def along(solution: Any, name: str, quantity: str, rows, places: np.ndarray) -> np.ndarray:
    """Values of one of the `QUANTITIES` or internal variables along a beam, at places of elements.

    But for the speed, they are polynomials through the values at the Gauss points, and may jump.
    """
    rows, beam = list(rows), solution.beams[name]
    if quantity == "speed":
        nodes = nodes_of_elements(solution, name)
        v = solution.recorded("v")[rows][:, nodes, :2]
        v = np.einsum("pn,renc->repc", lagrange(np.linspace(0, 1, beam.degree + 1), places), v)
        return np.hypot(v[..., 0], v[..., 1])
    if quantity == "strain energy":
        values = energy_density(solution, name, rows)
    else:
        values = _at_points(solution, name, quantity)[rows]
        values = values.reshape(len(rows), beam.elements, beam.degree)
    return values @ lagrange(_gauss(beam.degree), places).T


def along_all(solution: Any, quantity: str, rows, places: np.ndarray) -> np.ndarray:
    """The same for all beams of a solution (rows, elements, places), quickly for frames."""
    rows, beams = list(rows), solution.beams
    sections = {id(beam.section): beam.section for beam in beams.values()}
    if quantity == "strain energy" and all(map(_is_constant, sections.values())):
        degree = next(iter(beams.values())).degree
        nodes = np.concatenate([nodes_of_elements(solution, name) for name in beams])
        known = {
            key: [section.values(kind, np.array([0.5]))[0] for kind in _STIFFNESSES]
            for key, section in sections.items()
        }
        stiffness = np.array([known[id(beam.section)] for beam in beams.values()])
        stiffness = np.repeat(stiffness, [beam.elements for beam in beams.values()], axis=0)
        strains = _strains(solution, nodes, degree, rows)
        density = np.einsum("ek,krep->rep", stiffness, strains**2) / 2
        return density @ lagrange(_gauss(degree), places).T
    return np.concatenate([along(solution, name, quantity, rows, places) for name in beams], axis=1)


def _is_constant(section: Any) -> bool:
    """Whether a beam's stored energy is quadratic, with the same stiffness all along it."""
    if section is None or section.strain_energy is not None:
        return False
    return not any(section.varies(kind) for kind in _STIFFNESSES)


def _at_points(solution: Any, name: str, quantity: str) -> np.ndarray:
    """Values (n, points) of a resultant, or of an internal variable: zero if a beam lacks it."""
    resultants = solution.resultants(name)
    if quantity in RESULTANTS:
        return getattr(resultants, quantity)
    return solution.internal_of_beam.get(name, {}).get(quantity, np.zeros_like(resultants.N))


def energy_density(solution: Any, name: str, rows) -> np.ndarray:
    """Stored energy per length (rows, elements, degree) of a beam at its Gauss points [J/m]."""
    beam = solution.beams[name]
    if beam.section is None:
        raise ValueError(
            "the strain energy along a member needs its section, which a saved file does not hold; "
            "take the solution as simulate gave it, or N, Q, M or speed"
        )
    strains = _strains(solution, nodes_of_elements(solution, name), beam.degree, list(rows))
    if beam.section.strain_energy is not None:
        internal = solution.internal_of_beam.get(name, {}).values()
        columns = [*strains.reshape(3, -1), *(rows_of[rows].ravel() for rows_of in internal)]
        found = [
            _stored(beam.section.strain_energy, *point) for point in zip(*columns, strict=True)
        ]
        return np.array(found).reshape(strains.shape[1:])
    fractions = arc_lengths(beam, _gauss(beam.degree)) / beam.length
    stiffness = np.array([beam.section.values(kind, fractions) for kind in _STIFFNESSES])
    return np.sum(stiffness[:, None] * strains**2, axis=0) / 2


def _strains(solution: Any, nodes: np.ndarray, degree: int, rows: list[int]) -> np.ndarray:
    """Axial strain, shear strain and curvature (3, rows, elements, degree) (eqs 9 and 10)."""
    powers = np.arange(degree + 1)
    polynomials = np.linalg.inv(np.linspace(0, 1, degree + 1)[:, None] ** powers)
    places = _gauss(degree)[:, None]
    values = places**powers @ polynomials
    slopes = powers * places ** np.maximum(powers - 1, 0) @ polynomials
    X, q = solution.X[nodes], solution.recorded("q")[rows][:, nodes]
    tangent = np.einsum("pn,enc->epc", slopes, X)
    J = np.hypot(tangent[..., 0], tangent[..., 1])
    t = tangent / J[..., None]
    stretched = np.einsum("pn,renc->repc", slopes, X + q[..., :2]) / J[..., None]
    psi = np.einsum("pn,ren->rep", values, q[..., 2])
    c, s = np.cos(psi), np.sin(psi)
    turned = np.stack([c * t[..., 0] - s * t[..., 1], s * t[..., 0] + c * t[..., 1]], axis=-1)
    normal = np.stack([-turned[..., 1], turned[..., 0]], axis=-1)
    curvature = np.einsum("pn,ren->rep", slopes, q[..., 2]) / J
    return np.stack([(stretched * turned).sum(-1) - 1, (stretched * normal).sum(-1), curvature])


def nodes_of_elements(solution: Any, name: str) -> np.ndarray:
    """Numbers (elements, degree + 1) of the nodes of each element, in order along it."""
    beam, nodes = solution.beams[name], solution.nodes_of_beam[name]
    first = beam.degree * np.arange(beam.elements)
    return nodes[first[:, None] + np.arange(beam.degree + 1)]


@functools.cache
def _gauss(degree: int) -> np.ndarray:
    """Gauss points (degree,) of an element, from 0 to 1."""
    return (np.polynomial.legendre.leggauss(degree)[0] + 1) / 2


def _stored(energy: Any, eps, gamma, kappa, *a) -> float:
    """Stored energy per length of strains and internal variables [J/m]."""
    numbers = [ufl.as_ufl(float(x)) for x in (eps, gamma, kappa, *a)]
    return float(energy(*numbers[:3], *([ufl.as_vector(numbers[3:])] if a else []))(()))
