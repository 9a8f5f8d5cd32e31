"""Odd inputs: each error names the thing and says what it must be."""

from decimal import Decimal
from types import SimpleNamespace

import numpy as np
import pytest
from scenes import assert_refused, guided_body, pinned_bar

import fx_beam as fb

STEPS = {"dt": 0.1, "t_end": 0.3}


def bar(length=1.0):
    section = fb.Section(EA=1e4, GA=1e4, EI=1.0, rhoA=1.0, rhoI=1e-3)
    return pinned_bar((length, 0), section, elements=1, gravity=(0, -9.81))


def build(x):
    scene, beam = bar()
    scene.add_mass(beam.end, x[0])
    return scene, {"tip": fb.Output("position", beam.end)}


def oscillator(f):
    """A body on a spring; for a frequency with a damper and a force."""
    spring, damper = fb.Spring(1.0), fb.Damper(0.1 if f else 0.0)
    scene, body, _ = guided_body((0, 0), 1.0, 1.0, spring=spring, damper=damper)
    if f:
        scene.add_force(body, lambda t: (0.3 * np.cos(2 * np.pi * float(f) * t), 0))
    return scene


@pytest.fixture(scope="module")
def my(tmp_path_factory):
    """A response, solutions, handles of another scene, and a folder."""
    scene, beam = bar()
    run = fb.Response(build, **STEPS)
    return SimpleNamespace(
        run=run,
        tip=run([1.0])[1]["tip"],
        scene=scene,
        beam=beam,
        fall=fb.simulate(scene, **STEPS),
        bent=fb.static(scene, load_steps=1),
        other=bar(2.0)[1],
        axes=fb.plot.figure(1, 1)[1][0, 0],
        folder=str(tmp_path_factory.mktemp("odd")),
    )


def no_arguments():
    return None


def shafts():
    scene = fb.Scene()
    places = [scene.add_body((x, 0), 1.0, 0.1).centre for x in (0, 1)]
    return [scene.add_joint(fb.Revolute(fb.GROUND, place)) for place in places]


def geared(**options):
    return fb.Gear(*shafts(), ratio=1.0, **options)


def shaken(my, base):
    return fb.frequency_response(my.scene, at=my.beam.end, frequencies=[1.0], base=base)


def cost(value, **weights):
    return lambda t, y: (value, weights or {"tip": np.zeros_like(y["tip"])})


