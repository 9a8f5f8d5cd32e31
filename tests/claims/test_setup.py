"""A scene of a known kind compiles nothing; functions of the user are asked again each time."""

import subprocess
import sys

import ufl

import numpy as np
import pytest
from scenes import clamped_bar, one_bar

import fx_beam as fb
from fx_beam.fem import ffcx_api
from fx_beam.step.program import PROGRAMS


def arm(elements=3, length=1.0, EA=1e4, force=1.0, degree=1, second=None, **more):
    """A clamped arm of one or two sections under its weight and a force at its end."""
    section = fb.Section(EA=EA, GA=EA, EI=10.0, rhoA=1.0, **more)
    scene, beam = clamped_bar(
        (length, 0), section, elements=elements, degree=degree, gravity=(0.0, -9.81)
    )
    if second is not None:
        scene.add_beam([beam.end, (length, length)], second, elements=2, degree=degree)
    scene.add_force(beam.end, (0.0, force))
    return scene, beam


RUNS = {
    "simulate": lambda scene: fb.simulate(scene, dt=0.01, t_end=0.05).q,
    "Newmark": lambda scene: fb.simulate(scene, fb.Newmark(), dt=0.01, t_end=0.05).q,
    "static": lambda scene: fb.static(scene).q,
    "modes": lambda scene: fb.modes(scene, n=2).frequencies,
}


@pytest.mark.parametrize(("run", "degree"), [*((run, 1) for run in RUNS), ("simulate", 2)])
def test_other_numbers_in_a_scene_compile_nothing(run, degree, monkeypatch):
    def signature(form):
        raise AssertionError("signed again")

    simple = {"degree": degree}
    stepped = {"degree": degree, "second": fb.Section(EA=5e3, GA=5e3, EI=5.0, rhoA=2.0)}
    first = [RUNS[run](arm(**kind)[0]) for kind in (simple, stepped)]
    monkeypatch.setattr(ufl.Form, "signature", signature)
    # A mesh of equal connectivity has its own places, another one its own nodes.
    others = {"length": 2.0}, {"elements": 5, "length": 2.0, "EA": 3e4, "force": -2.0}
    for kind, before, other in zip((simple, stepped), first, others, strict=True):
        after = RUNS[run](arm(**kind, **other)[0])
        assert np.isfinite(after).all()
        assert after.shape != before.shape or abs(after - before).max() > 1e-6
        # The first scene again: what is kept has no data of another one.
        np.testing.assert_array_equal(RUNS[run](arm(**kind)[0]), before)


SECOND = """
import sys
import fx_beam as fb
scene = fb.Scene(gravity=(0, -9.81))
section = fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0, rhoI=0.01)
a = scene.add_beam([(0, 0), (1, 0)], section, elements=2)
b = scene.add_beam([a.end, (2, 0)], section, elements=2)
c = scene.add_beam([(2, 0), (3, 0)], section, elements=2)
scene.clamp(a.start)
scene.add_joint(fb.Revolute(b.end, c.start, spring=fb.Spring(10.0), damper=fb.Damper(0.1)))
scene.add_drag(c, linear=0.1)
scene.add_contact(c.end, fb.Line((0, -1), (1, -1)), stiffness=1e3)
path = fb.static(scene)
solution = fb.simulate(scene, fb.EnergyDecaying(), dt=0.01, t_end=0.05)
solution.resultants(a), fb.modes(scene, n=1)
print({"ufl", "basix", "ffcx", "cffi"} & set(sys.modules))
"""


def test_a_process_that_finds_its_forms_in_the_cache_needs_no_ufl():
    command = [sys.executable, "-c", SECOND]
    runs = [subprocess.run(command, capture_output=True, text=True) for _ in range(2)]
    assert runs[1].stdout == "set()\n", runs[1].stderr


