"""Values of the wrong kind are refused by a sentence that names them; numbers of all kinds fit."""

import copy
import datetime
import math
from decimal import Decimal
from fractions import Fraction

import ufl

import numpy as np
import pytest

import fx_beam as fb

SECTION = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.1)
MASKED = np.ma.masked_array([1.0, 2.0], mask=[True, False])
NO_NUMBERS = {
    "none": None,
    "text": "1.0",
    "bytes": b"1",
    "boolean": True,
    "boolean of numpy": np.True_,
    "not a number": math.nan,
    "infinite": math.inf,
    "too large": 1e300,
    "integer of 400 digits": 10**400,
    "integer of 5000 digits": 10**5000,
    "complex": 1j,
    "date": np.datetime64("2020-01-01"),
    "time span": np.timedelta64(1, "s"),
    "day": datetime.date(2020, 1, 1),
    "masked": np.ma.masked,
    "three": np.arange(3.0),
    "dict": {"a": 1},
    "ragged": [[1, 2], [3]],
    "object": object(),
}
NO_PAIRS = {
    "texts": ["1", "2"],
    "boolean": (1.0, True),
    "booleans": np.array([True, False]),
    "dates": [np.datetime64("2020-01-01")] * 2,
    "masked": MASKED,
    "long integer": (0, 10**400),
    "UFL": [ufl.variable(ufl.as_ufl(1.0))] * 2,
}
NUMBERS = [1, np.float32(1), np.int64(1), np.array(1.0), Fraction(1), Decimal(1)]


class Parts:
    """A beam with two nodes that is clamped at its start, and another one."""

    def __init__(self):
        self.scene = fb.Scene()
        self.beam = self.scene.add_beam([(0, 0), (1, 0)], SECTION, elements=2, name="arm")
        self.other = self.scene.add_beam([(1, 0), (2, 0)], SECTION, elements=2)
        self.scene.clamp(self.beam.start)
        self.scene.clamp(self.other.end)
        self.end = self.beam.end

    def simulate(self, **options):
        return fb.simulate(self.scene, **({"dt": 1.0, "t_end": 1.0} | options))


def stop(**given):
    return fb.Stop(**({"lower": 0.0, "upper": 1.0, "stiffness": 2.0} | given))


def material(**given):
    return fb.Section(**({"EA": 1.0, "GA": 1.0, "EI": 1.0} | given))


#: Where one number is wanted; 1 fits.
WITH_A_NUMBER = {
    "mass": lambda p, x: p.scene.add_mass(p.end, x),
    "inertia": lambda p, x: p.scene.add_mass(p.end, 1.0, x),
    "body: mass": lambda p, x: p.scene.add_body((0, 0), x, name="body"),
    "moment": lambda p, x: p.scene.add_moment(p.end, x),
    "quadratic": lambda p, x: p.scene.add_drag(p.end, quadratic=x),
    "spin": lambda p, x: p.scene.set_velocity(p.end, spin=x),
    "restitution": lambda p, x: stop(restitution=x, speed=1.0),
    "Stop: stiffness": lambda p, x: stop(stiffness=x),
    "radius": lambda p, x: fb.Circle((0, 0), x),
    "rest": lambda p, x: fb.Spring(rest=x),
    "viscosity": lambda p, x: fb.Damper(x),
    "speed": lambda p, x: fb.Friction(1.0, x),
    "EA": lambda p, x: material(EA=x),
    "retardation": lambda p, x: material(retardation=x),
    "fraction": lambda p, x: p.beam.node(x),
    "Slider: fraction": lambda p, x: fb.Slider(p.beam, p.other.end, fraction=x),
    "max_turn": lambda p, x: fb.NewtonOptions(max_turn=x),
    "beta": lambda p, x: fb.Newmark(beta=x),
    "level": lambda p, x: fb.NodalRates(lambda D, *rest: (D, D, D), level=x),
    "dt": lambda p, x: p.simulate(dt=x),
    "t_end": lambda p, x: p.simulate(t_end=x),
    "Motion: dt": lambda p, x: fb.Motion(p.scene, dt=x),
    "static: t": lambda p, x: fb.static(p.scene, 1, t=x),
}
#: Where a pair of numbers is wanted.
WITH_A_PAIR = {
    "gravity": lambda p, x: fb.Scene(gravity=x),
    "points": lambda p, x: p.scene.add_beam([(0, 3), x], SECTION),
    "arc": lambda p, x: fb.arc((0, 0), x, (1, 0)),
    "axis": lambda p, x: fb.Prismatic(fb.GROUND, p.end, axis=x),
    "offset": lambda p, x: fb.Revolute(p.end, p.other.start, offset=x),
    "force": lambda p, x: p.scene.add_force(p.end, x),
    "force of a function": lambda p, x: p.scene.add_force(p.end, lambda t: x),
    "factor": lambda p, x: fb.Input("push", factor=x),
    "positions": lambda p, x: fb.Line((0, 0), (0, 1)).gap(x),
    "frequencies": lambda p, x: fb.rayleigh(x, (0.1, 0.1)),
    "load": lambda p, x: fb.frequency_response(p.scene, (p.end, x), p.end, [1.0]),
    "times": lambda p, x: fb.Record(times=x),
    "breaks": lambda p, x: p.simulate(dt=None, tolerance=1e-2, breaks=x),
}


