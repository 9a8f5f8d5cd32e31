"""Derivatives of critical loads, by closed forms, and how these fall with imperfections."""

import ufl

import numpy as np
import pytest
import scipy.integrate
import scipy.optimize
from scenes import assert_refused, clamped_bar, held_body, supported_bar

import fx_beam as fb

STIFF = 1e6


def observed(scene):
    return scene, {"load": fb.Output("critical_load", scene)}


def column(x, loaded):
    """EI, length and how much there is of the load."""
    scene = fb.Scene(gravity=(0, -9 * x[2]) if loaded is own_weight else None)
    section = fb.Section(EA=STIFF * x[0], GA=STIFF * x[0], EI=x[0], rhoA=1.0)
    beam = scene.add_beam([(0, 0), (0, x[1])], section, elements=8, degree=3)
    loaded(scene, beam, x[2])
    return observed(scene)


def own_weight(scene, beam, load):
    scene.clamp(beam.start)


def heated(scene, beam, load):
    """Between two pins."""
    scene.pin(beam.start)
    scene.pin(beam.end)
    scene.add_natural_strain(beam, axial=12 * load / STIFF)


def pushed(scene, beam, load):
    scene.pin(beam.start)
    scene.fix(beam.end, "x")
    scene.prescribe(beam.end, y=lambda t: -12 * load / STIFF * beam.length * t)


def followed(scene, beam, load):
    """Beck's column: it flutters."""
    scene.clamp(beam.start)
    scene.add_force(beam.end, (0, -22.0 * load), follower=True)


@pytest.mark.parametrize(
    ("loaded", "factor", "powers"),
    [
        (own_weight, 7.8373 / 9, (1, -3, -1)),
        (heated, np.pi**2 / 12, (0, -2, -1)),
        (pushed, np.pi**2 / 12, (0, -2, -1)),
        (followed, 20.05095 / 22, (1, -2, -1)),
    ],
)
def test_loads_of_columns_depend_on_their_data_as_in_the_closed_forms(loaded, factor, powers):
    run = fb.StaticResponse(lambda x: column(x, loaded), load_steps=4, t=1.0)
    x = np.ones(3)
    _, y = run(x)
    assert y["load"] == pytest.approx(factor, rel=1e-4)
    J = run.jacobian()["load"]
    assert pytest.approx(powers, abs=2e-4) == J / y["load"]
    assert run.vjp({"load": -2.0}) == pytest.approx(-2 * J, rel=1e-12)
    # The place of a point is known to 1e-7: wide differences, of which two are combined.
    direction, h = np.array([0.3, -0.5, 0.4]), 4e-3
    loads = [run(x + k * h * direction)[1]["load"] for k in (-2, -1, 1, 2)]
    slope = (loads[0] - 8 * loads[1] + 8 * loads[2] - loads[3]) / (12 * h)
    assert slope == pytest.approx(J @ direction, rel=1e-4)


def hinged(x, c=10.0, square=0.0, cube=1.0):
    """A rigid column that leans by x[0], on a hinge with the moment c psi + ...; 15 N on it."""
    scene, stiff = fb.Scene(), fb.Section(EA=STIFF, GA=STIFF, EI=STIFF)
    bar = scene.add_beam([(0, 0), (np.sin(x[0]), np.cos(x[0]))], stiff, elements=1)

    def energy(psi):
        return square * psi**3 / 6 + cube * psi**4 / 4

    spring = fb.Spring(stiffness=c * x[1], strain_energy=energy)
    scene.add_joint(fb.Revolute(fb.GROUND, bar.start, spring=spring))
    scene.add_force(bar.end, (0, -15.0))
    return observed(scene)


@pytest.mark.parametrize(
    ("laws", "exponent", "exact"),
    [
        # (P - c) psi - (cube + c / 6) psi^3 - square psi^2 / 2 - c x = 0, with its fold
        ({"cube": -5.0}, 2 / 3, 10 * 1.5 ** (2 / 3) / 15),
        ({"cube": -1.0}, 2 / 3, 0.0),
        ({"square": 6.0}, 1 / 2, np.sqrt(2 * 6 * 10) / 15),
    ],
)
def test_loads_fall_with_imperfections_as_koiter_says(laws, exponent, exact):
    run = fb.StaticResponse(lambda x: hinged(x, **laws), load_steps=4)
    run([0.0, 1.0])
    power, coefficients = run.imperfection_sensitivity()
    assert power == exponent
    assert coefficients == pytest.approx([exact, 0.0], rel=1e-4, abs=1e-12)
    assert_refused(r"x\[0\], which is an imperfection", run.jacobian)


