"""Derivatives of periodic motions: closed forms, another integrator, and differences."""

import numpy as np
import pytest
from derivatives import assert_orbit_slopes, differences
from scenes import assert_refused, clamped_bar, guided_body, one_body
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve
from scipy.special import ellipk

import fx_beam as fb

W = 1.3  # [rad/s]


def duffing(x, f=None):
    """An oscillator with the spring force k s + s^3; its mass, k, damping and load."""
    scene, (m, k, c, force) = fb.Scene(), x
    body = scene.add_body((0, 0), mass=m, inertia=1.0)
    spring = fb.Spring(stiffness=k, strain_energy=lambda s: s**4 / 4)
    damper = fb.Damper(c) if f else None
    scene.add_joint(fb.Prismatic(fb.GROUND, body.centre, (1, 0), spring=spring, damper=damper))
    if f:
        scene.add_force(body.centre, lambda t: (force * np.cos(2 * np.pi * f * t), 0.0))
    outputs = {
        "period": fb.Output("period", scene),
        "x": fb.Output("position", body.centre, "x"),
        "a": fb.Output("acceleration", body.centre),
        "energy": fb.Output("total_energy", scene),
    }
    return scene, outputs


def forced(scene):
    return fb.periodic(scene, period=2 * np.pi / W, steps=101, tolerance=1e-12)


def free(**options):
    return lambda scene: fb.periodic(scene, mode=0, steps=41, tolerance=1e-12, **options)


# -- Against closed forms and another integrator --------------------------------------------------


def test_the_period_of_duffings_equation_has_the_derivatives_of_its_closed_form():
    def exact(x):
        m, k, a = x
        return 4 * np.sqrt(m / (k + a**2)) * ellipk(a**2 / (2 * (k + a**2)))

    errors, known = [], differences(exact, np.array([1.2, 0.8, 1.0]))[:2]
    for steps in (31, 61):
        scheme = fb.EnergyMomentum(order=4)
        own = {"mode": 0, "amplitude": 1.0, "steps": steps, "scheme": scheme, "tolerance": 1e-12}
        run = fb.PeriodicResponse(
            lambda x: duffing([*x, 0, 0]), lambda scene, own=own: fb.periodic(scene, **own)
        )
        run([1.2, 0.8])
        errors.append(abs(run.jacobian("period")["period"] / known - 1).max())
    assert errors[1] < 1e-6
    assert np.log(errors[0] / errors[1]) / np.log(61 / 31) == pytest.approx(4, abs=0.4)


def test_the_product_of_multipliers_changes_with_damping_as_liouville_says():
    # A pair of them has the product exp(-c T / m).
    x = np.array([1.1, 1.0, 0.2, 0.3])
    run = fb.PeriodicResponse(lambda x: duffing(x, W / (2 * np.pi)), forced)
    run(x)
    (value,), (by_x,) = run.multipliers()
    assert value.imag > 0
    rate = 2 * (by_x / value).real  # of the logarithm of the product
    period = 2 * np.pi / W
    assert rate == pytest.approx([0.2 * period / 1.1**2, 0, -period / 1.1, 0], abs=5e-3)


def exact_fold(x, start):
    """Start and frequency at which the monodromy matrix has the eigenvalue 1, by solve_ivp."""
    m, k, c, force = x

    def rates(t, y, w):
        u, v, a, b = y[0], y[1], y[2:4], y[4:6]
        stiffness = k + 3 * u**2
        acceleration = (force * np.cos(w * t) - c * v - k * u - u**3) / m
        return [v, acceleration, *b, *(-(stiffness * a + c * b) / m)]

    def equations(unknown):
        u, v, w = unknown
        y0 = [u, v, 1, 0, 0, 1]
        end = solve_ivp(rates, (0, 2 * np.pi / w), y0, "DOP853", rtol=1e-11, atol=1e-12, args=(w,))
        u1, v1, a, b, c1, d = end.y[:, -1]
        return [u1 - u, v1 - v, (a - 1) * (d - 1) - b * c1]

    return fsolve(equations, start, xtol=1e-12)[2]


