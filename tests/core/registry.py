"""Small scenes, one for each law, joint, load, contact and material: `SCENES`.

Each is a function of nine numbers x, all 1, which scale its data; derivatives are taken by them.
The files beside this one check invariants over all of them: a new feature adds a scene here.
"""

from collections.abc import Callable
from dataclasses import dataclass

import ufl

import numpy as np
from scenes import clamped_bar, with_variables, zener_energy, zener_flow

import fx_beam as fb

ONES = np.ones(9)
GRAVITY = (0.0, -9.81)
DATA = {"EA": 1e4, "GA": 1e4, "EI": 100.0, "rhoA": 1.0, "rhoI": 0.1}


@dataclass(frozen=True)
class Case:
    """A scene, and what holds for it."""

    name: str
    build: Callable  # of x: the scene
    scheme: Callable = fb.EnergyMomentum
    dt: float = 0.01
    steps: int = 20
    free: bool = False  # nothing acts from outside: both momenta are constant

    def simulate(self, x=ONES, **options):
        """Its motion."""
        options = {"dt": self.dt, "t_end": self.steps * self.dt} | options
        scene = options.pop("scene", None) or self.build(x)
        return fb.simulate(scene, self.scheme(), **options)


SCENES: dict[str, Case] = {}


def case(**facts):
    """Enter a scene into `SCENES` by the name of its function."""

    def enter(build):
        name = build.__name__.replace("_", " ")
        SCENES[name] = Case(name, build, **facts)
        return build

    return enter


def section(x, **data):
    """A section whose five data follow x[0] to x[4]."""
    values = DATA | data
    names = ("EA", "GA", "EI", "rhoA", "rhoI")
    return fb.Section(**values | {name: values[name] * x[i] for i, name in enumerate(names)})


def arm(x, scene=None, points=((0, 0), (1, 0.3)), elements=2, material=None, **options):
    """A beam that swings about its start, which turns at 2 rad/s; x[5] moves its end."""
    scene = scene or fb.Scene(gravity=GRAVITY)
    points = [points[0], (points[1][0], points[1][1] * x[5])]
    beam = scene.add_beam(points, material or section(x), elements, **options)
    scene.set_velocity(beam, lambda X, Y: (-2 * x[6] * Y, 2 * x[6] * X), spin=2.0 * x[6])
    return scene, beam


def swing(x, **options):
    """The arm on a pin."""
    scene, beam = arm(x, **options)
    scene.pin(beam.start)
    return scene, beam


# -- Members and materials -------------------------------------------------------------------------


@case(free=True)
def free_beam(x):
    return arm(x, fb.Scene())[0]


@case()
def pinned_beam(x):
    return swing(x)[0]


@case()
def curved_tapered_beam(x):
    scene = fb.Scene(gravity=GRAVITY)
    curve = fb.arc((0, 0), (0.5, 0.2 * x[5]), (1, 0))
    taper = fb.Section(**DATA | {"EI": lambda f: 100 * x[2] * (1 - 0.5 * f)})
    beam = scene.add_beam(curve, taper, elements=2, degree=2)
    scene.clamp(beam.start)
    return scene


@case()
def spline_of_degree_three(x):
    scene = fb.Scene(gravity=GRAVITY)
    curve = fb.spline([(0, 0), (0.5, 0.2 * x[5]), (1, 0.1)])
    scene.clamp(scene.add_beam(curve, section(x), elements=1, degree=3).start)
    return scene


@case()
def beams_with_an_offset(x):
    scene, deck = swing(x)
    rib = scene.add_beam(deck.nodes, section(x), elements=2, offset=-0.2 * x[7])
    curve = fb.arc((1, 0.3 * x[5]), (1.2, 0.5), (1.5, 0.6))
    edge = scene.add_beam(curve, section(x), elements=2, offset=0.1 * x[8])
    scene.add_joint(fb.Rigid(deck.end, edge.start))
    for beam in (rib, edge):
        scene.set_velocity(beam, lambda X, Y: (-2 * x[6] * Y, 2 * x[6] * X), spin=2.0 * x[6])
    return scene


@case()
def mesh_of_pinned_bars(x):
    scene = fb.Scene(gravity=GRAVITY)
    points = [(0, 0), (1, 0), (0.5, 0.8 * x[5]), (1.5, 0.8)]
    cells = [(0, 1), (2, 0), (1, 2), (2, 3), (3, 1)]
    bars = {"chord": section(x), "web": section(x, EA=5e3)}
    tags = ["chord", "web", "web", "chord", "web"]
    beams = scene.add_mesh(points, cells, bars, [1, 2, 1, 1, 1], joints="pin", tags=tags)
    scene.pin(beams.nodes[0])
    scene.fix(beams.nodes[1], "y")
    return scene


