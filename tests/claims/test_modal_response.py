"""Derivatives of natural frequencies: closed forms, remainders, crossing and repeated modes."""

import pickle

import numpy as np
import pytest
from jointed import four_bar
from test_static_response import DATA, X, bending, chain, driven, motors, slide

import fx_beam as fb

LONG = {"elements": 16, "degree": 2}


def cantilever(x):
    """EI, mass per length and length; the other stiffnesses are large, and grow with EI."""
    scene = fb.Scene()
    section = fb.Section(EA=1e6 * x[0], GA=1e6 * x[0], EI=x[0], rhoA=x[1])
    beam = scene.add_beam([(0, 0), (x[2], 0)], section, **LONG)
    scene.clamp(beam.start)
    return scene


def column(x):
    """EI, and a force at its end, between two pins."""
    scene = fb.Scene()
    section = fb.Section(EA=1e7, GA=1e7, EI=x[0], rhoA=1.0)
    beam = scene.add_beam([(0, 0), (1, 0)], section, **LONG)
    scene.pin(beam.start)
    scene.fix(beam.end, "y")
    scene.add_force(beam.end, (-x[1], 0))
    return scene


def crossed(x):
    """A mass on a cross of four beams: half lengths along x and y, and stiffness."""
    scene = fb.Scene()
    section = fb.Section(EA=1e4 * x[2], GA=1e4 * x[2], EI=x[2], rhoA=1.0)
    lines = [[(-x[0], 0), (x[0], 0)], [(0, -x[1]), (0, x[1])]]
    first, second = (scene.add_beam(points, section, elements=4) for points in lines)
    for node in (first.start, first.end, second.start, second.end):
        scene.clamp(node)
    scene.add_joint(fb.Rigid(first.node(0.5), second.node(0.5)))
    scene.add_mass(second.node(0.5), 10.0)
    return scene


def damped(x):
    scene, section = fb.Scene(gravity=(0, -x[3])), {"EA": 1e4, "GA": 1e4, "rhoA": 1.0}
    member = fb.Section(EI=2.0, retardation=1e-3 * x[1], **section)
    beam = scene.add_beam([(0, 0), (x[0], 0)], member, elements=3, degree=2)
    hinge = {"spring": fb.Spring(20.0), "damper": fb.Damper(0.5 * x[2])}
    scene.add_joint(fb.Revolute(fb.GROUND, beam.start, **hinge))
    scene.add_drag(beam.end, linear=0.1 * x[0])
    return scene


def loaded(scene):
    return fb.static(scene, load_steps=3, t=1.0, newton=fb.NewtonOptions(tolerance=1e-13))


def test_frequencies_of_a_cantilever_depend_on_its_data_as_in_the_closed_form():
    """They are in proportion to sqrt(EI / rhoA) / L^2, whatever the mode."""
    run = fb.ModalResponse(cantilever, n=3)
    x = np.array([2.0, 3.0, 1.5])
    w = run(x)
    assert w[0] == pytest.approx(3.51602 * np.sqrt(2.0 / 3.0) / 1.5**2, rel=1e-4)
    relative = run.jacobian() * x / w[:, None]
    assert relative[:, :2] == pytest.approx(np.tile([0.5, -0.5], (3, 1)), abs=1e-7)
    assert relative[:, 2] == pytest.approx(-2.0, abs=1e-3)  # it has some shear
    assert run.vjp([1, 0, 2]) == pytest.approx(np.array([1, 0, 2]) @ run.jacobian(), rel=1e-9)


def test_the_frequency_of_a_column_depends_on_its_force_as_in_the_closed_form():
    """w^2 = pi^2 (pi^2 EI - P) per unit of mass and length: the state follows from the force."""
    run, EI, P = fb.ModalResponse(column, n=1, state=loaded), 2.0, 12.0
    (w,) = run([EI, P])
    assert w**2 == pytest.approx(np.pi**2 * (np.pi**2 * EI - P), rel=1e-4)
    exact = np.pi**2 * np.array([np.pi**2, -1.0]) / (2 * w)
    assert run.jacobian()[0] == pytest.approx(exact, rel=1e-4)


