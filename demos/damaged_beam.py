r"""A beam that is damaged where it bends: stiffness by a field of one's own, in dolfinx.

A strip is bent to an arc by turning its end, and turned back. Where it has been bent most, it has
lost stiffness for good. Objective: a law of damage with a threshold, written with a Function on the
mesh of dolfinx. Its moment and loss of energy are held against the closed form. Then a force at the
end damages the strip near its clamp alone, against the elastica of the same law by an ODE.

With the largest curvature $K$ so far, $D$ is the damage, as in Mazars' law for one strain (Mazars
1986, doi 10.1016/0013-7944(86)90034-6):

$$ M = (1 - D)\,EI \kappa, \qquad D = A\,(1 - \exp(-B (K - K_0))) $$

for $K > K_0$, else $D = 0$.

Under a couple, $M$ and $\kappa = \alpha/L$ are the same all along, $\alpha$ being the angle of the
end: the moment is $M(\alpha/L)$, on the way back $(1 - D)\,EI \alpha/L$. The lost energy is the
area between both moments over $\alpha$. Under a force $P$ across the end, $\psi' = \kappa(M)$ with
$M = P\,(x(L) - x)$ and $x' = \cos\psi$. $A$ and $B$ are such that $M$ rises with $\kappa$: where it
falls, all damage gathers in one element, and results depend on the mesh.

Units are metre, newton and second.
"""

import logging

import numpy as np
import scipy.integrate
import scipy.optimize

import fx_beam as fb
from shared import script

try:
    from fx_beam import fenicsx
except ImportError as error:
    raise SystemExit(str(error)) from None


import ufl
from dolfinx import fem

log = logging.getLogger("fx_beam.demo")

LENGTH, EA, GA, EI = 1.0, 1e6, 1e6, 4.0  # [m], [N], [N], [N m²]
LIMIT, A, B = 0.5, 0.6, 0.8  # K0 [1/m], A, B [m]
ANGLE = 2.0  # of the end [rad]
FORCE = 4.5  # [N]
STEPS = 20  # to the largest angle or force, and as many back
MESHES = 8, 16, 32  # elements


def damage_of(K):
    """Damage after a largest curvature [1/m]."""
    return A * (1 - np.exp(-B * np.maximum(K - LIMIT, 0.0)))


def closed_form(angles):
    """Moments [N m] at angles of the end that rise and fall."""
    kappa = angles / LENGTH
    return (1 - damage_of(np.maximum.accumulate(kappa))) * EI * kappa


def elastica():
    """End (x, y) [m] of a strip without strain along it and shear, under the force."""
    kappas = np.linspace(0, 4, 4001)
    moments = closed_form(LENGTH * kappas)

    def shot(reach):
        def slopes(s, state):
            x, _, psi = state
            kappa = np.interp(FORCE * (reach - x), moments, kappas)
            return np.cos(psi), np.sin(psi), kappa

        strains = scipy.integrate.solve_ivp(slopes, (0, LENGTH), (0, 0, 0), rtol=1e-9, atol=1e-12)
        return strains.y[:2, -1]

    reach = scipy.optimize.brentq(lambda x: shot(x)[0] - x, 0.3 * LENGTH, LENGTH)
    return shot(reach)


def strip(elements, turned):
    """A clamped strip whose end is turned, or pulled up, and the beam."""
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (LENGTH, 0)], fb.Section(EA, GA, EI), elements, name="strip")
    scene.clamp(beam.start)
    if turned:
        scene.prescribe(beam.end, rotation=lambda t: ANGLE)
    else:
        scene.add_force(beam.end, (0.0, FORCE))
    return scene, beam


