"""What cannot be right is refused by a sentence that names it: one line for each bad call."""

import datetime
import math
from decimal import Decimal
from fractions import Fraction

import ufl

import numpy as np
import pytest
from registry import DATA
from scenes import guided_body, one_bar

import fx_beam as fb

SECTION = fb.Section(**DATA)
ELSEWHERE = fb.Scene().add_beam([(0, 1), (0, 9)], SECTION, name="arm", elements=1)
SQUARE = [(1, 0), (0, 1), (-1, 0), (0, -1), (1, 0)]
MASSLESS = fb.Section(EA=1e4, GA=1e4, EI=100.0)


class Parts:
    """Two beams end to end, clamped at both ends, with a body on the first, and calls with them."""

    def __init__(self):
        self.scene = fb.Scene()
        self.beam = self.scene.add_beam([(0, 0), (1, 0)], SECTION, elements=2, name="arm")
        self.other = self.scene.add_beam([(1, 0), (2, 0)], SECTION, elements=2, name="leg")
        self.body = self.scene.add_body((1, 0), 1.0, 0.1)
        self.scene.clamp(self.beam.start)
        self.scene.clamp(self.other.end)
        self.scene.add_joint(fb.Rigid(self.beam.end, self.body.centre))
        self.end = self.beam.end
        self.ends = self.end, self.other.start

    def run(self, scheme=None, **options):
        return fb.simulate(self.scene, scheme, **{"dt": 0.1, "t_end": 0.1} | options)

    def beam_of(self, points=((0, 1), (1, 1)), section=SECTION, **options):
        return self.scene.add_beam(points, section, **options)

    def pressed(self, pressure, **options):
        return self.scene.add_line_load(self.beam, pressure, follower=True, **options)

    def damped_by(self, ratio):
        load = self.end, (1.0, 0.0)
        return fb.frequency_response(self.scene, load, self.end, [1.0], damping_ratio=ratio)

    def observed(self):
        return self.scene, {"tip": fb.Output("position", self.end)}

    def joint(self, make=fb.Revolute, **options):
        return self.scene.add_joint(make(*self.ends, **options))

    def moved(self, velocity=(0.0, 0.0), spin=0.0, of=None):
        self.scene.set_velocity(of or self.beam, velocity, spin)
        return self.run()


def duffing(force=None, **options):
    """A body on a guide, with a spring."""
    spring = {"spring": fb.Spring(1.0)} | options
    scene, body, _ = guided_body((0, 0), 1.0, 1.0, **spring)
    if force is not None:
        scene.add_force(body, lambda t: (force(t), 0.0))
    return scene


def light(*fixed, mass=None):
    """A beam without mass from (2, 1) to (5, 1) with supports of its start, and its motion."""
    scene, beam = one_bar([(2, 1), (5, 1)], MASSLESS, elements=2)
    if fixed:
        scene.fix(beam.start, *fixed)
    if mass:
        scene.add_mass(getattr(beam, mass), 1.0)
    return fb.simulate(scene, dt=0.1, t_end=0.1)


def with_work(p, term):
    p.scene.add_virtual_work(term)
    return p.run()


def later(p, add, value, **options):
    """A load with a bad value, or that raises, from t = 0.35 on."""

    def function(t):
        if t > 0.35:
            return value / 0 if value == 1.0 else value
        return (0.0, 0.0) if add != "add_moment" else 0.0

    getattr(p.scene, add)(p.end, function)
    return p.run(t_end=1.0, **options)


def of_response(p, build=None, **options):
    return fb.Response(build or (lambda x: p.observed()), **{"dt": 0.1, "t_end": 0.1} | options)(
        [1.0]
    )


def mesh_of():
    """Falling beams of the elements that `converge` asks for."""

    def scene_of(elements, degree):
        scene = fb.Scene(gravity=(0, -10))
        scene.add_beam([(0, 0), (1, 0)], SECTION, elements, degree)
        return scene

    return scene_of


def shaken(p, x=None):
    """Vibrations of the tip under a load there, computed for some numbers."""
    run = fb.HarmonicResponse(lambda x: (p.scene, (p.end, (1.0, 0.0)), p.end), [1.0])
    if x is not None:
        run(x)
    return run


def mesh(**bad):
    """Two struts with something bad."""
    arguments = {"points": [(0, 0), (1, 0), (1, 1)], "cells": [(0, 1), (1, 2)], "section": SECTION}
    return lambda p: p.scene.add_mesh(**arguments | bad)


def until(p, condition, **options):
    return p.run(until=condition, **options)


def energy_of(term):
    return lambda p: fb.Section(strain_energy=term)


def of_section(**data):
    return lambda p: fb.Section(**DATA | data)


def in_parts(name, *arguments, **options):
    """A call of a method of the scene."""
    return lambda p: getattr(p.scene, name)(p.end, *arguments, **options)


def stop(**options):
    return lambda p: fb.Stop(**{"lower": 0.0, "upper": 1.0, "stiffness": 2.0} | options)


def line(p):
    return fb.Line((0, -1), (0, 1))


