"""Units do not matter: the same scene in metres, micrometres, nanometres and others."""

import functools

import ufl

import numpy as np
import pytest
from scenes import clamped_bar, one_bar

import fx_beam as fb


class Units:
    """Units of length [m], time [s] and force [N]; methods turn values in SI into them."""

    def __init__(self, length=1.0, time=1.0, force=1.0):
        self.length, self.time, self.force = length, time, force
        self.mass, self.energy = force * time**2 / length, force * length

    def points(self, *places):
        return [tuple(x / self.length for x in place) for place in places]

    def section(self, EA, GA, EI, rhoA=0.0, rhoI=0.0):
        EI, rhoA = EI / self.force / self.length**2, rhoA / self.mass * self.length
        EA, GA, rhoI = EA / self.force, GA / self.force, rhoI / self.mass / self.length
        return fb.Section(EA=EA, GA=GA, EI=EI, rhoA=rhoA, rhoI=rhoI)

    def forces(self, *components):
        return tuple(x / self.force for x in components)

    def gravity(self):
        return (0.0, -9.81 * self.time**2 / self.length)

    def spring(self, stiffness, rest=0.0):
        return fb.Spring(stiffness * self.length / self.force, rest / self.length)

    def damper(self, viscosity):
        return fb.Damper(viscosity * self.length / self.force / self.time)

    def body(self, scene, mass, inertia, centre, **points):
        places = {name: self.points(place)[0] for name, place in points.items()}
        inertia = inertia / self.mass / self.length**2
        return scene.add_body(self.points(centre)[0], mass / self.mass, inertia, points=places)

    def turning_spring(self, stiffness, rest=0.0):
        return fb.Spring(stiffness / self.energy, rest)

    def turning_damper(self, viscosity):
        return fb.Damper(viscosity / self.energy / self.time)


SI = Units()
UNITS = {
    "nm": Units(length=1e-9),
    "nm, ns, nN": Units(1e-9, 1e-9, 1e-9),
    "km, h, GN": Units(1e3, 3600.0, 1e9),
    "large forces": Units(force=1e24),
}


def cantilever(u):
    section = u.section(1e6, 4e5, 80.0, 1.0, 1e-3)
    scene, beam = clamped_bar(u.points((0, 0), (1, 0)), section, elements=4)
    scene.add_force(beam.end, u.forces(-5.0, 60.0))
    scene.add_moment(beam.end, 20.0 / u.energy)
    scene.add_line_load(beam, (0.0, -3.0 * u.length / u.force))
    return scene


def crank_and_slot(u):
    section = u.section(1e6, 1e6, 1e3, 1.0, 1e-3)
    scene, crank = one_bar(u.points((0, 0), (0.3, 0.2)), section, elements=2, gravity=u.gravity())
    rod = scene.add_beam(u.points((0.3, 0.2), (1.1, 0)), section, elements=2)
    motor = fb.Revolute(fb.GROUND, crank.start, motor=lambda t: 1.5 * (t * u.time) ** 2)
    slot = {"axis": (1, 0), "spring": u.spring(20.0, 0.01), "damper": u.damper(0.5)}
    scene.add_joint(motor)
    scene.add_joint(fb.Revolute(crank.end, rod.start))
    scene.add_joint(fb.PinInSlot(rod.end, fb.GROUND, offset=u.points((0.2, 0.1))[0], **slot))
    scene.add_mass(rod.end, 0.7 / u.mass)
    return scene


def pendulum(u):
    scene = fb.Scene(gravity=u.gravity())
    beam = scene.add_beam(u.points((0, 0), (0, -0.5)), u.section(1e8, 1e8, 1e3), elements=2)
    scene.pin(beam.start)
    scene.add_mass(beam.node(0.5), 0.2 / u.mass)
    scene.add_mass(beam.end, 1.0 / u.mass, 0.01 / u.mass / u.length**2)
    speed = u.time / u.length
    scene.set_velocity(
        beam, lambda x, y: (-1.695 * y * u.length * speed / 0.5, 0.0), spin=1.695 / 0.5 * u.time
    )
    return scene