@case()
def material_of_ones_own(x):
    k = fb.Parameter("k", lambda t: 50 * x[2] * (1 + 2 * t))

    def energy(eps, gamma, kappa):
        return 5e3 * (eps**2 + gamma**2) + 2e6 * eps**4 + k * kappa**2 + 20 * kappa**4

    return swing(x, material=fb.Section(strain_energy=energy, rhoA=x[3], rhoI=0.1 * x[4]))[0]


@case()
def retarded_material(x):
    return swing(x, material=section(x, retardation=(1e-3 * x[7], 2e-3, 3e-3)))[0]


@case()
def material_with_a_memory(x):
    mass = {"rhoA": x[3], "rhoI": 0.1 * x[4]}
    return swing(x, material=with_variables(zener_energy, zener_flow, **mass))[0]


@case()
def rigid_bodies(x):
    scene = fb.Scene(gravity=GRAVITY)
    points = {"hook": (0.2 * x[5], 0.1)}
    body = scene.add_body((0, 0), mass=2.0 * x[3], inertia=0.3 * x[4], points=points)
    scene.pin(body.points["hook"])
    return scene


@case()
def lumped_mass_on_massless_beam(x):
    scene = fb.Scene(gravity=GRAVITY)
    material = fb.Section(EA=1e4 * x[0], GA=1e4, EI=100.0 * x[2])
    beam = scene.add_beam([(0, 0), (1, 0.3 * x[5])], material, elements=1)
    scene.pin(beam.start)
    scene.add_mass(beam.end, 2.0 * x[3], inertia=0.1 * x[4])
    return scene


# -- Loads -----------------------------------------------------------------------------------------


@case()
def dead_loads(x):
    scene, beam = swing(x)
    scene.add_force(beam.end, lambda t: (3 * x[7] * np.sin(3 * t), 1 + t))
    scene.add_moment(beam.end, lambda t: 2.0 * x[8] * t)
    scene.add_line_load(beam, lambda t: (0.0, x[7] * (1 + t)))
    return scene


@case()
def follower_force(x):
    scene, beam = swing(x)
    scene.add_force(beam.end, lambda t: (x[7], 20 * x[8] * t), follower=True)
    return scene


@case()
def drag(x):
    scene, beam = swing(x)
    scene.add_drag(beam, linear=(0.3 * x[7], 0.2 * x[8]), quadratic=0.2 * x[8], rotation=0.1)
    scene.add_drag(beam.end, linear=0.3, quadratic=0.2, rotation=0.1 * x[7])
    return scene


@case()
def rayleigh_damping(x):
    taper = fb.Section(**DATA | {"rhoA": lambda f: x[3] * (1 - 0.3 * f)})
    scene, beam = swing(x, material=taper)
    scene.add_mass(beam.end, 0.5, 0.03 * x[6])
    scene.add_drag(beam, linear=0.1)
    scene.add_damping(0.4 * x[7], 1e-3 * x[8])
    scene.add_damping(mass=0.2)
    return scene


@case()
def line_load_that_travels(x):
    scene, beam = swing(x)
    wave = lambda s, t: (0.0, 5 * x[7] * np.sin(4 * s - 30 * x[8] * t))  # noqa: E731
    scene.add_line_load(beam, wave, of="arc length and time")
    return scene


@case()
def natural_strains(x):
    """Also in the reference, and with loads along the arc, at all places at once or one by one."""
    scene, beam = clamped_bar((1, 0), section(x), 2, gravity=GRAVITY)
    heat = fb.thermal(1e-5, lambda f, t: 100.0 * t * f * x[8])
    scene.add_natural_strain(beam, axial=heat, curvature=lambda t: 0.5 * x[7] * t)
    scene.add_natural_strain(beam, axial=1e-3 * x[8], curvature=lambda f: 0.1 * x[7] * f)
    scene.add_line_load(beam, lambda s: (x[7] * s, x[8] * np.sin(s)), of="arc length")
    scene.add_line_load(beam, lambda s: (x[7] * float(s), x[8]), of="arc length")
    for load in (
        lambda s, t: (x[7] * s * t, np.sin(s * x[8])),
        lambda s, t: (x[7] * t * float(s), x[8]),
    ):
        scene.add_line_load(beam, load, of="arc length and time")
    return scene


@case()
def virtual_work_with_a_parameter(x):
    scene, beam = swing(x)
    pull = fb.Parameter("pull", lambda t: 100.0 * x[7] * (1 + t))
    scene.add_virtual_work(lambda step: -pull * ufl.dot(step.u, step.virtual_u), beam)
    return scene


@case()
def prescribed_motion(x):
    scene = fb.Scene(gravity=GRAVITY)
    beam = scene.add_beam([(0, 0), (1, 0.3 * x[5])], section(x), 2)
    scene.pin(beam.start)
    scene.prescribe(beam.end, y=lambda t: 3 * x[7] * t**2)
    return scene


