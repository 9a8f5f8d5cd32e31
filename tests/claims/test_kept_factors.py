"""Sparse factors that serve several steps: same motion, exact energy, renewed when poor."""

import math

import numpy as np
import pytest
import scipy.sparse
from scenes import pendulum
from test_loop import SCENES, SPARSE, lattice

import fx_beam as fb
from fx_beam.algebra.lu_layout import factors_of
from fx_beam.algebra.sparse_lu import CompiledLU
from fx_beam.compiled import handover, loop
from fx_beam.stepping import linear_solver

STRUT = fb.Section(EA=1e6, GA=1e6, EI=1e2, rhoA=1.0, rhoI=1e-2)


@pytest.fixture
def problems(monkeypatch):
    """The data in C of all runs of a test, which count the factorisations."""
    made = []

    def problem(*arguments):
        made.append(handed_over(*arguments))
        return made[-1]

    handed_over = loop.Problem
    monkeypatch.setattr(loop, "Problem", problem)
    return made


@pytest.fixture
def keep(monkeypatch):
    """Let every scene keep its factors, or none."""

    def set_worth(kept):
        least = 0 if kept else math.inf
        monkeypatch.setattr(
            handover, "COSTS", SPARSE._replace(substitution=0.05, least_worth=least)
        )

    return set_worth


def flying(cells, turn):
    """A free lattice of single elements, which rotates as a whole [rad/s]."""
    scene, nodes, middle = fb.Scene(), {}, cells / 2
    for i in range(cells + 1):
        for j in range(cells + 1):
            for end in ((i + 1, j), (i, j + 1)):
                if max(end) <= cells:
                    strut = scene.add_beam([nodes.get(at, at) for at in ((i, j), end)], STRUT)
                    nodes[i, j], nodes[end] = strut.start, strut.end
    for beam in scene.beams:
        scene.set_velocity(
            beam, lambda x, y: (-turn * (y - middle), turn * (x - middle)), spin=turn
        )
    return scene, nodes


@pytest.mark.parametrize("name", ["lattice", "linkage", "springs and dampers"])
def test_kept_factors_give_the_motion_of_new_ones(name, keep, problems):
    make, dt = SCENES[name]
    runs = []
    for kept in (True, False):
        keep(kept)
        runs.append(fb.simulate(make(), dt=dt, t_end=60 * dt, max_halvings=0))
        assert ("kept over several steps" in runs[-1].stats.solver) == kept
    often, always = (problem.c.kept.made for problem in problems)
    assert always == runs[1].stats.newton_iterations
    assert often < always / 4
    assert abs(runs[0].q - runs[1].q).max() < 1e-10 * max(1, abs(runs[1].q).max())


def test_a_large_frame_keeps_its_factors_and_its_energy(problems):
    scene, nodes = flying(26, 0.0)
    scene.add_force(nodes[26, 26], lambda t: (2e3 if t < 0.05 else 0.0, 0.0))
    solution = fb.simulate(scene, dt=0.01, t_end=0.3, record=fb.Record(every=10))
    assert solution.stats.solver.endswith("kept over several steps")
    assert problems[0].c.kept.made < solution.stats.newton_iterations / 3
    energy = solution.energy
    assert abs(energy.balance_error).max() < 1e-10 * energy.kinetic.max()


@pytest.mark.parametrize("turn", [0.01, 0.2])
def test_factors_that_a_rotation_makes_poor_are_renewed(turn, keep, problems):
    # In each step the stiff directions turn by this angle [rad].
    keep(True)
    scene, _ = flying(4, turn / 0.01)
    solution = fb.simulate(scene, dt=0.01, t_end=0.4, max_halvings=0)
    energy, momentum = solution.energy, solution.angular_momentum
    assert abs(energy.balance_error).max() < 1e-12 * energy.kinetic.max()
    assert np.ptp(momentum) < 1e-12 * abs(momentum[0])
    assert problems[0].c.kept.made >= 40 * turn


def test_factors_of_a_stiff_pendulum_do_not_hide_an_error(keep):
    # A ratio of stiffnesses of 1e10, and sub-steps in which the pendulum turns by a large angle.
    keep(True)
    solution = fb.simulate(pendulum()[0], fb.EnergyMomentum(order=4), dt=0.1, t_end=3.0)
    energy = solution.energy
    scale = max(abs(part).max() for part in (energy.kinetic, energy.strain, energy.potential))
    assert abs(energy.balance_error).max() < 1e-12 * scale


def test_a_run_with_kept_factors_repeats_itself_exactly(keep):
    keep(True)
    runs = [fb.simulate(lattice(), dt=0.005, t_end=0.2) for _ in range(2)]
    assert (runs[0].q == runs[1].q).all()


def test_a_run_that_goes_on_with_new_factors_is_equal_within_the_tolerance(keep):
    keep(True)
    whole = fb.simulate(lattice(), dt=0.005, t_end=0.2)
    half = fb.simulate(lattice(), dt=0.005, t_end=0.1)
    rest = fb.simulate(lattice(), dt=0.005, t_end=0.2, start=half)
    assert abs(rest.q[-1] - whole.q[-1]).max() < 1e-10 * abs(whole.q[-1]).max()


# -- Band or sparse rows ---------------------------------------------------------------------------


def storage(cells, high):
    """Storage of a frame of single elements, clamped at one side, from its pattern alone."""
    nodes = np.arange(cells * (high + 1)).reshape(cells, high + 1)
    ends = [(nodes[1:], nodes[:-1]), (nodes[:, 1:], nodes[:, :-1])]
    a, b = (np.concatenate([end.ravel() for end in each]) for each in zip(*ends, strict=True))
    graph = scipy.sparse.coo_matrix((np.ones(len(a)), (a, b)), (nodes.size, nodes.size))
    graph = graph + graph.T + scipy.sparse.identity(nodes.size)
    pattern = scipy.sparse.kron(graph, np.ones((3, 3))).tocsr()
    return factors_of(pattern.indptr, pattern.indices)


# `benchmarks/frames.py storage` measures both: a band takes less time for the first ones, and more
# than twice as long for the others.
@pytest.mark.parametrize("cells", [(3, 3), (20, 1), (100, 2), (500, 2), (100, 3)])
def test_a_narrow_frame_has_a_band(cells):
    assert storage(*cells).band


@pytest.mark.parametrize("cells", [(12, 12), (20, 20), (40, 25), (36, 28), (50, 20), (150, 20)])
def test_a_wide_frame_has_sparse_rows_which_are_kept(cells):
    assert storage(*cells).worth and not storage(*cells).band


def test_load_steps_of_a_large_frame_keep_factors_and_are_those_with_new_ones(monkeypatch):
    made = []
    factorise = CompiledLU.factorise
    monkeypatch.setattr(
        CompiledLU, "factorise", lambda self, values: made.append(1) or factorise(self, values)
    )
    scene, nodes = flying(32, 0.0)
    for j in range(33):
        scene.clamp(nodes[0, j])
        scene.add_force(nodes[32, j], (0.0, 2e4))

    def run():
        made.clear()
        return fb.static(scene, steps=4), len(made)

    kept, few = run()
    monkeypatch.setattr(linear_solver, "_LEAST_WORTH", math.inf)
    new, many = run()
    assert abs(kept.q[-1, :, 2]).max() > 0.1
    assert few <= many / 3
    assert kept.stats.newton_iterations == new.stats.newton_iterations == many
    assert abs(kept.q - new.q).max() < 1e-9 * abs(new.q).max()
