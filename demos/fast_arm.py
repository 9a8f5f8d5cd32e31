r"""A flexible arm turns by 90 degrees in the shortest time and rests: 40 numbers of a motor.

An arm of aluminium with a mass at its tip turns in a horizontal plane. A motor prescribes the angle
of its hub; its angular acceleration is limited to $a_\mathrm{max}$. Objective: the shortest time
$T$ in which the arm turns by 90 degrees so that after $T$ the tip stays within 1 mm of its goal.
There is no damping: a vibration that is left at $T$ does not decay.

This example is our own. A flexible body that turns in the shortest time by a bounded control is
the problem of G. Singh, P. T. Kabamba, N. H. McClamroch, Planar, time-optimal, rest-to-rest slewing
maneuvers of flexible spacecraft, Journal of Guidance, Control, and Dynamics 12(1) (1989) 71-81,
of a linear model; the control is then always at one of its limits.

The acceleration is constant in each of 40 intervals of $[0, T]$, $a_\mathrm{max}$ times the entries
of $P c$, with

$$ -1 \le P c \le 1, \qquad \dot\theta(T) = 0, \qquad \theta(T) = 90^\circ. $$

$P$ is the unit matrix: 40 free numbers $c$. For comparison, $P c$ are the values of a polynomial of
degree 7, with 8 numbers $c$, so that the angle has degree 9. For each $T$ the numbers minimise the
mean square of the distance of the tip from its goal in a window after $T$. `Response.vjp` gives the
gradient, from the motion that has just been computed. The interval between a $T$ that fails and one
that succeeds is bisected; a minimum that fails may be a local one. The usual polynomial of degree 5
for the angle, without speed and acceleration at both ends, has only one number, the time $T$. A
rigid arm needs the time $2 \sqrt{\pi/(2 a_\mathrm{max})}$. Units are metre, kilogram and second.
"""

import logging
from time import process_time

import numpy as np
from scipy.optimize import LinearConstraint, minimize, minimize_scalar

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

LENGTH, WIDTH, HEIGHT, LOAD = 1.0, 20e-3, 3e-3, 0.05  # [m], mass at the tip [kg]
ALUMINIUM = {"E": 70e9, "nu": 0.33, "rho": 2700.0}
ANGLE, A_MAX = np.pi / 2, 12.0  # [rad], [rad/s²]
GOAL = LENGTH * np.array([np.cos(ANGLE), np.sin(ANGLE)])
INTERVALS, DEGREE = 40, 7  # of the acceleration; degree of the best polynomial
LIMIT, WINDOW = 1e-3, 0.3  # distance of the tip [m], time after T in which it counts [s]
ELEMENTS, STEPS = 4, 4  # of the arm, of degree 2; in each interval
FINER = 4  # times as many elements and steps, for the error of both
RIGID = 2 * np.sqrt(ANGLE / A_MAX)  # shortest time of a rigid arm [s]
MIDDLES = np.arange(INTERVALS) + 0.5  # middles of the intervals, in terms of their length
FREE = np.eye(INTERVALS)
POLYNOMIAL = np.polynomial.legendre.legvander(2 * MIDDLES / INTERVALS - 1, DEGREE)


def motor(profile, T):
    """Angle over time: profile are accelerations in terms of a_max."""
    h = T / INTERVALS
    knots = h * np.arange(INTERVALS + 1)
    a = A_MAX * np.append(profile, 0.0)
    rates = np.append(0.0, np.cumsum(a[:-1] * h))
    angles = np.append(0.0, np.cumsum((rates[1:] + rates[:-1]) * h / 2))

    def angle(t):
        i = min(int(t / h), INTERVALS)
        s = t - knots[i]
        return angles[i] + s * (rates[i] + s * a[i] / 2)

    return angle


def quintic(T):
    """Accelerations of the polynomial of degree 5, means of the intervals."""
    s = np.linspace(0, 1, INTERVALS + 1)
    rate = ANGLE / T * 30 * s**2 * (1 - s) ** 2
    return np.diff(rate) / (A_MAX * T / INTERVALS)


