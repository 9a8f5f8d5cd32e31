"""The last state of a solution in a file: what is damaged is refused, or ends with an error."""

import json
from contextlib import suppress

import numpy as np
import pytest
from scenes import assert_refused, supported_bar

import fx_beam as fb


@pytest.fixture(scope="module")
def rope():
    """A stick falls on a rope, with friction."""
    cord = fb.Section.circle(diameter=8e-3, E=5e6, rho=1100.0)
    scene, rope = supported_bar((0.6, 0), cord, elements=8, gravity=(0, -9.81), held="xy")
    stick = scene.add_beam([(0.25, 0.0081), (0.35, 0.3)], cord, elements=4)
    scene.add_contact(stick, rope, stiffness=2e5, radius=4e-3, friction=fb.Coulomb(0.3, 1e5))
    return scene, fb.simulate(scene, dt=1e-3, t_end=5e-3)


DAMAGES = {
    "nan": lambda values: np.full_like(values, np.nan),
    "text": lambda values: values.astype(str),
    "scalar": lambda values: np.array(1.0),
    "longer": lambda values: np.append(values, 0.0),
}
ARRAYS = "motors q v a slides spring_internal parts owners".split()


@pytest.mark.parametrize(
    ("name", "damage"),
    [(f"end_{name}", damage) for name in ARRAYS for damage in ("text", "scalar")]
    + [(f"end_{name}", "longer") for name in ("q", "v", "a", "slides", "parts", "owners")]
    + [(f"end_{name}", "nan") for name in ("t", "q", "spring_internal", "parts", "length")]
    + [("end_past_differences", "nan"), ("end_past_orders", "longer"), ("end_fitted", "longer")],
)
def test_a_damaged_last_state_is_refused(name, damage, rope, tmp_path):
    rope[1].save(tmp_path / "run.npz")
    with np.load(tmp_path / "run.npz") as file:
        arrays = dict(file)
    arrays[name] = DAMAGES[damage](arrays.get(name, np.zeros(3)))
    if name == "end_owners" and damage == "text":
        arrays[name] = np.zeros(arrays[name].shape)
    np.savez(tmp_path / "other.npz", **arrays)
    with pytest.raises(ValueError, match="other.npz is not a solution saved by fx_beam"):
        fb.load(tmp_path / "other.npz")


def edited(rope, path, end=None, **values):
    """A file whose text has other values, also of its last state."""
    rope[1].save(path)
    with np.load(path) as file:
        arrays = dict(file)
    meta = json.loads(str(arrays["meta"]))
    meta["end"] |= end or {}
    np.savez(path, **arrays | {"meta": np.array(json.dumps(meta | values))})
    return path


@pytest.mark.parametrize("value", ["x", True, None, [1.0], {"tuple": []}])
@pytest.mark.parametrize("name", ["work", "dissipated", "impact", "constraints", "past", "q"])
def test_parts_of_a_last_state_of_another_kind_are_refused(name, value, rope, tmp_path):
    if value is None and name in ("constraints", "past"):
        return
    path = edited(rope, tmp_path / "other.npz", {name: value})
    assert_refused("other.npz is not a solution saved by fx_beam", fb.load, path, error=ValueError)


@pytest.mark.parametrize("name", ["t", "length"])
def test_a_last_state_without_its_time_is_refused(name, rope, tmp_path):
    path = edited(rope, tmp_path / "other.npz", {name: np.nan})
    assert_refused("other.npz is not a solution saved by fx_beam", fb.load, path, error=ValueError)


@pytest.mark.parametrize("name", ["work", "dissipated", "numerical", "algorithmic"])
def test_a_motion_does_not_go_on_from_sums_that_are_not_finite(name, rope, tmp_path):
    start = fb.load(edited(rope, tmp_path / "other.npz", {name: np.nan}))
    with pytest.raises(fb.SceneError, match=f"start: {name} = nan .*not finite"):
        fb.simulate(rope[0], dt=1e-3, t_end=7e-3, start=start)


