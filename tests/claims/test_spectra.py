"""Response spectra: against models by hand, histories of records, and statics of what is stiff."""

import pickle

import numpy as np
import pytest
import scipy.linalg
from registry import ONES, SCENES
from scenes import assert_refused
from scipy.integrate import quad
from scipy.signal import lsim

import fx_beam as fb

# Rises to a plateau from 0.5 to 0.8 s.
TABLE = [0.0, 0.5, 0.8, 5.0], [1.0, 3.0, 3.0, 0.4]
DAMPING = 0.05


def storeys(arm=0.0, base="ground"):
    """Two storeys of 2 and 3 kg on springs of 100 and 50 N/m, the second on an arm of its body.

    The first spring is to the ground, or to a body of 1 kg that is held or prescribed.
    """
    scene = fb.Scene()
    first = scene.add_body((0, 0), 2.0, 1.0).centre
    body = scene.add_body((1, arm), 3.0, 1.0, points={"foot": (1, 0)} if arm else None)
    second = body["foot"] if arm else body.centre
    for node in (first, body.centre):
        scene.fix(node, "y", "rotation")
    if base == "ground":
        lines = [scene.add_spring(first, x=fb.Spring(100.0)).x]
    else:
        ground = scene.add_body((-1, 0), 1.0, 1.0).centre
        scene.fix(ground, "y", "rotation", *(["x"] if base == "fixed" else []))
        if base == "prescribed":
            scene.prescribe(ground, x=lambda t: 0.0 * t)
        lines = [scene.add_force_between(ground, first, spring=fb.Spring(100.0, rest=1.0))]
    lines.append(scene.add_force_between(first, second, spring=fb.Spring(50.0, rest=1.0)))
    outputs = {"drift": fb.Output("displacement", body.centre, "x")}
    outputs |= {name: fb.Output("force", line) for name, line in zip("ab", lines, strict=True)}
    outputs["felt"] = fb.Output("acceleration", first, "x")
    return scene, outputs


def correlation(r):
    """Correlation of two oscillators with a ratio of frequencies under white noise."""

    def response(w, own):
        return 1 / (own**2 - w**2 + 2j * DAMPING * own * w)

    def product(a, b):
        def density(w):
            return (response(w, a) * np.conj(response(w, b))).real

        return quad(density, 0, 40, points=[1, r], limit=500, epsabs=0, epsrel=1e-9)[0]

    return product(1, r) / np.sqrt(product(1, 1) * product(r, r))


@pytest.mark.parametrize("base", ["ground", "fixed", "prescribed"])
@pytest.mark.parametrize(("arm", "count"), [(0.0, 1), (0.0, 2), (0.5, 2)])
def test_storeys_have_the_largest_responses_of_a_model_by_hand(arm, count, base):
    K, M, ones = np.array([[150.0, -50.0], [-50.0, 50.0]]), np.diag([2.0, 3.0]), np.ones(2)
    squares, vectors = (part[..., :count] for part in scipy.linalg.eigh(K, M))
    periods, factors = 2 * np.pi / np.sqrt(squares), vectors.T @ M @ ones
    ordinates = np.interp(periods, *TABLE)
    rigid = np.where(periods < TABLE[0][1], 1 / ordinates, 0.0)
    moved = vectors * factors * ordinates / squares
    left = ones - vectors @ factors
    rest = np.linalg.solve(K, M @ left)
    rho = correlation(np.sqrt(squares[-1] / squares[0]))
    correlations = rho + (1 - rho) * np.eye(count)
    parts = {
        name: (np.array(row) @ moved, np.array(row) @ rest)
        for name, row in {"drift": [0, 1], "a": [100, 0], "b": [-50, 50]}.items()
    }
    parts["felt"] = vectors[0] * factors * ordinates, left[0]
    scene, outputs = storeys(arm, base)
    found = fb.modes(scene, n=count)
    for combine, matrix in ("CQC", correlations), ("SRSS", np.eye(count)):
        shaken = found.spectrum(TABLE, (2, 0), DAMPING, combine, outputs=outputs)
        for name, (modal, remaining) in parts.items():
            own = np.sqrt(1 - rigid**2) * modal
            largest = np.sqrt((rigid @ modal + remaining) ** 2 + own @ matrix @ own)
            assert shaken.values[name] == pytest.approx(largest, rel=2e-6)
            assert abs(shaken.modal[name]) == pytest.approx(abs(modal), rel=1e-8)
            assert abs(shaken.rest[name]) == pytest.approx(abs(remaining), rel=1e-8, abs=1e-9)
        assert shaken.share == pytest.approx(factors @ factors / 5)


