"""Closed loops of rigid members: published values, invariants, analyses, and redundant joints."""

import numpy as np
import pytest
import scipy.linalg
from growth import ladder
from jointed import CORNERS, chain, four_bar
from plain_step import assert_balanced
from scenes import FLYING, assert_refused, demo, hinged_body, relative_drift

import fx_beam as fb
from fx_beam.linear.linearisation import linearised

GRAVITY = (0, -9.81)


def largest(values):
    return abs(np.asarray(values)).max()


def trammel():
    """A ladder on two slides: one of them closes the loop."""
    scene = fb.Scene(gravity=GRAVITY)
    bar = scene.add_body((0.5, 0.4), 2.0, 0.3, points={"x": (1, 0), "y": (0, 0.8)})
    scene.add_joint(fb.PinInSlot(fb.GROUND, bar["x"], axis=(1, 0)))
    spring, damper = fb.Spring(20.0, rest=0.1), fb.Damper(0.5)
    slide = fb.PinInSlot(fb.GROUND, bar["y"], axis=(0, 1), spring=spring, damper=damper)
    return scene, bar, scene.add_joint(slide)


def slider_crank():
    """A rod whose end is supported in y: its hinge closes a loop in y only."""
    scene = fb.Scene(gravity=GRAVITY)
    crank, rod = chain(scene, [(0, 0), (0.2, 0.2), (1.0, 0.0)])
    scene.add_joint(fb.Revolute(fb.GROUND, crank["a"]))
    scene.fix(rod["b"], "y")
    return scene, rod, None


def guided():
    """A crank and a rod that push a body along a guide: a prismatic joint closes the loop."""
    scene = fb.Scene(gravity=GRAVITY)
    crank, rod = chain(scene, [(0, 0), (0.2, 0.2), (1.0, 0.1)])
    scene.add_joint(fb.Revolute(fb.GROUND, crank["a"]))
    block = scene.add_body((1.1, 0.1), 0.5, 0.01, points={"pin": (1, 0.1)})
    scene.add_joint(fb.Revolute(rod["b"], block["pin"]))
    slide = fb.Prismatic(fb.GROUND, block.centre, axis=(1, 0.1), spring=fb.Spring(30.0))
    return scene, block, scene.add_joint(slide)


def run(scene, scheme=None, dt=0.01, t_end=0.5):
    return fb.simulate(scene, scheme, dt=dt, t_end=t_end)


# -- Motion ------------------------------------------------------------------------------------


def test_andrews_mechanism_has_the_published_angles_with_orders_two_and_four():
    andrews = demo("andrews")
    for order, coarse, bound in ((2, 500, 2e-4), (4, 200, 1e-6)):
        errors = [
            andrews.audit(*andrews.simulate(n, order))["largest relative error of an angle"]
            for n in (coarse, 2 * coarse)
        ]
        assert errors[1] < bound
        assert errors[0] / errors[1] == pytest.approx(2**order, rel=0.06)


def test_a_driven_linkage_is_where_circles_intersect():
    scene, bars, _ = four_bar(motor=lambda t: 1.5 * t**2)
    solution = run(scene, t_end=2.0)
    assert solution.stats.unknowns == 0
    A, C = solution.position(bars[0]["b"]), np.array(CORNERS[3])
    (rod, rocker), line = (np.hypot(*np.diff(CORNERS, axis=0)[i]) for i in (1, 2)), C - A
    distance = np.hypot(*line.T)
    along = (distance**2 + rod**2 - rocker**2) / (2 * distance)
    across = np.sqrt(rod**2 - along**2)
    unit = line / distance[:, None]
    B = A + along[:, None] * unit + across[:, None] * np.column_stack([-unit[:, 1], unit[:, 0]])
    assert solution.position(bars[1]["b"]) == pytest.approx(B, abs=1e-12)
    assert largest(solution.energy.balance_error) < 1e-12 * solution.energy.work.max()