@pytest.mark.parametrize("number", [0, 1])
def test_folds_have_the_frequency_and_the_derivatives_of_another_integrator(number):
    x = np.array([1.0, 1.0, 0.1, 0.3])
    values, slopes = [], []
    for steps in (51, 101):

        def fold(build, steps=steps):
            curve = fb.forced_response(build, (0.15, 0.4), steps=steps)
            (k, kind, motion), f = curve.critical[number], curve.frequencies
            assert kind == "fold" and abs(motion.multipliers - 1).min() < 1e-4
            # The curve turns back there: no motion beside it goes further.
            beside = np.sort([*f[k - 2 : k + 2], motion.frequency])
            assert beside[0 if number else -1] == motion.frequency
            return motion

        run = fb.PeriodicResponse(lambda x, f: duffing(x, f), fold)
        values.append(float(run(x)[1]["period"]))
        slopes.append(run.jacobian("period")["period"])
    solution = run.motion.solution
    start = solution.q[0, 0, 0], solution.v[0, 0, 0], 2 * np.pi / values[1]
    errors = np.array(values) * exact_fold(x, start) / (2 * np.pi) - 1
    assert np.log(errors[0] / errors[1]) / np.log(101 / 51) == pytest.approx(2, abs=0.2)
    by_x = differences(lambda x: 2 * np.pi / exact_fold(x, start), x, 1e-3)
    far, near = (abs(slope - by_x).max() / abs(by_x).max() for slope in slopes)
    assert near < 5e-3 and near < far / 3


# -- Against differences of other searches --------------------------------------------------------


def test_a_forced_motion_has_exact_derivatives_at_all_times():
    run = fb.PeriodicResponse(lambda x: duffing(x, W / (2 * np.pi)), forced)
    assert_orbit_slopes(run, [1.0, 1.0, 0.2, 0.3], 2e-8)


@pytest.mark.parametrize("chosen", [{"amplitude": 1.0}, {"energy": 0.75}])
def test_a_free_motion_of_an_amplitude_or_energy_has_exact_derivatives(chosen):
    run = fb.PeriodicResponse(lambda x: duffing([*x, 0, 0]), free(**chosen))
    assert_orbit_slopes(run, [1.0, 1.2], 1e-6, multipliers=False)


@pytest.mark.parametrize("chosen", [{"amplitude": 0.5}, {"energy": -1.0}])
def test_a_free_motion_about_an_equilibrium_has_exact_derivatives(chosen):
    def build(x):
        scene = fb.Scene(gravity=(0, -9.81))
        one = scene.add_body((0.5, 0), mass=x[0], inertia=0.1, points={"a": (0, 0), "b": (1, 0)})
        two = scene.add_body((1.5, 0), mass=1.0, inertia=0.1, points={"b": (1, 0)})
        spring, other = fb.Spring(stiffness=100.0 * x[1]), fb.Spring(stiffness=30.0)
        scene.add_joint(fb.Revolute(fb.GROUND, one["a"], spring=spring))
        scene.add_joint(fb.Revolute(one["b"], two["b"], spring=other))
        scene.add_force(two.centre, (x[2], 0.0))
        place = fb.Output("position", two.centre)
        return scene, {"place": place, "period": fb.Output("period", scene)}

    def motion(scene):
        return free(state=fb.static(scene), **chosen)(scene)

    assert_orbit_slopes(fb.PeriodicResponse(build, motion), [1.0, 1.0, 0.5], 1e-6)