class Turn:
    """The motion with a motor that stops at T, as a function of c."""

    def __init__(self, T, P=FREE, finer=1):
        self.T, self.P, self.elements, self.motions = T, P, finer * ELEMENTS, 0
        self.dt = T / (INTERVALS * STEPS * finer)
        self.steps = INTERVALS * STEPS * finer + round(WINDOW / self.dt)
        self.run = fb.Response(self.build, dt=self.dt, t_end=self.steps * self.dt)

    def build(self, c):
        scene = fb.Scene()
        section = fb.Section.rectangle(height=HEIGHT, width=WIDTH, **ALUMINIUM)
        arm = scene.add_beam(
            [(0, 0), (LENGTH, 0)], section, elements=self.elements, degree=2, name="arm"
        )
        drive = motor(self.P @ c, self.T)
        scene.add_joint(fb.Revolute(fb.GROUND, arm.start, motor=drive))
        scene.add_mass(arm.end, LOAD)
        return scene, {"tip": fb.Output("position", arm.end)}

    def off(self, c):
        """Tip from its goal (n, 2), zero before T."""
        self.motions += 1
        t, y = self.run(c)
        return np.where(t[:, None] < self.T - self.dt / 2, 0.0, y["tip"] - GOAL)

    def largest(self, c):
        """Largest distance of the tip from its goal after T [m]."""
        return float(np.hypot(*self.off(c).T).max())

    def cost(self, c):
        """Mean square of the distance after T, in terms of the limit, and its gradient."""
        off = self.off(c)
        scale = LIMIT**2 * WINDOW / self.dt
        return (off**2).sum() / scale, self.run.vjp({"tip": 2 * off / scale})

    def best(self, start):
        """Numbers c with the least vibration, near those that are given."""
        h, P = self.T / INTERVALS, self.P
        # Rate at T, and angle at T in terms of the goal.
        ends = np.array([np.ones(INTERVALS), (INTERVALS - MIDDLES) * h**2 * A_MAX / ANGLE])
        limits = [LinearConstraint(P, -1, 1), LinearConstraint(ends @ P, [0, 1], [0, 1])]
        options = {"maxiter": 100, "ftol": 1e-4}
        return minimize(
            self.cost, start, jac=True, method="SLSQP", constraints=limits, options=options
        ).x

    def solution(self, c):
        """The whole motion."""
        return fb.simulate(self.build(c)[0], dt=self.dt, t_end=self.steps * self.dt)


def shortest(P, T, c, within):
    """Shortest T to some seconds with its numbers c, from some that succeed, and what it took."""
    failed, motions, start = RIGID, 0, process_time()
    while T - failed > within:
        turn = Turn((failed + T) / 2, P)
        best = turn.best(c)
        distance = turn.largest(best)
        log.info("T = %.4f s: %d motions, %.3g mm", turn.T, turn.motions, 1e3 * distance)
        motions += turn.motions
        if distance <= LIMIT:
            T, c = turn.T, best
        else:
            failed = turn.T
    took = {"failed": failed, "motions": motions, "seconds": process_time() - start}
    return Turn(T, P), c, took


def numbers_of(turn, c):
    """Numbers of the motion of one profile."""
    energy = turn.solution(c).energy
    return {
        "T": turn.T,
        "largest acceleration": float(abs(turn.P @ c).max()) * A_MAX,
        "tip off its goal": turn.largest(c),
        "with finer steps and elements": Turn(turn.T, turn.P, FINER).largest(c),
        "energy left": float(energy.total[-1]),
        "largest energy": float(energy.total.max()),
        "largest energy error": float(abs(energy.balance_error).max()),
    }


