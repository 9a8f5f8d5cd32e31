"""Fields along the members: what colours a shape and is written for ParaView."""

from __future__ import annotations

from typing import Any

import ufl

import numpy as np

from fx_beam.scene.beam import arc_lengths, gauss_rule, lagrange, lagrange_and_slopes
from fx_beam.scene.loads import NAMES
from fx_beam.scene.parameters import replaced

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
    if quantity == "strain energy":
        return _energies(solution, [name], rows, places)
    if quantity == "speed":
        return _speeds(solution, [name], rows, places)
    values = _at_points(solution, name, quantity)[rows]
    values = values.reshape(len(rows), beam.elements, beam.degree)
    return values @ lagrange(gauss_rule(beam.degree)[0], places).T


def at_ends(values: np.ndarray) -> np.ndarray:
    """Values (..., degree + 1) at the nodes of elements of those (..., degree) at Gauss points."""
    degree = values.shape[-1]
    return values @ lagrange(gauss_rule(degree)[0], np.linspace(0, 1, degree + 1)).T


def along_all(solution: Any, quantity: str, rows, places: np.ndarray) -> np.ndarray:
    """The same for all beams of a solution (rows, elements, places)."""
    names = list(solution.beams)
    if quantity in ("strain energy", "speed"):  # at once, quickly for frames
        evaluate = _energies if quantity == "strain energy" else _speeds
        return evaluate(solution, names, list(rows), places)
    return np.concatenate([along(solution, name, quantity, rows, places) for name in names], axis=1)


def _at_points(solution: Any, name: str, quantity: str) -> np.ndarray:
    """Values (n, points) of a resultant, or of an internal variable: zero if a beam lacks it."""
    resultants = solution.resultants(name)
    if quantity in RESULTANTS:
        return getattr(resultants, quantity)
    return solution.variables_of_beam.get(name, {}).get(quantity, np.zeros_like(resultants.N))


def _speeds(solution: Any, names: list[str], rows, places: np.ndarray) -> np.ndarray:
    nodes = np.concatenate([nodes_of_elements(solution, name) for name in names])
    values = lagrange(np.linspace(0, 1, nodes.shape[1]), places)
    v = np.einsum("pn,renc->repc", values, solution.recorded("v")[rows][:, nodes, :2])
    return np.hypot(v[..., 0], v[..., 1])


def _energies(solution: Any, names: list[str], rows, places: np.ndarray) -> np.ndarray:
    degree = solution.beams[names[0]].degree
    return energy_density(solution, names, rows) @ lagrange(gauss_rule(degree)[0], places).T


def energy_density(solution: Any, names: list[str], rows) -> np.ndarray:
    """Stored energy per length (rows, elements, degree) of beams at their Gauss points [J/m]."""
    beams = [solution.beams[name] for name in names]
    if any(beam.section is None for beam in beams):
        raise ValueError(
            "the strain energy along a member needs its section, which a saved file does not hold; "
            "take the solution as simulate gave it, or N, Q, M or speed"
        )
    nodes = np.concatenate([nodes_of_elements(solution, name) for name in names])
    strains = _strains(solution, nodes, beams[0].degree, list(rows))
    natural = np.concatenate([_natural(solution, beam, rows) for beam in beams], axis=2)
    strains = strains - natural
    stiffness, constant = np.empty((3, *strains.shape[2:])), dict[int, np.ndarray]()
    ends = np.cumsum([beam.elements for beam in beams]).tolist()
    of_beams = [slice(end - beam.elements, end) for beam, end in zip(beams, ends, strict=True)]
    for beam, cells in zip(beams, of_beams, strict=True):
        stiffness[:, cells] = _stiffness(beam, constant)
    density = np.einsum("kep,krep->rep", stiffness, strains**2) / 2
    for beam, cells in zip(beams, of_beams, strict=True):
        if beam.section.strain_energy is not None:
            variables = solution.variables_of_beam.get(beam.name, {})
            internal = [of for name, of in variables.items() if name not in NAMES.values()]
            columns = [*strains[:, :, cells].reshape(3, -1), *(of[rows].ravel() for of in internal)]
            points = np.column_stack(columns).reshape(len(strains[0]), -1, len(columns))
            energies = [
                _stored(beam.section.strain_energy, values, *point)
                for values, of_row in zip(_parameters(solution, list(rows)), points, strict=True)
                for point in of_row
            ]
            density[:, cells] = np.reshape(energies, density[:, cells].shape)
    return density


def _stiffness(beam: Any, constant: dict[int, np.ndarray]) -> np.ndarray:
    """EA, GA and EI of a beam (3, elements, degree); those of constant sections are kept."""
    section = beam.section
    if id(section) in constant:
        return constant[id(section)]
    fractions = arc_lengths(beam, gauss_rule(beam.degree)[0]) / beam.length
    stiffnesses = np.array([section.values(kind, fractions) for kind in _STIFFNESSES])
    if not any(map(section.varies, _STIFFNESSES)):
        constant[id(section)] = stiffnesses = stiffnesses[:, :1, :1]
    return stiffnesses


# In NumPy, beside laws/kinematics.py: pictures are also drawn of solutions that come from
# another process or a copy, without the compiled forms.
def _strains(solution: Any, nodes: np.ndarray, degree: int, rows: list[int]) -> np.ndarray:
    """Axial strain, shear strain and curvature (3, rows, elements, degree) (eqs 9 and 10)."""
    values, slopes = lagrange_and_slopes(np.linspace(0, 1, degree + 1), gauss_rule(degree)[0])
    X, q = solution.X[nodes], solution.recorded("q")[rows][:, nodes]
    (X, Y), (u, v, psi) = np.moveaxis(X, -1, 0), np.moveaxis(q, -1, 0)
    x, y, dx, dy, curvature = (f @ slopes.T for f in (X, Y, X + u, Y + v, psi))
    J, psi = np.hypot(x, y), psi @ values.T
    c, s = np.cos(psi), np.sin(psi)
    tx, ty = (c * x - s * y) / J, (s * x + c * y) / J
    return np.stack([(dx * tx + dy * ty) / J - 1, (dy * tx - dx * ty) / J, curvature / J])


def _natural(solution: Any, beam: Any, rows) -> np.ndarray:
    """Natural strains (3, rows, elements, degree) of a beam."""
    shape, variables = (-1, beam.elements, beam.degree), solution.variables_of_beam
    of_beam = variables.get(beam.name, {})
    none = np.zeros((len(rows), beam.elements * beam.degree))
    return np.stack(
        [(of_beam[n][list(rows)] if n in of_beam else none).reshape(shape) for n in NAMES.values()]
    )


def nodes_of_elements(solution: Any, name: str) -> np.ndarray:
    """Numbers (elements, degree + 1) of the nodes of each element, in order along it."""
    beam, nodes = solution.beams[name], solution.nodes_of_beam[name]
    first = beam.degree * np.arange(beam.elements)
    return nodes[first[:, None] + np.arange(beam.degree + 1)]


def _parameters(solution: Any, rows: list[int]) -> list[dict[str, float]]:
    """Values of the parameters by name in each row."""
    names = solution.names_of_parameters
    return [dict(zip(names, solution.parameters[row].tolist(), strict=True)) for row in rows]


def _stored(energy: Any, parameters: dict[str, float], eps, gamma, kappa, *a) -> float:
    """Stored energy per length of strains and internal variables [J/m]."""
    numbers = [ufl.as_ufl(float(x)) for x in (eps, gamma, kappa, *a)]
    density = energy(*numbers[:3], *([ufl.as_vector(numbers[3:])] if a else []))
    return float(replaced(density, parameters)(()))