@pytest.mark.parametrize("chosen", ["energy", "amplitude"])
def test_the_period_of_a_pendulum_has_the_derivative_of_its_closed_form_by_its_length(chosen):
    """Its centre, which has the energy and the amplitude, is a distance away from its hinge."""
    m, g, inertia, size = 2.0, 9.81, 0.1, {"energy": 6.0, "amplitude": 0.4}[chosen]

    def exact(x):
        (d,) = x
        if chosen == "energy":
            square = size / (2 * m * g * d)
        else:
            square = (1 - np.sqrt(1 - (size / d) ** 2)) / 2
        return 4 * np.sqrt((inertia + m * d**2) / (m * g * d)) * ellipk(square)

    def build(x):
        scene = fb.Scene(gravity=(0, -g))
        body = scene.add_body((0, -x[0]), mass=m, inertia=inertia, points={"hinge": (0, 0)})
        scene.pin(body["hinge"])
        return scene, {"period": fb.Output("period", scene)}

    def motion(scene):
        options = {chosen: size, "scheme": fb.EnergyMomentum(order=4)}
        return free(state=fb.static(scene), **options)(scene)

    run, x = fb.PeriodicResponse(build, motion), np.array([0.7])
    assert run(x)[1]["period"] == pytest.approx(exact(x), rel=1e-5)
    assert run.jacobian()["period"] == pytest.approx(differences(exact, x), rel=1e-4)


HARDENS = {"strain_energy": lambda angle: 5 * angle**4}


def geared(x):
    """A gear, a rack, and a mass on a spring behind them."""
    scene, (stiffness, ratio, radius, soft) = fb.Scene(), x
    one, two = (scene.add_body((at, 0), mass=1.0, inertia=0.1 * (at + 1)) for at in (0, 1))
    three = scene.add_body((3, 1), mass=1.5, inertia=0.1)
    four = scene.add_body((3, 2), mass=0.5, inertia=0.1)
    spring = fb.Spring(stiffness, **HARDENS)
    first = scene.add_joint(fb.Revolute(fb.GROUND, one.centre, spring=spring))
    second = scene.add_joint(fb.Revolute(fb.GROUND, two.centre))
    slide = scene.add_joint(fb.Prismatic(fb.GROUND, three.centre, axis=(1, 0)))
    scene.add_joint(fb.Gear(first, second, ratio=ratio))
    scene.add_joint(fb.Rack(second, slide, radius=radius))
    scene.add_force_between(three.centre, four.centre, spring=fb.Spring(soft, rest=1.0))
    lift = fb.Prismatic(fb.GROUND, four.centre, axis=(0, 1), spring=fb.Spring(20.0))
    scene.add_joint(lift)
    outputs = {
        "angle": fb.Output("angle", second),
        "slide": fb.Output("slide", slide),
        "lift": fb.Output("velocity", four.centre),
    }
    return scene, outputs | {"period": fb.Output("period", scene)}


def linkage(x):
    """Four bars, of which the length x[0] of the crank changes where the others begin."""
    scene, places = fb.Scene(), np.array([(0, 0), (0, x[0]), (0.5, 0.6), (0.5, 0)])
    bars = [
        scene.add_body((a + b) / 2, mass=1.0, inertia=0.1, points={"a": a, "b": b})
        for a, b in zip(places, places[1:], strict=False)
    ]
    spring = fb.Spring(x[1], **HARDENS)
    crank = scene.add_joint(fb.Revolute(fb.GROUND, bars[0]["a"], spring=spring))
    for bar, other in zip(bars, bars[1:], strict=False):
        knee = scene.add_joint(fb.Revolute(bar["b"], other["a"]))
    rocker = scene.add_joint(fb.Revolute(bars[2]["b"], fb.GROUND))
    outputs = {
        "crank": fb.Output("angle", crank),
        "rocker": fb.Output("angle", rocker),
        "force": fb.Output("force", knee),
        "centre": fb.Output("velocity", bars[1].centre),
    }
    return scene, outputs | {"period": fb.Output("period", scene)}


@pytest.mark.parametrize("chosen", [{"amplitude": 0.1}, {"energy": 0.5}])
@pytest.mark.parametrize(
    ("build", "x"), [(geared, [30.0, -1.3, 0.4, 10.0]), (linkage, [0.6, 30.0])]
)
def test_what_follows_by_gears_and_loops_at_the_start_changes_with_their_numbers(build, x, chosen):
    """Nothing moves the independent unknowns of the start, but the others with ratio and length."""
    run = fb.PeriodicResponse(build, free(**chosen))
    assert_orbit_slopes(run, x, 1e-6, multipliers=build is geared)