def braked(u):
    section = u.section(1e4, 1e4, 100.0, 1.0, 0.1)
    scene, arm = one_bar(u.points((0, 0), (1, 0)), section, elements=2, gravity=u.gravity())
    force, speed = u.force, u.length / u.time
    scene.add_drag(
        arm, linear=0.4 * speed * u.length / force, quadratic=0.3 * speed**2 * u.length / force
    )
    scene.add_drag(arm.end, linear=0.4 * speed / force, rotation=0.1 / u.energy / u.time)
    friction = fb.SmoothFriction(0.5 / u.energy, 0.1 * u.time)
    turning = {"spring": u.turning_spring(20.0, 0.1), "damper": u.turning_damper(0.3)}
    scene.add_joint(fb.Revolute(fb.GROUND, arm.start, friction=friction, **turning))
    return scene


def loops_with_slides(u):
    """A four-bar of bodies with a bead on a rod, and a carriage of two sleeves on another rod."""
    scene = fb.Scene(gravity=u.gravity())
    section = u.section(1e4, 1e4, 10.0, 1.0, 1e-3)
    corners, mass = [(0, 0), (0.2, 0.6), (1.1, 0.8), (1.0, 0)], (1.0, 2.0, 3.0)
    bars = [
        u.body(scene, m, 0.1, ((a[0] + b[0]) / 2, (a[1] + b[1]) / 2), a=a, b=b)
        for m, a, b in zip(mass, corners, corners[1:], strict=False)
    ]
    ends = [fb.GROUND, *(bar[end] for bar in bars for end in "ab"), fb.GROUND]
    for a, b in zip(ends[::2], ends[1::2], strict=True):
        scene.add_joint(fb.Revolute(a, b))
    rod = scene.add_beam([bars[1].centre, *u.points((2.65, 1.1))], section, elements=4)
    bead = u.body(scene, 0.5, 0.01, (1.75, 0.92)).centre
    scene.add_joint(fb.Sleeve(rod, bead, spring=u.spring(30.0, np.hypot(1.1, 0.22))))
    rail = scene.add_beam(u.points((3, 0), (5, 0)), section, elements=4)
    scene.clamp(rail.start)
    scene.clamp(rail.end)
    carriage = u.body(scene, 1.0, 0.05, (3.8, 0.1), back=(3.72, 0), front=(4.05, 0))
    scene.add_joint(fb.Sleeve(rail, carriage["back"], spring=u.spring(50.0, 0.72)))
    scene.add_joint(fb.Sleeve(rail, carriage["front"]))
    scene.add_force(carriage.centre, u.forces(3.0, 0.0))
    return scene


def bent(u):
    """A moment bends a beam whose nodes have no rotary inertia: they start in equilibrium."""
    section = u.section(1e5, 2e4, 20.0, 1.0)
    scene, beam = clamped_bar(u.points((0, 0), (1, 0)), section, elements=4, gravity=u.gravity())
    scene.add_moment(beam.end, 2.0 / u.energy)
    return scene


def rubbing(u):
    """A pin whose friction follows its force, on a beam with large moments."""
    section = u.section(1e5, 4e4, 50.0, 1.0, 1e-3)
    scene, arm = one_bar(u.points((0, 0), (1, 0)), section, elements=2, gravity=u.gravity())
    friction = fb.Coulomb(0.3, 50.0 / u.energy, radius=0.1 / u.length)
    scene.add_joint(fb.Revolute(fb.GROUND, arm.start, friction=friction))
    scene.add_moment(arm.end, 3.0 / u.energy)
    return scene


MAKERS = bent, rubbing, cantilever, crank_and_slot, pendulum, braked, loops_with_slides
SCENES = {make.__name__: make for make in MAKERS}


def motion(solution, u):
    """Motion, slides and energy of a solution in SI units, and how it was found."""
    stats = solution.stats
    return (
        solution.q * [u.length, u.length, 1],
        solution.slides * u.length,
        np.column_stack([solution.energy.total, solution.energy.work]) * u.energy,
        np.array([stats.steps, stats.halvings]),
    )


def simulated(scene, u):
    return motion(fb.simulate(scene, dt=0.01 / u.time, t_end=0.3 / u.time), u)


def loaded(continuation):
    def run(scene, u):
        solution = fb.static(scene, load_steps=5, t=0.3 / u.time, continuation=continuation)
        return motion(solution, u)

    return run


RUNS = {
    "load steps": loaded(None),
    "arc length": loaded("arc-length"),
    "simulate": simulated,
    "modes": lambda scene, u: (fb.modes(scene).angular_frequencies / u.time,),
}


# It can turn without support; and friction follows a force.
REFUSED = {("pendulum", "load steps"), ("pendulum", "arc length"), ("rubbing", "arc length")}


