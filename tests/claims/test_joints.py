"""What joints keep: unknowns, gaps, energy and momenta, and the laws of Newton."""

import jointed
import numpy as np
import pytest
from jointed import BENDING, KINDS, MEMBER, SLIDING, W, drift, momenta, pair, throw, thrown
from scenes import one_bar

import fx_beam as fb


def scale(solution):
    return solution.energy.kinetic.max()


def cross(a, b):
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


# -- Unknowns ----------------------------------------------------------------------------------


@pytest.mark.parametrize("motor", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_a_joint_leaves_no_unknown_but_its_slide(kind, motor):
    motor = motor and "rigid" not in kind
    options = {"motor": lambda t: 0.1 * t**2} if motor else {}
    scene, first, _, joint = pair(kind, **options)
    scene.fix(first.start, "y")
    solution = fb.simulate(scene, dt=0.1, t_end=0.1)
    turns_together = joint.rotation is None or (motor and joint.axis is None)
    slides = kind in SLIDING and not motor
    assert solution.stats.unknowns == 3 * 6 - 1 - (3 if turns_together else 2) + slides


# -- Energy and momenta ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "degree", "inner"),
    [(k, 1, "offset" in k) for k in KINDS] + [(k, 2, False) for k in SLIDING],
)
def test_energy_and_momenta_are_kept_in_free_flight(kind, degree, inner):
    scene, joint = thrown(kind, degree, inner=inner)
    solution = fb.simulate(scene, dt=0.02, t_end=1.0)
    assert drift(solution.energy.total) < 1e-10
    assert drift(solution.linear_momentum) < 1e-10
    assert drift(solution.angular_momentum) < 1e-10
    assert solution.joint(joint).gap.max() < 1e-12
    if kind in SLIDING:
        assert np.ptp(solution.joint(joint).slide) > 1.5  # and the members are 1 long
    assert np.ptp(solution.rotation(joint.b)) > 0.3


@pytest.mark.parametrize("kind", ["revolute with offset", "prismatic with offset"])
def test_gaps_stay_closed_over_10_000_steps_without_stabilisation(kind):
    scene, first, second, joint = pair(kind, spring=fb.Spring(2.0))
    throw(scene, first, second, joint)
    solution = fb.simulate(scene, dt=0.01, t_end=100.0)
    assert solution.stats.steps == 10_000
    assert solution.joint(joint).gap.max() < 1e-11
    assert drift(solution.energy.total) < 1e-9


# -- Which node follows which ------------------------------------------------------------------


def held(place, kind):
    """A pair with its joint's nodes supported, or a joint with the ground as b."""
    if place == "ground as b":
        make, _, data = KINDS[kind]
        scene, beam = one_bar((1, 0), MEMBER, elements=2, gravity=(3, -9.81))
        scene.add_joint(make(beam.start, fb.GROUND, **data))
        return scene
    scene, first, second, _ = pair(kind, gravity=(3, -9.81))
    {
        "b pinned": lambda: scene.pin(second.start),
        "b clamped": lambda: scene.clamp(second.start),
        "a clamped": lambda: scene.clamp(first.end),
        "x of a and y of b": lambda: (scene.fix(first.end, "x"), scene.fix(second.start, "y")),
    }[place]()
    return scene


def row(*kinds, first=(), last=()):
    """Beams of one element, each joined to the start of the one before, some of them supported."""
    scene, beam = one_bar((1, 0), MEMBER, elements=1, gravity=(3, -9.81))
    if first == "slot":
        scene.add_joint(fb.PinInSlot(beam.start, fb.GROUND, axis=(1, 2), offset=(0.1, 0.3)))
    elif first:
        scene.fix(beam.start, *first)
    for kind in kinds:
        make, place, data = KINDS[kind]
        start = np.array([beam.start.x, beam.start.y]) + place
        other = scene.add_beam([start, start + (1, 0.5)], MEMBER, elements=1)
        scene.add_joint(make(beam.start, other.start, **data))
        beam = other
    if last:
        scene.fix(beam.start, *last)
    return scene


def motors():
    """A turning motor that carries a guide with a driven slide, and a free slot on that."""
    scene = fb.Scene()
    a, b, c, d = (scene.add_beam([(0, i), (1, i)], MEMBER, elements=1).start for i in range(4))
    scene.add_joint(fb.Revolute(a, b, offset=(0, 1), motor=lambda t: 2 * t**2))
    scene.add_joint(fb.Prismatic(b, c, axis=(0, 1), motor=lambda t: 3 * t**2))
    hinge = fb.Coordinate(motor=lambda t: -(t**2))
    scene.add_joint(fb.PinInSlot(c, d, axis=(1, 0), offset=(0.3, 1), hinge=hinge))
    return scene


OF_PAIRS = ("b pinned", "b clamped", "a clamped", "x of a and y of b", "ground as b")
ORDERS = {f"{kind}, {place}": (held, place, kind) for kind in BENDING for place in OF_PAIRS}
ORDERS |= {
    "row of slots": (row, "pin in slot", "pin in slot with offset", "prismatic"),
    "row on the ground": (lambda: row("prismatic", "revolute with offset", first="slot"),),
    "row, the last one clamped": (
        lambda: row(
            "rigid with offset", "prismatic with offset", "pin in slot", last=("x", "y", "rotation")
        ),
    ),
    "row, held in y at one end and in x at the other": (
        lambda: row("rigid with offset", "revolute", "pin in slot", first=("y",), last=("x",)),
    ),
    "motors": (motors,),
}