def test_natural_strains_count_in_the_energy_of_a_free_motion():
    def build(x):
        section = fb.Section(EA=1e4, GA=1e4, EI=40.0, rhoA=1.0, rhoI=0.01)
        scene, beam = clamped_bar((1, 0), section, elements=1, gravity=(0, -9.81))
        scene.add_natural_strain(beam, curvature=0.5 * x[0])
        period = fb.Output("period", scene)
        return scene, {"tip": fb.Output("position", beam.end), "period": period}

    def motion(scene):
        return free(state=fb.static(scene), energy=2.5)(scene)

    assert_orbit_slopes(fb.PeriodicResponse(build, motion), [0.9], 1e-6, multipliers=False)


def cantilever(x):
    section = fb.Section(EA=1e4, GA=1e4, EI=x[0], rhoA=x[1], retardation=5e-3)
    scene, beam = clamped_bar((x[2], 0), section, elements=3)
    scene.add_force(beam.end, lambda t: (0.0, x[3] * np.cos(0.8 * np.pi * t)))
    place, reaction = fb.Output("position", beam.end), fb.Output("reaction", beam.start)
    return scene, {"place": place, "M": fb.Output("M", beam), "reaction": reaction}


@pytest.mark.parametrize("scheme", [fb.EnergyMomentum(order=4), fb.MidPoint()])
def test_a_beam_that_is_shaken_has_exact_derivatives(scheme):
    def motion(scene):
        return fb.periodic(scene, period=2.5, steps=41, scheme=scheme, tolerance=1e-12)

    assert_orbit_slopes(fb.PeriodicResponse(cantilever, motion), [1.0, 1.0, 1.0, 0.3], 1e-7)


def test_natural_strains_have_exact_derivatives_also_at_the_start():
    """A viscous section sees how they change in the first step, too."""

    def build(x):
        section = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.01, retardation=0.01)
        scene, beam = clamped_bar((1, 0), section, elements=2, gravity=(0, -9.81))
        scene.add_natural_strain(beam, curvature=0.3 * x[0])
        scene.add_natural_strain(beam, curvature=lambda f, t: x[1] * f * (0.5 + np.cos(W * t)))
        return scene, {"tip": fb.Output("position", beam.end), "M": fb.Output("M", beam)}

    assert_orbit_slopes(fb.PeriodicResponse(build, forced), [1.1, 0.9], 1e-6, multipliers=False)


def test_what_a_scheme_remembers_of_the_step_before_is_followed():
    """Also in resultants of the first step, work and losses, by the damping of the scheme, too."""
    damping = fb.Parameter("damping", 0.1)

    def build(x):
        scene, outputs = cantilever(x)
        scene.add_parameter(fb.Parameter("damping", x[4]))
        beam = scene.beams[0]
        outputs |= {name: fb.Output(name, beam) for name in "NQ"}
        sums = "work", "dissipated_energy", "strain_energy"
        return scene, outputs | {name: fb.Output(name, scene) for name in sums}

    def motion(scene):
        scheme = fb.EnergyDecaying(damping)
        return fb.periodic(scene, scheme=scheme, period=2.5, steps=21, tolerance=1e-12)

    # With shorter differences the rounding errors of normal forces are as large as the tolerance.
    run = fb.PeriodicResponse(build, motion)
    assert_orbit_slopes(run, [1.0, 1.0, 1.0, 0.3, 0.1], 1e-7, part=1e-3)