# fmt: off
REFUSED = {
    "sections": [
        (of_section(EA=-1.0), "Section: EA = .*positive and finite"),
        (of_section(EI=None), "EI is missing"),
        (of_section(retardation=-1.0), "retardation"),
        (of_section(internal=3), "internal"),
        (of_section(EA=lambda s: 0.0), "EA = 0.0 at the fraction 0.5 .* must be positive"),
        (of_section(EA=lambda: 1.0), "TypeError"),
        (lambda p: fb.Section.rectangle(0.0, 0.1, E=1.0), "Section: height"),
        (lambda p: fb.Section.rectangle(0.1, 0.1, E=1.0, nu=0.6), "nu = .* must be a number in"),
        (lambda p: fb.Section.circle(0.1, E="steel"), "E = 'steel' must be"),
        (lambda p: fb.Section.circle(lambda s: 0.3 - s, E=1.0), "diameter = -0.2 at the fraction"),
        (lambda p: fb.Section.rectangle(*fb.materials.steel, height=0.1, width=0.1),
         r"Section.rectangle: multiple values for argument 'height'.* write \*\*material"),
        (lambda p: fb.Section.rectangle(0.1, 0.1, *fb.materials.glulam), "not isotropic"),
        (lambda p: fb.Section.tube(0.1, 0.06, E=1.0), "thickness = 0.06 must be at most half"),
        (energy_of(lambda e, g, k: e**2 if e > 0 else 0 * e), "must give a UFL expression"),
        (energy_of(lambda e, g, k: math.cosh(e)), "strain_energy"),  # has to come to an end
        (energy_of(lambda *e: ufl.as_vector(e)), r"a scalar, not of shape \(3,\)"),
        (energy_of(lambda e, g, k: 1e4 * (e**2 + g**2) - 50 * k**2),
         "falls as kappa grows .* derivative by kappa is -100, which must be"),
        (lambda p: fb.InternalVariables(("a", "a"), min), "InternalVariables: names"),
        (lambda p: fb.InternalVariables("a", min), "InternalVariables: names"),
        (lambda p: fb.InternalVariables(("a",), min, level=0.2), "InternalVariables: level"),
        (lambda p: fb.Parameter("", 1.0), "Parameter: name"),
        (lambda p: setattr(fb.Parameter("k", 1.0), "value", 2.0),
         r"'k' has a value in each scene: scene.parameters\['k'\] = 2.0"),
    ],
    "beams": [
        (lambda p: p.beam_of([(0, 1), (1, 1), (1, 1)], elements=2), "points 1 and 2 coincide"),
        (lambda p: p.beam_of([(1e6, 0), (1e6 * (1 + 2e-16), 0)]), "coincide"),
        (lambda p: p.beam_of([(0, 0)], name="rod"), "'rod': a beam needs at least two points"),
        (lambda p: p.beam_of([(0, 0), (1, 0, 0)]), "points must be"),
        (lambda p: p.beam_of([ELSEWHERE.end, (5, 5)]), "node 1 at .* belongs to another scene"),
        (lambda p: p.beam_of(elements=2.5), "elements"),
        (lambda p: p.beam_of(elements=[2, 2]), "2 numbers of elements for 1 straight pieces"),
        (lambda p: p.beam_of([(0, 0), (1, 0), (1, 1)], elements=1), "too few for 2 straight piec"),
        (lambda p: p.beam_of(degree=4), "degree = 4 must be 1, 2 or 3"),
        (lambda p: p.beam_of(degree=2), "degree 2 differs from degree 1 of 'arm'"),
        (lambda p: p.beam_of(name="arm"), "two beams are called 'arm'"),
        (lambda p: p.beam_of(section=fb.Section), "section must be an fx_beam.Section.*tapered"),
        (lambda p: p.beam.node(0.3), r"'arm' has no node at the fraction 0.3.*\[0. , 0.5, 1. \]"),
        (lambda p: fb.arc((0, 0), (1, 1), (2, 2)), "on a line"),
        (lambda p: fb.arc((0, 0), (1, 1), (0, 0)), "coincide"),
        (lambda p: fb.arc((0, 0), p.end, (6, 4)), "arc: only its ends"),
        (lambda p: fb.spline([(0, 0)]), "at least two"),
        (lambda p: fb.spline(3), "must be points"),
        (lambda p: p.beam_of(lambda f: f), "wrong type or shape"),
        (lambda p: p.beam_of(lambda f: (1.0, 2.0)), "no length"),
        (lambda p: p.beam_of(lambda f: (f, np.nan if f > 0.5 else 0.0)), "not finite"),
        (lambda p: p.beam_of(lambda f: (f, 1 / 0)), "ZeroDivisionError"),
        (lambda p: p.beam_of(lambda f: (f, float(f > 0.5))), "jumps at the fraction 0.5;"),
        (lambda p: p.beam_of(fb.Curve(lambda f: (f, f), start=p.end)), "away from node 2"),
        (lambda p: p.beam_of(fb.Curve(lambda f: (f, f), breaks=[2.0])), "must be fractions"),
        (lambda p: p.beam_of(fb.arc((0, 0), (1, 1), (2, 0)), elements=[2, 2]), "one positive wh"),
        (lambda p: fb.Scene().add_beam(fb.spline(SQUARE), SECTION, 1, 2), "too few for its curve"),
        (lambda p: p.scene.add_body((0, 0), 1.0, name=3), "add_body: name"),
        (lambda p: p.body["z"], "has no point 'z'"),
    ],
    "meshes": [
        (mesh(points=[(0, 0, 0), (1, 0, 0), (1, 1, 0)]), r"points .*\(n, 2\).*: points\[:, :2\]"),
        (mesh(points="corners"), r"points must be an array \(n, 2\) of numbers, not 'corners'"),
        (mesh(points=[(0, 0), (1, math.nan), (1, 1)]), r"point 1 at \(1, nan\) is not finite"),
        (mesh(points=[(0, 0), (1, 0), (1, 0)]), r"cell 1 = \(1, 2\) has no length.* at \(1, 0\)"),
        (mesh(points=[(0, 0), (1, 0), (1, 1), (2, 2)]), r"no cell has the points \[3\]. Leave"),
        (mesh(cells=[]), r"cells must be an array \(m, 2\) of whole numbers"),
        (mesh(cells=[(0, 1), (1, 1.5)]), r"cells must be .* not \[\(0, 1\), \(1, 1.5\)\]"),
        (mesh(cells=[(0, 1, 2)]), "cells must be .* the points at both ends"),
        (mesh(cells=[(0, 1), (1, -1)]), r"cell 1 = \(1, -1\) has a point that is not among the 3"),
        (mesh(cells=[(1, 2), (2, 3)]), r"cell 1 = \(2, 3\) .* count from 1, give cells - 1"),
        (mesh(cells=[(0, 1), (1, 2), (1, 0)]), r"cell 2 = \(1, 0\) is there twice, also as cell 0"),
        (mesh(cells=[(0, 1), (2, 2)]), r"cell 1 = \(2, 2\) has no length"),
        (mesh(elements=0), "elements = 0 must be a whole number .* each of the 2 cells"),
        (mesh(elements=[1, 2, 3]), r"elements = \[1, 2, 3\] must be"),
        (mesh(degree=2), "add_mesh: degree 2 differs from degree 1 of 'arm'"),
        (mesh(joints="hinge"), "add_mesh: joints = 'hinge' must be one of .*rigid.*pin"),
        (mesh(section=3), "add_mesh: section must be an fx_beam.Section, not 3"),
        (mesh(join=0.0), "add_mesh: join = 0.0 must be a positive number"),
        (mesh(section={1: SECTION}), "give the tag of each cell"),
        (mesh(tags=[1, 1]), "give a dict of sections by tag"),
        (mesh(section={1: 3.0}, tags=[1, 1]), "section of the tag 1 must be an fx_beam.Section"),
        (mesh(section={1: SECTION}, tags=[1]), r"tags = \[1\] must be one for each of 2 cells"),
        (mesh(section={1: SECTION}, tags=[1, 2]), r"cell 1 has the tag 2, .* of \[1\]"),
    ],
    "supports and loads": [
        (in_parts("fix", "z"), "'z' must be one of .*'x', 'y', 'rotation'"),
        (in_parts("fix", "x", "x"), "x of node 2 .* is supported twice; scene.free"),
        (lambda p: p.scene.pin(p.beam.start), "is supported twice"),
        (in_parts("fix"), "support of node 2 .* name the components to fix"),
        (lambda p: p.scene.free(p.beam.start, np.array(["x", "y"])), "one that is supported"),
        (in_parts("prescribe"), "prescribed motion of node 2 .* give x, y or rotation"),
        (lambda p: (in_parts("prescribe", x=lambda t: 0.5 + t)(p), p.run()), "is 0.5 at t = 0"),
        (lambda p: p.scene.clamp(ELSEWHERE.end), r"node 1 at \(0, 9\) belongs to another scene"),
        (lambda p: p.scene.pin("end"), "'end' is not a node; take one from a beam"),
        (lambda p: p.scene.add_line_load(p.end, (1.0, 0.0)), "line load: .* is not a beam"),
        (lambda p: p.scene.add_line_load(ELSEWHERE, (1.0, 0.0)), "'arm' belongs to another sce"),
        (lambda p: p.scene.add_line_load(p.beam, lambda t: (t, 0.0), of="arc length"),
         r"takes \(t\), but it is called with \(s\)"),
        (lambda p: p.scene.add_line_load(p.beam, lambda t, s: (s, t), of="arc length and time"),
         r"takes \(t, s\), but it is called with \(s, t\)"),
        (in_parts("add_force", (1.0, 2.0, 3.0)), "force on .* wrong type or shape.* 2 numbers"),
        (in_parts("add_force", (lambda t: t, 0.0)), "as a component. Give one function of all"),
        (in_parts("add_force", (fb.Input("push"), 0.0)), "one Input, such as .*factor=.1, 0."),
        (lambda p: fb.Scene(gravity=(0.0, lambda t: -t)), "gravity: .* function of all components"),
        (in_parts("add_force", lambda t, x: (0.0, 0.0)), "force on node 2 .*raised TypeError"),
        (in_parts("add_force", (0, 1), follower=2), "follower"),
        (in_parts("add_force", fb.Input("f", factor=1.0)), "1 factors"),
        (in_parts("add_moment", fb.Parameter("M", lambda t: t)), "is an expression of UFL; give a"),
        (in_parts("add_moment", math.nan), "moment on .* not finite"),
        (in_parts("add_moment", lambda t: {}["a"]), "moment on .*raised KeyError"),
        (in_parts("add_mass", -1.0), r"mass.* of node 2 at \(1, 0\)"),
        (in_parts("add_mass", 1e-320), "mass of node 2"),
        (in_parts("add_drag", quadratic=True), "quadratic"),
        (lambda p: fb.Scene(gravity=9.81), "gravity: .*wrong type or shape"),
        (lambda p: fb.Scene(gravity=lambda t: -9.81), "gravity: .*wrong type or shape"),
        (lambda p: p.pressed((1.0, 0.0)), "pressure 1.*wrong type or shape"),
        (lambda p: p.pressed(1.0, of="arc length"), "pressure on beam 'arm': of"),
        (lambda p: p.pressed(1.0, between=(0.1, 0.5)), "ends of elements.*: 0 and 0.5 are"),
        (lambda p: p.pressed(lambda s: s), "pressure on beam 'arm': the function takes .s., but"),
        (in_parts("add_line_load", 1.0, follower=2), "line load: .* is not a beam"),
        (
            lambda p: p.scene.change(p.scene.add_virtual_work(lambda step: step.virtual_u[0]), 1.0),
            "change = .* must be a pressure",
        ),
        (lambda p: p.scene.add_damping(), "damping: mass, stiffness = 0.0 must be positive"),
        (lambda p: p.scene.add_damping(-1.0, 1e-3), "damping: mass = -1.0 must be zero or"),
        (lambda p: (p.scene.add_damping(1.0), fb.static(p.scene, spin=1.0)), "mass does not turn"),
        (lambda p: p.damped_by(-0.02), "damping_ratio = -0.02 must be a ratio such as"),
        (lambda p: p.damped_by([]), "damping_ratio = .* must be a ratio such as"),
        (lambda p: p.damped_by([0.02] * 1000), "at most .* ratios, as there are no more modes"),
        (lambda p: p.scene.shake(), "shake: x, y = None must be an acceleration"),
        (lambda p: p.scene.shake(x=([0, 1], [1])), "shaking along x: a record has two lists of"),
        (lambda p: p.scene.shake(x=np.ones((5, 2))), "shaking along x: a record has two lists of"),
        (lambda p: p.scene.shake(y=([0, 1], [1, np.nan])), "shaking along y: a record has two"),
        (lambda p: p.scene.shake(y=([0, 2, 1], [1, 2, 3])), "must rise, but 1 s comes after 2 s"),
        (lambda p: p.scene.shake(x=lambda x: 1.0), "shaking along x: the function takes .x., but"),
        (lambda p: (p.scene.shake(x=1.0), fb.static(p.scene, spin=1.0)), "does not turn with the"),
        (lambda p: fb.Input(""), "Input: name"),
        (lambda p: fb.Input("f", factor=(0, 0)), "different from zero"),
        (lambda p: fb.thermal("a", 100.0), "thermal"),
        (lambda p: p.scene.add_natural_strain(p.end, axial=0.1), "is not a beam"),
        (lambda p: p.scene.change(p.scene.add_natural_strain(p.beam, axial=1e-3), 2e-3), "axial="),
        (lambda p: p.scene.change(p.scene.add_line_load(p.beam, (0, 1)), curvature=1.0),
         "curvature of a load"),
        (lambda p: p.scene.add_virtual_work("drag"), "needs a function of the step"),
        (lambda p: with_work(p, lambda step: step.virtual_u), "virtual work 1: .*must be a scalar"),
        (lambda p: with_work(p, lambda step: step.psi), "virtual work 1: .*linear in step.virtual"),
        (lambda p: with_work(p, lambda step: step.none), "raised AttributeError"),
        (lambda p: p.moved(lambda x, y: x), "velocity of beam 'arm': .*it must be 2 numbers"),
        (lambda p: p.moved(lambda x, y: (1 / (1 - x), 0.0)), "of beam 'arm'.*ZeroDivisionError"),
        (lambda p: p.moved(lambda x, y: (math.inf if x > 0.6 else 0.0, 0.0)), "must be finite"),
        (lambda p: p.moved(spin=1.0, of=p.beam.start), "rotation, but its initial rate there is 1"),
        (lambda p: (p.scene.prescribe(p.end, y=lambda t: t), p.moved((0, 5.0), of=p.end)), "node"),
    ],
    "additions": [
        (lambda p: p.scene.add_natural_strain(p.beam), "give axial, shear or curvature"),
        (lambda p: p.scene.add_natural_strain(p.beam, axial=math.nan),
         "natural axial strain of beam 'arm'.*not finite"),
        (lambda p: p.scene.add_natural_strain(p.beam, axial=(1.0, 2.0)), "must be a number"),
        (lambda p: p.scene.add_natural_strain(p.beam, curvature=lambda s: s), r"\(s\).*Name them"),
        (lambda p: p.scene.add_natural_strain(p.beam, shear=np.sin), "Name them f"),
        (lambda p: p.scene.add_natural_strain(p.beam, shear=lambda f: "much"), "natural shear st"),
        (lambda p: p.scene.add_natural_strain(p.beam, curvature=lambda f, t: np.inf + f),
         "at f = 0, t = 0.*not finite"),
        (in_parts("add_spring"), "spring: x, y, rotation = None must be an fx_beam.Spr"),
        (in_parts("add_spring", x=3.0), "spring: x = 3.0 must be an fx_beam.Spring, Dam"),
        (in_parts("add_spring", x=[fb.Spring(1.0)] * 2), "a list with one of each"),
        (in_parts("add_spring", x=fb.Spring(1.0), axis=(0, 0)), "axis = .* a direction"),
        (in_parts("add_spring", y=fb.Stop(0.1, None, 1e3)), "along .0, 1.: the displacement"),
        (lambda p: p.scene.add_spring(p.beam, x=fb.Spring(1.0)), "spring"),
        (lambda p: p.scene.add_bed(p.beam), "normal = 0.0 must be a positive stiffness"),
        (lambda p: p.scene.add_bed(p.beam, normal=-1.0), "bed of beam .*: normal = -1.0"),
        (lambda p: p.scene.add_bed(p.beam, 1.0, pushes_only=2), "pushes_only = 2 must be True"),
        (in_parts("add_bed", normal=1.0), "bed"),
        (lambda p: p.beam.at(4), "at = 4 must be an arc length from 0 to the length of the beam, "),
        (lambda p: p.beam.at("a"), "at = 'a' must be an arc length"),
        (lambda p: p.scene.add_force(p.beam.at(0.3), (0, 1), follower=True), "inside an element;"),
        (lambda p: p.scene.add_line_load(p.beam, (0, 1), between=(0.6, 0.3)), "two arc lengths in"),
        (lambda p: p.scene.add_line_load(p.beam, (0, 1), between=(0.5, 5)), "of the beam, 1"),
        (lambda p: p.scene.add_line_load(p.beam, lambda s, t: 0, "arc length and time", (0.1, 1)),
         "between is for loads that are constant"),
        (lambda p: p.scene.add_line_load(p.beam, [(0, 1)] * 3), r"\(qx, qy\), or those at both en"),
        (lambda p: p.scene.add_line_load(p.beam, [(0, 1), (0, "a")]), "an end"),
        (lambda p: p.scene.add_line_load(p.beam, [(0, 1), 2]), "must be 2 numbers"),
        (lambda p: p.scene.add_drag(p.beam, linear=-1.0), "drag on beam 'arm': linear"),
        (lambda p: p.scene.add_drag(p.beam, quadratic="much"), "drag on beam 'arm': quadratic"),
        (lambda p: p.scene.add_drag(p.beam, linear=(0.1, -0.1)), "drag on beam 'arm': linear"),
        (lambda p: p.scene.add_drag(p.beam, quadratic=(1.0,) * 3), "drag on beam 'arm': quadratic"),
        (lambda p: p.scene.add_drag(p.beam, rotation=(1.0, 2.0)), "rotation = .* one number"),
        (lambda p: p.scene.add_drag(p.beam), "not all zero"),
        (in_parts("add_drag", linear=(1.0, 2.0)), "drag on node 2 .*only a beam has directions"),
        (lambda p: p.scene.add_drag(ELSEWHERE, linear=1.0), "another scene"),
        (lambda p: p.scene.add_drag(3, linear=1.0), "drag: 3 is not a node"),
        (in_parts("add_force_between", (1, 0), fb.Spring(1.0)), "same place"),
        (in_parts("add_force_between", (2, 0)), "give a spring"),
        (in_parts("add_force_between", 3.0, fb.Spring(1.0)), "a node or a fixed point"),
        (in_parts("add_force_between", ELSEWHERE.end, fb.Spring(1.0)), "another scene"),
        (in_parts("add_force_between", (2, 0), stop=(None, 0.5, 1.0)), "upper limit"),
        (in_parts("add_force_between", (2, 0), force=lambda r, v, t: np.sin(r)), "UFL"),
        (in_parts("add_force_between", (2, 0), force=lambda r, v, t: r / v), "is nan"),
        (lambda p: p.scene.add_body((0,), 1.0), "body 2: position"),
        (lambda p: p.scene.add_body((0, 0), -1.0), "body 2: mass = -1.0 must be zero or positive"),
        (lambda p: p.scene.add_body((0, 0), 1.0, np.nan), "body 2: inertia"),
        (lambda p: p.scene.add_body((0, 0), 1.0, 0.1, [(0, 1)]), "points = .* must be a dict"),
        (lambda p: p.scene.add_body((0, 0), 1.0, 0.1, {"A": 3}), "body 2: point 'A'"),
        (lambda p: p.scene.add_body((0, 0), 1.0, name="body 1"), "two bodies are called 'body 1'"),
    ],
    "joints and contact": [
        (lambda p: p.scene.add_joint(3), "add_joint"),
        (lambda p: [p.joint(), p.joint()], "the scene has it already, as joint 1"),
        (lambda p: fb.Prismatic(*p.ends, axis=(0, 0)), "axis = .* has no direction"),
        (lambda p: fb.Revolute(*p.ends, offset=MASSLESS), "offset"),
        (lambda p: fb.Rigid(p.end, p.end), "node"),
        (lambda p: fb.Rigid(p.end, p.body), r"Rigid: <Body.* is not a node; .*body\.centre"),
        (lambda p: fb.PinInSlot(fb.GROUND, p.end, (1, 0), hinge=3), "hinge"),
        (lambda p: fb.Slider(p.end, p.other.end), "is not a beam; give the beam that guides"),
        (lambda p: fb.Slider(p.beam, p.other.end, fraction=2.0), "Slider: fraction"),
        (lambda p: fb.Coordinate(spring=3), "spring"),
        (lambda p: fb.Revolute(*p.ends, motor="fast"), "motor"),
        (lambda p: fb.Spring(stiffness=-1.0), "Spring: stiffness = -1.0 must be finite"),
        (lambda p: fb.Spring(strain_energy=lambda x: math.sin(x)), "UFL"),
        (lambda p: fb.Damper(-1.0), "Damper: viscosity"),
        (lambda p: fb.SmoothFriction(1.0, 0.0), "SmoothFriction: speed"),
        (lambda p: fb.Coulomb(-0.1, 1.0), "Coulomb: mu = -0.1 must be finite and not negative"),
        (stop(lower=None, upper=None), "Stop: give a lower limit, an upper limit or both"),
        (stop(restitution=2.0), "Stop: restitution"),
        (lambda p: fb.Line((0, 0), (0, 0)), "Line: normal = .* has no direction"),
        (lambda p: line(p).gap("ab"), "positions"),
        (lambda p: fb.Circle((0, 0), -1.0), "Circle: radius = -1.0"),
        (lambda p: fb.Circle((0, 0), 1.0, inside=2), "Circle: inside .*True or False"),
        (lambda p: p.scene.add_contact(p.beam, 3, 1.0), "needs an fx_beam.Line, an fx_beam.Ci"),
        (lambda p: p.scene.add_contact(p.beam, line(p), -1.0), "stiffness"),
        (lambda p: p.scene.add_contact(p.end, line(p), 1.0, friction=0.3), "friction"),
        (lambda p: p.scene.add_contact(p.beam, p.end, stiffness=1.0), "beam"),
        (lambda p: p.scene.add_force_between(p.end, (5, 5), force=lambda r, v, t: math.sin(t)),
         "force.distance, rate, t. must give a UFL expression.*not math"),
        (lambda p: fb.Latch(3, 1.0), "Latch: joint"),
        (lambda p: fb.Fuse(p.joint(), -1.0), "Fuse: force"),
        (lambda p: p.run(changes={"a": 3}), "changes"),
        (lambda p: p.scene.lock(p.joint(fb.Rigid)), "joint"),
        (lambda p: p.scene.lock(p.joint(), np.array(["slide", "rotation"])), "must be one of"),
    ],
    "schemes and records": [
        (lambda p: p.run("Newmark"), r"unknown scheme .*fx_beam.EnergyMomentum\(\)"),
        (lambda p: p.run(fb.Equilibrium()), "Equilibrium is a scheme for statics.*fx_beam.static"),
        (lambda p: fb.HHT(alpha=0.1), r"HHT: alpha = 0.1 must lie in [\[(].*\]"),
        (lambda p: fb.Newmark(beta=0), "Newmark: beta = 0 must lie in"),
        (lambda p: fb.NewmarkRates(beta=-1.0, gamma=0.5), "NewmarkRates: beta"),
        (lambda p: fb.MidPoint(order=3), "MidPoint: order = 3 must be 2 or 4"),
        (lambda p: fb.EnergyDecaying(damping=-1.0), "EnergyDecaying: damping"),
        (lambda p: fb.NodalRates(3), "NodalRates: rule"),
        (lambda p: fb.NodalRates(lambda D, *rest: (D, D, D), level=1.2), "NodalRates: level"),
        (lambda p: fb.Scheme("mine", 3, fb.MidPointRates()), "Scheme: resultants"),
        (lambda p: fb.Scheme("mine", lambda step: 1.0, fb.MidPointRates()), "take .step, law."),
        (lambda p: p.run(fb.Scheme("mine", lambda *_: None, fb.MidPointRates())),
         "mine: what resultants.step, law. gives = None must be fx_beam.Resultants"),
        (lambda p: fb.NewtonOptions(tolerance=1.0), "NewtonOptions: tolerance = .* be a number"),
        (lambda p: fb.NewtonOptions(max_iterations=2.0), "be a whole number from 1 on"),
        (lambda p: fb.NewtonOptions(max_turn=7), "NewtonOptions: max_turn = .* be a number betwe"),
        (lambda p: fb.Record(every=0), "Record: every = 0 must be a whole number from 1 on"),
        (lambda p: fb.Record(motion="no"), "Record: motion = 'no' must be True or False"),
        (lambda p: fb.Record(times=[1.0, 0.5]), "times"),
        (lambda p: fb.Record(times=[0.5], motion=False), "times"),
    ],
    "motions": [
        (lambda p: fb.simulate("scene", dt=0.1, t_end=0.1), "simulate needs an fx_beam.Scene"),
        (lambda p: fb.simulate(fb.Scene(), dt=0.1, t_end=0.1), "the scene has no beams"),
        (lambda p: [p.scene.remove(p.beam, p.other, p.body), p.run()], "the scene has no beams"),
        (lambda p: p.run(dt=math.nan), "dt = .* must be a positive number"),
        (lambda p: p.run(dt=-0.1), "dt = -0.1.* must be a positive number"),
        (lambda p: p.run(dt=1e-12, t_end=1.0), "dt = .* steps to t_end = 1.0 are more than"),
        (lambda p: p.run(t_end=0.05), "t_end = 0.05 must be at least one step dt = 0.1"),
        (lambda p: p.run(dt=None), "or give a tolerance"),
        (lambda p: p.run(dt=None, tolerance=1.0), "tolerance"),
        (lambda p: p.run(dt=None, tolerance=1e-3, dt_max=0.0), "dt_max"),
        (lambda p: p.run(dt=None, tolerance=1e-3, breaks=["now"]), "breaks"),
        (lambda p: p.run(breaks=[0.5]), "breaks"),
        (lambda p: p.run(fb.EnergyDecaying(order=1), dt=None, tolerance=1e-3), "order 1"),
        (lambda p: p.run(max_halvings=51), "max_halvings = 51 must be a whole number from 0 to 50"),
        (lambda p: p.run(start=3), "start.* be a Solution"),
        (lambda p: p.run(inputs={"a": 1}), "no input 'a'"),
        (lambda p: until(p, 3), "simulate: until = 3 must be a function"),
        (lambda p: until(p, lambda t, y: math.nan), "until gives nan at t = 0"),
        (lambda p: until(p, lambda t, y: True), "until is true at the start, t = 0"),
        (lambda p: until(p, lambda: 1.0), r"takes 0 positional arguments.*called as until\(t, y\)"),
        (lambda p: until(p, lambda t, y: y["z"], outputs={}), r"KeyError\('z'\) at t = 0"),
        (lambda p: until(p, lambda t, y: 1.0, outputs={"x": 3}), "simulate: outputs"),
        (lambda p: until(p, lambda t, y: 1.0, outputs={"x": fb.Output("spin", ELSEWHERE.end)}),
         "another scene"),
        (lambda p: p.run(dt_max=0.2), "dt_max"),
        (lambda p: p.run(outputs={}), "outputs .* given with `until` only"),
        (lambda p: fb.Output("slide", p.end), "one of .*position.* for node"),
        (lambda p: fb.Output("velocity", p.end, "z"), "component"),
        (lambda p: fb.Output("spin", p.end, "x"), "it is a single number"),
        (lambda p: fb.Motion("scene", dt=1.0), "Motion needs an fx_beam.Scene"),
        (lambda p: fb.Motion(p.scene, dt=0.0), "Motion: dt = 0.0 must be a positive number"),
        (lambda p: fb.Motion(p.scene, dt=1.0, outputs={"a": p.end}), r"outputs\['a'\]"),
        (lambda p: fb.Motion(p.scene, dt=1.0, outputs=5), "Motion: outputs = 5 must be a dict"),
        (lambda p: fb.Motion(p.scene, dt=1.0, outputs={"a": fb.Output("slide", p.joint())}),
         "a slide"),
        (lambda p: fb.Motion(p.scene, dt=1.0, outputs={"a": fb.Output("motor_force", p.joint())}),
         "motor"),
        (lambda p: fb.Motion(p.scene, dt=1.0, outputs={"T": fb.Output("kinetic_energy", p.scene)}),
         "a node, a joint, a rope or a contact"),
        (lambda p: fb.Motion(p.scene, dt=1.0).solution(), "nothing was recorded"),
        (lambda p: fb.Motion(p.scene, dt=1.0).restore(None), "Motion.restore"),
        (lambda p: fb.Motion(p.scene, dt=1.0, record=fb.Record(times=[0.0])), "record at times"),
        (lambda p: light(), r"beam 'beam 1' can (move|rotate) .* without mass or support"),
        (lambda p: light("x", "y"), r"can rotate about \(2, 1\) .*without mass or support"),
        (lambda p: light("y", "rotation"), r"can move along \(-?1, -?0\) .*without mass"),
        (lambda p: light(mass="end"), r"can rotate about \(5, 1\)"),
    ],
    "analyses": [
        (lambda p: fb.static("scene"), "static needs an fx_beam.Scene"),
        (lambda p: fb.static(p.scene, load_steps=-1), "static: load_steps = -1 must be a whole"),
        (lambda p: fb.static(p.scene, spin=math.inf), "static: spin"),
        (lambda p: fb.static(p.scene, spin=1.0, pivot=(0, 0, 0)), "static: pivot"),
        (lambda p: fb.modes(p.beam), "fx_beam.Scene"),
        (lambda p: fb.modes(p.scene, n=0), "modes: n = 0 must be a whole number from 1"),
        (lambda p: fb.modes(p.scene, state=3), "must be a solution"),
        (lambda p: fb.modes(p.scene, damping="no"), "damping = 'no' must be True or False"),
        (lambda p: fb.modes(p.scene, n=1).shape("nope", 0, 1.0), "'nope' is not a beam of these"),
        (lambda p: fb.modes(p.scene, n=1).shape(ELSEWHERE, 0, 1.0), "not a beam of these"),
        (lambda p: fb.modes(p.scene, n=1).shape(fb.Scene().add_body((0, 9), 1.0), 0, 1.0),
         "not a body of these"),
        (lambda p: fb.imperfect(p.scene, fb.modes(p.scene, n=1), 0.1, mode=1), "imperfect: mode"),
        (lambda p: fb.rayleigh((1.0, 1.0), (0.01, 0.05)), "must be positive and different"),
        (lambda p: fb.rayleigh((1.0, 4.0), (0.01, 0.05)),
         "negative mass factor alpha .* at most 0.04 at 4 Hz"),
        (lambda p: fb.linearise(p.scene, inputs=["pull"]), "linearise: inputs: .* no input 'pull'"),
        (lambda p: fb.linearise(p.scene, state=3.0), "state = 3.0 must be a Solution or a Motion"),
        (lambda p: fb.linearise(p.scene, outputs={"F": fb.Output("force", p.joint())}),
         "output 'F' is a force; only position"),
        (lambda p: fb.linearise(p.scene).deviation("here"), "deviation: of"),
        (lambda p: fb.frequency_response(p.scene, 3.0, p.end, [1.0]),
         "must be a node and its amplitudes, such as"),
        (lambda p: fb.frequency_response(p.scene, (p.end, (1, 0)), 7, [1.0]), "at: 7 is not a nod"),
        (lambda p: fb.frequency_response(p.scene, (p.end, (1, 0)), p.end, []), "a list of numbers"),
        (lambda p: fb.frequency_response(p.scene, (p.end, (0, 0)), p.end, [1.0]), "it is zero"),
        (lambda p: fb.periodic(duffing(), mode=0), "amplitude or the energy"),
        (lambda p: fb.periodic(duffing(), mode=0, amplitude=-1.0), "positive"),
        (lambda p: fb.periodic(duffing(), mode=0, amplitude=1.0, energy=1.0), "each sets the oth"),
        (lambda p: fb.periodic(duffing(), mode=7, amplitude=1.0), "does not vibrate"),
        (lambda p: fb.periodic(duffing(), mode=0, amplitude=1.0, steps=40), "odd"),
        (lambda p: fb.periodic(duffing(), mode=0, amplitude=1.0, scheme=fb.HHT()), "no derivat"),
        (lambda p: fb.periodic(duffing()), "how long a period is"),
        (lambda p: fb.periodic(duffing(math.cos), period=3.0), "do not repeat"),
        (lambda p: fb.periodic(duffing(math.cos)), "depend on time"),
        (lambda p: fb.backbone(duffing(), amplitude=0.0), "amplitude"),
        (lambda p: fb.forced_response(3, (0.1, 0.2)), "build"),
        (lambda p: fb.converge(3, len, 1e-2, t_end=1.0), "scene_of"),
        (lambda p: fb.converge(mesh_of(), lambda s: s.q, 1e-2, t_end=0.1), "of one shape in all"),
        (lambda p: fb.Branch(None), "no path branches off at a None"),
        (lambda p: fb.sweep(3, []), "sweep: function"),
        (lambda p: of_response(p, lambda x: 3), "build"),
        (lambda p: of_response(p, dt=None), "tolerance"),
        (lambda p: of_response(p, memory=0), "Response: memory = 0 must be a positive number"),
        (lambda p: fb.StaticResponse(3), "build"),
        (lambda p: fb.StaticResponse(len).vjp({}), r"StaticResponse\.vjp .* called after run\(x\)"),
        (lambda p: fb.StaticResponse(lambda x: p.observed(), load_steps=0)([1.0]), "steps"),
        (lambda p: fb.ModalResponse(3), "build"),
        (lambda p: fb.ModalResponse(len, n=0), "ModalResponse: n"),
        (lambda p: fb.ModalResponse(lambda x: x)([1.0]), "what build gives"),
        (lambda p: fb.ModalResponse(lambda x: p.scene)([]), "finite numbers"),
        (lambda p: fb.ModalResponse(lambda x: p.scene).jacobian(), r"called after run\(x\)"),
        (lambda p: fb.ModalResponse(lambda x: p.scene, state=lambda s: 3)([1.0]), "state"),
        (lambda p: fb.HarmonicResponse(lambda x: p.scene, [1.0])([1.0]), r"\(scene, load, at\)"),
        (lambda p: fb.HarmonicResponse(len, [-1.0]), "HarmonicResponse: frequencies"),
        (lambda p: shaken(p).jacobian(), r"called after run\(x\)"),
        (lambda p: shaken(p, [1.0]).vjp([1.0]), r"vjp: weights .* \(1, 3\) finite"),
        (lambda p: shaken(p, [1.0]).peaks("z"), "peaks: component"),
    ],
    "solutions": [
        (lambda p: p.run().position(ELSEWHERE.end), "node 1 at .* is not a node of this solution"),
        (lambda p: p.run().position(p.beam), "^<Beam 'arm': .* is not a node; take one"),
        (lambda p: p.run().position(p.body), r"<Body .* is not a node; .*body\.centre"),
        (lambda p: p.run().value(p.end), "^Solution.value: output = .* must be an fx_beam.Output"),
        (lambda p: p.run().value(fb.Output("period", p.scene)), "period of a PeriodicResponse"),
        (lambda p: p.run().value(fb.Output("N", ELSEWHERE.at(1.0))), "not a beam of this solution"),
        (lambda p: p.run().shape("boom"), r"'boom' is not a beam of this solution; it has \['arm'"),
        (lambda p: p.run().internal("arm", "creep"), "internal variable"),
        (lambda p: p.run().recorded("z"), "must be one of"),
        (lambda p: p.run().joint(1), "1 is not a joint of this solution; take the one"),
        (lambda p: p.run().contact(1), "not a contact"),
        (lambda p: p.run().to_csv(3), "path"),
        (lambda p: p.run().to_csv("a.csv", [p.end]), "must be a dict of nodes by the names"),
        (lambda p: p.run().save("nowhere/at/all"), "make the folder .*nowhere.at first"),
        (lambda p: p.run().load_factor, "over time, without load factors"),
        (lambda p: p.run().unstable_modes, "over time"),
        (lambda p: p.run(record=fb.Record(rates=False)).velocity(p.end), "rates not recorded"),
        (lambda p: fb.load("nowhere.npz"), "nowhere.npz", FileNotFoundError),
        (lambda p: fb.load(__file__), "test_refusals.py is not a solution saved by fx_beam"),
    ],
    "steps that fail": [
        (lambda p: later(p, "add_force", (math.nan, 0.0)), "force on .* t = 0.4.*not finite"),
        (lambda p: later(p, "add_moment", 1.0), "moment on .* t = 0.4.*raised ZeroDivision"),
        (lambda p: later(p, "add_force", (0.0,) * 3), "wrong type or shape"),
        (lambda p: (in_parts("add_moment", 1e9)(p), p.run(max_halvings=1)), "failed"),
        (lambda p: (in_parts("add_moment", 1e9)(p), fb.static(p.scene, max_cuts=0)), "load fact"),
        (lambda p: fb.converge(lambda *mesh: p.scene, lambda s: next(COUNT), 1e-3, t_end=0.1,
                               max_runs=4), "not known"),
    ],
}
# fmt: on
COUNT = iter(map(float, range(100)))
KINDS = {"solutions": ValueError, "steps that fail": fb.StepError}
CALLS = [
    pytest.param(*call, *[KINDS.get(topic, fb.SceneError)][: 3 - len(call)], id=f"{topic} {i}")
    for topic, calls in REFUSED.items()
    for i, call in enumerate(calls)
]


