"""The UFL tangent against the paper's explicit matrices and against differences."""

import ufl

import numpy as np
import pytest
from scenes import FLYING, pinned_beam

import fx_beam as fb
from fx_beam.fem.step_start import StepStart
from fx_beam.mechanics.interval import Interval
from fx_beam.model.model import Model

SCHEMES = [
    fb.EnergyMomentum(),
    fb.ModifiedMidPoint(),
    fb.MidPoint(),
    fb.Newmark(),
    fb.GeneralizedAlpha(0.6),
]


def stiffening(eps, gamma, kappa):
    """A stored energy that is not quadratic, of the size of the flying beam's."""
    return 5e3 * (eps**2 + gamma**2) + 1e5 * eps**4 + 50 * kappa**2 + 10 * ufl.sin(kappa) ** 4


def model_of(scheme, degree, energy=None, curved=False):
    section = FLYING if energy is None else fb.Section(strain_energy=energy, rhoA=1.0, rhoI=10.0)
    scene, _ = pinned_beam(3, degree, section)
    if curved:
        scene.add_beam(fb.arc((0, 0), (2, 1), (4, 0)), section, elements=2, degree=degree)
    model = Model(scene, scheme)
    random = np.random.default_rng(1)
    q, D, v, a = (random.uniform(-0.7, 0.7, model.size) for _ in range(4))
    model.forms.begin(Interval(0.0, 0.1), StepStart(q, v, a))
    return model, D


@pytest.mark.parametrize("energy", [None, stiffening], ids=["quadratic", "stiffening"])
@pytest.mark.parametrize(
    ("degree", "curved"), [(1, False), (2, False), (2, True), (3, False), (3, True)]
)
@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: s.name)
def test_tangent_is_the_derivative_of_the_forces(scheme, degree, curved, energy):
    model, D = model_of(scheme, degree, energy, curved)
    model.forms.internal_force(D)
    model.forms.assemble_stiffness()
    K = model.forms.stiffness.toarray()
    h = 1e-5

    def column(e):
        # Four points: an error of h^4 below the rounding.
        f = [model.forms.internal_force(D + k * h * e).copy() for k in (-2, -1, 1, 2)]
        return (f[0] - 8 * f[1] + 8 * f[2] - f[3]) / (12 * h)

    differences = np.array([column(e) for e in np.eye(model.size)]).T
    assert abs(K - differences).max() < 1e-7 * abs(K).max()


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: s.name)
def test_acceleration_and_work_increment_have_the_slopes_they_state(scheme):
    random = np.random.default_rng(2)
    D, v, a = (random.uniform(-1, 1, 9) for _ in range(3))
    turns, dt, h = np.array([2, 5, 8]), 0.03, 1e-5
    for rule in (
        lambda D: scheme.rates.acceleration(D, v, a, dt, turns),
        lambda D: scheme.rates.work_increment(D, turns),
    ):
        f = [rule(D + k * h)[0] for k in (-2, -1, 1, 2)]
        difference = (f[0] - 8 * f[1] + 8 * f[2] - f[3]) / (12 * h)
        assert rule(D)[1] == pytest.approx(difference, rel=1e-7)


# -- The paper's matrices, written once more ----------------------------------------------------

W = np.array([[0.0, -1.0], [1.0, 0.0]])


def rotation(psi):
    return np.array([[np.cos(psi), -np.sin(psi)], [np.sin(psi), np.cos(psi)]])


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


def test_residual_and_tangent_are_the_papers_matrices():
    section = fb.Section(EA=3e3, GA=1e3, EI=40.0, rhoA=1.0, rhoI=0.1)
    scene = fb.Scene()
    beam = scene.add_beam([(0.3, -0.2), (1.0, 0.5), (1.4, -0.6)], section, elements=4)
    model = Model(scene, fb.ModifiedMidPoint())
    random = np.random.default_rng(3)
    q0, D = (random.uniform(-0.8, 0.8, (len(model.mesh.X), 3)) for _ in range(2))
    f, K = np.zeros((model.size,)), np.zeros((model.size, model.size))
    for i, j in zip(beam.nodes[:-1], beam.nodes[1:], strict=True):
        ends = [i.number, j.number]
        x = model.mesh.X[ends]
        t0 = (x[1] - x[0]) / np.hypot(*(x[1] - x[0]))
        C = section.EA * np.outer(t0, t0) + section.GA * np.outer(W @ t0, W @ t0)
        fe, Ke = explicit_element(x, q0[ends], (q0 + D)[ends], C, section.EI)
        dofs = model.mesh.dofs[ends].ravel()
        f[dofs] += fe
        K[np.ix_(dofs, dofs)] += Ke

    zero = np.zeros(model.size)
    model.forms.begin(Interval(0.0, 0.1), StepStart(model.from_nodes(q0), zero, zero))
    force = model.forms.internal_force(model.from_nodes(D))
    model.forms.assemble_stiffness()
    assert abs(force - f).max() < 1e-12 * abs(f).max()
    assert abs(model.forms.stiffness.toarray() - K).max() < 1e-12 * abs(K).max()


def test_inertia_and_its_tangent_are_the_papers_matrix():
    # Eq. 49: 2/dt^2 A_rho and 2/dt^2 / cos^2(Dpsi/2) J_rho with the consistent mass, eq. 21.
    section = fb.Section(EA=1.0, GA=1.0, EI=1.0, rhoA=3.0, rhoI=0.6)
    scene = fb.Scene()
    scene.add_beam([(0, 0), (0.6, 0.8)], section, elements=1)
    model = Model(scene, fb.ModifiedMidPoint())
    consistent = np.kron(np.array([[2, 1], [1, 2]]) / 6, np.diag([3.0, 3.0, 0.6]))
    order = model.mesh.dofs.ravel()
    assert model.mass.toarray()[np.ix_(order, order)] == pytest.approx(consistent, abs=1e-15)
    D, dt = model.from_nodes(np.array([[0.1, 0.2, 0.5], [0.3, -0.1, -0.4]])), 0.2
    zero = np.zeros(6)
    a, slope = model.scheme.rates.acceleration(D, zero, zero, dt, model.turns)
    cos2 = np.cos(np.array([0.5, -0.4]) / 2) ** 2
    assert model.to_nodes(slope)[:, 2] == pytest.approx(2 / dt**2 / cos2)
    assert model.to_nodes(slope)[:, :2] == pytest.approx(2 / dt**2)
    assert model.to_nodes(a)[:, 2] == pytest.approx(4 / dt**2 * np.tan(np.array([0.5, -0.4]) / 2))