@pytest.mark.parametrize(
    ("build", "options"),
    [
        *((build, {"state": loaded}) for build in (bending, chain, driven, motors, slide)),
        (slide, {}),
        (damped, {"damped": True}),
        *((build, {"damped": True, "state": loaded}) for build in (damped, bending, driven)),
    ],
)
def test_what_is_left_of_the_linear_change_is_of_second_order(build, options, monkeypatch):
    if "damped" in options:
        monkeypatch.setitem(DATA, "retardation", 2e-3)
    x = np.append(X, 1.0)
    direction = np.array([0.3, -0.5, 0.4, 0.6])
    run = fb.ModalResponse(build, n=3, **options)
    w = run(x)
    J = run.jacobian()
    weights = np.random.default_rng(0).standard_normal(w.shape)
    assert run.vjp(weights) == pytest.approx(np.tensordot(weights, J, w.ndim), rel=1e-6, abs=1e-9)
    left = [run(x + h * direction) - w - h * J @ direction for h in (2e-3, -2e-3, 1e-3, -1e-3)]
    odd = abs(np.subtract(left[::2], left[1::2])).reshape(2, -1).max(axis=1)
    assert odd[0] < 1e-6 * abs(w).max()  # of third order: the difference of both sides
    even = abs(np.add(left[::2], left[1::2])).reshape(2, -1).max(axis=1)
    assert even[0] / even[1] == pytest.approx(4.0, rel=0.05)
    run.jacobian(), run(x)  # what was set up elsewhere serves again
    assert run.jacobian() == pytest.approx(J, rel=1e-7, abs=1e-7 * abs(J).max())


@pytest.mark.parametrize("build", [damped, bending, chain, driven, motors])
def test_slopes_of_all_numbers_come_from_a_single_scene(build):
    count = [0]

    def counted(x):
        count[0] += 1
        return build(x)

    run = fb.ModalResponse(counted, n=2, state=loaded)
    for x in (np.append(X, 1.0), np.append(X, 1.1)):
        run(x)
        count[0] = 0
        run.jacobian()
    assert count == [1]  # the first time, slopes are compared with differences


def test_modes_keep_their_places_where_frequencies_cross():
    run = fb.ModalResponse(crossed, n=3)
    before = run([1.0, 0.9, 1.0])
    after = run([0.9, 1.0, 1.0])
    assert (np.diff(before) > 0).all() and not (np.diff(after) > 0).all()
    assert np.sort(after) == pytest.approx(before, rel=1e-9)
    other = pickle.loads(pickle.dumps(run))  # has seen no modes yet
    assert other([0.9, 1.0, 1.0]) == pytest.approx(np.sort(after))


def test_repeated_modes_have_the_derivatives_of_their_group(caplog):
    """With other lengths they part: each change of a length alone is told exactly."""
    run = fb.ModalResponse(crossed, n=3)
    w = run([1.0, 1.0, 1.0])
    pair = np.flatnonzero(np.isclose(w, np.median(w), rtol=1e-9))
    J = run.jacobian()
    assert "have the same frequency" in caplog.text and len(pair) == 2
    for i in range(3):
        for sign in (1, -1):
            x = 1 + sign * 1e-5 * (np.arange(3) == i)
            slopes = (np.sort(fb.ModalResponse(crossed, n=3)(x)) - np.sort(w)) / (sign * 1e-5)
            assert np.sort(slopes) == pytest.approx(np.sort(J[:, i]), rel=1e-3)
    weights = 2.0 * np.isin(np.arange(3), pair)
    assert run.vjp(weights) == pytest.approx(weights @ J, rel=1e-9)
    weights[pair[0]] = 1.0
    with pytest.raises(fb.SceneError, match="only their sum has a gradient"):
        run.vjp(weights)
    cut, whole = (fb.ModalResponse(crossed, n=n) for n in (4, 8))  # of five, one and all
    cut(np.ones(3)), whole(np.ones(3))
    assert cut.jacobian()[3] == pytest.approx(whole.jacobian()[3], rel=1e-9)


def overdamped(x):
    scene = fb.Scene()
    body = scene.add_body((0, 0), mass=1.0, inertia=1.0)
    of = {"spring": fb.Spring(1.0), "damper": fb.Damper(3.0 * x[0])}
    scene.add_joint(fb.Prismatic(fb.GROUND, body.centre, axis=(1, 0), **of))
    return scene


@pytest.mark.parametrize(
    ("build", "options", "message"),
    [
        (lambda x: crossed(np.ones(3)), {"damped": True, "n": 3}, "the same root"),
        (overdamped, {"damped": True}, "mode 0 does not vibrate: it is overdamped"),
        (lambda x: four_bar()[0], {}, "closed loops"),
        (cantilever, {"state": lambda s: fb.static(s, spin=3.0, pivot=(0, 0))}, r"\(spin\)"),
    ],
)
def test_what_has_no_derivatives_is_refused(build, options, message):
    run = fb.ModalResponse(build, **{"n": 1} | options)
    run([1.0, 1.0, 1.0])
    with pytest.raises(fb.SceneError, match=message):
        run.jacobian()
