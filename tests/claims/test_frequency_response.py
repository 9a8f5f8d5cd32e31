"""Steady vibrations under harmonic loads, against closed solutions and long motions."""

import numpy as np
import pytest
import scipy.linalg
from scenes import assert_refused, clamped_bar, one_bar

import fx_beam as fb


def cantilever(elements, section):
    return clamped_bar((1, 0), section, elements=elements, degree=2)


# -- Closed solutions --------------------------------------------------------------------------


def timoshenko(section, tau, w, force, moment):
    """Displacement and rotation of a cantilever's end, by its transfer matrix."""
    GA, EI = (c * (1 + 1j * w * tau) for c in (section.GA, section.EI))
    # (y, psi, Q, M)' with gamma = y' - psi = Q / GA and psi' = M / EI.
    A = np.zeros((4, 4), dtype=complex)
    A[0, 1], A[0, 2], A[1, 3] = 1.0, 1 / GA, 1 / EI
    A[2, 0], A[3, 1], A[3, 2] = -section.rhoA * w**2, -section.rhoI * w**2, -1.0
    through = scipy.linalg.expm(A)
    start = np.linalg.solve(through[2:, 2:], [force, moment])
    return through[:2, 2:] @ start


def test_a_damped_cantilever_has_the_response_of_timoshenko():
    tau, force, moment = 2e-3, 1.0, 0.3j
    section = fb.Section(EA=1e4, GA=400.0, EI=10.0, rhoA=1.0, rhoI=0.02, retardation=tau)
    f = np.linspace(0.0, 30.0, 31)
    exact = np.array([timoshenko(section, tau, w, force, moment) for w in 2 * np.pi * f])
    errors = []
    for elements in (8, 16):
        scene, beam = cantilever(elements, section)
        response = fb.frequency_response(scene, (beam.end, (0.0, force, moment)), beam.end, f)
        size = abs(exact).max(axis=1, keepdims=True)
        errors.append((abs(response.values[:, 1:] - exact) / size).max())
    assert errors[1] < 1e-3
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.3)


# -- Against the motion ------------------------------------------------------------------------


def arm(load=None):
    """A stressed arm on a damped hinge and a damped slide; its end carries a load over time."""
    section = fb.Section(EA=1e4, GA=1e4, EI=20.0, rhoA=1.0, rhoI=1e-2, retardation=0.01)
    scene, post = clamped_bar((0.5, 0), section, elements=3, degree=2, gravity=(0.0, -9.81))
    arm = scene.add_beam([(0.5, 0), (1.3, 0.2)], section, elements=4, degree=2)
    laws = {"spring": fb.Spring(60.0), "damper": fb.Damper(2.0)}
    hinge = fb.Coordinate(spring=fb.Spring(30.0), damper=fb.Damper(0.8))
    joint = fb.PinInSlot(post.end, arm.start, axis=(0.6, 0.8), hinge=hinge, **laws)
    joint = scene.add_joint(joint)
    if load is not None:
        scene.add_force(arm.end, load)
    return scene, arm, joint


@pytest.mark.parametrize("f", [0.4, 4.0])
def test_the_response_is_that_of_a_long_motion_about_a_stressed_state(f):
    scene, beam, joint = arm()
    state = fb.static(scene)
    assert abs(state.rotation(beam.end)[-1]) > 0.05  # so that the state counts
    F = 1e-3 * np.array([1.0, -2.0])
    response = fb.frequency_response(scene, (beam.end, F), beam.end, [f], state)
    joint_response = fb.frequency_response(scene, (beam.end, F), joint, [f], state)
    assert joint_response.names == ("slide", "angle")

    # After 25 s the slowest mode has decayed to 2e-5. The scheme's periods are too long by
    # (w dt)^2 / 12 = 3.7e-5 of them, twice as much in terms of stiffness; the amplitude at a
    # resonance of damping ratio 0.07 changes by 1 / 0.14 times that, 5e-4.
    w, steps = 2 * np.pi * f, 300
    moving, moved, slider = arm(lambda t: F * np.cos(w * t))
    motion = fb.simulate(moving, dt=1 / (steps * f), t_end=round(25 * f) / f, start=state)
    last = slice(-steps - 1, None)
    t = motion.t[last]
    waves = np.column_stack([np.cos(w * t), np.sin(w * t), np.ones_like(t)])

    def amplitude(history):
        a, b, _ = np.linalg.lstsq(waves, history[last], rcond=None)[0]
        return a - 1j * b

    histories = [*motion.displacement(moved.end).T, motion.rotation(moved.end)]
    seen = np.array([amplitude(history) for history in histories])
    assert abs(response.values[0] - seen).max() < 5e-4 * abs(seen).max()
    coordinates = motion.joint(slider).slide, motion.joint(slider).angle
    seen = np.array([amplitude(history) for history in coordinates])
    assert abs(joint_response.values[0] - seen).max() < 5e-4 * abs(seen).max()
    # About the undeformed start it is another one.
    other = fb.frequency_response(scene, (beam.end, F), beam.end, [f])
    assert abs(other.values - response.values).max() > 5e-3 * abs(response.values).max()