def mast(EI, degree=2, **options):
    """A clamped mast of 2 m with two masses, whose own mass is small or none."""
    scene = fb.Scene()
    section = fb.Section(EA=1e9, GA=1e9, EI=EI, **options)
    beam = scene.add_beam([(0, 0), (0, 2)], section, elements=8, degree=degree)
    scene.clamp(beam.start)
    scene.add_mass(beam.node(0.5), 3.0)
    scene.add_mass(beam.end, 2.0)
    outputs = {part: fb.Output("reaction", beam.start, part) for part in ("x", "moment")}
    outputs |= {"M": fb.Output("M", beam.at(1.5)), "Q": fb.Output("Q", beam.at(0.2))}
    outputs["drift"] = fb.Output("displacement", beam.end, "x")
    return scene, beam, outputs


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_what_is_stiff_moves_with_the_ground_also_by_one_of_its_modes(degree):
    scene, _, outputs = mast(1e9, degree, rhoA=1.0)
    shaken = fb.modes(scene, n=1).spectrum(([0.0, 1e3], [4.0, 9e3]), (1, 0), outputs=outputs)
    scene.shake(x=4.0)
    still = fb.static(scene, linear=True)
    for name, output in outputs.items():
        expected = abs(still.value(output)[-1])
        assert shaken.values[name] == pytest.approx(expected, rel=2e-2)


@pytest.mark.parametrize("loaded", [False, True])
def test_contributions_of_modes_and_of_the_rest_add_up_to_statics(loaded):
    flat, ends = ([0.0, 50.0], [2.0, 2.0]), []
    scene, beam, outputs = mast(1e3, rhoA=1.0, rhoI=0.1)
    scene.add_force(beam.end, (0, -50.0))
    for push in 1e-3, -1e-3:
        shaking = scene.shake(x=push)
        pushed = fb.static(scene)
        ends.append({name: pushed.value(output)[-1] for name, output in outputs.items()})
        scene.remove(shaking.x)
    if not loaded:
        scene, beam, outputs = mast(1e3, rhoA=1.0, rhoI=0.1)
        scene.shake(x=2.0)
        linear = fb.static(scene, linear=True)
    state = fb.static(scene) if loaded else None
    for count in 2, 5:
        shaken = fb.modes(scene, state, n=count).spectrum(flat, (-1, 0), outputs=outputs)
        for name, output in outputs.items():
            total = shaken.modal[name].sum(axis=0) + shaken.rest[name]
            if loaded:
                expected = 2.0 * (ends[0][name] - ends[1][name]) / 2e-3
            else:
                expected = linear.value(output)[-1]
            assert total == pytest.approx(expected, rel=1e-6)


def test_the_weight_of_a_mass_above_a_hinge_lengthens_its_period():
    scene, (k, m, h, J) = fb.Scene(gravity=(0, -10)), (240.0, 2.0, 3.0, 1.5)
    body = scene.add_body((0, h), m, J, points={"hinge": (0, 0)})
    hinge = scene.add_joint(fb.Revolute(fb.GROUND, body["hinge"], spring=fb.Spring(k)))
    inertia, stiffness = m * h**2 + J, k - m * 10 * h
    ordinate = np.interp(2 * np.pi * np.sqrt(inertia / stiffness), *TABLE)
    outputs = {"angle": fb.Output("angle", hinge), "force": fb.Output("force", hinge, "x")}
    shaken = fb.modes(scene, fb.static(scene)).spectrum(TABLE, (1, 0), outputs=outputs)
    assert shaken.values["angle"] == pytest.approx(ordinate * m * h / stiffness, rel=1e-8)
    share = m * h**2 / inertia  # the rest of the mass moves with the ground
    expected = m * np.hypot(share * ordinate, (1 - share) * TABLE[1][0])
    assert shaken.values["force"] == pytest.approx(expected, rel=1e-8)


def ground(seed):
    """A record of 10 s with a peak below 4 Hz: noise that comes and goes."""
    t = np.arange(0, 10, 0.01)
    noise = np.random.default_rng(seed).normal(size=len(t))
    return t, np.convolve(noise, np.hanning(30), "same") * np.minimum(1, np.minimum(t, 10 - t) / 3)