@pytest.mark.parametrize(
    ("call", "message"),
    [
        # Functions of numbers
        (lambda my: my.run.misfit({"tip": "abc"}), r"measured\['tip'\] = 'abc' must be an array"),
        (lambda my: my.run.misfit({"tip": my.tip * 1j}), r"measured\['tip'\] .* array of numbers"),
        (lambda my: my.run.misfit({"tip": 10**400}), r"measured\['tip'\] .* array of numbers"),
        (lambda my: my.run.misfit({"tip": [[1], [1, 2]]}), r"measured\['tip'\] .* of numbers"),
        (
            lambda my: my.run.misfit({"tip": my.tip / 0.0}),
            r"measured\['tip'\] .* be finite, or NaN",
        ),
        (lambda my: my.run.misfit({"tip": my.tip}, "a"), "scatter of 'tip' = 'a' must be an array"),
        (
            lambda my: my.run.misfit({"tip": my.tip}, np.ones(7)),
            r"has the shape \(7,\), which does",
        ),
        (lambda my: my.run.misfit({}), "misfit: measured"),
        (lambda my: my.run.misfit({"a": [1.0]})([1.0]), "names of"),
        (lambda my: my.run.misfit({"tip": [1.0]})([1.0]), "of shape"),
        (lambda my: my.run.misfit({"tip": my.tip}, -1.0), "scatter of 'tip'"),
        (lambda my: my.run.misfit({"tip": my.tip}, {"a": 1.0}), "misfit: scatter"),
        (lambda my: my.run.objective(3), "objective: function"),
        (lambda my: my.run.objective(cost(1.0, a=1.0))([1.0]), "names of outputs"),
        (lambda my: my.run.objective(lambda t, y: 1.0)([1.0]), "must give a number and its deriv"),
        (lambda my: my.run.objective(cost(None))([1.0]), "must give a number and its derivatives"),
        (lambda my: my.run.objective(cost("a"))([1.0]), "must give a number and its derivatives"),
        (lambda my: my.run.objective(cost(1.0, tip="a"))([1.0]), r"weights\['tip'\] = 'a' must be"),
        (lambda my: my.run.objective(no_arguments), r"function takes \(\); it must take \(t, y\)"),
        (lambda my: my.run.jacobian(["tip"]), r"names = \[\['tip'\]\] must be names of outputs"),
        (lambda my: my.run.vjp({"tip": my.tip * 1j}), r"weights\['tip'\] .* an array of numbers"),
        (lambda my: fb.Response(no_arguments, **STEPS), r"build takes \(\); it must take \(x\)"),
        (lambda my: fb.Response(build, **STEPS, start=no_arguments), r"must take \(scene\)"),
        (
            lambda my: fb.Response(lambda x: (bar()[0], {"a": no_arguments}), **STEPS)([1.0]),
            r"the output 'a' takes \(\); it must take \(solution\)",
        ),
        # Numbers as arrays without axes, and joints
        (lambda my: my.scene.add_line_load(my.beam, np.array(1.0)), "must be 2 numbers"),
        (lambda my: geared(driven="slid"), "driven = 'slid' must be 'rotation' or"),
        (lambda my: geared(driven=0), "driven = 0 must be 'rotation' or"),
        (lambda my: fb.Rack(*shafts(), radius=np.nan), "Rack: radius = nan must be"),
        (lambda my: fb.imperfect(my.scene, None, 1e-3), "modes = None must be fx_beam.Modes"),
        (lambda my: shaken(my, np.eye(2)), "frequency_response: base"),
        (lambda my: shaken(my, (1, "a")), "frequency_response: base"),
        (lambda my: shaken(my, [1, [0]]), "frequency_response: base"),
        # Times
        (
            lambda my: fb.simulate(my.scene, dt=1e-320, t_end=1e-319),
            "dt = 1e-320 must .* least 1e-75",
        ),
        (lambda my: fb.periodic(oscillator(0.2), period=1e-300), "period = 1e-300 .* least 1e-75"),
        (lambda my: fb.forced_response(oscillator, [1e300, 2e300]), "frequencies = .* positive"),
        (lambda my: fb.forced_response(no_arguments, [1, 2]), r"it must take \(f\)"),
        (lambda my: fb.converge(bar, len, 1e-3, t_end=1.0), r"must take \(elements, degree\)"),
        (lambda my: fb.Motion(my.scene, dt=0.1).run(1.0, no_arguments), r"take \(t, outputs\)"),
        (lambda my: fb.sweep(no_arguments, [{"a": 1}]), r"it must take \(case\)"),
        # Solutions
        (lambda my: fb.imperfect(1, None, 1e-3), r"scene = 1 must be an fx_beam.Scene"),
        (lambda my: my.fall.resultants(my.other), "whose beam of this name has other nodes"),
        (lambda my: my.fall.position(my.other.start), r"node 0 .* is not a node of this solution"),
        (lambda my: my.fall.save(f"{my.folder}/a\0.npz"), "path = .* must be the name of a file"),
        (lambda my: my.fall.to_csv(f"{my.folder}/a\0.csv"), "path = .* must be the name of a file"),
        (lambda my: fb.load("a\0.npz"), "path = .* must be the name of a file"),
        (lambda my: fb.load(my.folder), "is a folder"),
        # Pictures
        (lambda my: fb.plot.equilibrium_paths(my.bent, lambda s: None), r"= None must be \d+ num"),
        (lambda my: fb.plot.equilibrium_paths(my.bent, no_arguments), r"must take \(solution\)"),
        (
            lambda my: fb.plot.equilibrium_paths(my.bent, lambda s: s.t, load="a"),
            "load = 'a' must be a number",
        ),
        (lambda my: fb.plot.interactive(my.fall, trace=1.0), "1.0 is not a node"),
        (lambda my: fb.plot.Page(1), "text = 1 must be a page"),
        (lambda my: fb.plot.diagrams(my.fall, quantities=1), "quantities = 1 must be some of"),
        (lambda my: fb.plot.curves(my.fall, "a.png", len), "axes = .* must be axes of matplotlib"),
        (lambda my: fb.plot.curves(my.axes, my.fall, len), "solutions = .* must be a dict"),
        (lambda my: fb.plot.curves(my.axes, {"a": 1}, len), r"solutions\['a'\] = 1 must be a Sol"),
        (lambda my: fb.plot.quantities(my.axes, {"a": 1}, [0, 1]), r"values\['a'\] = 1 must be 2"),
        (lambda my: fb.plot.quantities(my.axes, {"a": [0, 1]}, 1.0), r"= \[0, 1\] must be 1 num"),
        (
            lambda my: fb.plot.animate(my.fall, f"{my.folder}/a.gif", scenery=no_arguments),
            r"scenery takes \(\); it must take \(axes, k\)",
        ),
        (lambda my: fb.plot.figure(1.5, 1), "rows = 1.5 must be a whole number"),
        (lambda my: fb.plot.save(my.axes, "a.png"), "must be a figure"),
    ],
)
def test_what_does_not_fit_is_named_with_what_it_must_be(call, message, my):
    with (
        np.errstate(divide="ignore", invalid="ignore"),
        pytest.raises(ValueError, match=f"(?s){message}"),
    ):
        call(my)