# -- Joints ----------------------------------------------------------------------------------------


def hung(x, make, place=(0.0, 0.0), turn=0.0, base=None, **data):
    """A second beam on the swinging arm, by a joint, where it turns faster; x[8] moves its end."""
    scene, first = base or swing(x)
    start = np.array([first.end.x, first.end.y]) + place
    second = scene.add_beam([start, start + (0.8, -0.6 * x[8])], section(x), 2)
    scene.add_joint(make(first.end, second.start, **data))
    W, spin = np.array([[0, -1], [1, 0]]), 2.0 * x[6]

    def velocity(*X):
        return W @ (spin * np.array(X) + turn * (X - start))

    scene.set_velocity(second, velocity, spin=spin + turn)
    return scene


@case()
def rigid_joint_with_offset(x):
    return hung(x, fb.Rigid, place=(0.2, 0.1), offset=(0.2, 0.1))


@case()
def revolute_with_spring_and_damper(x):
    return hung(x, fb.Revolute, spring=fb.Spring(5 * x[7], rest=0.2), damper=fb.Damper(0.3))


@case()
def revolute_with_offset_motor(x):
    motor = {"motor": lambda t: 2 * x[7] * t**2, "offset": (0.2, 0.1)}
    return hung(x, fb.Revolute, place=(0.2, 0.1), **motor)


@case()
def prismatic_with_laws(x):
    options = {
        "axis": (0.6, 0.8),
        "offset": (0.2, 0.1),
        "spring": fb.Spring(strain_energy=lambda d: 30 * d**2 + 5 * d**4),
        "damper": fb.Damper(law=lambda rate: 0.7 * abs(rate) * rate),
    }
    return hung(x, fb.Prismatic, place=(0.26, 0.18), **options)


@case()
def pin_in_slot_with_friction(x):
    hinge = fb.Coordinate(spring=fb.Spring(10.0))
    friction = fb.SmoothFriction(0.5 * x[7], speed=0.1)
    return hung(x, fb.PinInSlot, axis=(1.0, 0.0), hinge=hinge, friction=friction)


@case(dt=5e-3)
def friction_that_follows_the_joint_force(x):
    return hung(x, fb.Revolute, friction=fb.Coulomb(0.3 * x[7], stiffness=50.0, radius=0.1))


@case(dt=2e-3)
def stop_of_a_joint(x):
    stop = fb.Stop(None, 0.05, stiffness=20.0 * x[7], restitution=0.5, speed=0.1)
    return hung(x, fb.Revolute, turn=6.0, stop=stop)


@case()
def closed_loop(x):
    scene = fb.Scene(gravity=GRAVITY)
    corners = [(0, 0), (0.3 * x[5], 1.0), (1.5, 1.2), (1.4, 0)]
    bars = [
        scene.add_beam([a, b], section(x), 2) for a, b in zip(corners, corners[1:], strict=False)
    ]
    scene.pin(bars[0].start)
    for before, after in zip(bars, bars[1:], strict=False):
        scene.add_joint(fb.Revolute(before.end, after.start))
    scene.pin(bars[-1].end)
    scene.add_moment(bars[0].start, lambda t: -20 * x[7] * t)
    return scene


def on_a_rod(x, make, **options):
    """A bar that slides along a swinging rod of four elements."""
    scene, rod = swing(x, elements=4)
    rest = rod.node(0.25)
    bar = scene.add_beam([(rest.x, rest.y), (rest.x, rest.y + 0.4)], section(x), 1)
    scene.add_mass(bar.end, 0.5 * x[7])
    scene.add_joint(make(rod, bar.start, fraction=0.25, **options))
    scene.set_velocity(bar, (0.5, 0.0))
    scene.make_velocities_compatible()
    return scene


@case()
def slider_on_a_beam(x):
    return on_a_rod(x, fb.Slider, spring=fb.Spring(20.0 * x[8], rest=0.2))


@case()
def sleeve_on_a_beam(x):
    return on_a_rod(x, fb.Sleeve, damper=fb.Damper(0.5 * x[8]))


@case()
def many_bodies_that_slide_on_a_beam(x):
    """So many that what slides is among the unknowns of the beam."""
    scene, rod = swing(x, elements=8)
    for k in range(8):
        place = rod.node(k / 8 + 0.125)
        body = scene.add_body((place.x, place.y), 0.1 * x[6], 0.02 * x[8]).centre
        make = fb.Sleeve if k % 3 == 1 else fb.Slider
        spring = fb.Spring(50.0 * x[7], rest=rod.length * (k + 0.9) / 8)
        scene.add_joint(make(rod, body, spring=spring))
    scene.make_velocities_compatible()
    return scene