def bend(elements, turned=True):
    """Load factors, moments at the end, and damage (steps, elements), there and back; the end."""
    scene, beam = strip(elements, turned)
    problem = fenicsx.Equilibrium(scene)
    space = getattr(fem, "functionspace", fem.FunctionSpace)(problem.mesh, ("DG", 0))
    largest = fem.Function(space, name="K")

    def curvature(step):  # the largest one, of the steps before and of this one
        return ufl.max_value(largest, abs(step.strains1[2]))

    def damage(step):
        return A * (1 - ufl.exp(-B * ufl.max_value(curvature(step) - LIMIT, 0)))

    def damaged(step, law):
        r = fb.Equilibrium().resultants(step, law).end
        return r._replace(M=(1 - damage(step)) * r.M, m=(1 - damage(step)) * r.m)

    problem.replace_resultants(damaged)
    K, D, M = curvature(problem.step), damage(problem.step), problem.resultants[0][2]
    rows, end = [(0.0, 0.0, np.zeros(elements))], None
    there = np.arange(1, STEPS + 1) / STEPS
    for factor in (*there, *there[-2::-1], 0.0):
        problem.advance(factor)
        rows.append((factor, problem.at_points(M)[-1, 0], problem.at_points(D)[:, 0]))
        largest.x.array[:] = problem.interpolate(K).x.array
        if factor == 1.0:
            end = np.array([LENGTH, 0.0]) + _at_end(problem, beam)
    factors, moments, damages = (np.array(column) for column in zip(*rows, strict=True))
    return factors, moments, damages, end


def _at_end(problem, beam):
    """Displacement (2,) of the end of the strip."""
    rows = np.empty(problem.system.M.size[0])
    rows[problem.system.dofs] = problem.q.x.array
    return rows[3 * beam.end.number :][:2]


def lost(angles, moments):
    """Energy [J] that a way there and back takes: the integral of the moment over the angle."""
    return float(np.sum((moments[1:] + moments[:-1]) / 2 * np.diff(angles)))


def compute():
    """The numbers, and what is drawn."""
    log.info("a strip whose end is turned")
    factors, moments, _, _ = bend(MESHES[0])
    angles = ANGLE * factors
    expected = closed_form(angles)
    pulled = {}
    for elements in MESHES:
        log.info("a strip that is pulled, of %d elements", elements)
        pulled[elements] = bend(elements, turned=False)
    reference = elastica()
    numbers = {
        "turned": {
            "largest moment": moments.max(),
            "relative error of moments": abs(moments - expected).max() / expected.max(),
            "lost energy": lost(angles, moments),
            "closed form, by the same steps": lost(angles, expected),
        },
        "pulled": {
            "end by an ODE": reference.tolist(),
            "distance from it": {
                str(n): float(np.hypot(*(end - reference))) for n, (*_, end) in pulled.items()
            },
            "largest damage": {str(n): D.max() for n, (_, _, D, _) in pulled.items()},
        },
    }
    return numbers, (angles, moments, pulled)


def report(numbers):
    turned, pulled = numbers["turned"], numbers["pulled"]
    print(
        f"Turned: up to {turned['largest moment']:.4f} N m, the closed form to "
        f"{turned['relative error of moments']:.0e}; lost {turned['lost energy']:.5f} J, closed "
        f"form {turned['closed form, by the same steps']:.5f} J"
    )
    for elements, distance in pulled["distance from it"].items():
        print(
            f"Pulled, {elements:>2} elements: {1e3 * distance:.2f} mm from the elastica, damage up "
            f"to {pulled['largest damage'][elements]:.3f}"
        )


def draw(results, angles, moments, pulled):
    # Imported here: the numbers need no matplotlib.
    from fx_beam import plot
    from shared import thumbnail

    figure, axes = plot.figure(2, 1, height=2.6)
    end_axes, damage_axes = axes.flat
    end_axes.plot(angles, closed_form(angles), "k-", linewidth=0.8, label="closed form")
    end_axes.plot(angles, moments, "C0o", fillstyle="none", label="dolfinx")
    end_axes.set(xlabel="angle of the end [rad]", ylabel="moment [N m]")
    for number, (elements, (_, _, D, _)) in enumerate(pulled.items(), start=1):
        s = (np.arange(elements) + 0.5) * LENGTH / elements
        damage_axes.step(s, D[-1], f"C{number}", where="mid", label=f"{elements} elements")
    damage_axes.set(xlabel="place $s$ [m]", ylabel="damage $D$, strip pulled")
    plot.save(figure, results / "damage.png")
    scene, _ = strip(MESHES[1], turned=True)
    shown = fb.static(scene, load_steps=40)
    plot.animate(shown, results / "motion.gif")
    thumbnail.card(shown, range(len(shown.t)), results / "thumbnail.png")


if __name__ == "__main__":
    script.run()