def test_a_driven_linkage_whose_loop_changes_its_form_has_exact_derivatives():
    speed = 20.0

    def build(x):
        section = fb.Section(EA=2e5, GA=8e4, EI=20.0, rhoA=0.3, rhoI=1e-5, retardation=1e-3)
        own = {"mass": 0.2, "inertia": 1e-3, "points": {"O": (0, 0), "A": (0.2, 0)}}
        scene, crank = one_body((0.1, 0), **own)
        coupler = scene.add_beam([(0.2, 0), (0.9 * x[0], 0.35)], section, elements=2)
        rocker = scene.add_beam([(0.9 * x[0], 0.35), (0.8, 0)], section, elements=2)

        def turn(t):
            return speed * t + x[1] * np.sin(speed * t)

        motor = scene.add_joint(fb.Revolute(fb.GROUND, crank["O"], motor=turn))
        scene.add_joint(fb.Revolute(crank["A"], coupler.start))
        scene.add_joint(fb.Revolute(coupler.end, rocker.start, damper=fb.Damper(0.05)))
        scene.pin(rocker.end)
        scene.make_velocities_compatible()
        torque = fb.Output("motor_force", motor)
        losses = fb.Output("dissipated_energy", scene)
        return scene, {"place": fb.Output("position", rocker.start), "T": torque, "lost": losses}

    def motion(scene):
        return fb.periodic(scene, period=2 * np.pi / speed, steps=101, tolerance=1e-12)

    assert_orbit_slopes(fb.PeriodicResponse(build, motion), [1.0, 0.1], 1e-6)


def dry_friction(stiffness, steps):
    def build(x):
        own = {"spring": fb.Spring(x[1]), "friction": fb.Coulomb(0.03 * x[2], stiffness)}
        scene, block, _ = guided_body((0, 0), x[0], 1.0, **own, gravity=(0, -10.0))
        scene.add_force(block, lambda t: (np.cos(1.4 * t), 0.0))
        return scene, {"place": fb.Output("position", block)}

    def motion(scene):
        return fb.periodic(scene, period=2 * np.pi / 1.4, steps=steps, tolerance=1e-12)

    run = fb.PeriodicResponse(build, motion)
    return run, run(np.ones(3))[1]["place"], run.jacobian()["place"]


def test_dry_friction_of_a_joint_is_followed():
    """Of a soft spring, whose slip reverses in so many steps that derivatives are theirs."""
    run, _, jacobian = dry_friction(2.0, 1601)
    by_x = differences(lambda x: run(x)[1]["place"], np.ones(3), 1e-5)
    assert jacobian == pytest.approx(by_x, abs=1e-5 * abs(by_x).max())


def test_dry_friction_changes_a_forced_motion_as_den_hartog_says():
    """Its largest displacement, for stiff springs of friction, whose slip reverses in one step.

    Forced vibrations with combined Coulomb and viscous friction, Trans. ASME 53 (1931) 107-115.
    There differences of motions are those of steps: 0.004 for -0.210 by the friction.
    """

    def largest(x):
        mass, stiffness, friction = x
        ratio = 1.4 / np.sqrt(stiffness / mass)
        lost = 0.3 * mass * friction  # friction over the amplitude of the force
        lag = np.sin(np.pi / ratio) / (ratio * (1 + np.cos(np.pi / ratio)))
        return np.sqrt(1 / (1 - ratio**2) ** 2 - (lag * lost) ** 2) / stiffness

    expected = differences(largest, np.ones(3), 1e-6)
    for steps, most in ((201, 0.02), (801, 0.005)):
        _, place, jacobian = dry_friction(1e7, steps)
        k = place[:, 0].argmax()
        assert place[k, 0] == pytest.approx(largest(np.ones(3)), abs=most / 5)
        assert jacobian[k, 0] == pytest.approx(expected, abs=most)


def test_multipliers_of_a_scene_at_rest_turn_with_its_frequency():
    # They are exp(+-i w T), w = sqrt(k / m), as far as steps resolve it.
    def build(x):
        scene, _ = duffing([x[0], x[1], 0, 0])
        return scene, {"period": fb.Output("period", scene)}

    run = fb.PeriodicResponse(build, lambda scene: fb.periodic(scene, period=1.5, steps=401))
    run([1.2, 0.8])
    (value,), (by_x,) = run.multipliers()
    turn = np.sqrt(0.8 / 1.2) * 1.5
    assert value == pytest.approx(np.exp(1j * turn), abs=1e-5)
    exact = 1j * value * turn / 2 * np.array([-1 / 1.2, 1 / 0.8])
    assert by_x == pytest.approx(exact, abs=1e-5)


