"""`EnergyMomentum`: the work of a step is the increment of the stored energy, for every degree."""

import ufl

import numpy as np
import pytest
from scenes import FLYING, free_flight, pinned_beam, relative_drift

import fx_beam as fb
from fx_beam.fem.step_start import StepStart
from fx_beam.mechanics.interval import Interval
from fx_beam.mechanics.resultants import averaged, with_exact_work
from fx_beam.model.model import Model


def stiffening(eps, gamma, kappa):
    """A stored energy that is not quadratic, of the size of the flying beam's."""
    return 5e3 * (eps**2 + gamma**2) + 1e5 * eps**4 + 50 * kappa**2 + 10 * ufl.sin(kappa) ** 4


def model_of(degree, energy=None, curved=False):
    section = FLYING if energy is None else fb.Section(strain_energy=energy, rhoA=1.0, rhoI=10.0)
    scene = fb.Scene()
    ends = fb.arc((0, 0), (2, 1), (4, 0)) if curved else [(0, 0), (2, 1), (4, 0)]
    scene.add_beam(ends, section, elements=2, degree=degree)
    return Model(scene, fb.EnergyMomentum())


def random_step(model, turn):
    """A configuration and an increment, with rotations up to `turn`."""
    random = np.random.default_rng(3)
    q, D = random.uniform(-0.5, 0.5, (2, model.size))
    D[model.turns] *= 2 * turn
    return q, D


def work_and_gain(model, q, D):
    """Work of the internal forces in a step, the energy gained, and the sum of the single works."""
    path, _ = model.scheme.rates.work_increment(D, model.turns)
    zero = np.zeros(model.size)
    model.forms.begin(Interval(0.0, 0.1), StepStart(q, zero, zero))
    works = model.forms.internal_force(D) * path
    gain = model.forms.strain_energy(q + D) - model.forms.strain_energy(q)
    return works.sum(), gain, abs(works).sum()


@pytest.mark.parametrize("energy", [None, stiffening], ids=["quadratic", "stiffening"])
@pytest.mark.parametrize("curved", [False, True], ids=["straight", "curved"])
@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("turn", [1e-9, 1e-3, 0.1, 1.5])
def test_the_work_of_any_step_is_the_energy_gained(turn, degree, curved, energy):
    model = model_of(degree, energy, curved)
    work, gain, scale = work_and_gain(model, *random_step(model, turn))
    assert abs(work - gain) < 1e-13 * scale


@pytest.mark.parametrize("curved", [False, True], ids=["straight", "curved"])
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_rigid_motions_do_no_work_on_any_step(degree, curved):
    model = model_of(degree, curved=curved)
    q, D = random_step(model, 1.5)
    zero = np.zeros(model.size)
    model.forms.begin(Interval(0.0, 0.1), StepStart(q, zero, zero))
    force = model.to_nodes(model.forms.internal_force(D))
    x, y = (model.mesh.X + model.to_nodes(q + D / 2)[:, :2]).T
    moments = np.array([x * force[:, 1], -y * force[:, 0], force[:, 2]])
    assert abs(force[:, :2].sum(axis=0)).max() < 1e-13 * abs(force).sum()
    assert abs(moments.sum()) < 1e-13 * abs(moments).sum()


@pytest.mark.parametrize("degree", [2, 3])
def test_work_is_exact_where_the_usual_interpolation_gives_no_virtual_strains(degree):
    # The interpolated 2 tan(Dpsi/2) gives no virtual strains here, though the element is bent: no
    # change of N, Q and m makes their work right.
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], FLYING, elements=1, degree=degree)
    model = Model(scene, fb.EnergyMomentum())
    nodes = np.linspace(0, 1, degree + 1)
    point = (1 + np.polynomial.legendre.leggauss(degree)[0][0]) / 2
    powers = np.arange(degree + 1)
    through = np.linalg.inv(nodes[:, None] ** powers)
    shape, slope = point**powers @ through, (powers * point ** abs(powers - 1.0)) @ through
    work_turn = np.array([2.0, 0.0, -0.8, 0.5])[: degree + 1]
    work_turn[1] = -(slope @ work_turn) / slope[1]
    turn = shape @ work_turn
    # Du' = turn W (t0 + Du'/2), the same on the whole element.
    W = np.array([[0.0, -1.0], [1.0, 0.0]])
    stretch = np.linalg.solve(np.eye(2) - turn / 2 * W, turn * W[:, 0])
    D = np.zeros((degree + 1, 3))
    along = model.mesh.nodes_of(scene, beam)
    D[along] = np.column_stack([np.outer(nodes, stretch), 2 * np.arctan(work_turn / 2)])
    assert abs(slope @ D[along, 2]) > 0.1  # it bends at the point
    work, gain, scale = work_and_gain(model, np.zeros(model.size), model.from_nodes(D))
    assert abs(work - gain) < 1e-13 * scale


@pytest.mark.parametrize(
    ("scene", "dt"),
    [
        (lambda: pinned_beam(1, degree=3)[0], 0.02),
        (lambda: pinned_beam(2, degree=2)[0], 0.01),
        (lambda: free_flight(2, degree=2)[0], 0.1),
        (lambda: free_flight(5, degree=3)[0], 0.1),
    ],
    ids=["pinned, degree 3", "pinned, degree 2", "free, degree 2", "free, degree 3"],
)
def test_no_step_is_halved_on_coarse_meshes(scene, dt):
    # Two to nine steps of each were halved when N, Q and m were changed to make the work exact.
    solution = fb.simulate(scene(), dt=dt, t_end=400 * dt if dt < 0.1 else 10.0, max_halvings=0)
    scale = solution.energy.total.max()
    assert abs(solution.energy.balance_error).max() < 1e-11 * scale


def test_resultants_of_ones_own_are_made_exact_for_degree_2():
    def own(step, law):
        return with_exact_work(step, averaged(step, law))

    scene, beam = free_flight(3, degree=2)
    scheme = fb.Scheme("own", own, fb.MidPointRates())
    solution = fb.simulate(scene, scheme, dt=0.05, t_end=5.0)
    after = solution.t > 2.5 + 1e-6
    assert relative_drift(solution.energy.total[after]) < 1e-11
    expected = fb.simulate(scene, dt=0.05, t_end=5.0)
    assert (solution.position(beam.end) == expected.position(beam.end)).all()