@functools.cache
def in_si(name, run):
    return RUNS[run](SCENES[name](SI), SI)


# Units of length, time and force by powers of two, which change no digit: about nm, mm, km, ns and
# years.
POWERS = {
    "nm": Units(length=2.0**-30),
    "mm": Units(length=2.0**-10),
    "km": Units(length=2.0**10),
    "ns": Units(time=2.0**-30),
    "years": Units(time=2.0**25),
    "nm, ns, nN": Units(2.0**-30, 2.0**-30, 2.0**-30),
    "km, years, GN": Units(2.0**10, 2.0**25, 2.0**30),
    "large forces": Units(force=2.0**80),
}


# Closures of loops, and damped eigenvalues, are found by pivots and iterations that compare numbers
# with different units.
ROUNDED = {("braked", "modes"), *(("loops_with_slides", run) for run in RUNS)}


@pytest.mark.parametrize("units", POWERS)
@pytest.mark.parametrize("run", RUNS)
@pytest.mark.parametrize("name", SCENES)
def test_powers_of_two_change_nothing(name, run, units):
    if (name, run) in REFUSED:
        pytest.skip("it is refused")
    u = POWERS[units]
    for computed, expected in zip(RUNS[run](SCENES[name](u), u), in_si(name, run), strict=True):
        most = 1e-10 * abs(expected).max(initial=1e-9) if (name, run) in ROUNDED else 0.0
        assert abs(computed - expected).max(initial=0.0) <= most


def test_forces_that_close_loops_are_the_same_in_all_units():
    def forces_in(u):
        solution = fb.simulate(loops_with_slides(u), dt=5e-3 / u.time, t_end=0.1 / u.time)
        forces = solution.joint_forces[1:] * [u.force, u.force, u.energy]
        return forces, solution.stats.newton_iterations

    expected, iterations = forces_in(SI)
    for u in (*UNITS.values(), Units(1e-3, 1.0, 1.0), Units(force=1e-3)):
        forces, as_many = forces_in(u)
        assert abs(forces - expected).max() < 1e-8 * abs(expected).max()
        assert as_many == pytest.approx(iterations, abs=1)  # but for round-off


def test_a_sleeve_on_a_beam_without_rotary_inertia_has_the_same_rates_and_forces_in_all_units():
    """A body beside a beam carries an arm. The force of a step has the change of the rates."""

    def found(u):
        scene = fb.Scene(gravity=u.gravity())
        bare, inert = (u.section(2e4, 1e4, 30.0, 1.5, rhoI) for rhoI in (0.0, 0.01))
        beam = scene.add_beam(u.points((0, 0), (1, 0)), bare, elements=4, degree=3)
        scene.clamp(beam.start)
        place, centre, tip = u.points((0.5, 0), (0.6, 0.2), (0.8, 0.8))
        inertia = 0.03 / u.mass / u.length**2
        body = scene.add_body(centre, 1.0 / u.mass, inertia, points={"foot": place})
        sleeve = scene.add_joint(fb.Sleeve(beam, body["foot"]))
        scene.add_beam([body.centre, tip], inert, elements=3, degree=3)
        scene.set_velocity(body, (0.3 * u.time / u.length, 0.0))
        scene.make_velocities_compatible()
        solution = fb.simulate(scene, dt=1e-3 / u.time, t_end=0.05 / u.time)
        velocity = solution.velocity(body.centre) * u.length / u.time
        return velocity, solution.joint(sleeve).force * [u.force, u.force, u.energy]

    expected = found(SI)
    for length in (1e-3, 1e3, 1e4):
        for values, others in zip(found(Units(length)), expected, strict=True):
            assert abs(values - others).max() < 1e-6 * abs(others).max()


def guided(u, kind):
    """A rod in a guide on the ground, pushed along: its closures may be angles."""
    section = u.section(1e4, 4e3, 10.0, 1.3, 0.02)
    scene, rod = one_bar(u.points((0, 0), (2, 0)), section, elements=4, gravity=u.gravity())
    scene.add_joint(kind(rod, fb.GROUND, 0.6))
    push = fb.Prismatic(
        fb.GROUND, rod.start, axis=(1, 0), motor=lambda t: 0.3 * (t * u.time) ** 2 / u.length
    )
    scene.add_joint(push)
    return scene