@pytest.mark.parametrize(("EA", "elements"), [(1e3, 12), (1e4, 24), (1e5, 12)])
def test_the_sway_of_an_arch_is_an_imperfection_however_stiff_it_is_along_its_axis(EA, elements):
    """Against a load at 1 mm. The bending stiffness is none."""

    def build(x):
        scene = fb.Scene()
        section = fb.Section(EA=EA, GA=EA, EI=x[1])
        arch = scene.add_beam(
            lambda f: (2 * f - 1, 1.8 * f * (1 - f) + x[0] * np.sin(2 * np.pi * f)),
            section,
            elements=elements,
            degree=3,
        )
        scene.pin(arch.start)
        scene.pin(arch.end)
        scene.add_force(arch.node(0.5), (0, -50.0))
        return observed(scene)

    options = {"load_steps": 24, "continuation": "arc-length", "max_steps": 90}
    run, size = fb.StaticResponse(build, **options), 1e-3
    _, y = run([0.0, 1.0])
    power, coefficients = run.imperfection_sensitivity()
    _, less = run([size, 1.0])
    falls = (y["load"] - less["load"]) / size**power
    assert coefficients == pytest.approx([falls, 0.0], rel=1e-3, abs=1e-12)


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.1])
def test_the_stiffness_of_a_column_is_no_imperfection_in_any_direction(angle):
    """Of a straight column, which is not bent, the work of its bending moments is round-off."""

    def build(x):
        along = np.array([-np.sin(angle), np.cos(angle)])
        section = fb.Section(EA=STIFF, GA=STIFF, EI=x[0])
        scene, beam = clamped_bar(along, section, elements=8, degree=2, load=-4 * along)
        return observed(scene)

    run = fb.StaticResponse(build, load_steps=4)
    _, y = run([1.0])
    assert y["load"] == pytest.approx(np.pi**2 / 16, rel=1e-4)
    assert run.jacobian()["load"][0] == pytest.approx(y["load"], rel=1e-4)


@pytest.mark.parametrize("steps", [8, 12, 16, 24])
def test_no_long_step_leaves_a_path_before_its_limit_point(steps):
    """An arch that is pushed a little to one side: it has limit points, but no bifurcation."""
    scene = fb.Scene()
    section = fb.Section(EA=1e4, GA=4e3, EI=1.0)
    points = [(-1, 0), (-0.5, 0.3375), (0, 0.45), (0.5, 0.3375), (1, 0)]
    left = scene.add_beam(points[:3], section, elements=4, degree=2)
    right = scene.add_beam([left.end, *points[3:]], section, elements=4, degree=2)
    scene.pin(left.start)
    scene.pin(right.end)
    scene.add_force(left.end, (0.01, -50.0))
    options = {"load_steps": steps, "continuation": "arc-length", "max_steps": 2 * steps}
    first, *_ = fb.static(scene, **options).critical_points
    assert first.load_factor == pytest.approx(0.1539068, rel=1e-6)
    assert first.kind == "limit point"


def heavy_column_buckles(load):
    """The weight q of a column with EI = 1 + (1/2 - s)/2 under a load at its top: by its ODE.

    m' = -(q (1 - s) + P) psi and psi' = m / EI, with m = 0 at the top and psi = 0 at the clamp.
    """

    def turn_of_clamp(q):
        def rates(s, state):
            psi, m = state
            return [m / (1 + 0.5 * (0.5 - s)), -(q * (1 - s) + load) * psi]

        ends = scipy.integrate.solve_ivp(rates, (1, 0), (1.0, 0.0), rtol=1e-11, atol=1e-12)
        return ends.y[0, -1]

    return scipy.optimize.brentq(turn_of_clamp, 4.0, 12.0, xtol=1e-12)