def test_an_energy_whose_data_change_is_asked_again():
    stiffness = {"EA": 1e4}

    def energy(eps, gamma, kappa):
        return 0.5 * (stiffness["EA"] * (eps**2 + gamma**2) + 10.0 * kappa**2)

    def tip():
        scene, beam = arm(strain_energy=energy)
        return fb.static(scene).displacement(beam.end)[-1, 1]

    stiff = tip()
    assert tip() == stiff
    stiffness["EA"] = 100.0
    soft = tip()
    # Shear adds (F + q l / 2) l / GA.
    assert soft - stiff == pytest.approx((1.0 - 9.81 / 2) * (1 / 100 - 1e-4), rel=0.1)


def test_two_models_of_a_kind_do_not_share_their_fields():
    (first, beam), (other, _) = arm(), arm(EA=2e4, length=2.0, force=3.0)
    solution = fb.simulate(first, dt=0.01, t_end=0.05)
    fb.simulate(other, dt=0.01, t_end=0.05)
    again = fb.simulate(first, dt=0.01, t_end=0.05)  # by the program of the other
    assert not again.stats.setup_reason
    np.testing.assert_array_equal(solution.resultants(beam).N, again.resultants(beam).N)


def reason_of(elements, scheme=None):
    """Why a motion of a new scene was prepared anew; empty if it was not."""
    return fb.simulate(arm(elements)[0], scheme, dt=1e-3, t_end=2e-3).stats.setup_reason


def test_scenes_of_thousands_of_elements_are_prepared_once_as_well():
    assert [reason_of(2001), reason_of(2001)] == ["the first scene", ""]


def test_schemes_that_are_compared_have_a_program_each():
    schemes = [fb.EnergyMomentum(), fb.GeneralizedAlpha(0.9), fb.GeneralizedAlpha(0.8)]
    reasons = [[reason_of(6, scheme) for scheme in schemes] for _ in range(2)]
    assert reasons[1] == ["", "", ""]


def test_the_earliest_of_the_prepared_scenes_is_forgotten_beyond_a_size(monkeypatch):
    PROGRAMS.clear()
    monkeypatch.setattr(PROGRAMS, "size", 60)  # degrees of freedom
    sizes = [7, 9, 7, 8, 7, 9]  # of which two are held, but not three
    new = [bool(reason_of(elements)) for elements in sizes]
    assert new == [True, True, False, True, False, True]


#: Functions or laws by kind, made anew in each call.
LAWS = {
    "spring": lambda: {"spring": fb.Spring(strain_energy=lambda x: 5 * x**2 + x**4)},
    "damper": lambda: {"damper": fb.Damper(law=lambda rate: 0.1 * rate + rate**3)},
    "friction": lambda: {"friction": fb.SmoothFriction(lambda rate: 1 + 0 * rate, 0.1)},
    "force": lambda: {"force": lambda distance, rate, t: 3 * distance},
    "contact": lambda: lambda depth: 400 * depth**2.5,
    "section": lambda: lambda e, g, k: 5e3 * (e**2 + g**2) + 4.5 * k**2 + k**4,
}


def row_of(count, kind, made):
    """Arms in a row, each with a law of its own that `made` gives, or a section."""
    scene = fb.Scene(gravity=(0.0, -9.81))
    for i in range(count):
        data = {"strain_energy": made()} if kind == "section" else {"EA": 1e4, "GA": 1e4, "EI": 9.0}
        beam = scene.add_beam(
            [(2 * i, 0), (2 * i + 1, 0)], fb.Section(**data, rhoA=1.0, rhoI=0.01), elements=1
        )
        scene.clamp(beam.start)
        if kind == "contact":
            scene.add_contact(beam.end, fb.Line((0, -0.001), (0, 1)), energy=made())
        elif kind != "section":
            scene.add_force_between(beam.end, (2 * i + 1, 1), **made())
    return scene