def linkage(u):
    """A loop of rigid bodies: all unknowns are angles."""
    scene = fb.Scene(gravity=u.gravity())
    corners = u.points((0, 0), (0.2, 0.5), (1.2, 0.8), (1.6, 0))
    centres = u.points((0.1, 0.25), (0.7, 0.65), (1.4, 0.4))
    inertia = 0.05 / u.mass / u.length**2
    ends = zip(centres, corners, corners[1:], strict=False)
    bars = [scene.add_body(c, 1.0 / u.mass, inertia, points={"a": a, "b": b}) for c, a, b in ends]
    before = fb.GROUND
    for bar in bars:
        scene.add_joint(fb.Revolute(before, bar["a"]))
        before = bar["b"]
    scene.add_joint(fb.Revolute(fb.GROUND, before))
    return scene


LOOPS = {
    "slider": functools.partial(guided, kind=fb.Slider),
    "sleeve": functools.partial(guided, kind=fb.Sleeve),
    "linkage": linkage,
    "two loops": loops_with_slides,
}


@pytest.mark.parametrize("name", LOOPS)
def test_closed_loops_have_the_same_motion_and_forces_in_all_units(name):
    def found(u):
        scene = LOOPS[name](u)
        solution = fb.simulate(scene, dt=0.01 / u.time, t_end=0.2 / u.time)
        forces = solution.joint_forces * [u.force, u.force, u.energy]
        return *motion(solution, u), forces, fb.modes(scene).angular_frequencies / u.time

    expected = found(SI)
    for u in UNITS.values():
        for values, others in zip(found(u), expected, strict=True):
            assert abs(values - others).max(initial=0.0) < 1e-6 * abs(others).max(initial=1e-9)


def test_a_law_that_softens_beyond_its_use_is_accepted_in_all_units():
    for u in UNITS.values():
        EI = 10.0 / u.force / u.length**2
        steepest = 0.5 * u.length  # a curvature of 0.5 / m

        def energy(eps, gamma, kappa, EI=EI, steepest=steepest):
            return 0.5 * EI * kappa**2 * (1 - 0.5 * (kappa / steepest) ** 2) + eps**2 + gamma**2

        assert fb.Section(strain_energy=energy).strain_energy is energy


# -- Refusals ------------------------------------------------------------------------------------


SOME_UNITS = pytest.mark.parametrize("u", [UNITS["nm"], UNITS["large forces"]], ids=["nm", "GN"])


def refusal(run, scene):
    with pytest.raises((fb.SceneError, fb.StepError)) as error:
        run(scene)
    return str(error.value)


@SOME_UNITS
def test_a_scene_that_can_move_is_refused_in_all_units(u):
    scene, beam = one_bar(u.points((1, 1), (3, 1)), u.section(1e6, 4e5, 80.0), elements=1)
    scene.fix(beam.start, "x", "y")
    pin = f"{1 / u.length:.4g}"
    wanted = f"beam 'beam 1' can rotate about ({pin}, {pin}) as a rigid body"
    assert wanted in refusal(fb.static, scene)
    assert wanted in refusal(lambda scene: fb.simulate(scene, dt=1.0, t_end=1.0), scene)


@SOME_UNITS
def test_a_tangent_that_is_singular_is_told_so_in_all_units(u):
    # Statics settles what virtual works do not hold; motions leave scenes with them alone.
    scene = fb.Scene()
    scene.add_beam(u.points((1, 1), (3, 1)), u.section(1e6, 4e5, 80.0), elements=1)
    push = 2.0 / u.force
    scene.add_virtual_work(lambda step: push * step.virtual_psi)
    assert "can move along (1, 0) as a rigid body" in refusal(fb.static, scene)
    run = functools.partial(fb.simulate, dt=1.0, t_end=1.0)
    assert "the tangent is singular" in refusal(run, scene)


@SOME_UNITS
def test_velocities_that_differ_at_a_node_are_refused_in_all_units(u):
    section = u.section(1e6, 4e5, 80.0, 1.0, 1e-2)
    scene, first = one_bar(u.points((0, 0), (1, 0)), section, elements=1)
    second = scene.add_beam([first.end, *u.points((2, 0))], section, elements=1)
    for beam, speed in ((first, 1.0), (second, 1.001)):
        scene.set_velocity(beam, (0.0, speed * u.time / u.length), spin=1.0 * u.time)
    assert "two initial velocities" in refusal(
        lambda scene: fb.simulate(scene, dt=0.01 / u.time, t_end=0.01 / u.time), scene
    )