@case()
def sleeve_on_the_ground(x):
    scene = fb.Scene(gravity=(0.5, -9.81 * x[5]))
    rod = scene.add_beam([(0, 0), (1, 0.3)], section(x), 4)
    spring = fb.Spring(20.0 * x[7], rest=0.4)
    scene.add_joint(fb.Sleeve(rod, fb.GROUND, fraction=0.6, spring=spring))
    tip = scene.add_body((1, 0.3), 0.5 * x[6], 0.02 * x[8])
    scene.add_joint(fb.Rigid(rod.end, tip.centre))
    return scene


@case()
def body_that_slides_on_a_sliding_bar(x):
    scene = on_a_rod(x, fb.Sleeve, friction=fb.SmoothFriction(0.5 * x[8], 0.5))
    bar = scene.beams[1]
    place = (bar.start.x, (bar.start.y + bar.end.y) / 2)
    body = scene.add_body(place, mass=0.2 * x[3], inertia=0.01)
    scene.add_joint(fb.Slider(bar, body.centre, spring=fb.Spring(100.0, rest=0.2)))
    return scene


@case()
def sleeve_on_an_arc(x):
    """It starts at a node of the arc, the shape of which follows numbers."""
    scene = fb.Scene(gravity=GRAVITY)
    curve = fb.arc((0, 0), (1, 0.3 * x[5]), (2 * x[8], 0))
    taper = fb.Section(**DATA | {"EI": lambda f: 100 * x[2] * (1 - 0.5 * f)})
    rod = scene.add_beam(curve, taper, elements=4, degree=2)
    scene.pin(rod.start)
    start = rod.nodes[2]
    bead = scene.add_body((start.x, start.y), mass=0.8 * x[3], inertia=0.05)
    scene.add_joint(fb.Sleeve(rod, bead.centre, spring=fb.Spring(40.0 * x[7], rest=1.0)))
    scene.set_velocity(bead, (8.0 * x[6], 1.0), spin=1.0)
    scene.make_velocities_compatible()
    return scene


@case(dt=2e-3)
def slider_with_friction_that_follows_its_force(x):
    return on_a_rod(x, fb.Slider, friction=fb.Coulomb(0.3 * x[8], 2000.0))


@case()
def slide_with_friction_that_follows_its_force(x):
    scene = fb.Scene(gravity=GRAVITY)
    arm = scene.add_body((0.4, 0), x[3], 0.2 * x[4], points={"pin": (0, 0)})
    block = scene.add_body((0.5, 0), 0.5, 0.01)
    scene.add_joint(fb.Revolute(fb.GROUND, arm["pin"]))
    friction = fb.Coulomb(0.3 * x[7], 300.0)
    scene.add_joint(fb.Prismatic(arm.centre, block.centre, axis=(1, 0), friction=friction))
    return scene


@case()
def motor_of_a_slider(x):
    """It moves a beam along a bridge, and a body slides along that beam."""
    scene = fb.Scene(gravity=GRAVITY)
    bridge = scene.add_beam([(0, 0.2 * x[8]), (4 * x[5], 0)], section(x), elements=8)
    scene.pin(bridge.start)
    scene.fix(bridge.end, "y")
    place = np.array([0.8 * x[5], 0.16 * x[8]])
    rod = scene.add_beam([place, place + (0.5, -x[5])], section(x), elements=4)
    scene.add_joint(fb.Sleeve(bridge, rod.start, motor=lambda t: 2 * t + x[7] * t * t))
    bead = scene.add_body(place + (0.1, -0.2 * x[5]), mass=0.3, inertia=0.01)
    scene.add_joint(fb.Slider(rod, bead.centre))
    scene.set_velocity(rod, (2.0, 0.0))
    scene.make_velocities_compatible()
    return scene


@case()
def sleeve_beside_a_hinge_with_a_motor(x):
    """The rotation where both are is the sum of two."""
    scene = fb.Scene(gravity=GRAVITY)
    hub = scene.add_body((0, 0), 2.0, 0.5 * x[7])
    scene.add_joint(fb.Revolute(fb.GROUND, hub.centre))
    rod = scene.add_beam([(0, 0), (3, 0)], section(x), elements=6)
    scene.add_joint(fb.Revolute(hub.centre, rod.start, motor=lambda t: x[8] * t * t))
    bead = scene.add_beam([(0.2, 0), (0.2, 0.3)], section(x), elements=1)
    scene.add_joint(fb.Sleeve(rod, bead.start))
    for turning in (rod, bead):
        scene.set_velocity(turning, lambda X, Y: (-2 * Y, 2 * X), spin=2.0)
    scene.set_velocity(hub, spin=2.0)
    scene.make_velocities_compatible()
    return scene


