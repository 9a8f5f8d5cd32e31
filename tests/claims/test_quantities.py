"""Quantities with units are refused wherever a number is given: their unit would be lost."""

import importlib

import numpy as np
import pytest
from scenes import assert_refused, clamped_bar

import fx_beam as fb

SECTION = fb.Section(EA=1e6, GA=1e6, EI=1e3, rhoA=1.0, rhoI=0.01)
# What a library calls its units, and how it reads the number of a quantity.
LIBRARIES = {
    "pint": ("UnitRegistry", r"to_base_units\(\)\.magnitude"),
    "astropy.units": ("", r"si\.value"),
    "unyt": ("", r"in_base\(\)\.value"),
}


@pytest.fixture(scope="module", params=LIBRARIES)
def library(request):
    """A unit, and how the number of a quantity is read."""
    try:
        module = importlib.import_module(request.param)
    except ImportError as error:
        pytest.skip(str(error))
    registry, number = LIBRARIES[request.param]
    return (getattr(module, registry)() if registry else module).mm, number


def moved_by(force):
    scene, beam = clamped_bar((1, 0), SECTION, 2)
    scene.add_force(beam.end, force)
    return fb.simulate(scene, dt=0.1, t_end=0.2)


def turned_by(moment):
    scene, beam = clamped_bar((1, 0), SECTION, 2)
    scene.add_moment(beam.end, moment)
    return fb.simulate(scene, dt=0.1, t_end=0.2)


def bent(EA):
    scene, _ = clamped_bar((1, 0), fb.Section(EA=EA, GA=1e6, EI=1e3), 2)
    return fb.static(scene)


def stepped(value=(0.0, 0.0), force=(0.0, 0.0)):
    scene, beam = clamped_bar((1, 0), SECTION, 2)
    scene.add_force(beam.end, fb.Input("push"))
    return fb.Motion(scene, dt=0.1).step({"push": value}, {beam.end: force})


def responds_to(x):
    def build(x):
        return clamped_bar((1, 0), fb.Section.circle(x[0], E=1e9, rho=1.0), 2)[0]

    return fb.Response(build, dt=0.1, t_end=0.1)(x)


ARRAY, PAIR = np.array([1.0, 2.0]), [(0.0, 0.0), (1.0, 0.0)]
CALLS = {
    "a stiffness": lambda u: fb.Section(EA=1e6 * u, GA=1.0, EI=1.0),
    "a stiffness that varies": lambda u: bent(lambda f: 1e6 * u),
    "a height": lambda u: fb.Section.rectangle(height=20 * u, width=1.0, E=1e9),
    "points in an array": lambda u: fb.Scene().add_beam(np.array(PAIR) * u, SECTION),
    "points in arrays": lambda u: fb.Scene().add_beam([np.array(x) * u for x in PAIR], SECTION),
    "coordinates": lambda u: fb.Scene().add_beam([(0, 0), (1 * u, 0)], SECTION),
    "a mesh": lambda u: fb.Scene().add_mesh(np.array(PAIR) * u, [(0, 1)], SECTION),
    "the centre of a body": lambda u: fb.Scene().add_body(ARRAY * u, 1.0),
    "a mass": lambda u: fb.Scene().add_body((0, 0), 1.0 * u),
    "gravity": lambda u: fb.Scene(gravity=ARRAY * u),
    "a spring": lambda u: fb.Spring(1.0 * u),
    "a line": lambda u: fb.Line(ARRAY * u, (0, 1)),
    "a strain": lambda u: fb.thermal(1e-5, 50.0 * u),
    "a force in an array": lambda u: moved_by(ARRAY * u),
    "a force in a tuple": lambda u: moved_by((0.0, 1.0 * u)),
    "an array of a function": lambda u: moved_by(lambda t: ARRAY * u),
    "a tuple of a function": lambda u: moved_by(lambda t: (0.0, t * u)),
    "a number of a function": lambda u: turned_by(lambda t: t * u),
    "a constant moment": lambda u: turned_by(1.0 * u),
    "a time step": lambda u: fb.simulate(fb.Scene(), dt=0.1 * u, t_end=1.0),
    "times": lambda u: fb.Record(times=ARRAY * u),
    "an input": lambda u: stepped(ARRAY * u),
    "a push": lambda u: stepped(force=ARRAY * u),
    "a parameter": lambda u: responds_to(np.array([0.1]) * u),
}


@pytest.mark.parametrize("call", CALLS)
def test_a_quantity_is_refused_and_told_how_its_number_is_read(library, call):
    unit, number = library
    kind = (fb.SceneError, fb.StepError)
    assert_refused(f"has a unit.*{number}", CALLS[call], unit, error=kind)