def spectrum_of(t, a):
    """Its spectrum for the damping: Duhamel's integral."""
    periods, largest = np.append(0.0, np.geomspace(0.02, 3.0, 80)), [abs(a).max()]
    for w in 2 * np.pi / periods[1:]:
        system = [[0, 1], [-(w**2), -2 * DAMPING * w]], [[0], [-1]], [[w**2, 0]], [[0]]
        largest.append(abs(lsim(system, a, t)[1]).max())
    return periods, largest


@pytest.mark.parametrize(("f", "count", "scatter"), [(1.5, 2, 0.1), (12.0, 1, 0.03)])
def test_spectra_of_records_give_the_largest_responses_of_their_histories(f, count, scatter):
    EI, ratios = (f / fb.modes(mast(1.0)[0], n=1).frequencies[0]) ** 2, []
    for seed in range(4):
        t, a = ground(seed)
        scene, _, outputs = mast(EI)
        modes = fb.modes(scene, n=count)  # of the stiff mast one: the other moves with the ground
        shaken = modes.spectrum(spectrum_of(t, a), (1, 0), DAMPING, outputs=outputs)
        scene.add_damping(*fb.rayleigh(fb.modes(scene, n=2).frequencies, (DAMPING, DAMPING)))
        scene.shake(x=(t, a))
        history = fb.simulate(scene, fb.EnergyMomentum(order=4), dt=0.01, t_end=11.0)
        largest = [abs(history.value(output)).max() for output in outputs.values()]
        ratios.append([shaken.values[name] for name in outputs] / np.array(largest))
    assert np.mean(ratios, axis=0) == pytest.approx(1.0, abs=scatter)


def test_round_off_on_a_plateau_does_not_matter():
    scene, outputs = storeys()
    modes = fb.modes(scene, n=2)  # of 1.96 and 0.70 s
    values = []
    for more in 0.0, 1e-12:
        spectrum = [0.0, 0.1, 1.0, 2.0], [1.0, 3.0, 3.0 + more, 0.5]
        values.append(modes.spectrum(spectrum, (1, 0), outputs=outputs))
    assert (values[1].rigid == values[0].rigid).all()
    assert values[1].values == pytest.approx(values[0].values, rel=1e-9)


def test_modes_without_most_of_the_mass_are_told(caplog):
    scene, _, outputs = mast(1e3)
    shaken = fb.modes(scene, n=1).spectrum(TABLE, (1, 0), outputs=outputs)
    assert "1 modes with 76." in repr(shaken)
    assert "the modes have 76 % of the mass" in caplog.text


def test_what_has_no_spectrum_is_refused():
    scene, outputs = storeys()
    modes, body = fb.modes(scene, n=2), scene.bodies[0]

    def refused(words, spectrum=TABLE, direction=(1, 0), found=modes, **options):
        options = {"outputs": outputs} | options
        assert_refused(words, found.spectrum, spectrum, direction, **options)

    refused("periods.*rise from 0", ([0.1, 2.0], [1.0, 1.0]))
    refused("two lists", [1.0, 2.0, 3.0])
    refused("two lists", ([0.0, 2.0], [1.0]))
    refused("accelerations.*positive", ([0.0, 2.0], [1.0, 0.0]))
    refused("ends at the period 0.5 s, but mode 0", ([0.0, 0.5], [1.0, 1.0]))
    refused("direction", direction=(0, 0))
    refused("damping.*between 0 and 1", damping=2.0)
    refused("combine", combine="ABS")
    refused("modes.*in this process", found=pickle.loads(pickle.dumps(modes)))
    refused("no rate and no energy", outputs={"v": fb.Output("velocity", body.centre)})
    energy = fb.Output("energy", scene.forces_between[0])
    refused("no rate and no energy", outputs={"E": energy})
    refused("rope or a contact", outputs={"E": fb.Output("strain_energy", scene)})
    scene.add_spring(body.centre, x=fb.Damper(3.0))
    refused("undamped ones", found=fb.modes(scene, n=1))
    free = fb.Scene()
    centre = free.add_body((0, 0), 1.0, 1.0).centre
    refused("none rigid", found=fb.modes(free), outputs={"u": fb.Output("rotation", centre)})


def test_where_friction_slips_small_motions_have_no_spectrum():
    scene = SCENES["friction that follows with a damping of its own"].build(ONES)
    modes = fb.modes(scene, fb.static(scene), damping=False)
    outputs = {"turn": fb.Output("rotation", scene.bodies[0].centre)}
    assert_refused("there and back", modes.spectrum, TABLE, (1, 0), outputs=outputs)
