"""Derivatives of all outputs of every scene by nine numbers: forwards, backwards, of the motion."""

import re

import derivatives
import pytest
from derivatives import EXACT, assert_both_ways_agree, outputs_of, size_of
from registry import ONES, SCENES

import fx_beam as fb

STEPS = 8


def at_rest(scene):
    return fb.static(scene, load_steps=2)


#: Schemes of the Newmark family have no derivatives.
CASES = {
    name: (name, {})
    for name, case in SCENES.items()
    if not isinstance(case.scheme().rates, fb.NewmarkRates)
}
#: Other rows, lengths of steps, and schemes, of scenes with what these meet.
CASES |= {
    "natural strains, from rest": ("natural strains", {"start": at_rest, "without": ("work",)}),
    # Near 1e-3 the number of steps changes with x.
    "loads, steps by a tolerance": ("dead loads", {"dt": None, "tolerance": 7e-4}),
    "bodies, some rows": ("rigid bodies", {"record": fb.Record(every=3)}),
    "motor, some rows": ("motor of a slider", {"record": fb.Record(every=3)}),
    "sleeve, decaying": ("sleeve on a beam", {"scheme": fb.EnergyDecaying()}),
    "sleeve, mid point": ("sleeve on a beam", {"scheme": fb.MidPoint()}),
    "friction, decaying": (
        "friction that follows the joint force",
        {"scheme": fb.EnergyDecaying(), "without": ("work", "dissipated")},
    ),
    "bodies, mid point of order four": (
        "loop of bodies with a slot",
        {"scheme": fb.MidPoint(order=4)},
    ),
}
every_case = pytest.mark.parametrize("name", CASES)


def exact(name):
    """Whether its scheme has the energy as EnergyMomentum has it, with its work."""
    scene, options = CASES[name]
    if "work" in options.get("without", ()):
        return False
    return options.get("scheme", SCENES[scene].scheme()).name.startswith("EnergyMomentum")


@pytest.fixture(scope="module")
def responses():
    """A response of each case, set up once, with its outputs and their derivatives."""
    return {}


@pytest.fixture
def response(responses, name):
    scene, options = CASES[name]
    case, without = SCENES[scene], options.get("without", ())

    def build(x):
        scene = case.build(x)
        return scene, outputs_of(scene, without)

    if name not in responses:
        options = {"scheme": case.scheme(), "dt": case.dt, "t_end": STEPS * case.dt} | options
        options.pop("without", None)
        run = fb.Response(build, newton=EXACT, **options)
        _, y = run(ONES)
        responses[name] = run, y, run.jacobian()
    return responses[name]


@every_case
def test_forward_and_adjoint_agree(response):
    run, y, J = response
    run(ONES)
    assert_both_ways_agree(run, y, J)


@every_case
def test_derivatives_are_those_of_the_motion(response):
    run, _, J = response
    derivatives.assert_they_are_those_of_the_motion(run, ONES, J)


@pytest.mark.parametrize("name", [*filter(exact, CASES)])
def test_the_balance_of_energy_holds_for_derivatives(response):
    """Energy and losses less work change as the energy at the start."""
    _, _, J = response
    balance = J["total"] + J["dissipated"] - J["work"]
    assert abs(balance - balance[0]).max() < 1e-9 * size_of(J["total"])


#: Scenes that stand without motion.
STANDING = ["rigid bodies", "follower force", "rigid joint with offset", "prismatic with laws"]
STANDING += ["revolute with spring and damper", "revolute with offset motor", "stop of a joint"]
STANDING += ["closed loop", "sleeve on the ground", "sleeve on an arc", "loads inside elements"]
STANDING += ["springs dampers and a stop to the ground", "loop of bodies with a slot"]


@pytest.mark.parametrize("name", STANDING)
def test_derivatives_of_equilibria_are_those_of_others_beside_a_line_taut_as_drawn(name):
    """Also where what holds the line has not faded, and joints and loops pass it on."""

    def build(x):
        scene = SCENES[name].build(x)
        pull = fb.Spring(3.0 * x[7], rest=0.2 * x[8])
        line = scene.add_force_between(scene.nodes[-1], (1.5, 1.5), spring=pull)
        outputs = outputs_of(scene, ("work", "dissipated"))
        rates = "velocity", "spin", "acceleration", "rate"
        outputs = {key: y for key, y in outputs.items() if not key.startswith(rates)}
        return scene, outputs | {"pull": fb.Output("force", line)}

    run = fb.StaticResponse(build, load_steps=2, newton=EXACT)
    _, y = run(ONES)
    J = run.jacobian()
    assert_both_ways_agree(run, y, J)
    derivatives.assert_they_are_those_of_the_motion(run, ONES, J)


DIFFERENCED = dict.fromkeys(
    ("free beam", "rigid bodies", "closed loop", "driven chain of bodies", "drag")
    + ("natural strains", "force between points", "circle carried by a body"),
    [],
)
DIFFERENCED["line obstacle with friction"] = ["3", "5"]  # masses, in the damping of what sticks


@pytest.mark.parametrize("name", DIFFERENCED)
def test_data_of_scenes_have_slopes_and_no_differences(name):
    """They agree with a difference in one direction, else there would be a reason."""
    case = SCENES[name]
    speed = lambda scene: {"end": fb.Output("velocity", scene.nodes[-1])}  # noqa: E731
    options = {"dt": case.dt, "t_end": STEPS * case.dt}
    run = fb.Response(lambda x: (scene := case.build(x), speed(scene)), case.scheme(), **options)
    run(ONES)
    run.jacobian()
    assert re.findall(r"x\[(\d)\]", run.stats.difference_reason) == DIFFERENCED[name]