def sizes(scene):
    """How many parts of each kind a scene has."""
    return {name: len(it) for name, it in vars(scene).items() if isinstance(it, list | dict)}


@pytest.mark.exact_times
@pytest.mark.parametrize(("call", "words", "kind"), CALLS)
def test_what_cannot_be_right_is_refused_by_name(call, words, kind):
    with pytest.raises(kind, match=words) as refused:
        call(Parts())
    assert len(str(refused.value)) < 700
    if kind is fb.StepError:
        assert isinstance(refused.value.failure, fb.Failure)


@pytest.mark.parametrize("call", [call for call, *_ in REFUSED["additions"]])
def test_what_is_refused_leaves_nothing_in_the_scene(call):
    parts = Parts()
    before = sizes(parts.scene)
    with pytest.raises(fb.SceneError):
        call(parts)
    assert sizes(parts.scene) == before


def test_errors_are_of_the_kinds_of_python():
    assert issubclass(fb.SceneError, ValueError) and issubclass(fb.StepError, RuntimeError)


NO_NUMBERS = [None, "1.0", b"1", True, np.True_, math.nan, math.inf, 1e300, 10**400, 10**5000, 1j]
NO_NUMBERS += [np.datetime64("2020-01-01"), np.timedelta64(1, "s"), datetime.date(2020, 1, 1)]
NO_NUMBERS += [np.ma.masked, np.arange(3.0), {"a": 1}, [[1, 2], [3]], object()]
MASKED = np.ma.masked_array([1.0, 2.0], mask=[True, False])
NO_PAIRS = [["1", "2"], (1.0, True), np.array([True, False]), [np.datetime64("2020-01-01")] * 2]
NO_PAIRS += [MASKED, (0, 10**400), [ufl.variable(ufl.as_ufl(1.0))] * 2]


