"""Paths with corners in statics: plastic flow along the arc length, kinks in load steps."""

import ufl

import numpy as np
import pytest
from scenes import clamped_bar, one_bar, supported_bar

import fx_beam as fb

YIELD = 0.3


def plastic_hinge(stiff, H):
    """A hinge that yields at the moment YIELD, with linear hardening or softening."""

    def energy(x, a):
        return stiff / 2 * (x - a[0]) ** 2 + H / 2 * a[0] ** 2

    def flow(old, strains0, strains, dt):
        trial = stiff * (strains[0] - old[0]) - H * old[0]
        excess = ufl.max_value(abs(trial) - YIELD, 0)
        return [old[0] + ufl.sign(trial) * excess / (stiff + H)]

    return fb.Spring(strain_energy=energy, internal=fb.InternalVariables(("plastic",), flow))


def arm_on(spring, moment=0.5, EI=6.0):
    scene, arm = one_bar((1, 0), fb.Section(EA=1e4, GA=4e3, EI=EI), elements=1)
    joint = scene.add_joint(fb.Revolute(fb.GROUND, arm.start, spring=spring))
    scene.add_moment(arm.end, moment)
    return scene, joint


def piecewise(slopes, kinks):
    """A spring whose stiffness changes at the kinks."""

    def energy(x):
        parts = [
            ufl.conditional(ufl.gt(abs(x), kink), (new - old) / 2 * (abs(x) - kink) ** 2, 0.0)
            for old, new, kink in zip(slopes, slopes[1:], kinks, strict=False)
        ]
        return sum(parts, slopes[0] / 2 * x**2)

    return fb.Spring(strain_energy=energy)


def own(EA, GA, EI):
    """A linear section given by its energy: it may have kinks for all that one knows."""

    def energy(eps, gamma, kappa):
        return EA / 2 * eps**2 + GA / 2 * gamma**2 + EI / 2 * kappa**2

    return fb.Section(strain_energy=energy)


# -- Flow along the arc length -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("stiff", "H", "steps"), [(1e5, 2.0, 1), (1e5, 2.0, 20), (100.0, 30.0, 5), (100.0, 0.1, 5)]
)
def test_the_arc_length_goes_through_yield_in_steps_as_long_as_before(stiff, H, steps):
    scene, joint = arm_on(plastic_hinge(stiff, H))
    path = fb.static(scene, steps, continuation="arc-length", max_steps=100)
    assert path.load_factor[-1] == 1
    flown = path.joint(joint).internal("plastic")
    exact = np.maximum(0.5 * path.load_factor - YIELD, 0) / H
    assert flown == pytest.approx(exact, abs=1e-7 / H)
    # A few rows at the corner; beside it the path is straight, with the step's own length.
    length = np.hypot(0.2 / H + 0.5 / 6, 1) * steps
    assert path.stats.steps < length + 20


@pytest.mark.parametrize("H", [-5.0, -30.0, -90.0])
def test_a_hinge_that_softens_has_its_limit_at_yield_and_goes_on_flowing(H):
    scene, joint = arm_on(plastic_hinge(100.0, H))
    path = fb.static(scene, 5, continuation="arc-length", max_steps=30)
    limit, *others = path.stats.limit_points
    # A corner nearer to the end of a step than 1e-4 of it is its end; steps are 0.2 long.
    assert limit == pytest.approx(YIELD / 0.5, abs=1e-4 * 0.2)
    assert not others
    assert limit in path.load_factor
    flown = path.joint(joint).internal("plastic")
    behind = flown > 0
    assert behind.sum() > 10
    assert (np.diff(flown[behind]) > 0).all()
    assert 0.5 * path.load_factor[behind] == pytest.approx(YIELD + H * flown[behind], abs=1e-6)


def test_the_limit_load_of_a_portal_frame_is_that_of_its_mechanism():
    # Hinges at the feet, the corners and under the load; the combined mechanism carries
    # P L/2 + Q h = 6 My (Neal, The plastic methods of structural analysis).
    P = 4.0
    scene, section = fb.Scene(), fb.Section(EA=1e7, GA=1e7, EI=6e3)
    corners = [(0, 0), (0, 1), (1, 1), (2, 1), (2, 0)]
    parts = [scene.add_beam([a, b], section, 2) for a, b in zip(corners, corners[1:], strict=False)]
    ends = [fb.GROUND, *(part.end for part in parts[:-1]), parts[-1].end]
    starts = [*(part.start for part in parts), fb.GROUND]
    joints = []
    for a, b in zip(ends, starts, strict=True):
        a, b = (b, a) if b is fb.GROUND else (a, b)
        joints.append(scene.add_joint(fb.Revolute(a, b, spring=plastic_hinge(1e5, 0.0))))
    scene.add_force(parts[1].end, (0.0, -P))
    scene.add_force(parts[1].start, (P, 0.0))
    path = fb.static(scene, 4, continuation="arc-length", max_steps=26)
    limit = path.load_factor[: 1 + np.argmax(np.diff(path.load_factor) < 0)].max()
    assert limit == pytest.approx(6 * YIELD / (2 * P), rel=1e-4)
    flown = [path.joint(joint).internal("plastic") for joint in joints]
    row = list(path.load_factor).index(limit) + 3
    # The left corner does not turn in the combined mechanism, all others do.
    assert [abs(a[row]) > 1e-3 for a in flown] == [True, False, True, True, True]


