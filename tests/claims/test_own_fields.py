"""Functions and constants of UFL that users bring along are refused: they would be frozen."""

from dataclasses import replace
from importlib.util import find_spec

import ufl

import pytest
from jointed import MEMBER
from scenes import assert_refused, clamped_bar

import fx_beam as fb
from fx_beam.fem import elements

ON = elements.domain(1)
FIELDS = {"Constant": ufl.Constant(ON), "Coefficient": elements.Symbols(ON).data(1)}
if find_spec("dolfinx"):  # whose constant is a number as well
    from mpi4py import MPI

    import dolfinx

    LINE = dolfinx.mesh.create_interval(MPI.COMM_SELF, 1, (0.0, 1.0))
    # The name depends on the version of dolfinx.
    SPACE = getattr(dolfinx.fem, "functionspace", dolfinx.fem.FunctionSpace)(LINE, ("DG", 0))
    FIELDS |= {"Constant": dolfinx.fem.Constant(LINE, 2.0), "Function": dolfinx.fem.Function(SPACE)}
every_field = pytest.mark.parametrize("kind", FIELDS)


def run(scheme=None, term=None, section=MEMBER):
    scene, beam = clamped_bar((1, 0), section, elements=1)
    if term is not None:
        scene.add_virtual_work(term)
    return fb.simulate(scene, scheme, dt=0.1, t_end=0.1)


def prestressed(name, value):
    """The mid-point rule with a field added to one of its resultants."""

    def resultants(step, law):
        r = fb.MidPoint().resultants(step, law)
        return r._replace(**{name: getattr(r, name) + value})

    return replace(fb.MidPoint(), name="own", resultants=resultants)


EI = "Section: EI at the fraction 0.5 of the length"
FORMS = {
    "virtual work 1": lambda field: run(term=lambda step: field * step.t * step.virtual_u[1]),
    "strain_energy": lambda field: fb.Section(
        strain_energy=lambda e, g, k: field * (e**2 + g**2 + k**2)
    ),
    "Damper: law": lambda field: fb.Damper(law=lambda rate: field * rate),
    EI: lambda field: fb.Section(EA=1.0, GA=1.0, EI=lambda fraction: 2 * field),
    "resultants of own": lambda field: run(prestressed("N", field)),
    "resultants of own ": lambda field: run(prestressed("m", field)),
}


@every_field
@pytest.mark.parametrize("what", FORMS)
def test_in_a_form(what, kind):
    of_your_own = f"{what.strip()}.* it contains .*, a {kind} of your own.*step.t"
    assert_refused(of_your_own, lambda: FORMS[what](FIELDS[kind]))


@every_field
@pytest.mark.parametrize(
    "build",
    [
        fb.Spring,
        fb.HHT,
        lambda field: fb.Section(EA=1.0, GA=1.0, EI=field),
        lambda field: fb.Scene(gravity=(0.0, field)),
        lambda field: fb.Scene(gravity=field),
        lambda field: fb.arc((0, field), (1, 1), (2, 0)),
    ],
)
def test_where_a_number_is_wanted(build, kind):
    # UFL would try without end to make a number of it.
    assert_refused("Spring|Section: EI|HHT|gravity|arc", lambda: build(FIELDS[kind]))


def test_what_is_kept_up_to_date_is_accepted():
    def everything(step):
        pull = step.t * step.dt * (step.u0[1] + step.u[1] + step.psi + step.Dpsi + step.X[0])
        return (pull + step.v[1] + step.omega) * step.virtual_u[1]

    def resultants(step, law):
        r = fb.MidPoint().resultants(step, law)
        return r._replace(N=r.N + step.t * ufl.sin(step.dt) * step.v[0])

    section = replace(MEMBER, EI=lambda fraction: 100.0 * (2 - fraction))
    scheme = replace(fb.Newmark(), name="own", resultants=resultants)
    assert len(run(scheme, everything, section).t) == 2
