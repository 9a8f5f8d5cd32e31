"""Steps and Newton iterations in contact: a ball that bounces, by stiffness and by tolerance.

.venv/bin/python benchmarks/contact.py
"""

import numpy as np

import fx_beam as fb


def ball(stiffness):
    """A mass of 1 kg, 5 cm above a floor; a bounce takes 0.2 s."""
    scene = fb.Scene(gravity=(0, -10))
    mass = scene.add_body((0, 0.05), 1.0, 1.0).centre
    scene.add_contact(mass, fb.Line((0, 0), normal=(0, 1)), stiffness)
    return scene


def main():
    print("stiffness [N/m]   iterations a step   halvings   balance error / fall, to 20 s")
    for stiffness in (1e5, 1e6, 1e9, 1e12):
        solution = fb.simulate(ball(stiffness), dt=0.01, t_end=20.0)
        stats, error = solution.stats, abs(solution.energy.balance_error).max() / 0.5
        iterations = stats.newton_iterations / stats.steps
        print(f"{stiffness:15g} {iterations:19.1f} {stats.halvings:10} {error:12.0e}")
    solution = fb.simulate(ball(1e5), tolerance=1e-4, t_end=2.0)
    lengths = np.diff(solution.t)
    print(f"tolerance 1e-4, 1e5 N/m, 2 s: {solution.stats.steps} steps, ", end="")
    print(f"from {lengths.min():.1e} to {lengths.max():.1e} s")


if __name__ == "__main__":
    main()