def sentence(call, *given):
    """The sentence by which something is refused."""
    with pytest.raises(ValueError) as error:
        call(*given)
    assert len(str(error.value)) < 700
    return str(error.value)


@pytest.mark.parametrize("name", WITH_A_NUMBER)
def test_what_is_no_number_is_refused_by_name(name):
    call = WITH_A_NUMBER[name]
    for value in NO_NUMBERS.values():
        if not (name == "Slider: fraction" and value is None):  # the nearest point
            assert name.split(": ")[-1] in sentence(call, Parts(), value)


@pytest.mark.parametrize("name", WITH_A_NUMBER)
def test_numbers_of_all_kinds_are_numbers(name):
    for value in NUMBERS:
        WITH_A_NUMBER[name](Parts(), value)


@pytest.mark.parametrize("name", WITH_A_PAIR)
def test_what_is_no_pair_of_numbers_is_refused_by_name(name):
    for value in NO_PAIRS.values():
        assert name.split()[0] in sentence(WITH_A_PAIR[name], Parts(), value)


@pytest.mark.parametrize("pair", [[np.array(0.0), np.float32(1)], (Fraction(0), Decimal(1))])
def test_pairs_may_have_numbers_of_all_kinds(pair):
    parts = Parts()
    parts.scene.add_force(parts.end, pair)
    assert parts.scene.loads[0].value(0.0).tolist() == [0.0, 1.0]


#: What has one kind of value besides numbers, with the values that fit.
OTHERS = {
    "follower": (lambda p, x: p.scene.add_force(p.end, (0, 1), follower=x), [False, np.True_]),
    "inside": (lambda p, x: fb.Circle((0, 0), 1.0, inside=x), [False, np.True_]),
    "damping": (lambda p, x: fb.modes(p.scene, n=1, damping=x), [False, np.True_]),
    "degree": (lambda p, x: p.scene.add_beam([(0, 0), (1, 1)], SECTION, degree=x), [1, np.int8(1)]),
    "elements": (
        lambda p, x: p.scene.add_beam([(0, 0), (1, 1)], SECTION, elements=x),
        [2, np.array(2), [2], np.array([2])],
    ),
    "add_beam: name": (lambda p, x: p.scene.add_beam([(0, 0), (1, 1)], SECTION, name=x), ["a"]),
    "add_body: name": (lambda p, x: p.scene.add_body((0, 0), 1.0, name=x), ["a", None]),
    "hinge": (
        lambda p, x: fb.PinInSlot(fb.GROUND, p.end, (1, 0), hinge=x),
        [None, fb.Coordinate(spring=fb.Spring(1.0))],
    ),
    "spring": (lambda p, x: fb.Coordinate(spring=x), [None, fb.Spring(1.0)]),
    "inputs": (lambda p, x: fb.linearise(p.scene, inputs=x), [None, [], ()]),
    "components": (
        lambda p, x: fb.Output("velocity", p.end, component=x),
        ["x", None],
    ),
    "order": (lambda p, x: fb.MidPoint(order=x), [2, np.int64(4)]),
    "is not a beam": (lambda p, x: FOUND.shape(x), ["arm"]),
    "internal variable": (lambda p, x: FOUND.internal("arm", x), []),
    "must be one of": (lambda p, x: FOUND.recorded(x), ["q"]),
    "path": (lambda p, x: FOUND.to_csv(x), []),
    "quantity": (
        lambda p, x: fb.converge(lambda *mesh: p.scene, lambda found: x, 1.0, t_end=1e-3),
        [],
    ),
}
FOUND = Parts().simulate()
ARRAYS = [np.arange(3), np.array(["a", "b"]), MASKED]
WRONG = [-1, math.nan, b"1", 1j, [[1], [2, 3]], {1: 2}, *ARRAYS]


