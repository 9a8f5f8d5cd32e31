"""Steps of the published scheme against the paper's explicit matrices, written once more."""

from itertools import pairwise

import numpy as np
import pytest
from jointed import W, rotation

import fx_beam as fb

SECTION = fb.Section(EA=3e3, GA=1e3, EI=40.0, rhoA=3.0, rhoI=0.6)
DT = 0.02


def explicit_element(x, q0, q1, C, EI):
    """Residual and tangent of one two-node element (eqs 48 to 54, published scheme).

    x, q0 and q1 are (2, 2), (2, 3) and (2, 3); C is the stiffness in the global frame.
    """
    length = np.hypot(*(x[1] - x[0]))
    t0 = (x[1] - x[0]) / length
    slope = np.array([-1.0, 1.0]) / length  # N_a' at the mid-point, where N_a = 1/2
    d0, d1 = (t0 + slope @ q[:, :2] for q in (q0, q1))
    dm = (d0 + d1) / 2
    psi0, psi1 = q0[:, 2].mean(), q1[:, 2].mean()
    R0, R1 = rotation(psi0), rotation(psi1)
    Rm = (R0 + R1) / 2
    E0, E1 = R0.T @ d0 - t0, R1.T @ d1 - t0
    N = C @ (E0 + E1) / 2  # eq. 40
    n, n_tilde = Rm @ N, R1 @ N  # eqs 47 and 52
    tan = np.tan((psi1 - psi0) / 2)
    m = EI * (slope @ q0[:, 2] + slope @ q1[:, 2]) / 2 / (1 + tan**2)  # eqs 41 and 47

    D = Rm @ C @ R1.T / 2
    Wd1, Wdm = W @ d1, W @ dm
    E = np.zeros((4, 4))  # eq. 50: rows and columns phi', psi, psi'
    E[:2, :2], E[:2, 2] = D, -D @ Wd1
    E[2, :2], E[2, 2] = -Wdm @ D, Wdm @ D @ Wd1
    E[3, 3] = EI / 2 / (1 + tan**2)
    G = np.zeros((4, 4))  # eq. 51
    G[:2, 2] = W @ n_tilde / 2
    G[2, :2], G[2, 2] = W @ n / 2, -dm @ n_tilde / 2
    G[3, 2] = -m * tan

    f, K = np.zeros(6), np.zeros((6, 6))
    # Fields (phi', psi, psi') from the nodal (x, y, psi), in eqs 53 and 54.
    L = [np.array([[s, 0, 0], [0, s, 0], [0, 0, 0.5], [0, 0, s]]) for s in slope]
    force = np.array([*n, -Wdm @ n, m])
    for a in range(2):
        f[3 * a : 3 * a + 3] = length * L[a].T @ force
        for b in range(2):
            K[3 * a : 3 * a + 3, 3 * b : 3 * b + 3] = length * L[a].T @ (E + G) @ L[b]
    return f, K


def paper_step(places, elements, free, q0, v0):
    """A step of elements [a, b] by eqs 27 to 30 and 48 to 54: increment and iterations."""
    n = len(places)
    D = np.zeros((n, 3))
    for iteration in range(1, 20):
        tan = np.tan(D[:, 2] / 2)
        a = 2 * (np.column_stack([D[:, :2], 2 * tan]) / DT - v0) / DT
        # Eq. 49: 2/dt^2 A_rho and 2/dt^2 / cos^2(Dpsi/2) J_rho with the consistent mass, eq. 21.
        slope = 2 / DT**2 * np.column_stack([np.ones((n, 2)), 1 + tan**2])
        r, K = np.zeros(3 * n), np.zeros((3 * n, 3 * n))
        for ends in elements:
            x, dofs = places[ends], np.add.outer(3 * np.array(ends), range(3)).ravel()
            length = np.hypot(*(x[1] - x[0]))
            t0 = (x[1] - x[0]) / length
            C = SECTION.EA * np.outer(t0, t0) + SECTION.GA * np.outer(W @ t0, W @ t0)
            f, tangent = explicit_element(x, q0[ends], (q0 + D)[ends], C, SECTION.EI)
            data = np.diag([SECTION.rhoA, SECTION.rhoA, SECTION.rhoI])
            mass = length * np.kron(np.array([[2, 1], [1, 2]]) / 6, data)
            r[dofs] += f + mass @ a[ends].ravel()
            K[np.ix_(dofs, dofs)] += tangent + mass * slope[ends].ravel()
        change = np.zeros(3 * n)
        change[free] = -np.linalg.solve(K[np.ix_(free, free)], r[free])
        D += change.reshape(n, 3)
        if abs(change).max() < 1e-11:
            return D, iteration
    raise AssertionError("the paper's tangent is none")


@pytest.mark.parametrize(("up", "down"), [(8, 4), (16, 11), (38, 19)])
def test_steps_and_their_iterations_are_those_of_the_papers_matrices(up, down):
    """Of two beams that meet, whose nodes lead up and down a chain, and a strut there."""
    scene = fb.Scene()
    beam = scene.add_beam([(0.3, -0.2), (1.0, 0.5), (1.4, -0.6)], SECTION, elements=up)
    other = scene.add_beam([(2.2, 0.3), beam.end], SECTION, elements=down)
    strut = scene.add_beam([(1.3, 0.4), beam.end], SECTION, elements=1)
    scene.clamp(strut.start)
    random = np.random.default_rng(3)
    places = np.array([(node.x, node.y) for node in scene.nodes])
    v = random.uniform(-7.5, 7.5, (len(places), 3))
    v[strut.start.number] = 0
    for node, rates in zip(scene.nodes, v, strict=True):
        if node is not strut.start:
            scene.set_velocity(node, rates[:2], spin=rates[2])
    ends = [[a.number, b.number] for x in (beam, other, strut) for a, b in pairwise(x.nodes)]
    free = np.flatnonzero(np.repeat(np.arange(len(places)) != strut.start.number, 3))
    newton = fb.NewtonOptions(tolerance=1e-11)
    motion = fb.simulate(scene, fb.ModifiedMidPoint(), dt=DT, t_end=10 * DT, newton=newton)
    assert motion.stats.solver == "compiled, chain"
    q, iterations = np.zeros_like(v), 0
    for row in range(1, 11):
        D, needed = paper_step(places, ends, free, q, v)
        v = 2 / DT * np.column_stack([D[:, :2], 2 * np.tan(D[:, 2] / 2)]) - v
        q, iterations = q + D, iterations + needed
        assert motion.q[row].reshape(-1, 3) == pytest.approx(q, abs=1e-11)
    assert abs(q).max() > 0.3
    # The tangents are the same, and the package has a better start.
    assert motion.stats.newton_iterations <= iterations
