"""Arc-length continuation: limit points in closed form, tangents, joints, and where paths end."""

import ufl

import numpy as np
import pytest
from scenes import clamped_bar, demo, guided_body, one_bar, supported_bar

import fx_beam as fb

#: Enough where the bordered tangent is the derivative of the equations; else it takes tens.
FEW = fb.NewtonOptions(max_iterations=8)
RISE, EA = 0.2, 1e4


def truss(load):
    """Half of a shallow truss of two bars under a load at its top, in units of the limit load.

    With l the length of the bar and y its height the load is EA y (1/l - 1/l0); its extrema are
    where l^3 = l0 (the half span is 1).
    """
    l0 = np.hypot(1, RISE)
    top = np.sqrt(l0 ** (2 / 3) - 1)
    limit = EA * top * (l0 ** (-1 / 3) - 1 / l0)
    scene, bar = supported_bar((1, RISE), fb.Section(EA=EA, GA=EA, EI=1e3), elements=2, held="x")
    scene.add_force(bar.end, (0.0, -load * limit))

    def exact(y):
        return EA * y * (1 / np.hypot(1, y) - 1 / l0) / limit / load

    return scene, bar, exact, top


# -- Limit points --------------------------------------------------------------------------------


@pytest.mark.parametrize("steps", [1, 40])
def test_the_first_step_does_not_decide_what_is_found(steps):
    scene, bar, exact, top = truss(1.5)
    solution = fb.static(scene, steps, continuation="arc-length")
    assert solution.stats.limit_points == pytest.approx([1 / 1.5, -1 / 1.5], rel=1e-9)
    height = solution.position(bar.end)[:, 1]
    assert solution.load_factor == pytest.approx(exact(height), abs=1e-9)
    assert solution.load_factor[-1] == 1 and (np.diff(height) < 0).all()
    rows = [list(solution.load_factor).index(p) for p in solution.stats.limit_points]
    assert height[rows] == pytest.approx([top, -top], rel=1e-4)


def test_a_load_below_the_limit_ends_before_it():
    scene, bar, exact, top = truss(0.999)
    solution = fb.static(scene, continuation="arc-length")
    assert solution.stats.limit_points == []
    assert solution.load_factor[-1] == 1
    assert solution.position(bar.end)[-1, 1] > top


def test_a_deep_arch_meets_the_limit_load_of_the_literature():
    # DaDeppo & Schmidt (1975), J. Appl. Mech. 42: 8.97 EI/R^2 for a circular arch of 215 degrees,
    # hinged at one end and clamped at the other, inextensible, under a load at its top.
    half = np.radians(215 / 2)

    def limit(elements):
        angles = np.linspace(-half, half, elements + 1)
        section = fb.Section(EA=1e8, GA=1e8, EI=1.0)
        around = np.column_stack([np.sin(angles), np.cos(angles)])
        scene, arch = clamped_bar(around, section, elements)
        scene.pin(arch.end)
        scene.add_force(arch.node(0.5), (0.0, -10.0))
        path = fb.static(scene, 20, continuation="arc-length", max_steps=40)
        return 10 * path.stats.limit_points[0]

    coarse, fine = limit(40), limit(80)
    assert coarse == pytest.approx(8.97, rel=0.01)
    assert fine + (fine - coarse) / 3 == pytest.approx(8.97, rel=1e-3)


def test_every_row_is_in_equilibrium_and_the_balance_of_energy_closes_to_second_order():
    lee = demo("lee_frame")
    gaps = []
    for steps in (10, 40):
        frame, loaded, hinge = lee.scene(elements=5, degree=2)
        path = fb.static(frame, steps, continuation="arc-length")
        energy = path.energy
        gaps.append(abs(energy.balance_error[-1]) / energy.strain.max())
    assert gaps[0] < 2e-3
    assert np.log2(gaps[0] / gaps[1]) / 2 == pytest.approx(2, abs=0.3)
    load = np.column_stack([0 * path.load_factor, -lee.LOAD * path.load_factor])
    held = hinge, path.beams["beam"].end
    forces = [(path.reaction(n)[:, :2], path.position(n)) for n in held]
    forces.append((load, path.position(loaded)))
    assert abs(sum(force for force, _ in forces)).max() < 1e-9 * lee.LOAD
    moments = sum(x[:, 0] * f[:, 1] - x[:, 1] * f[:, 0] for f, x in forces)
    assert abs(moments).max() < 1e-8 * lee.LOAD * lee.LEG


def test_steps_along_the_arc_length_are_about_as_many_as_asked_for_and_few_iterations_each():
    for steps in (10, 40):
        scene, beam = clamped_bar((1, 0), fb.Section(EA=1e5, GA=1e5, EI=10.0), 6, 2)
        scene.add_force(beam.end, (0.0, -50.0))
        solution = fb.static(scene, steps, continuation="arc-length", newton=FEW)
        assert np.diff(solution.load_factor).max() < 1.2 / steps
        assert solution.stats.steps == pytest.approx(steps, rel=0.2)
        assert solution.stats.halvings == 0