@pytest.mark.parametrize("name", OTHERS)
def test_other_kinds_of_values_are_refused_by_name(name):
    call, fits = OTHERS[name]
    for value in WRONG:
        if name != "quantity" or isinstance(value, bytes | complex | dict):
            assert name.split(": ")[-1].rstrip("s") in sentence(call, Parts(), value)
    for value in fits:
        call(Parts(), value)


def test_lengths_of_steps_that_are_no_lengths_are_refused():
    for option in ({"dt": 1e-320}, {"dt_max": 1e-320}, {"t_end": 1e-320}, {"t_end": 1e300}):
        given = {"dt": None, "tolerance": 1e-2} | option
        assert next(iter(option)) in sentence(lambda given=given: Parts().simulate(**given))


def test_a_mass_that_is_next_to_nothing_is_refused():
    for size in (1e-320, -1e-320):
        parts = Parts()
        assert "mass of node 2" in sentence(parts.scene.add_mass, parts.end, size)


def test_a_level_is_kept_as_a_float():
    def update(old, strains0, strains, dt):
        return [old[0] + 0 * strains[0]]

    level = fb.InternalVariables(("a",), update, level=np.float32(1)).level
    assert type(level) is float and level == 1


def test_a_joint_is_added_once():
    parts = Parts()
    joint = fb.Revolute(parts.end, parts.other.start)
    added = parts.scene.add_joint(joint)
    for again in (joint, added, fb.Revolute(parts.end, parts.other.start)):
        assert "the scene has it already, as joint 0" in sentence(parts.scene.add_joint, again)
    copied = copy.copy(parts.scene)
    again = fb.Revolute(copied.beams[0].end, copied.beams[1].start)
    assert "Add each joint once" in sentence(copied.add_joint, again)
    # Two slots for one pin are another thing than one slot twice.
    for axis in ((1, 0), (0, 1)):
        parts.scene.add_joint(fb.PinInSlot(fb.GROUND, parts.end, axis))


def test_a_motion_does_not_go_on_without_what_is_added_to_its_scene():
    parts = Parts()
    motion = fb.Motion(parts.scene, dt=0.1)
    motion.step()
    parts.scene.add_moment(parts.end, 1.0)
    assert "added to the scene since" in sentence(motion.step)
    follower = fb.Motion(parts.scene, dt=0.1, start=motion.state, outputs={})
    follower.step()
    assert follower.t == pytest.approx(0.2) and abs(follower.q).max() > 0


@pytest.mark.parametrize("solver", ["compiled", "petsc"])
def test_a_function_that_simulates_its_own_scene_is_stopped(solver):
    parts = Parts()

    def force(t):
        return parts.simulate().velocity(parts.end)[-1] if parts.scene.loads else (0.0, 0.0)

    parts.scene.add_force(parts.end, force)
    with pytest.raises(fb.StepError, match="^force on node 2 .* runs an analysis of the scene to"):
        parts.simulate(solver=solver)