# -- Refusals and pictures ---------------------------------------------------------------------


def test_what_is_no_load_place_or_frequency_is_refused():
    scene, beam, joint = arm()
    load, f = (beam.end, (1.0, 0.0)), [1.0]
    _, foreign, other_joint = arm()
    rigid_scene = fb.Scene()
    bodies = [rigid_scene.add_body((x, 0), 1.0, 0.1).centre for x in (0, 1)]
    rigid_scene.pin(bodies[0])
    rigid = rigid_scene.add_joint(fb.Rigid(*bodies, offset=(1, 0)))
    for bad_call, words in (
        ((scene, (foreign.end, (1.0, 0.0)), beam.end, f), "belongs to another scene"),
        ((scene, (beam.end, (1.0, np.nan)), beam.end, f), r"must be \(fx, fy\) or"),
        ((scene, (scene.beams[0].start, (1.0, 0.0)), beam.end, f), "supports take all of it"),
        ((scene, load, other_joint, f), "is not a joint of the scene"),
        ((rigid_scene, (bodies[1], (0, 1)), rigid, f), "has no free coordinate"),
        ((scene, load, beam.end, [-1.0]), "zero or positive"),
    ):
        assert_refused(words, fb.frequency_response, *bad_call)
    response = fb.frequency_response(scene, load, joint, f)
    assert repr(response) == "<FrequencyResponse of slide, angle at 1 frequencies>"
    assert_refused("component = 'x' must be one of", response.component, "x")


def test_a_motion_without_bound_is_refused():
    section = fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0, rhoI=1e-3)
    scene, free = one_bar((1, 0), section, elements=4, degree=2)
    load = (free.end, (0.0, 1.0))
    fb.frequency_response(scene, load, free.end, [0.1])
    with pytest.raises(fb.SceneError, match="at 0 Hz the motion has no bound"):
        fb.frequency_response(scene, load, free.end, [0.1, 0.0])
    guided, rod = one_bar((1, 0), fb.Section(EA=1.0, GA=1.0, EI=1.0), elements=1)
    guide = fb.Prismatic(fb.GROUND, rod.start, axis=(1, 0), spring=fb.Spring(4.0))
    guide = guided.add_joint(guide)
    guided.add_mass(rod.start, 1.0)
    resonance = 2.0 / (2 * np.pi)
    with pytest.raises(fb.SceneError, match="at 0.31831 Hz .* natural frequency without damping"):
        fb.frequency_response(guided, (rod.start, (1.0, 0.0)), guide, [resonance])


def test_tables_have_amplitudes_and_phases(tmp_path):
    scene, beam, joint = arm()
    response = fb.frequency_response(scene, (beam.end, (0.0, 1.0)), joint, [0.5, 1.0, 2.0])
    response.to_csv(tmp_path / "response.csv")
    head, *rows = (tmp_path / "response.csv").read_text().splitlines()
    assert head == "frequency,slide amplitude,slide phase,angle amplitude,angle phase"
    table = np.array([row.split(",") for row in rows], dtype=float)
    assert (table[:, 0] == response.frequencies).all()
    assert (table[:, 1::2] * np.exp(1j * table[:, 2::2])) == pytest.approx(response.values)
    pytest.importorskip("pandas")
    frame = response.to_pandas()
    assert frame.index.name == "frequency" and list(frame.columns) == head.split(",")[1:]
    assert (frame.to_numpy() == table[:, 1:]).all()


@pytest.mark.plot
def test_pictures_of_responses_are_written(tmp_path):
    scene, beam, _ = arm()
    f = np.geomspace(0.1, 20.0, 50)
    response = fb.frequency_response(scene, (beam.end, (0.0, 1.0)), beam.end, f)
    fb.plot.frequency_response(response, tmp_path / "all.png")
    fb.plot.frequency_response(response, tmp_path / "y.png", components=["y"])
    sizes = [(tmp_path / name).stat().st_size for name in ("all.png", "y.png")]
    assert sizes[0] > sizes[1] > 10_000
    with pytest.raises(ValueError, match="components = .* must be names to draw"):
        fb.plot.frequency_response(response, tmp_path / "none.png", components=[])
    with pytest.raises(fb.SceneError, match="component = 'z' must be one of"):
        fb.plot.frequency_response(response, tmp_path / "none.png", components=["z"])