@pytest.mark.parametrize("order", ORDERS)
def test_whichever_node_follows_energy_is_exact_joints_close_and_newton_converges(order):
    build, *arguments = ORDERS[order]
    for scheme in (fb.EnergyMomentum(), fb.GeneralizedAlpha(0.6)):
        scene = build(*arguments)
        tight = fb.NewtonOptions(tolerance=1e-12)
        solution = fb.simulate(scene, scheme, dt=0.05, t_end=0.3, newton=tight)
        assert np.ptp(solution.q, axis=0).max() > 0.03
        assert max(solution.joint(joint).gap.max() for joint in scene.joints) < 1e-13
        # Where a term of the tangent that bends with the joint is a tenth off, some take 5 or 6.
        assert solution.stats.newton_iterations <= 4.5 * solution.stats.steps
        assert solution.stats.halvings == 0
        if scheme.name == "EnergyMomentum":
            assert abs(solution.energy.balance_error).max() < 1e-11 * scale(solution)


# -- Forces of the joints ----------------------------------------------------------------------


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_the_impulse_of_the_joint_is_what_changes_the_momenta_of_a_member(kind, backwards):
    # Backwards, a follows b: the second beam's start is supported, and so retained.
    scene, first, second, joint = pair(kind)
    throw(scene, first, second, joint)
    if backwards:
        scene.prescribe(second.start, rotation=lambda t: (1 + (joint.rotation is not None)) * t)
        scene.velocities.clear()
        scene.make_velocities_compatible()
        for beam in (first, second):
            scene.set_velocity(beam, lambda x, y: (1.0 - y, 2.0 + x), spin=1.0)
    dt = 0.01
    solution = fb.simulate(scene, jointed.UNFITTED, dt=dt, t_end=0.2)
    force = solution.joint(joint).force[1:]
    support = solution.reaction(second.start)[1:]
    for beam, node, sign in ((second, joint.b, 1), (first, joint.a, -1)):
        p = momenta(solution.v, beam)
        linear = p[..., :2].sum(axis=1)
        angular = np.sum(cross(solution.shape(beam), p) + p[..., 2], axis=1)
        x = (solution.position(node)[1:] + solution.position(node)[:-1]) / 2
        moment = sign * force[:, 2]
        if sign < 0:
            rho = solution.position(joint.b) - solution.position(joint.a)
            moment = moment - cross((rho[1:] + rho[:-1]) / 2, force[:, :2])
        else:
            moment = moment + support[:, 2]
        impulse = dt * sign * force[:, :2]
        twist = dt * (cross(x, sign * force[:, :2]) + moment)
        assert abs(np.diff(linear, axis=0) - impulse).max() < 1e-10 * abs(linear).max()
        assert abs(np.diff(angular) - twist).max() < 1e-10 * abs(angular).max()


# -- Accelerations at the start --------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_initial_accelerations_follow_the_joint(kind):
    scene, joint = thrown(kind, spin=2.0, slide=3.0)
    solution = fb.simulate(scene, fb.Newmark(), dt=0.01, t_end=0.01)
    (xa, va, aa), (xb, vb, ab) = (
        (solution.position(n)[0], solution.v[0, n.number], solution.a[0, n.number])
        for n in (joint.a, joint.b)
    )
    rho, spin = xb - xa, va[2]
    gap = (ab - aa)[:2] - aa[2] * (W @ rho) + spin**2 * rho
    if joint.axis is not None:
        rate = joint.axis @ ((vb - va)[:2] - spin * (W @ rho))
        assert rate == pytest.approx(3.0)
        gap -= 2 * spin * rate * (W @ joint.axis)
        gap -= (gap @ joint.axis) * joint.axis
    assert abs(gap).max() < 1e-6


# -- Newmark's family --------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_the_newmark_family_keeps_linear_momentum_with_joints(kind):
    scene, joint = thrown(kind)
    solution = fb.simulate(scene, fb.GeneralizedAlpha(0.6), dt=0.01, t_end=0.5)
    assert drift(solution.linear_momentum) < 1e-10
    assert solution.joint(joint).gap.max() < 1e-12


@pytest.mark.parametrize(
    "scheme", [fb.EnergyMomentum(), fb.GeneralizedAlpha(0.6)], ids=lambda s: s.name
)
def test_schemes_are_of_second_order_with_joints_springs_and_dampers(scheme):
    stout = fb.Section(EA=200.0, GA=200.0, EI=20.0, rhoA=1.0, rhoI=0.1)
    laws = {"spring": fb.Spring(9.0, rest=0.1), "damper": fb.Damper(2.0)}

    def end(dt):
        kind = "prismatic with offset"
        scene, first, second, joint = pair(kind, 1, (0, -9.81), section=stout, **laws)
        scene.add_joint(fb.Revolute(fb.GROUND, first.start, **laws))
        tip = second.end.x, second.end.y
        bob = scene.add_beam([tip, (tip[0] + 0.3, tip[1] + 0.5)], stout, elements=1)
        scene.add_joint(fb.Revolute(second.end, bob.start))
        for beam in (first, second, bob):
            scene.set_velocity(beam, lambda x, y: 1.5 * (W @ (x + 1, y)), spin=1.5)
        solution = fb.simulate(scene, scheme, dt=dt, t_end=0.4)
        return np.append(solution.q[-1].ravel(), solution.slides[-1])

    fine = end(0.0003125)
    errors = [np.linalg.norm(end(dt) - fine) for dt in (0.005, 0.0025)]
    assert np.log2(errors[0] / errors[1]) > 1.9