@pytest.mark.parametrize("kind", LAWS)
def test_functions_that_give_the_same_are_written_once(kind, monkeypatch):
    """As those that a loop makes, one for each spring."""
    signed, signature = [], ffcx_api.signature
    monkeypatch.setattr(ffcx_api, "signature", lambda form: signed.append(form) or signature(form))
    counts, motions = [], []
    same = LAWS[kind]()
    for made, count in ((LAWS[kind], 2), (LAWS[kind], 7), (lambda: same, 7)):
        signed.clear()
        PROGRAMS.clear()  # each scene is set up anew
        solution = fb.simulate(row_of(count, kind, made), dt=1e-3, t_end=0.02)
        counts.append(len(signed))
        motions.append(solution.q)
    assert counts[0] == counts[1] == counts[2] > 0
    np.testing.assert_array_equal(motions[1], motions[2])


def test_functions_with_other_numbers_are_others():
    energies = [lambda x: 5 * x**2, lambda x: 6 * x**2]
    made = iter(fb.Spring(strain_energy=energy) for energy in energies)
    two = fb.simulate(row_of(2, "spring", lambda: {"spring": next(made)}), dt=1e-3, t_end=0.02)
    first, second = two.q[:, :2, 1], two.q[:, 2:, 1]
    assert abs(first - second).max() > 1e-3 * abs(first).max()


def test_laws_with_other_parameters_have_the_same_code(monkeypatch):
    values = iter([5.0, 6.0, 7.0])

    def made():
        k = fb.Parameter(f"k{(value := next(values)):g}", value)
        return {"spring": fb.Spring(strain_energy=lambda x: k * x**2 + x**6)}

    signed, signature = [], ffcx_api.signature
    monkeypatch.setattr(
        ffcx_api, "signature", lambda form: signed.append(signature(form)) or signed[-1]
    )
    solution = fb.simulate(row_of(3, "spring", made), dt=1e-3, t_end=0.02)
    assert len({*signed}) == 1
    heights = solution.q[-1, 1::2, 1]
    assert len({*heights.tolist()}) == 3


def test_a_joint_with_an_offset_does_not_take_the_set_up_of_one_without():
    """Nodes that lie elsewhere do not hide that the joint moves in another way."""

    def motion(offset):
        section = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.1)
        scene, first = one_bar([(-1, 0), (0, 0)], section, elements=1)
        second = scene.add_beam([(offset, 0), (offset + 1, 0)], section, elements=1)
        scene.add_joint(fb.Rigid(first.end, second.start, offset=(offset, 0)))
        for beam in (first, second):
            scene.set_velocity(beam, lambda x, y: (-2 * y, 2 * x), spin=2.0)
        stats = fb.simulate(scene, dt=0.01, t_end=0.02).stats
        return stats.setup_reason

    motion(0.0)
    assert motion(0.2) == "other joints have offsets"
    assert motion(0.3) == ""


CYCLE = """
import gc
import fx_beam as fb

def motion():
    scene = fb.Scene()
    energy = lambda eps, gamma, kappa: 5e3 * (eps**2 + gamma**2) + 50 * kappa**2 + 3 * kappa**4
    beam = scene.add_beam([(0, 0), (1, 0)], fb.Section(strain_energy=energy, rhoA=1.0, rhoI=0.1))
    scene.clamp(beam.start)
    scene.add_force(beam.end, (0.0, 1.0))
    end = fb.static(scene, load_steps=1).position(beam.end)
    return end, [fb.simulate(scene, dt=0.1, t_end=0.2)]

gc.disable()
for _ in range(2):
    end, cycle = motion()
    cycle.append(cycle)  # only the garbage collection ends it
    del cycle
    gc.collect()
print(end[-1, 1] > 0)
"""


def test_a_program_serves_after_a_solution_in_a_cycle_was_collected():
    """With the code of a user's functions, which leaves the process with the last set-up."""
    done = subprocess.run([sys.executable, "-c", CYCLE], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "True\n"), done.stderr