@pytest.mark.parametrize("load", [0.0, 1e-9, 0.5])
def test_a_load_that_is_zero_yet_is_no_imperfection(load):
    def build(x):
        section = fb.Section(EA=1e7, GA=1e7, EI=lambda f: 1 + 0.5 * (0.5 - f), rhoA=1.0)
        scene, column = clamped_bar((0, 1), section, elements=12, degree=3, gravity=(0.0, -10.0))
        # It acts with the weight, which is 10 N/m times the load factor.
        scene.add_force(column.end, (0.0, -x[0]))
        return scene, {"load": fb.Output("critical_load", scene)}

    run = fb.StaticResponse(build, load_steps=5)
    factor = float(run([load])[1]["load"])
    h = 1e-4
    low, middle, high = (heavy_column_buckles(factor * load + d) for d in (-h, 0.0, h))
    slope = (high - low) / (2 * h)
    assert 10 * factor == pytest.approx(middle, rel=1e-5)
    # 10 l = q(l x)
    exact = slope * factor / (10 - slope * load)
    assert run.jacobian()["load"] == pytest.approx([exact], rel=1e-4)


def test_a_critical_load_that_there_is_not_is_told_of():
    run = fb.StaticResponse(lambda x: column([*x, 0.5], followed), load_steps=2)
    assert_refused("no critical point up to load factor 1", run, [1.0, 1.0])
    motion = fb.Response(lambda x: column([*x, 1.0], heated), dt=0.1, t_end=0.1)
    assert_refused("a motion has no critical_load", motion, [1.0, 1.0])


def test_a_load_at_which_material_has_flowed_has_no_derivatives():
    """A shallow arch of two springs that yield before it snaps through."""

    def build(x):
        stiffness = fb.Parameter("stiffness", x[0])

        def energy(stretch, a):
            return (stiffness * (stretch - a[0]) ** 2 + 200 * a[0] ** 2) / 2

        def flow(old, before, now, dt):
            trial = stiffness * (now[0] - old[0]) - 200 * old[0]
            excess = ufl.max_value(abs(trial) - 2.0, 0)
            return [old[0] + ufl.sign(trial) * excess / (stiffness + 200)]

        internal = fb.InternalVariables(("a",), flow)
        scene, crown = held_body((0, 0.5), 1.0, 1.0, "x", "rotation")
        for end in ((-1, 0), (1, 0)):
            spring = fb.Spring(rest=np.hypot(1, 0.5), strain_energy=energy, internal=internal)
            scene.add_force_between(crown, end, spring=spring)
        scene.add_force(crown, (0, -20.0))
        return observed(scene)

    run = fb.StaticResponse(build, load_steps=40, continuation="arc-length", max_steps=60)
    assert 0.2 < run([500.0])[1]["load"] < 0.5
    assert_refused("no derivatives: material flows on the path", run.vjp, {"load": 1.0})


def test_two_modes_at_once_have_no_derivatives():
    def build(x):
        scene, _ = hinged([0.0, x[0]])
        bar = scene.add_beam([(1, 0), (1, 1)], scene.beams[0].section, elements=1)
        scene.add_joint(fb.Revolute(fb.GROUND, bar.start, spring=fb.Spring(stiffness=10.0)))
        scene.add_force(bar.end, (0, -15.0))
        return observed(scene)

    run = fb.StaticResponse(build, load_steps=4)
    assert 15 * run([1.0])[1]["load"] == pytest.approx(10.0, rel=1e-4)
    assert_refused("2 modes become unstable at once", run.vjp, {"load": 1.0})
    assert_refused(r"weights\['load'\] is no finite number\. ", run.vjp, {"load": np.nan})


def test_a_load_depends_on_parameters_at_the_time_of_the_path():
    """A column between two springs: its mode depends on their stiffness k = 60 t x at t = 1/2."""

    def jacobian(k_of):
        def build(x):
            section = fb.Section(EA=1e6, GA=1e6, EI=1.0)
            scene, beam = supported_bar((0, 1), section, elements=4, degree=2, held="x")
            k = fb.Parameter("k", k_of(x[0]))
            spring = fb.Spring(strain_energy=lambda stretch: k * stretch**2 / 2, rest=1.0)
            for side in (-1, 1):
                scene.add_force_between(beam.node(0.25), (side, 0.25), spring=spring)
            scene.add_force(beam.end, (0, -25.0))
            return observed(scene)

        run = fb.StaticResponse(build, load_steps=4, t=0.5)
        run([1.0])
        return run.jacobian()["load"]

    steady = jacobian(lambda x: lambda t: 60 * t * x)
    assert steady == pytest.approx(jacobian(lambda x: 30 * x), rel=1e-8)
