"""Length, rate, energy and power of forces between points and of springs to the ground."""

import numpy as np
import pytest

import fx_beam as fb


def pair(x=(1.0, 1.0), law=None, middle=False):
    """A body that swings on a spring to another one, which a spring and a damper hold."""
    scene = fb.Scene(gravity=(0.0, -9.81))
    a = scene.add_body((0.0, 0.0), mass=2.0 * x[0], inertia=0.1, name="a").centre
    b = scene.add_body((0.8, -0.6 * x[1]), mass=1.0, inertia=0.1, name="b").centre
    spring = fb.Spring(300.0 * x[0], rest=0.9) if law is None else law
    line = scene.add_force_between(a, b, spring=spring, damper=fb.Damper(0.4))
    held = scene.add_spring(
        a, x=fb.Spring(500.0), y=[fb.Spring(400.0), fb.Damper(3.0)], rotation=fb.Spring(2.0)
    )
    scene.set_velocity(b, (1.0, 0.5), spin=0.3)
    scene.set_velocity(a, (0.0, 0.2), spin=9.0)
    return scene, line, held


def test_outputs_of_lines_are_those_of_their_nodes():
    scene, line, held = pair()
    a, b = (scene.bodies[k].centre for k in (0, 1))
    outputs = {
        "length": fb.Output("length", line),
        "rate": fb.Output("rate", line),
        "force": fb.Output("force", line),
        "sag": fb.Output("length", held.y),
        "turn": fb.Output("length", held.rotation),
        "spin": fb.Output("rate", held.rotation),
    }
    motion = fb.Motion(scene, dt=0.01, outputs=outputs, record=fb.Record())
    rows = [motion.step() for _ in range(200)]
    solution = motion.solution()
    found = {name: np.array([row[name] for row in rows]) for name in outputs}
    apart = solution.position(b) - solution.position(a)
    moves = solution.velocity(b) - solution.velocity(a)
    distance = np.hypot(*apart.T)
    rate = np.sum(apart * moves, axis=1) / distance
    assert found["length"] == pytest.approx(distance[1:], abs=1e-13)
    assert found["rate"] == pytest.approx(rate[1:], abs=1e-12)
    assert found["sag"] == pytest.approx(solution.displacement(a)[1:, 1], abs=1e-14)
    assert found["turn"] == pytest.approx(solution.rotation(a)[1:], abs=1e-13)
    assert found["spin"] == pytest.approx(solution.spin(a)[1:], abs=1e-13)
    assert abs(found["turn"]).max() > 0.5
    of_line = solution.joint(line)
    assert of_line.rate == pytest.approx(rate, abs=1e-14)
    np.testing.assert_array_equal(solution.joint(held.rotation).rate, solution.spin(a))


@pytest.mark.parametrize("own", [False, True])
def test_energies_and_powers_of_all_lines_are_those_of_the_scene(own):
    """What lines store is the energy of springs; what they take beyond it is dissipated."""
    law = fb.Spring(strain_energy=lambda x: 120.0 * (x - 0.9) ** 4) if own else None
    scene, line, held = pair(law=law)
    solution = fb.simulate(scene, dt=0.01, t_end=1.0)
    lines = [solution.joint(one) for one in (line, *held)]
    stored, energy = sum(one.energy for one in lines), solution.energy
    assert stored == pytest.approx(energy.springs, abs=1e-12 * energy.springs.max())
    taken = 0.01 * np.cumsum(sum(one.power for one in lines))
    growth = energy.springs - energy.springs[0] + energy.dissipated
    assert energy.dissipated[-1] > 0.1
    assert taken == pytest.approx(growth, abs=1e-9 * growth.max())


def test_the_energy_of_a_bed_and_of_a_stop_is_that_of_springs():
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (2, 0)], fb.Section(EA=1e5, GA=1e5, EI=20.0), elements=8)
    scene.fix(beam.start, "x")
    bed = scene.add_bed(beam, normal=500.0, pushes_only=True)
    scene.add_force(beam.node(0.25), (0.0, -20.0))
    scene.add_force(beam.node(0.75), (0.0, -20.0))
    solution = fb.static(scene)
    found = solution.joint(bed.normal).energy
    assert found[-1] > 0 and found == pytest.approx(solution.energy.springs, rel=1e-12)
    with pytest.raises(ValueError, match="no bed"):
        solution.joint(bed.normal).power  # noqa: B018
    with pytest.raises(fb.SceneError, match="no bed"):
        solution.joint(bed.normal).rate  # noqa: B018


def test_lengths_and_rates_have_derivatives():
    """Against differences, of places and masses, forwards and backwards."""

    def build(x):
        scene, line, held = pair(x)
        outputs = {
            "length": fb.Output("length", line),
            "rate": fb.Output("rate", line),
            "sag": fb.Output("rate", held.y),
        }
        return scene, outputs

    response = fb.Response(build, dt=0.01, t_end=0.3)
    x, step = np.array([1.0, 1.0]), 1e-6
    ways = np.eye(2) * step
    names = "length", "rate", "sag"
    moved = [(response(x + way)[1], response(x - way)[1]) for way in ways]
    _, y = response(x)
    jacobian = response.jacobian()
    for name in names:
        known = np.stack([(a[name] - b[name]) / (2 * step) for a, b in moved], axis=-1)
        assert jacobian[name] == pytest.approx(known, abs=1e-6 * abs(known).max())
    gradient = response.vjp({name: np.ones_like(y[name]) for name in names})
    total = sum(jacobian[name].sum(axis=0) for name in names)
    assert gradient == pytest.approx(total, rel=1e-9)


def test_lengths_are_linearised():
    scene, line, held = pair()
    scene.fix(scene.bodies[1].centre, "rotation")
    rest = fb.static(scene)
    outputs = {"length": fb.Output("length", line), "sag": fb.Output("rate", held.y)}
    system = fb.linearise(scene, rest, outputs=outputs)
    a, b = (scene.bodies[k].centre for k in (0, 1))
    places = {"a": fb.Output("position", a), "b": fb.Output("position", b)}
    of_nodes = fb.linearise(scene, rest, outputs=places)
    apart = rest.position(b)[-1] - rest.position(a)[-1]
    way = apart / np.hypot(*apart)
    known = way @ (of_nodes.C[2:] - of_nodes.C[:2])
    assert system.C[0] == pytest.approx(known, abs=1e-12)