def test_a_path_may_go_below_the_loads_reversed_and_come_back():
    # An arch hinged at both ends and loaded at a quarter: each loop reaches further than the last.
    scene = fb.Scene()
    section = fb.Section(EA=113618.0, GA=56809.0, EI=1.0)
    arch = scene.add_beam(lambda f: (f, 0.193 * np.sin(np.pi * f)), section, 8, 2)
    scene.pin(arch.start)
    scene.pin(arch.end)
    scene.add_force(arch.node(0.75), (0.0, -168.0))
    path = fb.static(scene, continuation="arc-length")
    assert path.load_factor[-1] == 1
    assert min(path.stats.limit_points) < -1


# -- Joints and driven motion --------------------------------------------------------------------


def linkage():
    """Sliding and turning joints, a spring, a motor, a prescribed support, loads of all kinds."""
    section = fb.Section(EA=1e3, GA=1e3, EI=5.0, rhoA=0.1)
    scene, rail = one_bar((1, 0), section, elements=2, gravity=(0.0, -3.0))
    rod = scene.add_beam([(1.2, 0.1), (2.2, 0.1)], section, elements=2)
    arm = scene.add_beam([(2.4, 0.1), (3.0, 0.4)], section, elements=2)
    scene.fix(rail.start, "x", "y")
    scene.prescribe(rail.start, rotation=lambda t: 0.4 * t)
    scene.add_joint(
        fb.Prismatic(rail.end, rod.start, axis=(1, 0), offset=(0, 0.1), spring=fb.Spring(30.0))
    )
    scene.add_joint(fb.Revolute(rod.end, arm.start, offset=(0.2, 0), motor=lambda t: -0.5 * t))
    scene.add_force(arm.end, (0.3, 0.2), follower=True)
    scene.add_moment(rod.end, 0.5)
    scene.add_virtual_work(lambda step: step.load_factor * step.psi * step.virtual_u[0], rod)
    return scene, arm


def test_a_linkage_with_motors_is_driven_to_the_same_place_on_both_ways():
    scene, arm = linkage()
    one = fb.static(scene, 8, t=1.0)
    other = fb.static(scene, 8, t=1.0, continuation="arc-length", newton=FEW)
    assert abs(one.q[-1] - other.q[-1]).max() < 1e-9
    assert abs(one.slides[-1] - other.slides[-1]).max() < 1e-9
    assert abs(one.joint_forces[-1] - other.joint_forces[-1]).max() < 1e-7
    assert other.stats.halvings == 0
    turned = one.rotation(arm.start) - one.rotation(scene.beams[1].end)
    assert turned == pytest.approx(-0.5 * one.load_factor)


# -- Where a path ends ---------------------------------------------------------------------------


@pytest.mark.parametrize("axial", [None, 1e-3])
def test_a_contact_that_closes_on_the_path_may_stick_or_slip(axial):
    """A beam presses a bracket on a plane; Newton's method remembers its last iteration."""
    scene, beam = clamped_bar((1, 0), fb.Section(EA=1e4, GA=1e4, EI=10.0), elements=2)
    bracket = scene.add_body((1, 0), mass=1.0, inertia=0.1, points={"foot": (0.5, 1.0)})
    scene.add_joint(fb.Rigid(beam.end, bracket.centre))
    plane = fb.Line((0, 0.92), normal=(0.1, 1))
    scene.add_contact(bracket["foot"], plane, stiffness=500.0, friction=fb.Coulomb(0.3, 1e3))
    scene.add_force(beam.end, (0.0, -20.0))
    if axial is not None:
        scene.add_natural_strain(beam, axial=axial)
    ways = None, "arc-length"
    ends = [fb.static(scene, continuation=way).position(beam.end)[-1] for way in ways]
    assert abs(ends[1] - ends[0]).max() < 1e-5


def test_a_path_ends_after_the_steps_that_it_may_take(caplog):
    scene, bar, exact, _ = truss(2.0)
    solution = fb.static(scene, continuation="arc-length", max_steps=12)
    assert solution.stats.steps == 12 == len(solution.t) - 1
    assert solution.load_factor[-1] < 1
    assert (
        f"load factor {solution.load_factor[-1]:g}, below 1, after max_steps = 12 steps"
        in caplog.text
    )
    assert solution.stats.failure.reason in caplog.text
    assert not fb.static(truss(0.9)[0], continuation="arc-length").stats.failure