def test_a_file_of_another_format_names_both(rope, tmp_path):
    path = edited(rope, tmp_path / "other.npz", format="fx_beam solution 99")
    text = r"'fx_beam solution \d+', but in 'fx_beam solution 99'. Load it with a version"
    assert_refused(text, fb.load, path, error=ValueError)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
@pytest.mark.parametrize("node", [2, 10])
def test_a_start_that_is_lost_ends_with_an_error_where_members_touch(node, value, rope):
    scene, start = rope
    known = start.end.q[node, 0]
    start.end.q[node, 0] = value
    try:
        with pytest.raises((fb.StepError, fb.SceneError)):
            fb.simulate(scene, dt=1e-3, t_end=7e-3, start=start, max_halvings=1)
    finally:
        start.end.q[node, 0] = known


@pytest.fixture(scope="module")
def mobile():
    """A rope over a body on a pin and a ball that touches a floor, and what it is a file of."""
    scene = fb.Scene(gravity=(0, -9.81))
    section = fb.Section(EA=1e4, GA=1e4, EI=1.0, rhoA=1.0)
    bar = scene.add_beam([(0, 0), (1, 0)], section, elements=2, name="bar")
    scene.pin(bar.start)
    arm, ball = (scene.add_body((x, 0.5), mass=1.0, inertia=0.1) for x in (1, 2))
    joint = scene.add_joint(fb.Revolute(fb.GROUND, arm.centre, spring=fb.Spring(1.0)))
    floor = fb.Line((0, 0.4), (0, 1))
    scene.add_contact(ball.centre, floor, stiffness=1e4, radius=0.1, friction=fb.Coulomb(0.1, 1e3))
    rope = scene.add_rope([arm.centre, ball.centre], spring=fb.Spring(1e3))
    return scene, fb.simulate(scene, dt=1e-3, t_end=3e-3), (bar, joint, rope)


def places(part, path=()):
    """All places in JSON, by their keys."""
    keys = part if isinstance(part, dict) else range(len(part)) if isinstance(part, list) else ()
    yield from ((*path, key) for key in keys)
    for key in keys:
        yield from places(part[key], (*path, key))


def read_all(solution, scene, bar, joint, rope):
    """Read all that a solution has, and go on from it."""
    repr((solution, solution.stats, solution.end)), solution._repr_html_()
    solution.resultants(bar).at(0.3), solution.resultants("bar").ends, solution.shape(bar)
    solution.joint(joint).force, solution.joint(rope).length, solution.energy.balance_error
    for contact in solution.contacts:
        solution.contact(contact).gap, solution.contact(contact).slip
    for member in (*solution.beams.values(), *solution.bodies.values()):
        repr(member), [solution.position(node) for node in member.nodes]
    fb.simulate(scene, dt=1e-3, t_end=5e-3, start=solution)


TEXTS = "x", -1, 10**6, 0.5, None, True, [1.0], {"tuple": []}, "gone"


@pytest.mark.parametrize("first", [0, 4])
def test_a_text_with_a_damage_at_any_place_is_refused_or_read_without_raw_errors(
    first, mobile, tmp_path
):
    scene, solution, parts = mobile
    solution.save(tmp_path / "run.npz")
    with np.load(tmp_path / "run.npz") as file:
        arrays = dict(file)
    text = str(arrays["meta"])
    for i, (*path, last) in enumerate(places(json.loads(text)), first):
        owner = meta = json.loads(text)
        for key in path:
            owner = owner[key]
        owner[last] = damage = TEXTS[i % len(TEXTS)]
        if damage == "gone":
            del owner[last]
        np.savez(tmp_path / "other.npz", **arrays | {"meta": np.array(json.dumps(meta))})
        try:
            damaged = fb.load(tmp_path / "other.npz")
        except ValueError as error:
            refusal = f"{tmp_path / 'other.npz'} is not a solution saved by fx_beam"
            assert str(error).startswith(refusal)
            continue
        with suppress(ValueError, fb.StepError):
            read_all(damaged, scene, *parts)