def with_moments(u, size):
    """A cantilever under moments without a potential.

    They grow with the deflection beside them, and nothing gives that back.
    """
    section = u.section(1e6, 4e5, 80.0, 1.0, 1e-2)
    scene, beam = clamped_bar(u.points((0, 0), (1, 0)), section, elements=2)
    per_length = size / u.force * u.length

    def moment(step):
        return per_length * step.u[1] * step.virtual_psi

    scene.add_virtual_work(moment)
    return scene


@SOME_UNITS
def test_a_moment_without_a_potential_is_seen_by_modes_in_all_units(u):
    # `modes` has complex roots for it, and derivatives of modes, which have none, refuse it.
    run = fb.ModalResponse(lambda x: with_moments(u, 1e-3 * x[0]))
    assert "the stiffness is not symmetric" in refusal(run, [1.0])
    expected, roots = (fb.modes(with_moments(it, 1e3)).eigenvalues / it.time for it in (SI, u))
    assert roots == pytest.approx(expected, rel=1e-7)
    assert abs(expected.real).max() > 1.0  # it matters


# -- Linear systems --------------------------------------------------------------------------------


def stiffening(u, damped=False):
    """A beam whose bending stiffness rises with the curvature; or one that damps."""
    mass = {"rhoA": 1.0 / u.mass * u.length, "rhoI": 1e-3 / u.mass / u.length}
    values = 1e5 / u.force, 4e4 / u.force, 50.0 / u.force / u.length**2, 1 / u.length**2
    # Numbers that one form serves in all units.
    EA, GA, EI, more = map(fb.Parameter, ("EA", "GA", "EI", "more"), values)

    def energy(eps, gamma, kappa):
        return (EA * eps**2 + GA * gamma**2 + EI * (kappa**2 + more * kappa**4)) / 2

    scene = fb.Scene(gravity=u.gravity())
    section = fb.Section(strain_energy=energy, **mass)
    if damped:
        section = fb.Section(*values[:3], **mass, retardation=1e-3 / u.time)
    beam = scene.add_beam(u.points((0, 0), (1, 0)), section, elements=2)
    scene.clamp(beam.start)
    return scene, beam


def of_natural_strain(u):
    scene, beam = stiffening(u)
    scene.add_natural_strain(beam, curvature=fb.Input("input"))
    return scene, 0.3 * u.length


def of_parameter(u):
    """The stiffness of a spring is a root."""
    scene, beam = stiffening(u)
    root = fb.Parameter("root", fb.Input("input"))
    spring = fb.Spring(0.0, 0.2 / u.length, strain_energy=lambda x: ufl.sqrt(root) * x**2 / 2)
    scene.add_force_between(beam.end, u.points((1, 1))[0], spring=spring)
    return scene, 900.0 * (u.length / u.force) ** 2


@pytest.mark.parametrize("make", [of_natural_strain, of_parameter])
def test_inputs_inside_move_equilibria_as_far_in_all_units(make):
    """By the linear system of a motion, for an input that is as large again."""

    def moved(u):
        scene, value = make(u)
        motion = fb.Motion(scene, dt=0.01 / u.time)
        for _ in range(3):
            motion.step({"input": value})
        system = fb.linearise(scene, motion.state, inputs=["input"])
        size, unit = len(system.A) // 2, [1 / u.length, 1 / u.length, 1]
        unit = np.tile(unit, size // 3)
        K = system.A[size:, :size] / unit[:, None] * unit
        return np.linalg.solve(K, system.B[size:, 0] / unit * value)

    expected = moved(SI)
    for u in (*UNITS.values(), *POWERS.values()):
        assert abs(moved(u) - expected).max() < 1e-8 * abs(expected).max()


def test_a_natural_strain_that_changes_has_the_same_roots_in_all_units():
    def roots(u):
        scene, beam = stiffening(u, damped=True)
        scene.add_natural_strain(beam, curvature=lambda t: 0.1 * np.sin(7 * t * u.time) * u.length)
        solution = fb.simulate(scene, dt=0.01 / u.time, t_end=0.1 / u.time)
        return np.sort_complex(np.linalg.eigvals(fb.linearise(scene, solution).A)) / u.time

    expected = roots(SI)
    for u in (*UNITS.values(), *POWERS.values()):
        assert abs(roots(u) / expected - 1).max() < 1e-7
