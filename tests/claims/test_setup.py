"""A scene of a known kind compiles nothing; functions of the user are asked again each time."""

import ufl

import numpy as np
import pytest

import fx_beam as fb
from fx_beam.content_cache import cached_by_content
from fx_beam.fem import dolfinx_api, ffcx_api, interval_mesh, weak_form
from fx_beam.fem.fields import Fields


def arm(elements=3, length=1.0, EA=1e4, force=1.0, degree=1, second=None, **more):
    """A clamped arm of one or two sections under its weight and a force at its end."""
    scene = fb.Scene(gravity=(0.0, -9.81))
    section = fb.Section(EA=EA, GA=EA, EI=10.0, rhoA=1.0, **more)
    beam = scene.add_beam([(0, 0), (length, 0)], section, elements=elements, degree=degree)
    if second is not None:
        scene.add_beam([beam.end, (length, length)], second, elements=2, degree=degree)
    scene.clamp(beam.start)
    scene.add_force(beam.end, (0.0, force))
    return scene, beam


@pytest.fixture
def nothing_is_signed(monkeypatch):
    def refuse():
        def signature(form):
            raise AssertionError("signed again")

        monkeypatch.setattr(ufl.Form, "signature", signature)

    return refuse


RUNS = {
    "simulate": lambda scene: fb.simulate(scene, dt=0.01, t_end=0.05).q,
    "in Python": lambda scene: fb.simulate(scene, dt=0.01, t_end=0.02, solver="petsc").q,
    "Newmark": lambda scene: fb.simulate(scene, fb.Newmark(), dt=0.01, t_end=0.05).q,
    "static": lambda scene: fb.static(scene).q,
    "modes": lambda scene: fb.modes(scene, n=2).frequencies,
}


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("run", RUNS)
def test_other_numbers_in_a_scene_compile_nothing(run, degree, nothing_is_signed):
    simple = {"degree": degree}
    stepped = {"degree": degree, "second": fb.Section(EA=5e3, GA=5e3, EI=5.0, rhoA=2.0)}
    first = [RUNS[run](arm(**kind)[0]) for kind in (simple, stepped)]
    nothing_is_signed()
    other = {"elements": 5, "length": 2.0, "EA": 3e4, "force": -2.0}
    for kind, before in zip((simple, stepped), first, strict=True):
        after = RUNS[run](arm(**kind, **other)[0])
        assert np.isfinite(after).all()
        assert after.shape != before.shape or abs(after - before).max() > 1e-6
        # The first scene again: what is kept has no data of another one.
        np.testing.assert_array_equal(RUNS[run](arm(**kind)[0]), before)


def test_an_energy_whose_data_change_is_asked_again():
    stiffness = {"EA": 1e4}

    def energy(eps, gamma, kappa):
        return 0.5 * (stiffness["EA"] * (eps**2 + gamma**2) + 10.0 * kappa**2)

    def tip():
        scene, beam = arm(strain_energy=energy)
        return fb.static(scene).displacement(beam.end)[-1, 1]

    stiff = tip()
    assert tip() == stiff
    stiffness["EA"] = 100.0
    soft = tip()
    # Shear adds (F + q l / 2) l / GA.
    assert soft - stiff == pytest.approx((1.0 - 9.81 / 2) * (1 / 100 - 1e-4), rel=0.1)


def test_two_models_of_a_kind_do_not_share_their_fields():
    (first, beam), (other, _) = arm(), arm(EA=2e4, length=2.0, force=3.0)
    solution = fb.simulate(first, dt=0.01, t_end=0.05)
    fb.simulate(other, dt=0.01, t_end=0.05)
    late = solution.resultants(beam).N  # evaluated after the other motion
    np.testing.assert_array_equal(late, fb.simulate(first, dt=0.01, t_end=0.05).resultants(beam).N)


@pytest.mark.parametrize("degree", [1, 2])
def test_meshes_of_equal_connectivity_have_positions_of_their_own(degree):
    # A branched tree, whose cells dolfinx numbers anew.
    ends = np.array([[0, 3], [3, 1], [3, 4], [4, 2], [5, 4]])
    inner = 6 + np.arange(len(ends) * (degree - 1)).reshape(len(ends), -1)
    cells = np.hstack([ends, inner])
    places = [np.random.default_rng(seed).random((6 + inner.size, 2)) for seed in range(2)]
    meshes, orders = zip(
        *(interval_mesh.mesh_between(X, cells, degree) for X in places), strict=True
    )
    assert (orders[0] == orders[1]).all()
    for X, mesh in zip(places, meshes, strict=True):  # those of the first one as well
        found = dolfinx_api.element_coordinates(mesh).reshape(len(cells), -1, 3)
        np.testing.assert_array_equal(found[..., :2], X[cells[orders[0]]])
    functions = [dolfinx_api.function(interval_mesh.beam_space(mesh, degree)) for mesh in meshes]
    functions[0].x.array[:] = 1.0
    assert not functions[1].x.array.any()


def test_only_the_last_results_of_small_arrays_are_kept():
    calls = []

    @cached_by_content
    def doubled(values, factor):
        calls.append(len(values))
        return values * factor

    small = np.arange(3.0)
    first = doubled(small, 2)
    small[0] = 5.0  # another argument: contents count
    assert doubled(np.arange(3.0), 2) is first and calls == [3]
    assert doubled(small, 2)[0] == 10.0 and calls == [3, 3]
    with pytest.raises(ValueError, match="read-only"):
        first[0] = 1.0
    for _ in range(2):
        doubled(np.zeros(10**5), 2)
    assert calls[2:] == [10**5] * 2
    for factor in range(100):
        doubled(np.arange(3.0), 10 + factor)
    assert doubled(np.arange(3.0), 2) is not first


def test_a_form_does_not_depend_on_the_forms_that_a_process_has_built_before():
    fields = Fields(2, curved=False)  # as in a new process
    tapered = [
        weak_form.WeakForm(fields, fb.EnergyMomentum(), [(None, None)], (2, (3,)), None)
        for _ in range(2)
    ]
    first, second = (ffcx_api.signature(form.tangent) for form in tapered)
    assert first == second