def test_a_loop_in_flight_with_two_beams_keeps_energy_and_both_momenta():
    scene = fb.Scene()
    bars = chain(scene, [*CORNERS, CORNERS[0]], closed=True)
    scene.add_beam([bars[1]["b"], (3.0, 1.5)], FLYING, elements=2)
    soft = fb.Section(EA=100.0, GA=100.0, EI=1.0, rhoA=0.1, rhoI=0.01)
    scene.add_beam([bars[0].centre, bars[2].centre], soft, elements=2)
    for node in scene.nodes:
        scene.set_velocity(node, (-node.y, node.x), spin=1.0)
    solution = run(scene, dt=0.02, t_end=2.0)
    assert largest(solution.rotation(bars[1].centre)) > 0.5
    assert relative_drift(solution.energy.total) < 2e-12
    assert relative_drift(solution.angular_momentum) < 2e-12
    assert largest(np.ptp(solution.linear_momentum, axis=0)) < 1e-11


@pytest.mark.parametrize(
    ("made", "scheme"),
    [
        *((made, fb.EnergyMomentum()) for made in (four_bar, trammel, slider_crank, guided)),
        (guided, fb.Newmark()),
    ],
)
def test_closed_loops_are_in_balance_with_exact_energy(made, scheme):
    scene, *_ = made()
    assert_balanced(scene, scheme, dt=0.01, t_end=0.1)
    stats = run(scene, scheme, t_end=0.1).stats
    assert stats.newton_iterations < 4 * stats.steps
    if scheme.name == "EnergyMomentum":
        solution = run(scene)
        energy = solution.energy
        assert largest(energy.balance_error) < 1e-11 * energy.kinetic.max()
        # Forces of supports and of joints on the ground change the momentum.
        force = solution.reactions[1:, :, :2].sum(axis=1)
        for joint in scene.joints:
            sides = (joint.a is fb.GROUND) * 1.0 - (joint.b is fb.GROUND) * 1.0
            force = force + sides * solution.joint_forces[1:, joint.number, :2]
        mass = sum(mass for _, mass, _ in scene.masses)
        change = np.diff(solution.linear_momentum, axis=0) / 0.01 - mass * np.array(GRAVITY)
        assert force == pytest.approx(change, abs=1e-8 * largest(change))


def test_initial_velocities_that_open_a_loop_are_refused():
    scene, bars, _ = four_bar()
    scene.set_velocity(bars[0], (-0.45, 0.15), spin=1.0)
    assert_refused("initial velocities violate joint", run, scene)


# -- Statics and small motions -----------------------------------------------------------------


def test_a_linkage_on_a_spring_rests_where_it_was_found_at_rest():
    scene, bars, crank = four_bar(spring=fb.Spring(200.0))
    static = fb.static(scene, load_steps=3)
    assert static.stats.unknowns == 1 and largest(static.rotation(bars[0].centre)) > 0.01
    solution = fb.simulate(scene, dt=0.01, t_end=0.5, start=static)
    assert largest(np.ptp(solution.q, axis=0)) < 1e-9
    angle = static.rotation(bars[0].centre)[-1]
    # The spring's moment does the work of the weights, by differences.
    shift = 1e-6
    held, moved = (
        fb.static(four_bar(motor=lambda t, end=end: end * t)[0], t=1.0, load_steps=1)
        for end in (angle, angle + shift)
    )
    slope = np.diff([s.energy.potential[-1] for s in (held, moved)])[0] / shift
    assert slope == pytest.approx(-200 * angle, rel=1e-4)


def test_the_frequency_of_a_linkage_is_that_of_its_reduced_inertia():
    scene, bars, _ = four_bar(spring=fb.Spring(200.0))
    scene.gravity = None
    modes = fb.modes(scene)
    assert len(modes) == 1
    scene.set_velocity(bars[0].centre, (0, 0), spin=1.0)
    scene.make_velocities_compatible()
    start = run(scene, t_end=0.01)
    inertia = 2 * start.energy.kinetic[0] / start.spin(bars[0].centre)[0] ** 2
    assert modes.angular_frequencies[0] ** 2 == pytest.approx(200 / inertia, rel=1e-9)


def test_the_response_of_a_slide_is_that_of_its_node():
    scene, bar, slide = trammel()
    state = fb.static(scene, load_steps=2)
    slide_value, node = (
        fb.frequency_response(scene, (bar.centre, (1.0, 0.0)), place, [0.5, 1.5], state)
        for place in (slide, bar["y"])
    )
    assert slide_value.component("slide") == pytest.approx(node.component("y"), rel=1e-9)
    assert abs(node.component("y").imag).min() > 0


def plank(end):
    """A body on a hinge, and a second support at its other end."""
    scene, body, _ = hinged_body((0.5, 0.3), 2.0, 0.1, {"a": (0, 0), "b": (2, 0)}, gravity=(0, -10))
    return scene, scene.add_joint(end(fb.GROUND, body["b"]))