def wheels_on_a_carrier(x, **laws):
    """A sun and a planet on a free carrier, which a flexible arm has; ratios follow x[8]."""
    scene, beam = arm(x, fb.Scene())
    end = np.array([beam.end.x, beam.end.y])
    points = {"sun": (0, 0), "planet": end}
    carrier = scene.add_body(0.5 * end, 2.0 * x[7], 0.3, points | {"arm": beam.start})
    wheels = [scene.add_body(place, 0.5, 0.05 * x[3]).centre for place in points.values()]
    names = zip(points, wheels, strict=True)
    joints = [scene.add_joint(fb.Revolute(carrier[name], wheel)) for name, wheel in names]
    gear = scene.add_joint(fb.Gear(*joints, ratio=-1.5 * x[8], **laws))
    assert isinstance(gear, fb.Gear)
    scene.set_velocity(wheels[0], spin=9.0)
    scene.make_velocities_compatible()
    return scene


@case(free=True, dt=0.05)
def planetary_gear(x):
    return wheels_on_a_carrier(x)


@case(free=True)
def gear_with_play_and_losses(x):
    stop = fb.Stop(-0.02, 0.02 * x[6], 300.0 * x[7], restitution=0.5, speed=0.1)
    laws = {"spring": fb.Spring(20.0 * x[5]), "damper": fb.Damper(0.01)}
    return wheels_on_a_carrier(x, stop=stop, friction=fb.SmoothFriction(0.1, 0.5), **laws)


@case(dt=0.02)
def rack_and_gears_that_a_motor_drives(x):
    """A pinion on a cart, on a rack along the ground, behind two gears; a pole stands on it."""
    scene = fb.Scene(gravity=GRAVITY)
    cart = scene.add_body((0, 0), 3.0 * x[3], 0.4, {"axle": (0.1, 0), "motor": (-0.1, 0.1)})
    rail = scene.add_joint(fb.Prismatic(fb.GROUND, cart.centre, axis=(1, 0.1 * x[5])))
    places = (0.1, 0), (-0.1, 0.1)
    pinion, rotor = (scene.add_body(place, 0.2, 0.01 * x[4]).centre for place in places)
    axle = scene.add_joint(fb.Revolute(cart["axle"], pinion))
    shaft = scene.add_joint(fb.Revolute(cart["motor"], rotor, motor=lambda t: 4 * x[6] * t * t))
    scene.add_joint(fb.Rack(axle, rail, radius=-0.2 * x[8]))
    scene.add_joint(fb.Gear(shaft, axle, ratio=-0.5 * x[7]))
    pole = scene.add_beam([(0, 0), (0.1, 1)], section(x), 2)
    scene.add_joint(fb.Revolute(cart.centre, pole.start))
    return scene


@case()
def force_between_points(x):
    scene, beam = swing(x)
    pull = {"spring": fb.Spring(30 * x[7], rest=0.3), "damper": fb.Damper(0.1 * x[8])}
    scene.add_force_between(
        beam.end, (2 * x[8], 0.5), force=lambda r, rate, t: 2 * ufl.sin(t) / r, **pull
    )
    return scene


@case()
def springs_dampers_and_a_stop_to_the_ground(x):
    scene, beam = arm(x)
    laws = {"x": fb.Spring(200 * x[7]), "y": [fb.Spring(300 * x[8]), fb.Damper(5 * x[7])]}
    held = scene.add_spring(beam.start, **laws, axis=(1, 0.5))
    assert isinstance(held, fb.GroundSprings) and isinstance(held.x, fb.GroundSpring)
    scene.add_spring(beam.start, rotation=fb.Spring(20 * x[7], 0.1 * x[8]))
    scene.add_spring(beam.end, y=fb.Stop(-0.1, None, 1e4 * x[8], 0.5, 0.05))
    return scene


@case()
def curved_beam_on_a_bed(x):
    scene = fb.Scene(gravity=GRAVITY)
    curve = fb.arc((0, 0), (0.5, 0.2 * x[5]), (1, 0))
    beam = scene.add_beam(curve, section(x), elements=2, degree=2)
    bed = scene.add_bed(beam, normal=100 * x[7], tangential=50 * x[8])
    assert isinstance(bed, fb.Bed)
    return scene


@case()
def loads_inside_elements(x):
    scene, beam = swing(x)
    place = beam.at(0.3)
    assert isinstance(place, fb.BeamPlace)
    scene.add_force(place, lambda t: (3 * x[7] * t, -2.0))
    scene.add_moment(beam.at(0.7), x[8])
    scene.add_line_load(beam, lambda t: (0, -10 * x[7] * t), between=(0.2, 0.65))
    scene.add_line_load(beam, [(0, -5 * x[8]), (3, 2)], of="projected length", between=(0.1, 0.9))
    return scene