def test_a_bar_that_yields_as_it_snaps_through_unloads_where_it_is_shortest():
    rise, EA, H, most = 0.3, 100.0, 10.0, 1.0
    length = np.hypot(1, rise)

    def energy(eps, gamma, kappa, a):
        axial = EA / 2 * (eps - a[0]) ** 2 + H / 2 * a[0] ** 2
        return axial + 500 * gamma**2 + 500 * kappa**2

    def flow(old, strains0, strains, dt):
        trial = EA * (strains[0] - old[0]) - H * old[0]
        excess = ufl.max_value(abs(trial) - most, 0)
        return [old[0] + ufl.sign(trial) * excess / (EA + H)]

    section = fb.Section(strain_energy=energy, internal=fb.InternalVariables(("a",), flow))
    scene, bar = supported_bar((1, rise), section, elements=1, held="x", load=(0.0, -1.0))
    path = fb.static(scene, 40, continuation="arc-length")
    assert path.load_factor[-1] == 1
    heights, force, a = path.position(bar.end)[:, 1], [], 0.0
    for y in np.linspace(rise, heights[-1], 20001):  # the same bar, by its height
        stress = EA * (np.hypot(1, y) / length - 1 - a) - H * a
        a += np.sign(stress) * max(abs(stress) - most, 0) / (EA + H)
        force.append(-EA * (np.hypot(1, y) / length - 1 - a) * y / np.hypot(1, y))
    assert (np.diff(heights) < 0).all()
    exact = np.interp(-heights, -np.linspace(rise, heights[-1], 20001), force)
    assert path.load_factor == pytest.approx(exact, abs=2e-3)
    assert path.stats.limit_points[0] == pytest.approx(max(force[:10000]), rel=1e-2)
    for steps in (3, 10):  # under the load it jumps, unless a step is refused
        with pytest.raises(fb.StepError):
            fb.static(scene, steps)


# -- Kinks in load steps -------------------------------------------------------------------------


@pytest.mark.parametrize("soft", [-100.0, -1.0])
@pytest.mark.parametrize("max_cuts", [0, 8])
def test_a_spring_that_snaps_at_its_kink_is_refused(soft, max_cuts):
    # It falls behind the kink and rises again: under the load it jumps.
    for moment in (0.31, 0.9):
        scene, _ = arm_on(piecewise((100.0, soft, 100.0), (0.003, 0.03)), moment, EI=600.0)
        for steps in (4, 30):
            with pytest.raises(fb.StepError) as caught:
                fb.static(scene, steps, max_cuts=max_cuts)
            assert caught.value.time * moment < YIELD + 1e-9


def test_no_load_step_reaches_the_other_branch_of_a_column(side=1e-5):
    scene, column = clamped_bar((1, 0), own(1e4, 1e4, 1.0), elements=8)
    scene.add_force(column.end, (-1.3 * np.pi**2 / 4, side))
    for steps in (1, 3, 10):
        try:
            path = fb.static(scene, steps)
        except fb.StepError as error:
            path = error.solution
        assert path.position(column.end)[-1, 1] > -1e-3


def test_the_path_of_an_arch_passes_its_bifurcation_with_a_law_of_its_own_too():
    # Loaded at its middle, the arch could sway before the limit point: the determinant changes
    # its sign there, as at a corner that turns the path back.
    def limits(section):
        scene = fb.Scene()
        arch = scene.add_beam(lambda f: (f, 0.08 * np.sin(np.pi * f)), section, 8)
        scene.pin(arch.start)
        scene.pin(arch.end)
        scene.add_force(arch.node(0.5), (0.0, -100.0))
        path = fb.static(scene, continuation="arc-length")
        assert path.load_factor[-1] == 1
        return path.stats.limit_points

    smooth = limits(fb.Section(EA=1e5, GA=5e4, EI=1.0))
    assert limits(own(1e5, 5e4, 1.0)) == pytest.approx(smooth, rel=1e-9)