def test_a_frequency_is_placed_by_its_gradient():
    run = fb.PeriodicResponse(lambda x: duffing([1.0, *x, 0, 0]), free(amplitude=1.0))

    def gap(t, y):
        away = float(y["period"]) - 4.0
        return away**2 / 2, {"period": np.array(away)}

    x = [1.0]
    for _ in range(6):
        value, gradient = run.objective(gap)(x)
        if value < 1e-24:
            break  # where the period has all digits, both may be zero
        x = x - 2 * value / gradient
    assert float(run(x)[1]["period"]) == pytest.approx(4.0, abs=1e-8)


def test_a_motion_of_an_earlier_call_is_that_of_its_parameters():
    def first_motion(build):
        return fb.forced_response(build, (0.5, 0.45), steps=21)[0]

    run = fb.PeriodicResponse(lambda x, f: duffing(x, f), first_motion)
    run([1.0, 1.0, 0.1, 0.3])
    earlier = run.motion
    run([2.0, 1.0, 0.1, 0.6])
    q = earlier.solution.q
    np.testing.assert_allclose(q[-1], q[0], rtol=0, atol=1e-6 * np.ptp(q))


# -- What is refused ------------------------------------------------------------------------------


def test_what_has_no_derivatives_is_told():
    def motion_at_a_fold(build):
        return fb.forced_response(build, (0.15, 0.4), steps=41).critical[0].motion

    run = fb.PeriodicResponse(lambda x, f: duffing(x, f), motion_at_a_fold)
    run([1.0, 1.0, 0.1, 0.3])
    assert_refused("at a fold only", run.jacobian, "x")
    assert_refused("at a fold only", run.multipliers)

    def of_backbone(scene):
        return fb.backbone(scene, amplitude=0.5, steps=21, step=0.5)[0]

    run = fb.PeriodicResponse(lambda x: duffing([*x, 0, 0]), of_backbone)
    run([1.0, 1.0])
    assert_refused("of a family has no derivatives", run.jacobian)
    # Numbers that change the period of loads, and a motion of another scene.
    x = [1.0, 1.0, 0.2, 0.3]
    run = fb.PeriodicResponse(lambda w: duffing(x, w[0] / (2 * np.pi)), forced)
    run([W])
    assert_refused(r"x\[0\] changes the period of loads", run.jacobian)
    other = duffing([1.0, 1.1, 0.2, 0.3], W / (2 * np.pi))[0]
    run = fb.PeriodicResponse(lambda x: duffing(x, W / (2 * np.pi)), lambda scene: forced(other))
    run(x)
    assert_refused("does not repeat itself in the scene", run.jacobian)


def test_bad_input_is_told():
    assert_refused("build", fb.PeriodicResponse, 3, forced)
    assert_refused("must take", fb.PeriodicResponse, lambda: 0, forced)
    assert_refused("motion", fb.PeriodicResponse, duffing, lambda: 0)
    run = fb.PeriodicResponse(lambda x: duffing(x, 0.2), lambda scene: 3)
    assert_refused("a PeriodicMotion", run, [1.0, 1.0, 0.2, 0.3])
    assert_refused("no motion yet", run.jacobian)
    run = fb.PeriodicResponse(lambda x: duffing(x, W / (2 * np.pi)), forced)
    run([1.0, 1.0, 0.2, 0.3])
    assert_refused("multipliers: n", run.multipliers, 5)
    assert_refused("names of outputs", run.jacobian, "force")
    plain = fb.Response(lambda x: duffing(x, 0.2), dt=0.1, t_end=1.0)
    assert_refused("PeriodicResponse", plain, [1.0, 1.0, 0.2, 0.3])


def test_an_oscillator_without_damping_has_no_multipliers_but_those_that_are_one():
    def build(x):
        spring = fb.Spring(stiffness=x[0], strain_energy=lambda s: s**4 / 4)
        scene, body, _ = guided_body((0, 0), 1.0, 1.0, spring=spring)
        return scene, {"period": fb.Output("period", scene)}

    run = fb.PeriodicResponse(build, lambda scene: fb.periodic(scene, mode=0, amplitude=1.0))
    run([1.0])
    assert_refused("multipliers: all are 1, for shifts in time and the", run.multipliers)
