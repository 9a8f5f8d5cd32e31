"""The response of a stressed arm to a harmonic load, and the same from long motions.

    .venv/bin/python benchmarks/frequency_response.py [picture]

An arm hangs under gravity on a hinge that slides, with springs and dampers on both coordinates. The
curves are those of `frequency_response` about the static state, the crosses amplitude and phase of
the last period of motions of 25 s, after which the slowest vibration has decayed to 2e-5.
"""

import sys
from pathlib import Path

import numpy as np

import fx_beam as fb

FORCE = 1e-3 * np.array([1.0, -2.0])
SEEN = 0.25, 0.6, 1.0, 1.4, 2.2, 4.0, 8.0
STEPS = 300  # in a period; its error is about (2 pi / 300)^2 / 12 = 4e-5


def arm(load=None):
    """The scene, the arm and its joint, with a load over time at the end."""
    scene = fb.Scene(gravity=(0.0, -9.81))
    section = fb.Section(EA=1e4, GA=1e4, EI=20.0, rhoA=1.0, rhoI=1e-2, retardation=0.01)
    post = scene.add_beam([(0, 0), (0.5, 0)], section, elements=3, degree=2)
    scene.clamp(post.start)
    arm = scene.add_beam([(0.5, 0), (1.3, 0.2)], section, elements=4, degree=2)
    slide_laws = {"spring": fb.Spring(60.0), "damper": fb.Damper(2.0)}
    hinge = fb.Coordinate(spring=fb.Spring(30.0), damper=fb.Damper(0.8))
    joint = fb.PinInSlot(post.end, arm.start, axis=(0.6, 0.8), hinge=hinge, **slide_laws)
    joint = scene.add_joint(joint)
    if load is not None:
        scene.add_force(arm.end, load)
    return scene, arm, joint


def seen(f, state):
    """Complex amplitudes of the end (x, y, rotation) in a long motion."""
    w = 2 * np.pi * f
    scene, moved, _ = arm(lambda t: FORCE * np.cos(w * t))
    motion = fb.simulate(scene, dt=1 / (STEPS * f), t_end=round(25 * f) / f, start=state)
    t = motion.t[-STEPS - 1 :]
    waves = np.column_stack([np.cos(w * t), np.sin(w * t), np.ones_like(t)])
    histories = [*motion.displacement(moved.end).T, motion.rotation(moved.end)]
    last = np.column_stack([history[-STEPS - 1 :] for history in histories])
    a, b, _ = np.linalg.lstsq(waves, last, rcond=None)[0]
    return a - 1j * b


def main(picture=Path("frequency_response.png")):
    from fx_beam import plot

    scene, beam, _ = arm()
    state = fb.static(scene)
    load = beam.end, FORCE
    motions = np.array([seen(f, state) for f in SEEN])
    response = fb.frequency_response(scene, load, beam.end, SEEN, state)
    differences = abs(response.values - motions).max(axis=1) / abs(motions).max(axis=1)
    for f, difference in zip(SEEN, differences, strict=True):
        print(f"{f:5.2f} Hz: difference from the motion {difference:.1e} of the amplitude")
    f = np.geomspace(0.2, 10.0, 400)
    stressed = fb.frequency_response(scene, load, beam.end, f, state).component("y")
    unloaded = fb.frequency_response(scene, load, beam.end, f).component("y")
    figure, axes = plot.figure(2, 1)
    amplitude, phase = axes.flat
    for values, kind in ((stressed, "about the static state"), (unloaded, "about the start")):
        look = {"color": "#0072B2"} if values is stressed else {"color": "0.6", "linestyle": "--"}
        amplitude.loglog(f, abs(values), **look, label=kind)
        phase.semilogx(f, np.degrees(np.unwrap(np.angle(values))), **look)
    cross = {"marker": "x", "linestyle": "", "color": "#D55E00"}
    amplitude.plot(SEEN, abs(motions[:, 1]), **cross, label="motions of 25 s")
    phase.plot(SEEN, np.degrees(np.unwrap(np.angle(motions[:, 1]))), **cross)
    amplitude.set(ylabel="amplitude of y [m]")
    phase.set(ylabel="phase [deg]", xlabel="frequency of the load [Hz]")
    plot.save(figure, Path(picture))


if __name__ == "__main__":
    main(*sys.argv[1:])
