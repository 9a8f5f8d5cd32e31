"""Cost of a scene by what it has: modules, compiled code, memory, unknowns, set-up and steps.

    ./run report cost            three minutes
    ./run report cost --quick    counts only, of a few scenes
    ./run report cost --docs     and renew the page and the picture of docs/

Each scene but the first is the plainest one, a beam of 8 elements on a pin, with one thing more. It
is computed in a process of its own, first with an empty cache. Counts are those after its first
result; times around steps and of a step are medians of further calls. Memory is that of the arrays
which the compiled loop has, without the rows of the solution.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median
from time import perf_counter

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
SECTION = {"EA": 1e4, "GA": 1e4, "EI": 100.0, "rhoA": 1.0, "rhoI": 0.1}
DT, STEPS = 1e-3, 200
PLAIN = "beam"


# -- Scenes ----------------------------------------------------------------------------------------


def beam(fb, elements=8, **data):
    """The plainest scene, and its beam."""
    scene = fb.Scene(gravity=(0, -9.81))
    rod = scene.add_beam([(0, 0), (1, 0.3)], fb.Section(**SECTION | data), elements=elements)
    scene.pin(rod.start)
    return scene, rod


def single_body(fb):
    scene = fb.Scene(gravity=(0, -9.81))
    scene.add_body((0, 0), mass=1.0, inertia=0.1)
    return scene


def hinge(fb, **laws):
    """Two beams of 4 elements."""
    scene, first = beam(fb, 4)
    second = scene.add_beam([(1, 0.3), (2, 0.3)], fb.Section(**SECTION), elements=4)
    scene.add_joint(fb.Revolute(first.end, second.start, **laws))
    return scene


def rigid_joint(fb):
    """Two beams of 4 elements, which is what a hinge is compared with."""
    scene, first = beam(fb, 4)
    scene.add_beam([first.end, (2, 0.3)], fb.Section(**SECTION), elements=4)
    return scene


def with_body(fb, joint):
    """The beam, and a body that a joint holds at its end."""
    scene, rod = beam(fb)
    body = scene.add_body((rod.end.x, rod.end.y), mass=0.5, inertia=0.02)
    scene.add_joint(joint(rod, body.centre))
    return scene


def slide(fb):
    return with_body(fb, lambda rod, body: fb.Prismatic(rod.end, body, axis=(1, 0)))


def slider(fb):
    scene, rod = beam(fb)
    rest = rod.node(0.5)
    body = scene.add_body((rest.x, rest.y), mass=0.5, inertia=0.02)
    scene.add_joint(fb.Slider(rod, body.centre, fraction=0.5))
    return scene


def loop(fb):
    """A body that is hinged to the end of the beam and to the ground."""
    scene, rod = beam(fb)
    body = scene.add_body(
        (1.2, 0.8), mass=0.5, inertia=0.02, points={"a": (1, 0.3), "b": (1.4, 1.3)}
    )
    scene.add_joint(fb.Revolute(rod.end, body["a"]))
    scene.add_joint(fb.Revolute(body["b"], fb.GROUND))
    return scene


def spring(fb):
    return hinge(fb, spring=fb.Spring(5.0))


def force(fb):
    scene, rod = beam(fb)
    scene.add_force(rod.end, lambda t: (t, 1.0))
    return scene


def motor(fb):
    return hinge(fb, motor=lambda t: t * t)


def obstacle(fb, **laws):
    scene, rod = beam(fb)
    scene.add_contact(rod, fb.Line((0, -0.01), (0, 1)), stiffness=1e3, **laws)
    return scene


def obstacle_with_friction(fb):
    return obstacle(fb, friction=fb.Coulomb(0.3, 500.0))


def contact_of_members(fb):
    scene, rod = beam(fb)
    other = scene.add_beam([(0.5, -0.05), (1.5, -0.05)], fb.Section(**SECTION), elements=2)
    scene.clamp(other.end)
    scene.add_contact(other, rod, stiffness=1e4, radius=0.05)
    return scene


def retardation(fb):
    return beam(fb, retardation=1e-3)[0]


def own_material(fb):
    def energy(eps, gamma, kappa):
        return 5e3 * (eps**2 + gamma**2) + 50 * kappa**2 + 20 * kappa**4

    scene = fb.Scene(gravity=(0, -9.81))
    rod = scene.add_beam(
        [(0, 0), (1, 0.3)], fb.Section(strain_energy=energy, rhoA=1.0, rhoI=0.1), elements=8
    )
    scene.pin(rod.start)
    return scene


def everything(fb):
    """All of the above at once, as far as it fits into a scene."""
    scene, rod = beam(fb, retardation=1e-3)
    section = fb.Section(**SECTION)
    arm = scene.add_beam([(1, 0.3), (2, 0.3)], section, elements=4)
    scene.add_joint(fb.Revolute(rod.end, arm.start, spring=fb.Spring(5.0)))
    stay = scene.add_beam([(2, 0.3), (2, 1.5)], section, elements=4)
    scene.add_joint(fb.Revolute(arm.end, stay.start))
    scene.pin(stay.end)
    rest = arm.node(0.5)
    bead = scene.add_body((rest.x, rest.y), mass=0.5, inertia=0.02)
    scene.add_joint(fb.Slider(arm, bead.centre, fraction=0.5))
    block = scene.add_body((1.0, 0.3), mass=0.5, inertia=0.02)
    scene.add_joint(fb.Prismatic(rod.end, block.centre, axis=(1, 0), spring=fb.Spring(10.0)))
    scene.add_force(rod.end, lambda t: (t, 1.0))
    friction = fb.Coulomb(0.3, 500.0)
    scene.add_contact(rod, fb.Line((0, -0.1), (0, 1)), stiffness=1e3, friction=friction)
    other = scene.add_beam([(0.5, -0.05), (1.5, -0.05)], section, elements=2)
    scene.clamp(other.end)
    scene.add_contact(other, rod, stiffness=1e4, radius=0.05)
    return scene


def motion(fb, scene, **options):
    return fb.simulate(scene, dt=DT, **{"t_end": STEPS * DT} | options)


def order_four(fb, scene, **options):
    return motion(fb, scene, scheme=fb.EnergyMomentum(order=4), **options)


def static(fb, scene):
    return fb.static(scene, load_steps=10)


def modes(fb, scene):
    return fb.modes(scene)


def gradient(fb, scene):
    """The gradient of the last positions by the bending stiffness; `scene` is built anew."""

    def build(x):
        made, rod = beam(fb, EI=x[0])
        return made, {"tip": fb.Output("position", rod.end)}

    run = fb.Response(build, dt=DT, t_end=STEPS * DT)
    _, y = run([100.0])
    run.vjp({"tip": np.ones(y["tip"].shape)})
    return run


#: Of each scene what makes it, and what computes it.
SCENES = {
    "single body": (single_body, motion),
    PLAIN: (lambda fb: beam(fb)[0], motion),
    "+ node in the middle": (rigid_joint, motion),
    "+ hinge": (hinge, motion),
    "+ hinge with a spring": (spring, motion),
    "+ hinge with a motor": (motor, motion),
    "+ body on a slide": (slide, motion),
    "+ body that slides on it": (slider, motion),
    "+ closed loop": (loop, motion),
    "+ force over time": (force, motion),
    "+ obstacle": (obstacle, motion),
    "+ obstacle with friction": (obstacle_with_friction, motion),
    "+ contact of members": (contact_of_members, motion),
    "+ retardation": (retardation, motion),
    "+ material of one's own": (own_material, motion),
    "order 4": (lambda fb: beam(fb)[0], order_four),
    "statics": (lambda fb: beam(fb)[0], static),
    "modes": (lambda fb: beam(fb)[0], modes),
    "gradient": (lambda fb: beam(fb)[0], gradient),
    "everything": (everything, motion),
}
#: Those of the short form.
FEW = "single body", PLAIN, "+ hinge", "+ body on a slide", "everything"


# -- Measurements, in a process of their own -------------------------------------------------------


def measure(name, repeats):
    """Print what a scene costs."""
    start = perf_counter()
    import fx_beam as fb

    make, compute = SCENES[name]
    result = compute(fb, make(fb))
    numbers = {"first result [s]": perf_counter() - start, **counts()}
    stats = getattr(result, "stats", None)
    numbers["unknowns"] = getattr(stats, "unknowns", None)
    numbers |= memory(lambda: compute(fb, make(fb)))
    around, steps = [], []
    for _ in range(repeats):
        scene, clock = make(fb), perf_counter()
        stats = getattr(compute(fb, scene), "stats", None)
        seconds = getattr(stats, "seconds", 0.0)
        around.append(1e3 * (perf_counter() - clock - seconds))
        elements = max(1, sum(beam.elements for beam in scene.beams))
        steps.append(1e9 * seconds / (stats.steps * elements) if seconds else np.nan)
    if repeats:
        numbers |= {"around steps [ms]": median(around), "step [ns an element]": median(steps)}
    print(json.dumps(numbers))


def counts():
    """Modules that are loaded, and kB of compiled code."""
    own = [name for name in sys.modules if name.split(".")[0] == "fx_beam"]
    lines = Path("/proc/self/maps").read_text().splitlines()
    files = [line.split() for line in lines if ".so" in line]
    # Libraries of the cache lie in its folders; those of a clone named fx_beam lie deeper.
    ours = [file for file in files if Path(file[5]).parent.name in ("fenics", "fx_beam")]
    ranges = [file[0].split("-") for file in ours]
    return {
        "modules": len(sys.modules),
        "modules of fx_beam": len(own),
        "code [kB]": sum(int(end, 16) - int(start, 16) for start, end in ranges) / 1e3,
    }


def memory(call):
    """Bytes of the arrays that a call gives to C, by their names in C."""
    from fx_beam.step.program import PROGRAMS
    from fx_beam.step.tables import ProblemInC

    PROGRAMS.clear()  # the scene is set up anew
    problems, begin = [], ProblemInC.__init__

    def remember(self, *arguments, **named):
        begin(self, *arguments, **named)
        problems.append(self)

    ProblemInC.__init__ = remember
    call()
    ProblemInC.__init__ = begin
    arrays, nodes = (
        (arrays_of(problems[-1]), problems[-1].c.tables.mesh.nodes) if problems else ({}, 1)
    )
    node_memory = sum(arrays.values()) / nodes if problems else None
    return {"memory [bytes a node]": node_memory, "nodes": nodes, "arrays": arrays}


def arrays_of(problem):
    """Bytes of the arrays to which the structs for C point, by the names of members."""
    ffi, referenced = problem.ffi, problem.structs._referenced
    arrays = [array for array in referenced if isinstance(array, np.ndarray)]
    tables = [array for array in referenced if not isinstance(array, np.ndarray)]
    left = {array.ctypes.data: array.nbytes for array in arrays}
    sizes = {"scratch": problem.scratch.nbytes}
    for struct in [problem.c, *(row for table in tables for row in table)]:
        for name, address in pointers_of(ffi, struct):
            if size := left.pop(address, 0):
                sizes[name] = sizes.get(name, 0) + size
    return sizes | {"structs": sum(map(ffi.sizeof, tables)) + ffi.sizeof(problem.c[0])}


def pointers_of(ffi, struct):
    """Names and addresses of the pointers in a struct and in those inside."""
    kind = ffi.typeof(struct)
    for name, field in (kind.item if kind.kind == "pointer" else kind).fields:
        value = getattr(struct, name)
        if field.type.kind == "pointer":
            yield name, int(ffi.cast("uintptr_t", value))
        elif field.type.kind == "struct":
            yield from pointers_of(ffi, value)


# -- The report ------------------------------------------------------------------------------------


def measured(name, repeats, cache=None):
    """Cost of a scene, measured in another process."""
    variables = {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    variables |= {"XDG_CACHE_HOME": cache} if cache else {}
    command = [sys.executable, __file__, "--measure", name, "--repeats", str(repeats)]
    done = subprocess.run(command, env=os.environ | variables, check=True, capture_output=True)
    return json.loads(done.stdout.splitlines()[-1])


def study(names, times):
    """Rows of the report; with `times` of two processes each, the first with an empty cache."""
    rows = []
    for name in names:
        if times:
            with tempfile.TemporaryDirectory() as empty:
                cold = measured(name, 0, empty)["first result [s]"]
                row = {"empty cache [s]": cold} | measured(name, 15, empty)
        else:
            measured(name, 0)  # compiles, for which it loads more
            row = measured(name, 0)
        rows.append({"scene": name, **row})
        print(name, flush=True)
    return rows


#: What is drawn and told, and how large a difference to the plainest scene counts.
DRAWN = {
    "modules of fx_beam": 0,
    "code [kB]": 0.1,
    "memory [bytes a node]": 0.1,
    "empty cache [s]": 0.3,
    "around steps [ms]": 0.3,
    "step [ns an element]": 0.2,
}


SHOWN = "modules", *list(DRAWN)[:3], "first result [s]", *list(DRAWN)[3:]


def sentences(rows):
    """Sentences on the table."""
    plain = next(row for row in rows if row["scene"] == PLAIN)
    others = [row for row in rows if row["scene"].startswith("+")]

    def by(name, give="{:.1f}"):
        largest = max((row for row in others if row.get(name)), key=lambda row: row[name])
        ratio = give.format(largest[name] / plain[name])
        return f'{ratio} times ("{largest["scene"].removeprefix("+ ")}")'

    told = [
        f"The plainest scene loads {plain['modules of fx_beam']} modules and "
        f"{plain['code [kB]']:.0f} kB of compiled code, and has {plain['unknowns']} unknowns.",
        f"With a single thing more there is at most {by('code [kB]')} of the code, and "
        f"{by('memory [bytes a node]')} of the memory a node.",
    ]
    if "step [ns an element]" in plain:
        told.append(
            f"A step takes {plain['step [ns an element]']:.0f} ns an element, and at most "
            f"{by('step [ns an element]')}; around its steps a call takes "
            f"{plain['around steps [ms]']:.1f} ms, and the first one with an empty cache "
            f"{plain['empty cache [s]']:.1f} s, at most {by('empty cache [s]')}."
        )
    return told


def draw(path, rows):
    """A panel for each cost, a row for each scene; those far from the plainest in colour."""
    from fx_beam import plot

    names = [name for name in DRAWN if any(row.get(name) for row in rows)]
    figure, axes = plot.figure(1, len(names), height=0.5 + 0.24 * len(rows))
    plain = next(row for row in rows if row["scene"] == PLAIN)
    for ax, name in zip(axes.flat, names, strict=True):
        ax.axvline(plain[name], color="0.75", linewidth=1)
        for place, row in enumerate(rows):
            if (value := row.get(name)) is not None and np.isfinite(value):
                far = abs(value / plain[name] - 1) > DRAWN[name]
                ax.plot(value, place, "o", color="#D55E00" if far else "0.5", markersize=5)
        values = [row[name] for row in rows if row.get(name)]
        if np.nanmax(values) > 10 * np.nanmin(values):
            ax.set_xscale("log")
        else:
            ax.set_xlim(0, 1.1 * max(values))
        ax.set_title(f"{name}\nbeam: {plain[name]:.3g}", fontsize="medium")
        ax.set(yticks=range(len(rows)), ylim=(len(rows) - 0.5, -0.5))
        ax.set_yticklabels([row["scene"] for row in rows] if ax is axes.flat[0] else [])
        ax.grid(axis="y", visible=True, color="0.92")
    figure.set_figwidth(2.0 + 1.9 * len(names))
    figure.savefig(path, dpi=150)


def renew_docs(told, table, picture):
    """Renew the page in docs/reports, between its comments, and its picture."""
    shutil.copy(picture, ROOT / "docs" / "pictures" / "cost.png")
    page = ROOT / "docs" / "reports" / "cost.md"
    text = page.read_text("utf-8")
    for name, new in ("sentences", "".join(f"- {line}\n" for line in told)), ("table", table):
        before, _, rest = text.partition(f"<!-- {name} -->\n")
        rest = rest.partition(f"<!-- end {name} -->")[2]
        text = f"{before}<!-- {name} -->\n{new}<!-- end {name} -->{rest}"
    page.write_text(text, "utf-8")


def main(quick=False, results=ROOT / "results" / "cost", docs=False):
    """Write the page, the table and the picture; returns the rows."""
    from fx_beam_studies import reporting  # not where modules are counted

    rows = study(FEW if quick else SCENES, not quick)
    shown = [
        {name: row.get(name) for name in ("scene", "unknowns", *SHOWN) if name in row}
        for row in rows
    ]
    told = sentences(rows)
    draw(reporting.beside(results / "cost", ".png"), rows)
    page = "# What a scene costs by what it has\n\n" + "".join(f"- {s}\n" for s in told)
    page += "\n![Costs by scene](cost.png)\n\n" + reporting.table(shown)
    reporting.write_report(results / "cost", page, {"sentences": told, "scenes": rows}, rows)
    if docs:
        renew_docs(told, reporting.table(shown), results / "cost.png")
    print(*told, f"Written to {results}", sep="\n")
    return rows


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="counts of a few scenes only")
    parser.add_argument("--docs", action="store_true", help="renew the page and picture of docs")
    parser.add_argument("--measure", help=argparse.SUPPRESS)
    parser.add_argument("--repeats", type=int, default=0, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.measure:
        measure(arguments.measure, arguments.repeats)
    else:
        main(arguments.quick, docs=arguments.docs)