@case()
def shaken_base_in_gravity_that_changes(x):
    scene, beam = swing(x, scene=fb.Scene(gravity=lambda t: (x[7] * np.sin(5 * t), -9.81)))
    scene.add_mass(beam.end, 0.5 * x[8], 0.01)
    record = [0.0, 0.05, 0.12, 0.12, 0.3], [30.0 * x[7], 10 * x[8], -50.0, 20.0, 2.0]
    shaking = scene.shake(x=record, y=lambda t: 4 * x[8] * np.cos(20 * t))
    assert isinstance(shaking, fb.Shaking)
    return scene


@case()
def pressure_on_a_part(x):
    scene, beam = swing(x, elements=3)
    scene.add_line_load(beam, lambda t: 20 * x[7] * (1 - 3 * t), follower=True)
    part = beam.s[1:3].tolist()
    scene.add_line_load(beam, -10.0 * x[8], between=part, follower=True)
    return scene


@case()
def winch_on_a_rope_over_pulleys(x):
    scene, beam = swing(x)
    points = [(2, 0.5), beam.end, (1.7 * x[8], 0.9), (1.2, 1.1), beam.node(0.5)]
    length = {"length": lambda t: 3.0 * x[7] - 0.5 * t, "damper": fb.Damper(0.1 * x[8])}
    scene.add_rope(points, spring=fb.Spring(30 * x[7]), **length)
    return scene


@case(free=True)
def free_pair_on_a_guide(x):
    return hung(x, fb.Prismatic, base=arm(x, fb.Scene()), axis=(0.6, 0.8), spring=fb.Spring(50.0))


@case()
def winch_on_a_rope_over_circles(x):
    """A drum with a motor, a fixed pulley, and a loose one at a beam."""
    scene, beam = swing(x)
    drum = scene.add_body((-1.0, 0.5), 1.0, 0.05 * x[3], {"axle": (-1.0, 0.5)})
    motor = {"motor": lambda t: -2 * x[6] * t * t}
    scene.add_joint(fb.Revolute(fb.GROUND, drum["axle"], **motor))
    points = [
        fb.Pulley(drum.centre, 0.2 * x[7], "right"),
        fb.Pulley((0.2, 1.5 * x[5]), 0.15 * x[8], side="right"),
        fb.Pulley(beam.end, 0.1 * x[8]),
        (1.6, 1.5),
    ]
    laws = {"damper": fb.Damper(0.3 * x[7]), "stop": (None, 5.0, 300.0)}
    scene.add_rope(points, fb.Spring(60.0 * x[6], rest=3.5), **laws)
    return scene


@case()
def hinge_that_relaxes(x):
    def update(old, angle0, angle, dt):
        return [(old[0] + dt / 0.5 * angle[0]) / (1 + dt / 0.5)]

    internal = fb.InternalVariables(("dashpot",), update)
    energy = {"strain_energy": lambda angle, a: 10 * (2 * angle**2 + (angle - a[0]) ** 2)}
    return hung(x, fb.Revolute, turn=4.0, spring=fb.Spring(**energy, internal=internal))


def links(x, corners, motor=None):
    """Rigid bars between corners, hinged to the ground at the first and to each other."""
    scene, bars = fb.Scene(gravity=GRAVITY), []
    for a, b in zip(corners[:-1], corners[1:], strict=True):
        ends = {"mass": x[3], "inertia": 0.05 * x[4], "points": {"a": a, "b": b}}
        bars.append(scene.add_body(np.add(a, b) / 2, **ends))
        before = bars[-2]["b"] if len(bars) > 1 else fb.GROUND
        laws = {} if bars[1:] else {"motor": motor}
        scene.add_joint(fb.Revolute(before, bars[-1]["a"], **laws))
    return scene, bars


@case()
def long_chain_of_bodies(x):
    return links(x, [(0.1 * k, 0.05 * x[5] * (k % 2)) for k in range(20)])[0]


@case()
def driven_chain_of_bodies(x):
    return links(x, [(0, 0), (0.3, x[5]), (1, 1), (1.5, 0.5)], lambda t: 3 * x[7] * t**2)[0]


@case()
def loop_of_bodies_with_a_slot(x):
    scene, (arm,) = links(x, [(0, -0.2), (0.3 * x[5], 0.8)])
    points = {"O": (0, 0.5), "P": (0.2 * x[8], 0.5)}
    crank = scene.add_body((0.1, 0.5), mass=1.0, inertia=0.01, points=points)
    scene.add_joint(fb.Revolute(fb.GROUND, crank["O"]))
    damper = fb.Damper(0.1 * x[8])
    scene.add_joint(fb.PinInSlot(arm["a"], crank["P"], axis=(0.2 * x[8], 0.7), damper=damper))
    scene.add_moment(crank.centre, 0.5 * x[7])
    return scene