def pinned_at_random(seed, factor=1.0):
    """Bodies with pins at random, in loops; an output; derivatives of the equations of the pins."""
    random = np.random.default_rng(seed)
    count = int(random.integers(4, 16))
    loops = int(random.integers(1, max(2, (count - 1) // 2) + 1))
    centres = random.uniform(-1, 1, (count, 2))
    pins = []
    for b in range(count):
        place = random.uniform(-1, 1, 2)
        pins.append((int(random.integers(-1, b)) if b else -1, b, place))
    for _ in range(loops):
        a, b = random.choice(count, 2, replace=False)
        pins.append((int(a), int(b), random.uniform(-1, 1, 2)))
    scene, bodies = fb.Scene(gravity=GRAVITY), []
    for i, centre in enumerate(centres):
        points = {str(k): tuple(pin[2]) for k, pin in enumerate(pins) if i in pin[:2]}
        mass, inertia = 10 ** random.uniform(-1, 1), 10 ** random.uniform(-2, 0)
        bodies.append(scene.add_body(tuple(centre), factor * mass, inertia, points=points))
    order = np.arange(len(pins)) if random.random() < 0.5 else random.permutation(len(pins))
    for k in order:
        ends = (fb.GROUND if i < 0 else bodies[i][str(k)] for i in pins[k][:2])
        scene.add_joint(fb.Revolute(*ends))
    G = np.zeros((len(pins), 2, count, 3))
    for k, (a, b, place) in enumerate(pins):
        for i, sign in ((a, -1), (b, 1)):
            x, y = place - centres[i]
            if i >= 0:
                G[k, :, i] = sign * np.array([(1, 0, -y), (0, 1, x)])
    return scene, {"place": fb.Output("position", bodies[-1][str(count - 1)])}, G


# Pivots of the last ones were zero, by chance or by what was eliminated before them.
@pytest.mark.parametrize("seed", [*range(20), 80, 372, 849])
def test_linkages_of_several_loops_move_unless_a_pin_is_redundant(seed):
    scene, _, G = pinned_at_random(seed)
    pins, _, count, _ = G.shape
    rank = np.linalg.matrix_rank(G.reshape(2 * pins, 3 * count), tol=1e-6)
    if rank < 2 * pins:
        assert_refused("over-constrained", run, scene, dt=0.002, t_end=0.02)
        return
    assert_balanced(scene, dt=0.002, t_end=0.02)


@pytest.mark.parametrize("seed", [80, 372, 849])
def test_linkages_of_several_loops_have_derivatives(seed):
    response = fb.Response(lambda x: pinned_at_random(seed, x[0])[:2], dt=0.002, t_end=0.02)
    places = [response([1.0 + h])[1]["place"] for h in (-2e-3, -1e-3, 1e-3, 2e-3)]
    difference = (8 * (places[2] - places[1]) - (places[3] - places[0])) / 0.012
    response([1.0])
    by_mass = response.jacobian()["place"][..., 0]
    assert by_mass == pytest.approx(difference, rel=1e-7, abs=1e-8 * largest(difference))
    weights = {"place": np.ones_like(difference)}
    assert response.vjp(weights) == pytest.approx([by_mass.sum()], rel=1e-11)


def test_a_plank_on_two_supports_has_their_forces_and_cannot_move():
    scene, roller = plank(lambda a, b: fb.PinInSlot(a, b, axis=(1, 0)))
    for solution in (fb.static(scene, load_steps=1), run(scene, t_end=0.02)):
        assert solution.stats.unknowns == 0
        assert solution.joint(roller).force[-1] == pytest.approx([0, 5, 0], abs=1e-12)
    assert_refused("modes: the scene has no unknowns", fb.modes, scene)
    scene, _ = plank(fb.Revolute)
    assert_refused(r"joint 2, .* joint 3, .*axis=\(1, 0\) for joint 3", run, scene)


# -- Refusals ----------------------------------------------------------------------------------


def parallelogram(third):
    """Two parallel cranks, and a third one on a hinge, on a slide, or none."""
    scene = fb.Scene(gravity=GRAVITY)
    crank = np.array([0.3, 0.9])
    feet = [np.array([x, 0.0]) for x in (0, 2, 1)][: 3 if third else 2]
    points = {str(i): foot + crank for i, foot in enumerate(feet)}
    coupler = scene.add_body((1.3, 1.0), 2.0, 0.4, points=points)
    for i, foot in enumerate(feet):
        bar = scene.add_body(
            foot + crank / 2,
            1.0 if i < 2 else 0.0,
            0.1 if i < 2 else 0.0,
            points={"O": foot, "P": foot + crank},
        )
        scene.add_joint(fb.Revolute(fb.GROUND, bar["O"]))
        if i == 2 and third == "slide":
            scene.add_joint(fb.PinInSlot(bar["P"], coupler[str(i)], axis=crank))
        else:
            scene.add_joint(fb.Revolute(bar["P"], coupler[str(i)]))
    return scene, coupler


def test_a_third_parallel_crank_is_redundant_and_a_slide_mends_it():
    with pytest.raises(fb.SceneError) as refused:
        run(parallelogram("hinge")[0])
    text = str(refused.value)
    assert text.startswith("over-constrained: joint 5, Revolute")
    assert "Rigid" not in text and text.count("Revolute") == 7  # six hinges, one named twice
    assert "1 of them is redundant" in text
    assert "such as a PinInSlot with axis=(0.316, 0.949) for joint 14" in text
    values = []
    for third in (None, "slide"):
        scene, coupler = parallelogram(third)
        values.append(run(scene).position(coupler.centre))
    assert values[1] == pytest.approx(values[0], abs=1e-10)


def ladder_of_two(joint):
    scene = fb.Scene()
    first, second = (
        scene.add_body((0, y), 1.0, 0.1, points={"a": (-1, 0), "b": (1, 0)}) for y in (1, -1)
    )
    for name in "ab":
        scene.add_joint(joint(first[name], second[name]))
    return scene


@pytest.mark.parametrize(
    ("joint", "message"),
    [
        (fb.Revolute, r"joint 4, .*; joint 5, .* 1 of them is redundant.* axis=\(1, 0\) for joint"),
        (fb.Rigid, "over-constrained: .*joint 4, .*joint 5.*Remove one"),
    ],
)
def test_two_joints_between_two_bodies_are_redundant(joint, message):
    assert_refused(message, lambda: run(ladder_of_two(joint)))


@pytest.mark.parametrize("angle", [0.0, 0.7, np.pi / 2, np.pi])
def test_bars_in_line_are_refused_in_any_direction(angle):
    # Along y the closure in x comes first, and has small entries only.
    scene = fb.Scene(gravity=GRAVITY)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    bars = chain(
        scene, [turn @ point for point in [(0, 0), (0.3, 0.4), (1.1, 0.4 + 1e-7), (1.9, 0.4)]]
    )
    scene.add_joint(fb.Revolute(fb.GROUND, bars[0]["a"], motor=lambda t: 0.3 * t**2))
    scene.add_joint(fb.Revolute(fb.GROUND, bars[2]["b"]))
    assert_refused("singular position, such as bars in one line", run, scene)


def test_a_driven_step_that_begins_with_bars_in_line_goes_on():
    scene = fb.Scene()
    bars = chain(scene, [(0, 0), (0, 1), (2, 1), (2, 0)])
    scene.add_joint(fb.Revolute(fb.GROUND, bars[0]["a"], motor=lambda t: -np.pi / 2 * t**3))
    scene.add_joint(fb.Revolute(bars[2]["b"], fb.GROUND))
    solution = run(scene, dt=0.05, t_end=1.1)  # in line at t = 1
    assert solution.stats.halvings == 0
    assert solution.rotation(bars[2].centre) == pytest.approx(solution.rotation(bars[0].centre))
    assert largest(solution.energy.balance_error) < 1e-11 * solution.energy.kinetic.max()


@pytest.mark.parametrize("order", [2, 4])
def test_a_parallelogram_goes_through_its_line_from_any_distance(order):
    # Without forces both cranks turn at a constant rate; the ninth step begins at the distance.
    def turned(start, steps, spin=2.0, dt=0.01):
        crank, coupler = np.array([np.cos(start), np.sin(start)]), np.array([2.0, 0.0])
        scene = fb.Scene()
        bars = chain(scene, [(0, 0), crank, crank + coupler, coupler])
        scene.add_joint(fb.Revolute(fb.GROUND, bars[0]["a"]))
        scene.add_joint(fb.Revolute(bars[2]["b"], fb.GROUND))
        for bar, arm, own in zip(bars, ([0, 0], crank, coupler), (spin, 0.0, spin), strict=True):
            for node in (bar.centre, bar["a"], bar["b"]):
                x, y = crank if own == 0 else np.subtract((node.x, node.y), arm)
                scene.set_velocity(node, (-spin * y, spin * x), spin=own)
        solution = run(scene, fb.EnergyMomentum(order=order), dt, steps * dt)
        return solution, [np.unwrap(solution.rotation(bars[k].centre)) for k in (0, 2)]

    _, (regular, _) = turned(-1.0, 4)
    per_step = regular[-1] / 4
    for distance in (0.0, 1e-3, -1e-5, 1.6e-8, -1e-12):
        solution, angles = turned(distance - 8 * per_step, 12)
        assert solution.stats.halvings == 0
        for angle in angles:
            assert angle == pytest.approx(per_step * np.arange(13), abs=1e-6)
        assert largest(solution.energy.balance_error) < 1e-10 * solution.energy.kinetic[0]


def test_a_linkage_that_comes_to_rest_in_line_may_go_on_in_several_ways():
    scene = fb.Scene()
    bars = chain(scene, [(0, 0), (0, 1), (2, 1), (2, 0)])

    def angle(t):
        return -np.pi / 2 * (3 - 2 * min(t, 1)) * min(t, 1) ** 2

    scene.add_joint(fb.Revolute(fb.GROUND, bars[0]["a"], motor=angle))
    scene.add_joint(fb.Revolute(bars[2]["b"], fb.GROUND))
    with pytest.raises(fb.StepError, match="singular position.* in several ways") as failed:
        run(scene, dt=0.1, t_end=2.0)
    assert "smaller dt" not in str(failed.value)
    assert "Let it not come to rest in this position" in str(failed.value)


def test_modes_of_a_ladder_by_its_sparse_system_are_those_of_full_matrices():
    """Pulled aside: the cells are no parallelograms. Its inertia counts them all."""
    scene, node = ladder(6)
    scene.add_force(node, (30.0, 0.0))
    state = fb.static(scene, load_steps=2)
    assert not state.unstable_modes.any()
    about = linearised(scene, state, "modes")
    K, M = about.K.toarray(), about.M.toarray()
    squares = scipy.linalg.eigvalsh((K + K.T) / 2, M)
    modes = fb.modes(scene, state, n=len(K))
    assert modes.angular_frequencies**2 == pytest.approx(squares, rel=1e-9)
    counted = [about.undamped_modes.count_below(bound) for bound in squares * 1.001]
    assert counted == [*range(1, len(K) + 1)]


def test_a_loop_that_a_motor_leads_past_its_toggle_is_named():
    """Crank and coupler are in line at 1.338 rad, from which the follower cannot go on."""
    crank, coupler, follower, base = 0.25, 0.2, 0.22, 0.4
    start, way = 0.6, 0.8
    pin = crank * np.array([np.cos(start), np.sin(start)])
    apart = np.hypot(*([base, 0] - pin))
    along = (coupler**2 - follower**2 + apart**2) / (2 * apart)
    across = np.sqrt(coupler**2 - along**2) * np.array([pin[1], base - pin[0]]) / apart
    knee = pin + along * ([base, 0] - pin) / apart + across
    places, scene = [(0, 0), pin, knee, (base, 0)], fb.Scene()

    def turn(t):
        return way * np.sin(np.pi * t / 2) ** 2

    bars = [
        scene.add_body(np.add(a, b) / 2, mass=1.0, inertia=0.01, points={"a": a, "b": b})
        for a, b in zip(places, places[1:], strict=False)
    ]
    scene.add_joint(fb.Revolute(fb.GROUND, bars[0]["a"], motor=turn))
    for bar, other in zip(bars, bars[1:], strict=False):
        scene.add_joint(fb.Revolute(bar["b"], other["a"]))
    scene.add_joint(fb.Revolute(bars[2]["b"], fb.GROUND))
    with pytest.raises(fb.StepError, match="in line .a toggle., which no dt passes") as stop:
        fb.simulate(scene, dt=0.01, t_end=1.0)
    toggle = (crank**2 + base**2 - (coupler + follower) ** 2) / (2 * crank * base)
    assert start + turn(stop.value.failure.time) == pytest.approx(np.arccos(toggle), abs=1e-4)
