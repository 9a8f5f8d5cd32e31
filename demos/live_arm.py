r"""A three-link arm, driven by hand in a browser: a slider for each motor, the mouse for the rest.

Three flexible links turn by motors, with a payload at the tip and a table below. Objective: drive
the arm live; the balance of energy holds whatever the hand does. In the folder `demos`,
`python -c "import live_arm; live_arm.show()"` opens the page, where one moves the sliders of the
motors and pulls with the mouse.

Here a program takes the place of the hand. The motors go to new angles, a force $F$ pushes the tip
meanwhile, and the arm comes to rest. At each instant the work of motors and push is what is stored,
or lost in the material:

$$ W = \Delta (K + \Pi) + D $$

The tip comes to rest where the static equilibrium has it, at the angles $q_i$ of the motors. For
rigid links of length $L_i$ this would be

$$ x = \sum_i L_i \cos \left( \sum_{k \le i} q_k \right) \qquad
   y = \sum_i L_i \sin \left( \sum_{k \le i} q_k \right) $$

above which the flexible arm sags by its weight.
"""

import numpy as np

import fx_beam as fb
from shared import script

LENGTHS = 1.0, 0.8, 0.5
LINK = fb.Section.rectangle(
    height=15e-3, width=20e-3, E=70e9, nu=0.33, rho=2700.0, retardation=3e-2
)
MOTOR, PAYLOAD = 0.3, 0.5  # masses at the joints and at the tip
TABLE = -0.8  # height
START, END = (0.8, -0.6, -0.5), (0.2, -0.9, 0.4)  # angles of the motors
PUSH = (20.0, 30.0)
WAY, PUSHED, T_END, DT = 1.0, (0.3, 0.6), 8.0, 2e-3  # PUSHED: start and end of the push
NAMES = "shoulder", "elbow", "wrist"


def rigid_tip(angles):
    """Place of the tip of rigid links."""
    turns = np.cumsum(angles)
    return np.array([np.dot(LENGTHS, np.cos(turns)), np.dot(LENGTHS, np.sin(turns))])


def scene(angles):
    """The arm at some angles, which motors change from there; its tip."""
    made = fb.Scene(gravity=(0.0, -9.81))
    place, before = np.zeros(2), fb.GROUND
    for name, length, turn in zip(NAMES, LENGTHS, np.cumsum(angles), strict=True):
        end = place + length * np.array([np.cos(turn), np.sin(turn)])
        link = made.add_beam([place, end], LINK, elements=6, name=name)
        made.add_joint(fb.Revolute(before, link.start, motor=fb.Input(name)))
        made.add_mass(link.end, PAYLOAD if name == NAMES[-1] else MOTOR, inertia=1e-3)
        place, before = end, link.end
    table = fb.Line((0.0, TABLE), normal=(0, 1))
    made.add_contact(before, table, stiffness=1e4)
    return made, before


def arm():
    """A motion of the arm from its equilibrium at the start, and its tip."""
    made, tip = scene(START)
    outputs = {"tip": fb.Output("position", tip)}
    start = fb.static(made)
    return fb.Motion(made, dt=DT, outputs=outputs, start=start, record=fb.Record()), tip


def show():
    """Show the arm in a browser, until its page is ended."""
    motion, _ = arm()
    fb.plot.live(motion, limits=dict.fromkeys(NAMES, (-1.5, 1.5))).wait()


def turned(t):
    """What the motors have turned, with accelerations that do not jump, by name."""
    part = min(t / WAY, 1.0)
    part -= np.sin(2 * np.pi * part) / (2 * np.pi)
    return dict(zip(NAMES, part * np.subtract(END, START), strict=True))


def compute():
    """The numbers, and what is drawn."""
    motion, tip = arm()
    while motion.t < T_END - DT / 2:
        pushes = PUSHED[0] <= motion.t < PUSHED[1]
        motion.step(turned(motion.t + DT), {tip: PUSH} if pushes else {})
    solution, (made, held) = motion.solution(), scene(END)
    rest, rigid = fb.static(made).position(held)[-1], rigid_tip(END)
    energy = solution.energy
    numbers = {
        "tip": solution.position(tip)[-1].tolist(),
        "tip in equilibrium": rest.tolist(),
        "tip of rigid links": rigid.tolist(),
        "work": float(energy.work[-1] - energy.work[0]),
        "lost": float(energy.dissipated[-1]),
        "energy balance": float(abs(energy.balance_error).max() / np.ptp(energy.work)),
    }
    return numbers, (solution, tip)


def report(numbers):
    x, y = numbers["tip"]
    equilibrium, rigid = numbers["tip in equilibrium"], numbers["tip of rigid links"]
    print(
        f"The tip comes to rest at ({x:.4f}, {y:.4f}) m; in equilibrium it is at "
        f"({equilibrium[0]:.4f}, {equilibrium[1]:.4f}) m, {rigid[1] - equilibrium[1]:.4f} m below "
        "that of rigid links\n"
        f"Motors and push do the work {numbers['work']:.4f} J, of which {numbers['lost']:.4f} J "
        "are lost in the material\n"
        f"Energy balance: {numbers['energy balance']:.0e} of the work"
    )


def draw(results, solution, tip):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    plot.shapes(solution, results / "shapes.png", times=(0.0, WAY / 2, T_END))
    rows = range(0, int(2.0 / DT), 20)
    plot.animate(solution, results / "motion.gif", rows=rows)
    thumbnail.card(solution, rows, results / "thumbnail.png")
    figure, axes = plot.figure(1, 2, height=3.0)
    place, work = axes.flat
    place.plot(solution.t, solution.position(tip), label=("$x$", "$y$"))
    place.set(xlabel="time $t$ [s]", ylabel="tip [m]")
    energy = solution.energy
    work.plot(solution.t, energy.work - energy.work[0], label="work of motors and push")
    work.plot(solution.t, energy.total - energy.total[0], label="stored")
    work.plot(solution.t, energy.dissipated, label="lost in the material")
    work.set(xlabel="time $t$ [s]", ylabel="energy [J]")
    plot.save(figure, results / "tip_and_work.png")


if __name__ == "__main__":
    script.run()
