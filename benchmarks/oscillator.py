"""Spectral radius and period error of the schemes, measured on one oscillator.

    .venv/bin/python benchmarks/oscillator.py [picture]

A unit mass hangs on a massless rod of stiffness w^2 and vibrates along it, with steps of 1 s. The
linear recurrence of its displacements has the eigenvalues of a step: the largest modulus is the
spectral radius, the angle of that eigenvalue gives the period.
"""

import sys
from pathlib import Path

import numpy as np

import fx_beam as fb

STEPS = 12
SCHEMES = {
    "EnergyMomentum, MidPoint, Newmark": (fb.EnergyMomentum(), "#D55E00", "-"),
    "EnergyMomentum, order 4": (fb.EnergyMomentum(order=4), "#D55E00", ":"),
    "EnergyDecaying, 0.1": (fb.EnergyDecaying(), "#0072B2", "-"),
    "EnergyDecaying, 0.5": (fb.EnergyDecaying(0.5), "#0072B2", "--"),
    "EnergyDecaying, 0.1, order 1": (fb.EnergyDecaying(order=1), "#56B4E9", "-"),
    "HHT, -0.1": (fb.HHT(-0.1), "#009E73", "-"),
    "HHT, -0.3": (fb.HHT(-0.3), "#009E73", "--"),
    "generalized alpha, 0.9": (fb.GeneralizedAlpha(0.9), "#CC79A7", "-"),
    "generalized alpha, 0.5": (fb.GeneralizedAlpha(0.5), "#CC79A7", "--"),
}


def vibration(scheme, w, steps):
    """Motion of the mass for the angular frequency times the step, and its rod."""
    scene = fb.Scene()
    rod = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=w**2, GA=w**2, EI=w**2), elements=1)
    scene.clamp(rod.start)
    scene.fix(rod.end, "y", "rotation")
    scene.add_mass(rod.end, 1.0)
    scene.set_velocity(rod.end, (1e-3 * max(1, w) ** 2, 0.0))
    return fb.simulate(scene, scheme, dt=1.0, t_end=float(steps)), rod


def eigenvalue(scheme, w):
    """Eigenvalue of largest modulus of a step, for the angular frequency times the step."""
    solution, rod = vibration(scheme, w, STEPS)
    u = solution.displacement(rod.end)[1:, 0]
    # u_n+3 = c_2 u_n+2 + c_1 u_n+1 + c_0 u_n: no scheme has more than three modes.
    rows = np.column_stack([u[k : k - 3] for k in range(3)])
    c = np.linalg.lstsq(rows / abs(u).max(), u[3:] / abs(u).max(), rcond=1e-10)[0]
    roots = np.roots([1.0, *-c[::-1]])
    return roots[np.argmax(abs(roots) + 1e-9 * roots.imag)]


def main(picture=Path("oscillator.png")):
    from fx_beam import plot

    figure, axes = plot.figure(2, 1)
    radius, period = axes.flat
    for name, (scheme, colour, style) in SCHEMES.items():
        w = np.logspace(-2, 4, 121)
        eigenvalues = np.array([eigenvalue(scheme, x) for x in w])
        line = {"color": colour, "linestyle": style, "linewidth": 1.2}
        radius.semilogx(w, abs(eigenvalues), **line, label=name)
        slow = w < 2.0
        period.loglog(w[slow], abs(w[slow] / abs(np.angle(eigenvalues[slow])) - 1), **line)
        print(
            f"{name:34} least spectral radius {abs(eigenvalues).min():.4f}, "
            f"{abs(eigenvalues[-1]):.4f} at 1e4"
        )
    radius.set(ylabel="spectral radius", ylim=(0, 1.05))
    period.set(ylabel="relative error of the period", ylim=(1e-9, 1))
    for ax in axes.flat:
        ax.set(xlabel="angular frequency times step")
    plot.save(figure, Path(picture))


if __name__ == "__main__":
    main(*sys.argv[1:])
