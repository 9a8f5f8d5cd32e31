"""Functions and constants of dolfinx that users bring along are refused: they would be frozen."""

from dataclasses import replace

import ufl

import numpy as np
import pytest
from jointed import MEMBER

import fx_beam as fb
from fx_beam.fem import dolfinx_api, interval_mesh

LINE, _ = interval_mesh.mesh_between(np.array([(0.0, 0.0), (1.0, 0.0)]), np.array([(0, 1)]))
FIELDS = {
    "Constant": dolfinx_api.constant(LINE, 2.0),
    "Function": dolfinx_api.at_gauss_points(LINE, np.ones((1, 1))),
}
every_field = pytest.mark.parametrize("kind", FIELDS)


def refused(what, kind):
    return pytest.raises(
        fb.SceneError, match=f"{what}: it contains .*, a {kind} of your own.*step.t"
    )


def run(scheme=None, term=None, section=MEMBER):
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], section)
    scene.clamp(beam.start)
    if term is not None:
        scene.add_virtual_work(term)
    return fb.simulate(scene, scheme, dt=0.1, t_end=0.1)


@every_field
def test_in_a_virtual_work(kind):
    with refused("virtual work 1", kind):
        run(term=lambda step: FIELDS[kind] * step.t * step.virtual_u[1])


@every_field
def test_in_a_law(kind):
    with refused("strain_energy", kind):
        fb.Section(strain_energy=lambda e, g, k: FIELDS[kind] * (e**2 + g**2 + k**2))


@every_field
def test_as_a_datum_of_a_section(kind):
    for datum in (FIELDS[kind], lambda fraction: 2 * FIELDS[kind]):
        with refused("Section: EI at the fraction 0.5 of the length", kind):
            fb.Section(EA=1.0, GA=1.0, EI=datum)


class Prestressed:
    """Resultants of the mid-point rule with an axial force or a couple added."""

    def __init__(self, name, value):
        self.name, self.value = name, value

    def __call__(self, step, law):
        r = fb.MidPoint().resultants(step, law)
        return r._replace(**{self.name: getattr(r, self.name) + self.value})


@every_field
@pytest.mark.parametrize("part", ["N", "M", "m"])
def test_in_the_resultants_of_a_scheme(part, kind):
    scheme = replace(fb.MidPoint(), name="own", resultants=Prestressed(part, FIELDS[kind]))
    with refused("resultants of own", kind):
        run(scheme)


class Slowed(fb.MidPointRates):
    """Rates times a field."""

    def __init__(self, field):
        self.field = field

    def fields(self, *fields):
        v, omega = super().fields(*fields)
        return v, self.field * omega


@every_field
def test_in_the_rates_of_a_scheme(kind):
    with refused("rates of own", kind):
        run(replace(fb.MidPoint(), name="own", rates=Slowed(FIELDS[kind])))


@every_field
@pytest.mark.parametrize(
    "build",
    [
        fb.Spring,
        fb.Damper,
        fb.HHT,
        lambda field: fb.Scene(gravity=(0.0, field)),
        lambda field: fb.Scene(gravity=field),
        lambda field: fb.arc((0, field), (1, 1), (2, 0)),
    ],
)
def test_where_a_number_is_wanted(build, kind):
    # UFL would try without end to make a number of it.
    with pytest.raises(fb.SceneError, match="Spring|Damper|HHT|gravity|arc"):
        build(FIELDS[kind])


def test_what_is_kept_up_to_date_is_accepted():
    def everything(step):
        pull = step.t * step.dt * (step.u0[1] + step.u[1] + step.psi + step.Dpsi + step.X[0])
        return (pull + step.v[1] + step.omega) * step.virtual_u[1]

    def own(step, law):
        r = fb.MidPoint().resultants(step, law)
        return r._replace(N=r.N + step.t * ufl.sin(step.dt) * step.v[0])

    section = replace(MEMBER, EI=lambda fraction: 100.0 * (2 - fraction))
    solution = run(replace(fb.Newmark(), name="own", resultants=own), everything, section)
    assert len(solution.t) == 2
