"""Fields along the members: what colours a shape and is written for ParaView."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from fx_beam.scene.beam import arc_lengths, gauss_rule, lagrange, lagrange_and_slopes
from fx_beam.scene.law import Energy
from fx_beam.scene.loads import NAMES
from fx_beam.scene.parameters import replaced
from fx_beam.symbolic import ufl

from .records import BeamResultants
from .section_forces import BeamBalance, SectionForces
from .stresses import BeamStress

RESULTANTS = ("N", "Q", "M")
_STIFFNESSES = ("EA", "GA", "EI")
#: What can be had along a member, and its unit.
QUANTITIES = {
    **{"N": "N", "Q": "N", "M": "N m", "stress": "Pa"},
    **{"strain energy": "J/m", "speed": "m/s"},
}


def at_ends(values: np.ndarray) -> np.ndarray:
    """Values (..., degree + 1) at the nodes of elements of those (..., degree) at Gauss points."""
    return _through(values, np.linspace(0, 1, values.shape[-1] + 1))


def _through(values: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Values (..., points) of polynomials through those (..., degree) at Gauss points.

    The same to the last digit however the values lie in memory.
    """
    weights = lagrange(gauss_rule(values.shape[-1])[0], points).T
    return sum(values[..., k, None] * weight for k, weight in enumerate(weights))


def along_all(
    solution, quantities: Iterable[str], rows, points: np.ndarray
) -> dict[str, np.ndarray]:
    """Values (rows, elements, points) of quantities or internal variables, at points in [0, 1].

    N, Q and M follow from the balance of elements, where that is known. Others, but for the speed,
    are polynomials through the values at the Gauss points, and may jump. The stress is the larger
    one of both edges.
    """
    quantities, rows, fields = [*quantities], list(rows), dict[str, np.ndarray]()
    if not {*RESULTANTS, "stress"}.isdisjoint(quantities):
        try:
            balance, gauss = _as_one(solution, rows)
        except ValueError:  # the balance is not known
            known = {
                name: _through(_at_points(solution, name, rows), points) for name in RESULTANTS
            }
        else:
            known = dict(zip(RESULTANTS, balance.in_elements(gauss, points), strict=True))
        fields = {name: known[name] for name in RESULTANTS if name in quantities}
        if "stress" in quantities:
            fields["stress"] = _stresses(solution, known, points)
    for name in quantities:
        if name == "speed":
            nodes = nodes_of_elements(solution)
            values = lagrange(np.linspace(0, 1, nodes.shape[1]), points)
            v = np.einsum("pn,renc->repc", values, solution.recorded("v")[rows][:, nodes, :2])
            fields[name] = np.hypot(v[..., 0], v[..., 1])
        elif name not in fields:
            is_energy = name == "strain energy"
            values = (
                energy_density(solution, rows) if is_energy else _at_points(solution, name, rows)
            )
            fields[name] = _through(values, points)
    return {name: fields[name] for name in quantities}


def _as_one(solution, rows: list[int]) -> tuple[BeamBalance, np.ndarray]:
    """The balance of all beams, as of one behind the other, and values at the Gauss points.

    ValueError if it is not known.
    """
    resultants = [solution.resultants(name) for name in solution.beams]
    balances = [beam_resultants.balanced() for beam_resultants in resultants]
    parts = [np.stack([r.N[rows], r.Q[rows], r.M[rows]], axis=-1) for r in resultants]
    balance = BeamBalance.of_all([balance.in_rows(rows) for balance in balances])
    return balance, np.concatenate(parts, axis=1)


def _stresses(solution, known: dict[str, np.ndarray], points: np.ndarray) -> np.ndarray:
    """Larger stresses of both edges, of N, Q and M (rows, elements, points)."""
    end, values = 0, np.empty_like(known["N"])
    for beam in solution.beams.values():
        cells = slice(end, end := end + beam.elements)
        forces = (known[name][:, cells].reshape(len(values), -1) for name in RESULTANTS)
        along = SectionForces(arc_lengths(beam, points).ravel(), *forces)
        values[:, cells] = BeamStress(beam, along).largest.reshape(values[:, cells].shape)
    return values


def in_rows(resultants: BeamResultants, rows: list[int]) -> BeamResultants:
    """Resultants in some rows alone; ValueError if the balance of elements is not known."""
    balance = resultants.balanced().in_rows(rows)
    N, Q, M = (getattr(resultants, name)[rows] for name in RESULTANTS)
    return BeamResultants(resultants.s, N, Q, M, balance)


def _at_points(solution, quantity: str, rows: list[int]) -> np.ndarray:
    """Resultants or internal variables (rows, elements, degree): zero on a beam that lacks them."""
    beam_values = []
    for name, beam in solution.beams.items():
        if quantity in RESULTANTS:
            values = getattr(solution.resultants(name), quantity)
        else:
            values = solution.variables_of_beam.get(name, {}).get(quantity)
        shape = len(rows), beam.elements, beam.degree
        beam_values.append(np.zeros(shape) if values is None else values[rows].reshape(shape))
    return np.concatenate(beam_values, axis=1)