def test_the_nodes_of_a_scene_that_was_built_again_are_those_of_the_solution(my):
    assert np.array_equal(my.fall.position(bar()[1].end), my.fall.position(my.beam.end))


def test_decimals_are_numbers_of_periodic_motions():
    one, hundredth = Decimal(1), Decimal("0.01")
    free, options = oscillator(0), {"steps": 21, "tolerance": Decimal("1e-8")}
    swing = fb.periodic(free, mode=0, amplitude=hundredth, **options)
    family = fb.backbone(free, energy=hundredth, step=one, **options)
    forced = fb.periodic(oscillator(0.2), period=5 * one, **options)
    curve = fb.forced_response(oscillator, [one / 5, one / 4], step=one, **options)
    assert 1 / swing.period == pytest.approx(family.frequencies[-1]) == pytest.approx(0.159, 1e-2)
    assert 1 / forced.period == pytest.approx(curve.frequencies[0]) == pytest.approx(0.2)


@pytest.mark.parametrize("what", ["add_beam", "add_mass", "add_joint", "add_force"])
def test_a_load_that_changes_its_scene_is_refused(what):
    changes = {
        "add_beam": lambda scene, beam: scene.add_beam(
            [beam.end, (5, 5)], beam.section, elements=1
        ),
        "add_mass": lambda scene, beam: scene.add_mass(beam.end, 1.0),
        "add_joint": lambda scene, beam: scene.add_joint(fb.Revolute(fb.GROUND, beam.end)),
        "add_force": lambda scene, beam: scene.add_force(beam.end, (1.0, 0.0)),
    }

    def made():
        scene, beam = bar()
        left = [changes[what]]

        def load(t):
            if t > 0.15 and left:
                left.pop()(scene, beam)
            return 0.0, 0.0

        scene.add_force(beam.end, load)
        return scene

    analyses = {
        "simulate": lambda: fb.simulate(made(), **STEPS),
        "static": lambda: fb.static(made(), t=1.0),
        "Response": lambda: fb.Response(
            lambda x: ((scene := made()), {"tip": fb.Output("position", scene.nodes[1])}), **STEPS
        )([1.0]),
    }
    for analysis in analyses.values():
        assert_refused("the scene was changed while it was computed", analysis)


@pytest.mark.parametrize("value", [1e300, 1e-300])
@pytest.mark.parametrize("part", ["section", "mass", "spring", "step"])
def test_numbers_beyond_the_range_are_told_its_ends(part, value):
    scene, beam = bar()
    parts = {
        "section": lambda: fb.Section(EA=value, GA=1.0, EI=1.0),
        "mass": lambda: scene.add_body((0, 0), value, 1.0),
        "spring": lambda: fb.Spring(value),
        "step": lambda: fb.simulate(scene, dt=value, t_end=1.0),
    }
    if value < 1 and part in ("section", "spring"):
        assert parts[part]()
        return
    assert_refused("at most 1e.75" if value > 1 else "at least 1e-75", lambda: parts[part]())


@pytest.mark.parametrize("stiffness", [5e-324, 1e-320, 1e-310])
def test_a_stiffness_of_few_digits_is_none(stiffness):
    def build(x):
        spring = fb.Spring(x[0], strain_energy=lambda s: s**4 / 4)
        scene, body, _ = guided_body((0, 0), 1.0, 1.0, spring=spring)
        return scene, {"period": fb.Output("period", scene)}

    assert fb.modes(build([stiffness])[0], n=1).frequencies == 0
    run = fb.PeriodicResponse(build, lambda scene: fb.periodic(scene, mode=0, amplitude=1.0))
    assert_refused("mode 0 does not vibrate", run, [stiffness])


def test_tables_in_the_place_of_dicts_are_refused_in_one_line(my):
    pandas, xarray = pytest.importorskip("pandas"), pytest.importorskip("xarray")
    outputs = {"tip": [fb.Output("position", my.beam.end)] * 2}
    grid = xarray.Dataset({"tip": ("t", [1.0, 2.0])})
    tables = pandas.DataFrame(outputs), pandas.Series(outputs), grid, grid.tip
    for table in tables:
        calls = [
            lambda table=table: fb.Motion(my.scene, dt=0.1, outputs=table),
            lambda table=table: fb.linearise(my.scene, outputs=table),
            lambda table=table: fb.Response(lambda x: (my.scene, table), **STEPS)([1.0]),
            lambda table=table: fb.StaticResponse(lambda x: (my.scene, table))([1.0]),
            lambda table=table: my.fall.to_csv(f"{my.folder}/a.csv", table),
        ]
        if not isinstance(table, pandas.DataFrame):  # whose rows are cases
            calls.append(lambda table=table: fb.sweep(no_arguments, table))
        for call in calls:
            with pytest.raises(fb.SceneError) as raised:
                call()
            assert "\n" not in str(raised.value)