@pytest.mark.parametrize(
    ("word", "use"),
    {
        "moment": lambda p, x: p.scene.add_moment(p.end, x),
        "EA": lambda p, x: of_section(EA=x)(p),
        "radius": lambda p, x: fb.Circle((0, 0), x),
        "dt": lambda p, x: p.run(dt=x, t_end=1.0),
    }.items(),
)
def test_numbers_of_all_kinds_are_numbers_and_nothing_else_is(word, use):
    for value in (1, np.float32(1), np.int64(1), np.array(1.0), Fraction(1), Decimal(1)):
        use(Parts(), value)
    for value in NO_NUMBERS:
        with pytest.raises(fb.SceneError, match=word):
            use(Parts(), value)


@pytest.mark.parametrize(
    ("word", "use"),
    {
        "force": lambda p, x: p.scene.add_force(p.end, x),
        "points": lambda p, x: p.beam_of([(0, 3), x]),
        "axis": lambda p, x: fb.Prismatic(*p.ends, axis=x),
        "frequencies": lambda p, x: fb.rayleigh(x, (0.1, 0.1)),
    }.items(),
)
def test_pairs_of_numbers_are_pairs_and_nothing_else_is(word, use):
    for value in ([np.array(1.0), np.float32(2)], (Fraction(1), Decimal(2)), np.array([1, 2])):
        use(Parts(), value)
    for value in NO_PAIRS:
        with pytest.raises(fb.SceneError, match=word):
            use(Parts(), value)


@pytest.mark.parametrize("kind", [list, np.array])
def test_a_triple_of_times_and_a_pair_of_radii_may_be_lists_and_arrays(kind):
    times, parts = (0.1, 0.0, 0.2), Parts()
    assert fb.Section(**DATA, retardation=kind(times)) == fb.Section(**DATA, retardation=times)
    above = parts.beam_of(((0, 5), (1, 5)))
    contact = parts.scene.add_contact(parts.beam, above, stiffness=1.0, radius=kind((0.1, 0.2)))
    assert contact.radius == (0.1, 0.2)
    with pytest.raises(fb.SceneError, match="must be one time, or three"):
        fb.Section(**DATA, retardation=kind((0.1, 0.2)))