@case()
def locked_joint(x):
    spring = {"spring": fb.Spring(5 * x[7], rest=0.2)}
    scene = hung(x, fb.PinInSlot, axis=(1.0, 0.0), hinge=fb.Coordinate(**spring))
    scene.lock(scene.joints[0], "slide")
    return scene


def free_bodies(x):
    """Two free bodies about a common point, of which the second turns faster."""
    scene = fb.Scene()
    one = scene.add_body((0, 0), mass=1.0 * x[3], inertia=0.1, points={"pin": (0.5, 0)})
    other = scene.add_body((1, 0.1 * x[5]), mass=2.0, inertia=0.2 * x[4], points={"pin": (0.5, 0)})
    scene.set_velocity(one, (0, 0.5), spin=1.0)
    scene.set_velocity(other, (0, 1.0 * x[6]), spin=3.0)
    return scene, one, other


@case(free=True)
def laws_between_free_bodies(x):
    scene, one, other = free_bodies(x)
    laws = {"damper": fb.Damper(0.1, law=lambda v: 0.7 * abs(v) * v), "stop": (-0.1, 0.1, 500.0)}
    friction = fb.SmoothFriction(0.5 * x[7], 0.5)
    scene.add_joint(fb.Revolute(one["pin"], other["pin"], friction=friction, **laws))
    scene.make_velocities_compatible()
    return scene


@case(free=True)
def friction_that_follows_between_free_bodies(x):
    scene, one, other = free_bodies(x)
    friction = fb.Coulomb(0.5 * x[7], 1e4, radius=0.1)
    scene.add_joint(fb.Revolute(one["pin"], other["pin"], friction=friction))
    scene.make_velocities_compatible()
    return scene


@case(free=True)
def force_between_free_bodies(x):
    scene, one, other = free_bodies(x)
    spring = fb.Spring(30.0 * x[7], 0.8, lambda d: 5 * d**4)
    scene.add_force_between(one.centre, other.centre, spring, stop=(0.9, 1.02, 1e4 * x[8]))
    return scene


@case(free=True, dt=0.05)
def rope_over_circles_of_free_bodies(x):
    scene, one, other = free_bodies(x)
    third = scene.add_body((2.2, -0.5), 1.5, 0.1).centre
    scene.set_velocity(third, (0.2, 0.3), spin=-2.0)
    ends = fb.Pulley(one.centre, 0.2 * x[8], side="right"), fb.Pulley(third, 0.3, side="right")
    points = [ends[0], fb.Pulley(other.centre, 0.1 * x[7], side="right"), ends[1]]
    scene.add_rope(points, fb.Spring(20.0 * x[3], rest=1.5))
    energy = fb.Spring(strain_energy=lambda length: 5 * (length - 2.0) ** 4)
    scene.add_rope([fb.Pulley(one.centre, 0.15), fb.Pulley(third, 0.25, side="right")], energy)
    return scene


@case(free=True)
def rope_over_free_bodies(x):
    scene, one, other = free_bodies(x)
    points = [one["pin"], other.centre, one.centre, other["pin"]]
    scene.add_rope(points, fb.Spring(30.0 * x[7], 0.8), stop=(None, 6.0, 1e3 * x[8]))
    return scene


@case(dt=5e-3, free=True)
def friction_that_follows_on_a_free_beam(x):
    scene, rod = arm(x, fb.Scene(), elements=4)
    rest = rod.node(0.25)
    bead = scene.add_body((rest.x, rest.y), mass=1.0 * x[7], inertia=0.05).centre
    scene.add_joint(fb.Slider(rod, bead, fraction=0.25, friction=fb.Coulomb(0.3 * x[8], 1e3)))
    scene.set_velocity(bead, (1.0, 0.0))
    scene.make_velocities_compatible()
    return scene


# -- Contact ---------------------------------------------------------------------------------------


@case(dt=2e-3)
def line_obstacle_with_friction(x):
    scene = fb.Scene(gravity=GRAVITY)
    beam = scene.add_beam([(0, 0.001), (1, 0.2 * x[5])], section(x), 2)
    scene.set_velocity(beam, (1.0 * x[6], -1.0))
    floor = fb.Line((0, 0.02 * (x[7] - 1)), (0.1 * (x[8] - 1), 1))
    friction = fb.Coulomb(0.3 * x[8], 500.0)
    scene.add_contact(beam, floor, stiffness=1e3 * x[7], friction=friction)
    return scene