def gradient_times(T, c, finer):
    """Processor time [s] of a cost with its gradient, by vjp and by differences."""
    turn = Turn(T, finer=finer)
    turn.cost(c)
    start = process_time()
    turn.cost(c * 0.999)
    middle = process_time()
    for i in range(5):
        turn.off(c * (0.998 - 1e-3 * i))
    end = process_time()
    return {"vjp": middle - start, "differences": (INTERVALS + 1) / 5 * (end - middle)}


def compute(within=4e-3):
    """The numbers, and what is drawn; shortest times to some seconds."""
    quick = np.sqrt(10 / np.sqrt(3) * ANGLE / A_MAX)  # where the polynomial of degree 5 has a_max
    usual = minimize_scalar(
        lambda T: Turn(T).largest(quintic(T)), bounds=(quick, 1.4 * quick), method="bounded"
    ).x
    c = np.linalg.lstsq(POLYNOMIAL, quintic(usual), rcond=None)[0]
    polynomial, c_polynomial, took_polynomial = shortest(POLYNOMIAL, usual, c, within)
    free, c, took = shortest(FREE, polynomial.T, POLYNOMIAL @ c_polynomial, within)
    turns = {
        "40 numbers": (free, c),
        "best polynomial": (polynomial, c_polynomial),
        "degree 5": (Turn(usual), quintic(usual)),
        "degree 5, as fast": (Turn(free.T), quintic(free.T)),
    }
    numbers = {name: numbers_of(*turn) for name, turn in turns.items()}
    numbers["40 numbers"] |= took
    numbers["best polynomial"] |= took_polynomial
    numbers["rigid arm"] = {"T": RIGID}
    numbers["gradient"] = gradient_times(free.T, c, 1)
    numbers["gradient, finer"] = gradient_times(free.T, c, FINER)
    return numbers, (turns,)


def report(numbers):
    for name in ("40 numbers", "best polynomial", "degree 5", "degree 5, as fast"):
        own = numbers[name]
        print(
            f"{name:>17}: T = {own['T']:.3f} s, {own['largest acceleration']:5.2f} rad/s^2, tip "
            f"within {1e3 * own['tip off its goal']:.2g} mm, energy left "
            f"{own['energy left']:.1e} of {own['largest energy']:.2f} J"
        )
    own = numbers["40 numbers"]
    print(f"40 numbers: {own['motions']} motions, {own['seconds']:.1f} s")
    for name in ("gradient", "gradient, finer"):
        own = numbers[name]
        print(f"{name}: {own['vjp']:.2f} s, by differences {own['differences']:.2f} s")


def draw(results, turns):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    figure, axes = plot.figure(1, 2, height=3.2)
    profiles, distances = axes.flat
    colours = {"40 numbers": "#0072B2", "best polynomial": "#D55E00", "degree 5": "#009E73"}
    for name, colour in colours.items():
        turn, c = turns[name]
        edges = np.linspace(0, turn.T, INTERVALS + 1)
        look = {"color": colour, "label": f"{name}, {turn.T:.2f} s"}
        profiles.stairs(A_MAX * (turn.P @ c), edges, baseline=None, **look)
        solution = turn.solution(c)
        tip = solution.beams["arm"].end
        off = np.hypot(*(solution.position(tip) - GOAL).T)
        distances.semilogy(solution.t, 1e3 * off, **look)
    distances.axhline(1e3 * LIMIT, color="0.5", lw=1)
    profiles.set(xlabel="time $t$ [s]", ylabel="acceleration of the motor [rad/s$^2$]")
    distances.set(xlabel="time $t$ [s]", ylabel="tip from its goal [mm]", ylim=(1e-3, None))
    plot.save(figure, results / "profiles.png")
    turn, c = turns["40 numbers"]
    rows = range(0, INTERVALS * STEPS + 1, 4 * STEPS)
    fastest = turn.solution(c)
    plot.shapes(fastest, results / "shapes.png", rows=rows)
    plot.animate(fastest, results / "motion.gif")
    thumbnail.card(fastest, range(0, len(fastest.t), 4), results / "thumbnail.png")


if __name__ == "__main__":
    script.run()