def energy_density(solution, rows: list[int]) -> np.ndarray:
    """Stored energy per length (rows, elements, degree) of beams at their Gauss points [J/m]."""
    if solution.has_own_energy:
        raise ValueError(
            "the strain energy along a member is not known: resultants, strains or energy are your "
            "own, not those of its section. Take N, Q, M or speed"
        )
    if any(beam.section is None for beam in solution.beams.values()):
        raise ValueError(
            "the strain energy along a member needs its section, which a saved file does not hold; "
            "take the solution as simulate gave it, or N, Q, M or speed"
        )
    natural = np.stack([_at_points(solution, name, rows) for name in NAMES.values()])
    q = solution.recorded("q")[rows]
    strains = _strains(solution, nodes_of_elements(solution), q) - natural
    names, values = solution.names_of_parameters, solution.parameters[rows].tolist()
    parameters = [dict(zip(names, row_points, strict=True)) for row_points in values]
    density, end = np.empty(strains.shape[1:]), 0
    constant: dict[int, list[np.ndarray]] = {}  # stiffnesses by sections, empty where they vary
    for beam in solution.beams.values():
        first, end = end, end + beam.elements
        cells, section = slice(first, end), beam.section
        beam_strains, energy = strains[:, :, cells], section.strain_energy
        if energy is None:
            if (stiffness := constant.get(id(section))) is None:
                kinds = () if any(map(section.varies, _STIFFNESSES)) else _STIFFNESSES
                stiffness = [section.values(kind, np.zeros(1)) for kind in kinds]
                constant[id(section)] = stiffness
            if not stiffness:
                fractions = arc_lengths(beam, gauss_rule(beam.degree)[0]) / beam.length
                stiffness = [section.values(kind, fractions) for kind in _STIFFNESSES]
            parts = zip(stiffness, beam_strains**2, strict=True)
            density[:, cells] = sum(factor * squares for factor, squares in parts) / 2
            continue
        variables = solution.variables_of_beam.get(beam.name, {})
        internal = [variable for name, variable in variables.items() if name not in NAMES.values()]
        columns = [*beam_strains.reshape(3, -1), *(variable[rows].ravel() for variable in internal)]
        points = np.column_stack(columns).reshape(len(rows), -1, len(columns))
        pairs = zip(parameters, points, strict=True)
        energies = [_stored(energy, values, *x) for values, row_points in pairs for x in row_points]
        density[:, cells] = np.reshape(energies, density[:, cells].shape)
    return density


# In NumPy, beside laws/kinematics.py: pictures are also drawn of solutions that come from
# another process or a copy, without the compiled forms.
def _strains(solution, nodes: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Axial strain, shear strain and curvature (3, rows, elements, degree) (eqs 9 and 10)."""
    count = nodes.shape[1]
    values, slopes = lagrange_and_slopes(np.linspace(0, 1, count), gauss_rule(count - 1)[0])
    X, q = solution.X[nodes], q[:, nodes]
    (X, Y), (u, v, psi) = np.moveaxis(X, -1, 0), np.moveaxis(q, -1, 0)
    x, y, du, dv, curvature = (f @ slopes.T for f in (X, Y, u, v, psi))
    J, half = np.hypot(x, y), psi @ values.T / 2
    c, s = np.cos(half), np.sin(half)
    turn_x, turn_y = -2 * s * (s * x + c * y) / J, 2 * s * (c * x - s * y) / J
    tx, ty = x / J + turn_x, y / J + turn_y
    Ex, Ey = du / J - turn_x, dv / J - turn_y
    return np.stack([Ex * tx + Ey * ty, Ey * tx - Ex * ty, curvature / J])


def nodes_of_elements(solution) -> np.ndarray:
    """Numbers (elements, degree + 1) of the nodes of each element, in order along its beam."""
    beam_nodes = [np.empty((0, 2), dtype=int)]
    for name, beam in solution.beams.items():
        first = beam.degree * np.arange(beam.elements)[:, None]
        beam_nodes.append(solution.nodes_of_beam[name][first + np.arange(beam.degree + 1)])
    return np.concatenate(beam_nodes[1:] or beam_nodes)


def _stored(energy: Energy, parameters: dict[str, float], eps, gamma, kappa, *a) -> float:
    """Stored energy per length of strains and internal variables [J/m]."""
    numbers = [ufl.as_ufl(float(x)) for x in (eps, gamma, kappa, *a)]
    density = energy(*numbers[:3], *([ufl.as_vector(numbers[3:])] if a else []))
    return float(replaced(density, parameters)(()))