def test_a_path_that_cannot_go_on_ends_in_an_error_with_what_was_found():
    scene, *_ = truss(2.0)
    newton = fb.NewtonOptions(max_iterations=2)
    with pytest.raises(
        fb.StepError, match="along the arc length from load factor 0 failed"
    ) as error:
        fb.static(scene, continuation="arc-length", newton=newton, max_cuts=2)
    assert "after 2 cuts: no convergence in 2 iterations" in str(error.value)
    assert len(error.value.solution.t) == 1
    assert error.value.solution.stats.failure


def test_a_path_that_runs_off_is_given_up_and_its_limit_points_are_named():
    section = fb.Section(EA=1e5, GA=1e5, EI=10.0, rhoA=1.0)
    scene, left = clamped_bar((1, 0), section, elements=4, gravity=(0, -9.81))
    right = scene.add_beam([(1, 0), (1.8, 0.5)], section, elements=4)
    scene.pin(right.end)
    scene.add_joint(fb.PinInSlot(left.end, right.start, axis=(0.9, 0.4)))
    scene.add_force(left.node(0.5), (3, -30))
    with pytest.raises(fb.StepError, match="does not return to load factor 1") as caught:
        fb.static(scene, continuation="arc-length")
    path = caught.value.solution
    (limit,) = path.stats.limit_points
    assert f"limit points at {limit:.6g} it has reached {path.load_factor[-1]:.6g}" in str(
        caught.value
    )
    assert path.load_factor.max() == limit
    assert -10.2 < path.load_factor[-1] < -10 < path.load_factor[-2]
    assert path.stats.steps < 150


def pulled(energy):
    """A body on a guide whose spring has this energy, and a load of 2 N."""
    scene, body, _ = guided_body((1, 0), 1.0, 1.0, spring=fb.Spring(strain_energy=energy))
    scene.add_force(body, (2.0, 0))
    return scene


def stretched(energy):
    """A bar of two elements whose normal force is ten times the slope of this energy at 10 eps."""
    section = fb.Section(
        strain_energy=lambda eps, gamma, kappa: energy(10 * eps) + gamma**2 + kappa**2
    )
    scene, bar = clamped_bar((1, 0), section, elements=2, load=(40.0, 0))
    return scene


@pytest.mark.parametrize(
    ("build", "energy", "largest"),
    [
        (pulled, lambda x: 1 - ufl.exp(-(x**2)), 0.4288819),  # exp(-1/2) / sqrt(2)
        (pulled, lambda x: ufl.sqrt(1 + x**2), 0.5),  # a plateau
        (pulled, lambda x: ufl.ln(1 + x**2) / 2, 0.25),
        (stretched, lambda x: x**2 / (1 + x**2), 0.1623798),  # 3 sqrt(3) / 32
    ],
    ids=["exponential", "plateau", "logarithm", "bar"],
)
def test_a_path_on_which_no_force_is_left_ends_with_what_was_computed(build, energy, largest):
    with pytest.raises(fb.StepError, match="leads nowhere: .* no force is left") as caught:
        fb.static(build(energy), continuation="arc-length")
    path = caught.value.solution
    assert path.load_factor.max() == pytest.approx(largest, rel=1e-6)
    assert len(path.t) == path.stats.steps + 1 < 60
    assert path.stats.failure.kind == "off the path"


def test_a_path_that_goes_far_and_carries_more_is_followed_to_its_end():
    scene = pulled(lambda x: ufl.sqrt(1 + x**2) + 1e-6 * x**2)
    path = fb.static(scene, continuation="arc-length")
    assert path.q[-1, 0, 0] == pytest.approx((2 - 1) / 2e-6, rel=1e-6)


def test_a_path_may_end_behind_its_first_limit_point():
    """Half a von Mises truss: EA (1/c - 1/L) sqrt(c^2 - a^2), c^3 = a^2 L."""
    EA, a, h, k = 1e7, 4.0, 1.0, 2.074576271186441
    L = np.hypot(a, h)
    c = (a**2 * L) ** (1 / 3)
    limit = EA * (1 / c - 1 / L) * np.sqrt(c**2 - a**2)
    scene, bar = supported_bar((a, h), fb.Section(EA, EA, 1e9), elements=1, held="x")
    scene.add_force(bar.end, (0.0, -k * limit))
    path = fb.static(scene, 5, continuation="arc-length", stop_at="limit point")
    assert path.load_factor.argmax() == len(path.t) - 2
    assert path.load_factor.max() * k == pytest.approx(1, rel=1e-8)
    assert path.stats.limit_points == [path.load_factor.max()] and path.stats.failure is None
    assert path.critical_points[0].kind == "limit point"
    # Load steps fail there, and the error names the point as what it is.
    with pytest.raises(fb.StepError, match="limit point near load factor 0.482"):
        fb.static(scene, load_steps=5)
    with pytest.raises(fb.SceneError, match='stop_at .*"limit point", with continuation'):
        fb.static(scene, stop_at="limit point")