@case(dt=2e-3)
def circle_carried_by_a_body(x):
    scene = fb.Scene()
    wheel = scene.add_body((0.5, 0.65), mass=1.0 * x[3], inertia=0.05)
    beam = scene.add_beam([(0, 0), (1, 0)], section(x), 4)
    rim = fb.Circle(wheel.centre, 0.6 * x[8])
    scene.add_contact(beam, rim, stiffness=1e3 * x[7], restitution=0.8, speed=0.1)
    scene.set_velocity(wheel, (0.2, -2.0), spin=1.0)
    return scene


@case(dt=2e-3, free=True)
def member_contact(x):
    scene = fb.Scene()
    below = scene.add_beam([(0, 0), (2, 0)], section(x), 4)
    above = scene.add_beam([(0.7, 0.11), (1.1, 1.2 * x[5])], section(x), 2)
    friction = fb.Coulomb(0.2, 1e3)
    scene.add_contact(above, below, stiffness=1e4 * x[7], radius=0.05, friction=friction)
    scene.set_velocity(above, (0.3, -2.0 * x[6]))
    return scene


@case(dt=2e-3, free=True)
def ball_that_rolls_on_a_member(x):
    scene = fb.Scene()
    below = scene.add_beam([(0, 0), (2, 0)], section(x), 4)
    ball = scene.add_body((0.7, 0.251), 2.0, 0.03 * x[8]).centre
    law = {"radius": (0.2 * x[5], 0.05), "friction": fb.Coulomb(0.1, 2e3)}
    scene.add_contact(ball, below, stiffness=1e4 * x[7], **law)
    scene.set_velocity(ball, (0.3, -2.0 * x[6]), spin=-4.0)
    return scene


def with_a_beam_that_touches(x, scene, member, place):
    """A free beam moves down with its tip on the middle of a member."""
    above = scene.add_beam([place + (0, 0.105), place + (0.2, 0.8 * x[5])], section(x), elements=2)
    scene.set_velocity(above, (0.3, -2.0 * x[6]))
    friction = fb.Coulomb(0.2 * x[8], 1e3)
    scene.add_contact(above, member, stiffness=1e4 * x[7], radius=0.05, friction=friction)
    return scene


@case(dt=2e-3)
def loop_of_which_a_member_is_touched(x):
    scene = closed_loop(x)
    coupler = scene.beams[1]
    middle = np.array([(coupler.start.x + coupler.end.x) / 2, 1.1])
    return with_a_beam_that_touches(x, scene, coupler, middle)


@case(dt=2e-3)
def long_chain_of_which_the_end_is_touched(x):
    scene = long_chain_of_bodies(x)
    last = scene.bodies[-1]["b"]
    tip = scene.add_beam([(last.x, last.y), (last.x + 1.0, last.y)], section(x), elements=2)
    scene.add_joint(fb.Rigid(last, tip.start))
    return with_a_beam_that_touches(x, scene, tip, np.array([last.x + 0.55, last.y]))


@case(dt=2e-3, steps=40)
def friction_that_follows_with_a_damping_of_its_own(x):
    scene = fb.Scene(gravity=GRAVITY)
    bob = scene.add_body((0.5, 0), mass=2.0 * x[3], inertia=0.05, points={"pin": (0, 0)})
    pin = fb.Coulomb(0.3, 1e3, radius=0.05, damping=0.02 * x[7])
    scene.add_joint(fb.Revolute(fb.GROUND, bob["pin"], friction=pin))
    plate = scene.add_body((0.4, -0.06), mass=1.0, inertia=0.1).centre
    scene.fix(plate, "rotation", "y")
    scene.add_force_between(plate, (2.0, -0.06), spring=fb.Spring(200.0 * x[8]))
    law = {"stiffness": 2e3, "friction": fb.Coulomb(0.5, 5e3, damping=0.02 * x[7])}
    scene.add_contact(bob.centre, fb.Line(plate, (0, 1)), radius=0.05, **law)
    return scene


# -- Schemes ---------------------------------------------------------------------------------------

SCHEMES = {
    "order four": lambda: fb.EnergyMomentum(order=4),
    "energy decaying": fb.EnergyDecaying,
    "mid point": fb.MidPoint,
    "modified mid point": fb.ModifiedMidPoint,
    "newmark": fb.Newmark,
    "hht": fb.HHT,
    "generalized alpha": fb.GeneralizedAlpha,
}
for _name, _scheme in SCHEMES.items():
    SCENES[_name] = Case(_name, lambda x: hung(x, fb.Revolute), scheme=_scheme)
SCENES["driven by newmark's family"] = Case(
    "driven by newmark's family", prescribed_motion, SCHEMES["generalized alpha"], dt=0.0025
)
# Its first step is predicted by the rates, else it takes tens of iterations and is halved.
SCENES["sleeve by order four"] = Case(
    "sleeve by order four", sleeve_on_an_arc, SCHEMES["order four"], steps=8
)
