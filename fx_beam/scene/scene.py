"""A scene: beams, bodies, supports, joints, masses and loads, checked as they are added."""

from __future__ import annotations

import copy
import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar, overload

import numpy as np

from fx_beam import errors
from fx_beam.dual import dual_array, scene_number
from fx_beam.errors import SceneError, finite, is_flag, is_name, is_one_of, require, vector

from . import forces_between as lines, loads
from .beam import COMPONENTS, Beam, BeamPlace, Node, Nodes, checked_degree, position_of
from .body import Body, Members, check_body, velocities_of
from .contacts import Contact, Shape, check_members, check_start
from .coordinate import Coordinate, Coulomb, Damper, SmoothFriction, Spring, Stop, functions_of
from .curve import Curve, MeshBeams, layout, mesh_layout, sections_of, shifted
from .forces_between import Bed, ForceBetween, GroundSprings, Point, Pull, Pulley, checked_force
from .functions import ArrayCalls, Input, Signal, TimeValue, is_open_input, time_function
from .joints import GROUND, Joint, Revolute, Rigid, coupling_of, moved_by, placed
from .law import functions_of_energy
from .loads import NaturalStrain, Shaking, acceleration, changed_strain, natural_strain
from .notebook import facts, html_table, sketch
from .parameters import Parameters, is_parameter
from .part_index import PartIndices
from .removal import joint_of, locked, place_in, remove_parts, unlocked
from .section import Section, functions_of_section, warn_of_coarse_elements
from .sliders import SlidingJoint

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from fx_beam.symbolic import Expr

    from .gears import Gear
    from .ufl_symbols import Parameter

_Part = TypeVar("_Part")
_Force = TypeVar("_Force", bound=ForceBetween)
_Load = TypeVar("_Load", loads.Load, loads.VirtualWork, NaturalStrain)


@errors.answering
class Scene:
    """Beams, rigid bodies, supports, joints, masses, loads, drag and initial velocities.

    Lengths in metres, masses in kilograms, times in seconds and angles in radians, or any other
    consistent units. Angles and moments are positive anticlockwise.

    A copied or unpickled scene has its own nodes, beams, bodies, joints and contacts: take them
    from its `beams`, `bodies`, `joints` and `contacts`.

    Parameters
    ----------
    gravity : (gx, gy), callable or Input, optional
        Acceleration [m/s^2] of every mass, lumped masses included, or a function ``gravity(t)`` of
        time [s]; none by default. The work of a gravity that is not constant is part of
        `Energy.work`.

    Examples
    --------
    A cantilever with a tip load.

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> beam = scene.add_beam([(0, 0), (2, 0)], fb.Section(EA=1e6, GA=1e6, EI=1e3), elements=16)
    >>> scene.clamp(beam.start)
    >>> load = scene.add_force(beam.end, (0.0, -0.3))
    >>> tip = fb.static(scene, load_steps=1).displacement(beam.end)[-1]
    >>> round(float(tip[1]), 4), round(-0.3 * 2**3 / 3e3, 4)
    (-0.0008, -0.0008)
    """

    def __init__(self, gravity: Sequence[float] | Callable | Input | None = None):
        #: Number of changes that do not show in the lengths of lists.
        self.changes = 0
        self.loads: list[loads.Load] = []
        self.gravity = gravity
        self.beams = Members[Beam]("beam")
        self.nodes = Nodes()
        # Fixed components: (node number, component number).
        self.fixed: set[tuple[int, int]] = set()
        # Components prescribed as functions of time.
        self.prescribed: dict[tuple[int, int], Signal] = {}
        self.masses: list[loads.Mass] = []
        self.drags: list[loads.Drag] = []
        self.dampings: list[loads.Damping] = []
        self.velocities: list[loads.Velocity] = []
        self.virtual_works: list[loads.VirtualWork] = []
        self.natural_strains: list[NaturalStrain] = []
        #: Numbers in functions of your own by name, which change without compilation: `Parameter`.
        self.parameters = Parameters()
        self.bodies = Members[Body]("body")
        #: Numbers of nodes whose members were taken away. They are held where they are.
        self.gone: set[int] = set()
        self.joints: list[Joint] = []
        #: Gears and racks between joints, with numbers of their own among those of joints.
        self.gears: list[Gear] = []
        #: Joints that were ever added: as their numbers stay, so do rows of solutions.
        self.joint_count = 0
        self._couplings: dict[tuple, Joint] = {}
        self.contacts: list[Contact] = []
        self.forces_between: list[ForceBetween] = []
        #: Contacts and forces between points that were ever added: their numbers stay as well.
        self.contact_count = self.force_count = 0
        # Initial rates of joints by their numbers.
        self.rates: dict[int, float] = {}
        # Whether incompatible initial velocities are projected instead of refused.
        self.projects_velocities = False
        #: What is known of functions that are called with arrays; None if none is.
        self.array_calls: ArrayCalls | None = None
        #: Where parts are in the lists.
        self.part_indices = PartIndices()

    def __copy__(self):
        return copy.deepcopy(self)

    def __getstate__(self):
        # Code has no copies, and copies of parts have other ids.
        return self.__dict__ | {"array_calls": None, "part_indices": PartIndices()}

    def __setstate__(self, state):
        self.__dict__.update(state)
        for node in self.nodes:
            object.__setattr__(node, "scene", self)

    @property
    def gravity(self) -> np.ndarray | None:
        """Acceleration (2,) of every mass [m/s^2], or None. It may be set.

        It is also None for a function of time, which is one of the `loads` of the scene.
        """
        return self._gravity

    @gravity.setter
    def gravity(self, gravity: Sequence[float] | Callable | Input | None) -> None:
        value = None if gravity is None else time_function(gravity, 2, "gravity")
        other_loads = [load for load in self.loads if load.kind != "gravity"]
        self._gravity = value.value if value and value.is_constant else None
        if value and not value.is_constant:
            other_loads.insert(0, loads.Load("gravity", None, value))
        self.loads[:] = other_loads
        self.changes += 1

    def __repr__(self):
        return f"<Scene: {', '.join(f'{name} {value}' for name, value in facts(self).items())}>"

    def _repr_html_(self):
        beams = [[*map(position_of, beam.nodes)] for beam in self.beams]
        ends = [(body.centre, point) for body in self.bodies for point in body.nodes[1:]]
        arms = [[*map(position_of, pair)] for pair in ends]
        shades = ["#0072B2"] * len(beams) + ["#444"] * len(arms)
        return html_table("Scene", facts(self)) + sketch([*beams, *arms], shades)

    def add_beam(
        self,
        points: Sequence | Curve | Callable,
        section: Section,
        elements: int | Sequence[int] | None = None,
        degree: int = 1,
        name: str | None = None,
        offset: float | None = None,
    ) -> Beam:
        """Add a beam along a polyline or a curve; it is free of stress in that shape.

        Parameters
        ----------
        points : sequence of (x, y) or Node, Curve, or callable
            Corners [m]; or a curve: an `arc`, a `spline`, or ``points(fraction)`` that gives
            (x, y) for a fraction in [0, 1]. A node of another beam is shared rigidly:
            displacement and rotation are the same. Points at the same position are not joined; a
            warning names ends that lie on another beam, unless a joint, a contact or a line
            connects them. On a curve the elements end at equal distances of arc length; elements of
            degree 2 and 3 are curved, those of degree 1 are its chords.
        section : Section
            Cross-section.
        elements : int or sequence of int, optional
            Number of elements of the beam, or of each straight piece. By default 16 elements of
            degree 1, 4 of degree 2, 2 of degree 3, or one for each piece if there are more pieces.
            For a cantilever, a column between hinges and a bow the deflection, the buckling load
            and two frequencies then have errors below 1 %, a third frequency below 4 %. One element
            is enough for a bar between hinges.
        degree : int
            Polynomial degree 1, 2 or 3, the same for all beams of a scene.
        name : str, optional
            Name in messages and pictures.
        offset : float, optional
            Distance of the axis from the points [m], positive to the left of the direction from
            start to end: for a rib below a plate, or a rail that is held at its foot. Rigid arms
            hold the axis at the ends of the elements: for layers that bend as one take at least 16
            elements of degree 2 or 3.

        Returns
        -------
        Beam
            The beam, whose `start`, `end` and `node(fraction)` are its nodes.

        Raises
        ------
        SceneError
            For invalid points, elements, degree, section or name.

        Examples
        --------
        >>> import fx_beam as fb
        >>> scene, section = fb.Scene(), fb.Section(EA=1e6, GA=1e6, EI=1e3)
        >>> post = scene.add_beam([(0, 0), (0, 1)], section, elements=4, name="post")
        >>> scene.add_beam([post.end, (2, 1)], section, elements=[2], name="girder")
        <Beam 'girder': 2 elements from node 4 at (0, 1) to node 6 at (2, 1)>
        """
        name = self.beams.new_name(name)
        if not isinstance(section, Section):
            tapered = ". Of a tapered beam the numbers of a Section are functions of the fraction"
            raise SceneError(
                f"beam {name!r}: section must be an fx_beam.Section, not {errors.shown(section)}"
                + tapered * callable(section)
            )
        degree = checked_degree(degree, self.beams, f"beam {name!r}")
        self.parameters.add(functions_of_section(section), "add_beam: section")
        line = layout(points, elements, degree, name)
        if offset is None:
            nodes = self._nodes_at(line.ends, f"beam {name!r}")
            beam = Beam(name, nodes, degree, line.s, section, line.inner)
            _look_at_elements(beam)
            return self.beams.add(beam)
        axis = shifted(line, offset, name)
        carriers, nodes = (self._nodes_at(path.ends, f"beam {name!r}") for path in (line, axis))
        for a, b in zip(carriers, nodes, strict=True):
            self._numbered(Rigid(a, b, offset=(b.x - a.x, b.y - a.y)))
        fractions = line.s / line.s[-1]
        beam = Beam(name, nodes, degree, axis.s, section, axis.inner, fractions, carriers)
        _look_at_elements(beam)
        return self.beams.add(beam)

    def add_mesh(
        self,
        points: ArrayLike,
        cells: ArrayLike,
        section: Section | Mapping[Any, Section],
        elements: int | Sequence[int] = 1,
        degree: int = 1,
        joints: str = "rigid",
        tags: ArrayLike | None = None,
        join: float | None = None,
    ) -> MeshBeams:
        """Add straight beams between the points of a mesh: a lattice, a truss, a frame, a drawing.

        Cells that share a point are joined there. Without `join` points at the same position are
        not joined, nor is a point on another cell; a warning says so.

        Parameters
        ----------
        points : (n, 2) array_like
            Positions (x, y) [m]. Each point must belong to a cell.
        cells : (m, 2) array_like of int
            For each beam the points at its start and end, counted from 0.
        section : Section or dict
            Cross-section of all beams, or sections by tag.
        elements : int or (m,) array_like of int
            Number of elements of each beam. One is enough for bars between pins; members that bend
            need more, as in `add_beam`.
        degree : int
            Polynomial degree 1, 2 or 3, the same for all beams of a scene.
        joints : {"rigid", "pin"}
            Whether beams at a point share its node, or are hinged to it: the first beam has the
            node, each other beam a node of its own, with a `Revolute` between them.
        tags : (m,) array_like, optional
            For each beam the key of its section.
        join : float, optional
            Tolerance of a drawing [m]: points within this distance become one, at the place of the
            first, and a cell is divided at points within this distance of it, its elements in
            proportion. Cells that cross without a common point stay apart.

        Returns
        -------
        list of Beam
            The beams in the order of the cells. Its attribute `nodes` is a list too: ``nodes[i]``
            is the node at point i, to be supported and loaded. With pins all beams at the point
            share the displacement of this node, but only the first one its rotation and moments.
            ``cells[k]`` is the cell to which beam k belongs, as a whole or as a part.

        Raises
        ------
        SceneError
            For arrays that do not fit each other, points without cells, cells without length, cells
            given twice (with `join` also in part), tags without a section, and in the cases of
            `add_beam`.

        Examples
        --------
        A truss of three bars: half of the load goes down each leg, N = -F / (2 sin a).

        >>> import fx_beam as fb
        >>> scene = fb.Scene()
        >>> bar = fb.Section(EA=1e8, GA=1e8, EI=1e2)
        >>> points, cells = [(0, 0), (4, 0), (2, 1.5)], [(0, 1), (1, 2), (2, 0)]
        >>> beams = scene.add_mesh(points, cells, bar, joints="pin")
        >>> scene.pin(beams.nodes[0])
        >>> scene.fix(beams.nodes[1], "y")
        >>> load = scene.add_force(beams.nodes[2], (0, -120.0))
        >>> truss = fb.static(scene)
        >>> print([round(float(truss.resultants(beam).N[-1, 0]), 2) for beam in beams])
        [80.0, -100.0, -100.0]
        """
        kinds = ("rigid", "pin")
        require(is_one_of(joints, kinds), "add_mesh: joints", joints, f"one of {kinds}")
        degree = checked_degree(degree, self.beams, "add_mesh")
        mesh = mesh_layout(points, cells, elements, joints == "pin", join)
        section_of_cell = sections_of(section, tags, np.shape(cells)[0])
        sources = mesh.source_cell.tolist()
        sections = [section_of_cell[k] for k in sources]
        parts = {id(part): part for part in sections}.values()
        for part in parts:
            self.parameters.add(functions_of_section(part), "add_mesh: section")
        nodes = self._nodes_at(mesh.positions.tolist(), "add_mesh")
        beams = MeshBeams([nodes[i] for i in mesh.node_of_point.tolist()], sources)
        numbers, ends = mesh.nodes.tolist(), mesh.starts.tolist()
        for first, end, part in zip(ends[:-1], ends[1:], sections, strict=True):
            name = self.beams.new_name(None)
            beam_nodes = tuple(nodes[i] for i in numbers[first:end])
            beams.append(self.beams.add(Beam(name, beam_nodes, degree, mesh.s[first:end], part)))
        if any(map(_varies, parts)):
            for beam in beams:
                _look_at_elements(beam)
        pin = None  # the others are copies of the first one, quickly
        for pair in mesh.pins.tolist():
            a, b = (nodes[i] for i in pair)
            pin = self._numbered(pin or Revolute(a, b), a=a, b=b)
        return beams

    def add_body(
        self,
        position: Sequence[float],
        mass: float,
        inertia: float = 0.0,
        points: Mapping[str, Sequence[float] | Node] | None = None,
        name: str | None = None,
    ) -> Body:
        """Add a rigid body, with points for joints and beams.

        The points move exactly with the centre and have no unknowns of their own: the body has
        three unknowns.

        Parameters
        ----------
        position : (x, y)
            Centre of mass in the reference configuration [m].
        mass : float
            Mass m [kg].
        inertia : float
            Moment of inertia J about the centre [kg m^2].
        points : dict, optional
            Points by name: positions (x, y) in the reference configuration [m], not relative to
            the centre; or nodes of beams and of other bodies, which then follow this body.
        name : str, optional
            Name in messages.

        Returns
        -------
        Body
            The body: ``body.centre`` and ``body["A"]`` are its nodes.

        Raises
        ------
        SceneError
            For a position, mass, inertia or point that is invalid, or a name that is in use.

        Examples
        --------
        A compound pendulum: omega^2 = m g a / (J + m a^2) for small angles. What holds it in
        statics is in a copy, as it hangs by its weight.

        >>> import copy, fx_beam as fb
        >>> scene = fb.Scene(gravity=(0, -10))
        >>> body = scene.add_body((0, -0.2), mass=3.0, inertia=0.48, points={"pin": (0, 0)})
        >>> pin = scene.add_joint(fb.Revolute(fb.GROUND, body["pin"]))
        >>> held = copy.deepcopy(scene)
        >>> held.fix(held.bodies[0].centre, "rotation")
        >>> found = fb.modes(scene, state=fb.static(held, load_steps=1))
        >>> round(float(found.angular_frequencies[0] ** 2), 9)
        10.0
        """
        name = self.bodies.new_name(name)
        x, y = vector(position, 2, f"{name}: position")
        m = loads.not_negative(mass, f"{name}: mass")
        J = loads.not_negative(inertia, f"{name}: inertia")
        ok = isinstance(points, Mapping | None) and all(map(is_name, points or ()))
        require(ok, f"{name}: points", points, "a dict of positions by their names")
        ends: list[Point] = [(x, y)]
        for key, point in (points or {}).items():
            subject = f"{name}: point {key!r}"
            if isinstance(point, Node):
                loads.check_node(self, point, subject)
            ends.append(point if isinstance(point, Node) else vector(point, 2, subject))
        centre, *nodes = self._nodes_at(ends, name)
        for node in nodes:
            offset = (node.x - centre.x, node.y - centre.y)
            self.add_joint(Rigid(centre, node, offset=offset))
        if m or J:
            self.add_mass(centre, m, J)
        named = dict(zip(points or {}, nodes, strict=True))
        return self.bodies.add(Body(name, centre, named, m, J))

    # -- Supports and joints ------------------------------------------------------------------

    def fix(self, node: Node, *components: str) -> None:
        """Fix components of a node at their start value.

        Parameters
        ----------
        node : Node
            A node of this scene.
        *components : {"x", "y", "rotation"}
            The components to fix.

        Raises
        ------
        SceneError
            For an unknown component or one that is already supported.
        """
        loads.check_node(self, node, "support")
        if not components:
            raise SceneError(f"support of {node}: name the components to fix, of {COMPONENTS}")
        for component in components:
            self.fixed.add(_free_component(self, node, component))

    def pin(self, node: Node) -> None:
        """Fix the displacement of a node; its rotation stays free.

        Parameters
        ----------
        node : Node
            A node of this scene.
        """
        self.fix(node, "x", "y")

    def clamp(self, node: Node) -> None:
        """Fix displacement and rotation of a node.

        Parameters
        ----------
        node : Node
            A node of this scene.
        """
        self.fix(node, *COMPONENTS)

    def prescribe(self, node: Node, x=None, y=None, rotation=None) -> None:
        """Prescribe components of a node as functions of time.

        Parameters
        ----------
        node : Node
            A node of this scene.
        x, y : callable or Input, optional
            Displacement from the reference position at time t [m]; zero at t = 0.
        rotation : callable or Input, optional
            Rotation from the reference configuration at time t [rad]; zero at t = 0.

        Raises
        ------
        SceneError
            For a component that is already supported, or a function that does not return a number.
        """
        loads.check_node(self, node, "prescribed motion")
        motions = zip(COMPONENTS, (x, y, rotation), strict=True)
        components = {name: value for name, value in motions if value is not None}
        if not components:
            raise SceneError(f"prescribed motion of {node}: give x, y or rotation")
        for name, value in components.items():
            function = time_function(value, 1, f"prescribed {name} of {node}")
            self.prescribed[_free_component(self, node, name)] = function

    @overload
    def add_joint(self, joint: Joint, at: object = None) -> Joint: ...

    @overload
    def add_joint(self, joint: Gear, at: object = None) -> Gear: ...

    def add_joint(self, joint: Joint | Gear, at: object = None) -> Joint | Gear:
        """Add a joint, or a gear or rack between two joints.

        Parameters
        ----------
        joint : Joint or Gear
            Created by `Rigid`, `Revolute`, `Prismatic`, `PinInSlot`, `Slider` or `Sleeve`; or by
            `Gear` or `Rack`, between joints of this scene.
        at : Solution, optional
            A motion or equilibrium at whose end the joint is made, in the place of the reference
            configuration: the nodes must meet in this state, a joint to the ground is at the
            present place of its node, a joint that does not turn keeps the relative rotation, and a
            gear keeps the angles. The next motion must start from this solution.

        Returns
        -------
        Joint or Gear
            The numbered joint or gear of the scene, for `Solution.joint`.

        Raises
        ------
        SceneError
            For nodes of another scene, nodes that do not fit the joint (the message says how far
            they are apart), or a motor that does not start from zero.
        """
        if not isinstance(joint, Joint):
            from .gears import added_gear

            return added_gear(self, joint, at)
        for node in (joint.a, joint.b):
            if node is not GROUND:
                loads.check_node(self, node, joint.kind)
        guide = None
        if isinstance(joint, SlidingJoint) and _is_held(self, joint.b):
            guide, place = joint.b, joint.place_of_guide()
            joint = replace(joint, b=Node(len(self.nodes), *place, self))
        if at is None:
            joint.kinematics.check_start(self.nodes.size)
        else:
            joint = placed(joint, moved_by(at, joint.a), moved_by(at, joint.b), self.nodes.size)
        twin = self._couplings.get(coupling_of(joint))
        if twin is not None and any(twin is other for other in self.joints):
            raise SceneError(f"{joint}: the scene has it already, as {twin}. Add each joint once")
        for coordinate in joint.coordinates.values():
            self.parameters.add(functions_of(coordinate), str(joint))
        if guide is not None:  # the scene gets its node with the joint, which is not refused
            (node,) = self._nodes_at([place], str(joint))
            joint = replace(joint, b=node)
        joint = self._numbered(joint)
        if guide is not None:
            self.add_joint(Rigid(guide, joint.b))
        return joint

    def _numbered(self, joint: Joint, **nodes) -> Joint:
        """A checked joint, with other nodes if given, added with the next number."""
        joint = replace(joint, number=self.joint_count, **nodes)
        self.joint_count += 1
        self._couplings[coupling_of(joint)] = joint
        return _added(self.joints, joint)

    def add_parameter(self, parameter: Parameter) -> None:
        """Add a parameter that is in no function of the scene, such as the damping of a scheme.

        Parameters in functions of the scene are added with these functions.

        Parameters
        ----------
        parameter : Parameter
            The parameter, with its value.

        Raises
        ------
        SceneError
            If it is no parameter, or if its name has another value.

        Examples
        --------
        >>> import fx_beam as fb
        >>> scheme = fb.EnergyDecaying(damping=fb.Parameter("damping", 0.1))
        >>> scene = fb.Scene()
        >>> scene.add_parameter(fb.Parameter("damping", 0.2))
        >>> scene.parameters["damping"]
        0.2
        """
        ok = is_parameter(parameter)
        require(ok, "add_parameter: parameter", parameter, "an fx_beam.Parameter")
        self.parameters.add([("parameter", parameter)], "add_parameter")

    def make_velocities_compatible(self) -> None:
        """Project initial velocities that violate joints or supports, which are otherwise an error.

        The projection gives the nearest velocities in the norm of the mass matrix, with the rates
        of joints that `set_rate` gives.
        """
        self.projects_velocities = True

    def add_contact(
        self,
        a: Beam | Node,
        b: Shape | Beam,
        stiffness: float | None = None,
        restitution: float = 1.0,
        speed: float | None = None,
        energy: Callable[[Expr], Expr] | None = None,
        friction: Coulomb | None = None,
        radius: float | tuple[float, float] = 0.0,
        along: int | None = None,
    ) -> Contact:
        """Add contact of a node or beam with a line or circle, fixed or carried, or with a beam.

        If a node enters the shape by the depth d, the force k d (1 + r tanh(rate of d / speed))
        pushes it back along the normal; r = (1 - e^2) / (1 + e^2), as for a `Stop`. The energy
        k d^2 / 2 is stored. The contact of a beam acts at its nodes, also inside elements, each
        with its share of the length; between two nodes a beam may enter the shape.

        On a node that carries the circle or line the opposite force and its moment act. In schemes
        that conserve energy the work of both forces is exactly the change of the stored energy, and
        both momenta are conserved.

        Of two beams the nodes of each touch the other beam, anywhere along a smooth curve through
        the middles of its elements, with round ends. The stiffness per length is that of both beams
        together. A beam may touch itself: `b` is `a`.

        Parameters
        ----------
        a : Beam or Node
            The node or beam that touches. The contact does not stop other members.
        b : Line, Circle or Beam
            A shape that is fixed or carried by a node, another beam, or the same beam.
        stiffness : float, optional
            Stiffness k of a node [N/m], of a beam per length [N/m^2].
        restitution : float
            Coefficient of restitution e from 0 to 1 of each node, as of a `Stop`; 1 returns all
            energy.
        speed : float, optional
            Speed below which the loss is viscous [m/s]; required for e < 1.
        energy : callable, optional
            In place of the stiffness ``energy(d)``, the stored energy of a node [J], of a beam per
            length [J/m], as a UFL expression of the depth d [m] that rises from d = 0 on. Its
            derivative takes the place of k d.
        friction : Coulomb, optional
            Friction that sticks; none by default. It acts on the surface of a member with a
            `radius`, and on that of a circle or line that moves. A node with a radius rolls on a
            member: the surface of the node turns with the node, the surface of the member with its
            sections.
        radius : float or pair
            Half of the thickness of the beam, or radius of a wheel or ball around the node [m].
            Required if `b` is a beam: one number for both, or a pair for `a` and `b`.
        along : int, optional
            For lines and circles: number of Gauss points in each element at which the beam touches,
            for elements that are not much shorter than the arc of contact. By default the beam
            touches at its nodes.

        Returns
        -------
        Contact
            The numbered contact, for `Solution.contact`.

        Raises
        ------
        SceneError
            For members of another scene, a value out of range, a node that starts behind the shape,
            a shape carried by the beam or body that it should stop, or members that overlap at the
            start.

        Examples
        --------
        A bar that falls on a floor and bounces.

        >>> import fx_beam as fb
        >>> scene = fb.Scene(gravity=(0, -10))
        >>> section = fb.Section(EA=1e5, GA=1e5, EI=1e3, rhoA=1.0, rhoI=0.01)
        >>> bar = scene.add_beam([(0, 0.2), (1, 0.2)], section, elements=2)
        >>> floor = scene.add_contact(bar, fb.Line((0, 0), normal=(0, 1)), stiffness=1e5)
        >>> solution = fb.simulate(scene, dt=1e-3, t_end=0.4)
        >>> bool(solution.contact(floor).gap.min() > -0.01)
        True
        >>> bool(abs(solution.energy.balance_error).max() < 1e-11)
        True

        A ball hits a disc of the same mass that is free: their velocities change places.

        >>> scene = fb.Scene()
        >>> ball, disc = (scene.add_body((x, 0), mass=1.0, inertia=0.01).centre for x in (0, 1))
        >>> hit = scene.add_contact(ball, fb.Circle(disc, 0.2), stiffness=1e5, radius=0.1)
        >>> scene.set_velocity(ball, (2.0, 0.0))
        >>> solution = fb.simulate(scene, dt=1e-3, t_end=0.5)
        >>> solution.velocity(disc)[-1].round(9)
        array([2., 0.])
        """
        loads.check_target(self, a, "contact")
        carrier = getattr(b, "carrier", None)
        if carrier is not None:
            loads.check_node(self, carrier, f"{type(b).__name__} of a contact")
        if (stiffness is None) == (energy is None):
            raise SceneError(f"contact of {loads.label(a)}: give either a stiffness or an energy")
        k, number = 1.0 if stiffness is None else stiffness, self.contact_count
        contact = Contact(a, b, k, restitution, speed, number, energy, radius, along, friction)
        if isinstance(contact.shape, Beam):
            loads.check_target(self, contact.shape, "contact")
            check_members(contact, self.nodes.size)
        else:
            check_start(contact, self.nodes.size)
        self.parameters.add(functions_of_energy(contact.energy, None, 1), str(contact))
        self.contact_count += 1
        return _added(self.contacts, contact)

    def add_force_between(
        self,
        a: Node,
        b: Point,
        spring: Spring | None = None,
        damper: Damper | None = None,
        friction: SmoothFriction | None = None,
        stop: Stop | tuple | None = None,
        force: Pull | float | Input | None = None,
    ) -> ForceBetween:
        """Add a force along the line between two nodes, or between a node and a fixed point.

        The force depends on the distance r of the points and on its rate, and acts on both points
        with opposite signs. The force of a spring is the derivative of its energy by r. In schemes
        that conserve energy the work of this force is exactly the change of the energy, and both
        momenta are conserved.

        Parameters
        ----------
        a : Node
            A node of this scene.
        b : Node or (x, y)
            Another node, or a fixed point [m].
        spring : Spring, optional
            Spring on r, linear or with a ``strain_energy(x)`` of x = r - rest.
        damper : Damper, optional
            Damper on the rate of r, linear or with a law of your own.
        friction : SmoothFriction, optional
            Friction on the rate of r.
        stop : Stop or (lower, upper, stiffness), optional
            Limits of r: a rope has only an upper limit, a prop only a lower limit. A rope without
            spring and force has a damper and friction that act while it is taut.
        force : callable, float or Input, optional
            ``force(distance, rate, t)``, an additional tension [N] as a UFL expression of r [m],
            its rate [m/s] and the time [s]; or a number or an `Input` for the tension. Its work is
            part of `Energy.work`. In statics it is multiplied by the load factor.

        Returns
        -------
        ForceBetween
            The numbered force.

        Raises
        ------
        SceneError
            For points at the same place, or a law that is no UFL expression or not finite at the
            start.

        Examples
        --------
        Two balls on a spring: they swing against each other at sqrt(k / m + k / m).

        >>> import numpy as np, fx_beam as fb
        >>> scene = fb.Scene()
        >>> left, right = (scene.add_body((x, 0), mass=2.0, inertia=0.1).centre for x in (0, 1))
        >>> force = scene.add_force_between(left, right, spring=fb.Spring(100.0, rest=1.0))
        >>> scene.set_velocity(right, (0.1, 0.0))
        >>> turn = fb.simulate(scene, dt=1e-3, t_end=0.2 * np.pi).position(right)[-1]
        >>> bool(abs(turn[0] - (1 + 0.05 * 0.2 * np.pi)) < 1e-6)
        True
        """
        for node in (a, b) if isinstance(b, Node) else (a,):
            loads.check_node(self, node, "force between points")
        # A stop may be a triple, from which a coordinate makes a `Stop`.
        laws = Coordinate(spring, damper, friction=friction, stop=stop)  # type: ignore[arg-type]
        return self._with_force(checked_force(self, (a, b), laws, force))

    def add_rope(
        self,
        points: Sequence[Point | Pulley],
        spring: Spring | None = None,
        damper: Damper | None = None,
        friction: SmoothFriction | None = None,
        stop: Stop | tuple | None = None,
        force: Pull | float | Input | None = None,
        length: TimeValue | Parameter | None = None,
        taut: bool = False,
        pretension: float = 0.0,
    ) -> ForceBetween:
        r"""Add a massless rope over several points: a force on the sum of their distances.

        :math:`l = \sum_k |x_{k+1} - x_k|`. The rope slides over the points between without
        friction, so that its tension is the same everywhere: a pulley block, a tendon, a
        bowstring. With a `Pulley` l has arcs, and spans that touch circles. The laws are those of
        `add_force_between`, with l in place of the distance: in schemes that conserve energy the
        work is exactly the change of the stored energy, and momenta are conserved.

        Parameters
        ----------
        points : sequence of Node, (x, y) or Pulley
            Two or more points in order: nodes of this scene and fixed places [m]. A node may occur
            several times, such as that of a block with two sheaves. A `Pulley` is a circle; at an
            end it is a drum, on which the rope is wound and that turns with its node.
        spring : Spring, optional
            Spring on l, which pulls and pushes; with a `length` the stiffness of a rope that only
            pulls.
        damper : Damper, optional
            Damper on the rate of l, also if `length` changes; with a drum on a motor it damps only
            the rate at which the rope is stretched. In a rope that only pulls it acts while the
            rope is taut, and reduces the tension at most to zero.
        friction : SmoothFriction, optional
            Friction on the rate of l, in the same way.
        stop : Stop or (lower, upper, stiffness), optional
            Limits of l: a rope has an upper limit. With a damper or friction, and no spring or
            force, ``(None, l0, k)`` is ``spring=Spring(k), length=l0``.
        force : callable, float or Input, optional
            ``force(length, rate, t)``, an additional tension [N], as of `add_force_between`.
        length : float, callable, Parameter or Input, optional
            Length of the rope without tension [m], also as a function of time, as of a winch. The
            rope pulls with ``spring.stiffness * (l - length)`` where it is longer, and is slack
            otherwise. A change of the length does work, which is part of `Energy.work`. Statics
            takes the length at the time ``t``. An `Input` that is not set yet is the length as
            drawn.
        taut : bool
            Whether the length without tension is the drawn length: a brace that only pulls.
        pretension : float, optional
            Tension as drawn [N]: the length without tension is shorter than drawn by pretension /
            stiffness.

        Returns
        -------
        ForceBetween
            The numbered force; ``solution.joint(rope)`` has its tension and its length.

        Raises
        ------
        SceneError
            For fewer than two points, no node among them, two successive points at one place, or a
            length without a linear spring; and in the cases of `add_force_between`.

        Examples
        --------
        A pulley block: a load of 20 kg hangs at a loose pulley, held by two parts of the rope.

        >>> import fx_beam as fb
        >>> scene = fb.Scene(gravity=(0, -9.81))
        >>> load = scene.add_body((0.1, -2), mass=20.0).centre
        >>> scene.fix(load, "x", "rotation")
        >>> points = [(0, 0), load, (0.2, 0)]
        >>> rope = scene.add_rope(points, spring=fb.Spring(1e5), length=4.0)
        >>> float(fb.static(scene).joint(rope).force[-1].round(1))
        98.2
        """
        name = "rope: points"
        ok = isinstance(points, list | tuple) and len(points) > 1
        require(ok, name, points, "a sequence of two or more nodes and positions (x, y)")
        make: Callable[..., ForceBetween] = ForceBetween
        if any(hasattr(point, "side") for point in points):
            points, kinds, radii = lines.rope_parts(points)
            make = functools.partial(lines.RopeOverPulleys, kinds=kinds, radii=radii)
        nodes = [point for point in points if isinstance(point, Node)]
        require(bool(nodes), name, points, "with a node among them: nothing else can move")
        for node in nodes:
            loads.check_node(self, node, "rope")
        laws = Coordinate(spring, damper, friction=friction, stop=stop)  # type: ignore[arg-type]
        if taut or pretension:
            require(length is None, "rope: length", length, "left out, as it is taut as drawn")
            ok = isinstance(spring, Spring) and spring.stiffness > 0
            require(ok, "rope: spring", spring, "an fx_beam.Spring(k), as the rope is taut")
            assert spring is not None
            tension = finite(pretension, "rope: pretension", "not negative")
            drawn = checked_force(self, points, laws, None, None, make).drawn_length
            length = drawn - tension / spring.stiffness
            require(length > 0, "rope: pretension", pretension, "less than stiffness times length")
        of_length = lines.parameter_of_length(length, self.force_count)
        rope = self._with_force(checked_force(self, points, laws, force, length, make))
        if length is not None and is_open_input(signal := self.parameters.functions[of_length]):
            begins_as_drawn = signal.beginning_with(float(rope.length_at_start))
            self.parameters.functions[of_length] = begins_as_drawn
        return rope

    def add_spring(
        self,
        node: Node,
        x=None,
        y=None,
        rotation=None,
        axis: Sequence[float] = (1.0, 0.0),
        *,
        at: str | None = None,
        start=None,
    ) -> GroundSprings:
        """Hold a node to the ground by springs, dampers, friction or stops.

        The laws act on the displacement of the node from the reference configuration along fixed
        directions, and on its rotation. In schemes that conserve energy the work of springs and
        stops is exactly the change of their energy.

        Parameters
        ----------
        node : Node
            A node of this scene.
        x, y, rotation : Spring, Damper, SmoothFriction, Stop or a list of them, optional
            Laws on each displacement [m] and on the rotation [rad].
        axis : (2,) float, optional
            Direction of x, of any length; y is to its left. By default the directions of the scene.
        at : "now", optional
            Displacements and rotation of the laws count from the position of the node at the end of
            `start`, as for a prop that is put under it. By default they count from the reference
            configuration.
        start : Solution, optional
            The state in which the springs are added, from which `static` or `simulate` then start.

        Returns
        -------
        GroundSprings
            With `x`, `y` and `rotation`; ``solution.joint(springs.x)`` has the force and the
            displacement.

        Raises
        ------
        SceneError
            Without any law, for anything that is no law, for a stop beyond which the node starts,
            an axis without a direction, or one of `at` and `start` alone.

        Examples
        --------
        A mass of 2 kg on a spring of 800 N/m with a damper: it hangs m g / k lower.

        >>> import fx_beam as fb
        >>> scene = fb.Scene(gravity=(0, -9.81))
        >>> mass = scene.add_body((0, 0), mass=2.0).centre
        >>> scene.fix(mass, "x", "rotation")
        >>> held = scene.add_spring(mass, y=[fb.Spring(800.0), fb.Damper(20.0)])
        >>> rest = fb.static(scene)
        >>> float(rest.joint(held.y).force[-1].round(2)), float(rest.position(mass)[-1, 1].round(6))
        (-19.62, -0.024525)
        """
        loads.check_node(self, node, "spring")
        forwards = dual_array(vector(axis, 2, "spring: axis"))
        size = np.hypot(*forwards)
        require(bool(size > 0), "spring: axis", axis, "a direction")
        left = np.stack([-forwards[1], forwards[0]]) + 0.0  # no -0
        ways = scene_number(forwards / size), scene_number(left / size), None
        beginnings = _where_now(node, at, start, ways[0], ways[1])
        parts = zip(("x", "y", "rotation"), (x, y, rotation), ways, beginnings, strict=True)
        springs = {
            name: lines.ground_spring(node, laws, way, f"spring: {name}", beginning)
            for name, laws, way, beginning in parts
            if laws is not None
        }
        expected = "an fx_beam.Spring for one of them at least"
        require(bool(springs), "spring: x, y, rotation", None, expected)
        return GroundSprings(**{n: self._with_force(part) for n, part in springs.items()})

    def add_bed(
        self,
        beam: Beam,
        normal: float = 0.0,
        tangential: float = 0.0,
        pushes_only: bool = False,
        law=None,
    ) -> Bed:
        """Lay a beam on an elastic bed (Winkler's): springs along all of its length to the ground.

        The springs act at the nodes of the beam, each with its share of the length, on the
        displacements across and along the axis in the reference configuration.

        Parameters
        ----------
        beam : Beam
            A beam of this scene.
        normal : float
            Stiffness across the beam per length [N/m^2].
        tangential : float, optional
            Stiffness along the beam per length [N/m^2].
        pushes_only : bool, optional
            Whether the bed only pushes. It then lies to the right of the beam, seen from its start:
            below a beam that runs from left to right.
        law : Spring, Damper, SmoothFriction, Stop or a list of them, optional
            Law across the beam per length in the place of `normal`, on the displacement to its left
            [m]: a spring with a `strain_energy` [J/m] for soil that yields (p-y curves) or that the
            beam leaves.

        Returns
        -------
        Bed
            With `normal` and `tangential`; ``solution.joint(bed.normal)`` has the force on all of
            the beam and the displacements at its nodes.

        Raises
        ------
        SceneError
            For a negative stiffness, without any stiffness or law, for a law together with
            `normal`, or anything that is no law.

        Examples
        --------
        A long beam on a bed of stiffness k sinks under a load P by P b / (2 k), with
        b^4 = k / (4 EI) (Hetenyi 1946).

        >>> import fx_beam as fb
        >>> scene = fb.Scene()
        >>> section = fb.Section(EA=1e6, GA=1e7, EI=100.0)
        >>> beam = scene.add_beam([(-5, 0), (5, 0)], section, elements=100, degree=2)
        >>> scene.fix(beam.start, "x")
        >>> bed = scene.add_bed(beam, normal=6400.0)
        >>> load = scene.add_force(beam.node(0.5), (0, -1.0))
        >>> sunk = fb.static(scene, load_steps=1).displacement(beam.node(0.5))[-1, 1]
        >>> bool(abs(sunk * 2 * 6400.0 / 2.0 + 1) < 1e-4)
        True
        """
        loads.check_beam(self, beam, "bed")
        name = f"bed of beam {beam.name!r}"
        normal = finite(normal, f"{name}: normal", "not negative")
        tangential = finite(tangential, f"{name}: tangential", "not negative")
        acts, expected = normal + tangential > 0, "a positive stiffness [N/m^2]"
        require(acts or law is not None, f"{name}: normal", normal, expected)
        alone = law is None or not (normal or pushes_only)
        require(alone, f"{name}: law", law, "given without normal and pushes_only")
        require(is_flag(pushes_only), f"{name}: pushes_only", pushes_only, "True or False")
        parts = lines.parts_of_bed(beam, normal, tangential, pushes_only, law)
        return Bed(**{name: self._with_force(part) for name, part in parts.items()})

    def _with_force(self, force: _Force) -> _Force:
        """A checked force along a line, added with the next number."""
        force = replace(force, number=self.force_count)
        self.parameters.add(force.functions, str(force))
        self.force_count += 1
        return _added(self.forces_between, force)

    # -- Masses and loads -----------------------------------------------------------------------

    def add_mass(self, node: Node, mass: float, inertia: float = 0.0) -> loads.Mass:
        """Add a lumped mass.

        Parameters
        ----------
        node : Node
            A node of this scene.
        mass, inertia : float
            Mass [kg] and moment of inertia [kg m^2].

        Returns
        -------
        Mass
            The mass, which `remove` takes away again.

        Raises
        ------
        SceneError
            For a negative or non-finite value.
        """
        loads.check_node(self, node, "mass")
        m = loads.not_negative(mass, f"mass of {node}")
        J = loads.not_negative(inertia, f"inertia of {node}")
        return _added(self.masses, loads.Mass(node.number, m, J))

    def add_force(self, node: Node | BeamPlace, force, follower: bool = False) -> loads.Load:
        """Add a force.

        Parameters
        ----------
        node : Node or BeamPlace
            A node of this scene, or a place on a beam, ``beam.at(s)``: the forces at the nodes of
            its element have the same sum and moment.
        force : (fx, fy), callable or Input
            Force, or ``force(t)`` [N].
        follower : bool
            Whether the force rotates with the section of its node; then (fx, fy) are its components
            in the reference configuration. A dead force keeps its direction.

        Returns
        -------
        Load
            The load, for `change` and `remove`.
        """
        loads.check_place(self, node, "force")
        name = f"force on {node}"
        require(is_flag(follower), f"{name}: follower", follower, "True or False")
        ok = isinstance(node, Node) or not follower
        require(ok, f"{name}: follower", follower, "False inside an element; take a node")
        value = time_function(force, 2, name)
        return _added(self.loads, loads.Load("force", node, value, bool(follower)))

    def add_moment(self, node: Node | BeamPlace, moment) -> loads.Load:
        """Add a moment.

        In the plane dead and follower moments are the same, as the axis of a moment does not
        rotate.

        Parameters
        ----------
        node : Node or BeamPlace
            A node of this scene, or a place on a beam, ``beam.at(s)``.
        moment : float, callable or Input
            Moment, or ``moment(t)`` [N m].

        Returns
        -------
        Load
            The load, for `change` and `remove`.
        """
        loads.check_place(self, node, "moment")
        value = time_function(moment, 1, f"moment on {node}")
        return _added(self.loads, loads.Load("moment", node, value))

    def add_line_load(
        self,
        beam: Beam,
        load,
        of: str = "time",
        between: Sequence[float] | None = None,
        follower: bool = False,
    ) -> loads.Load | loads.VirtualWork:
        r"""Add a dead load along a beam or a part of it, or a pressure on it.

        A pressure, with ``follower=True``, is a force per present length of the axis along its
        normal, :math:`p W \varphi'` per reference length. In schemes that conserve energy its work
        in a step is exactly the pressure in the middle of the step times the area over which the
        axis sweeps, on a closed curve times the change of the area within.

        Parameters
        ----------
        beam : Beam
            A beam of this scene.
        load : (qx, qy), callable or Input
            Force per reference length [N/m]: a constant; a pair of constants at both ends, linear
            between them; or a function ``load(t)`` of time, ``load(s)`` of the arc length from the
            beam's start [m], or ``load(s, t)`` of both. ``load(s, t)`` is called at both ends of
            each step, with all arc lengths at once if it takes arrays, else one by one. Functions
            of the arc length may jump inside elements: their integrals are right.
        of : {"time", "arc length", "arc length and time", "projected length"}
            The arguments of the function. With "projected length" a constant, a pair or a function
            of time is a force per projected length, as of snow: qy per length along x, qx per
            length along y.
        between : (2,) float, optional
            Arc lengths from the beam's start between which the load acts [m], anywhere in its
            elements; by default from end to end. In straight elements the sum of the nodal forces
            is exact. A pressure acts on whole elements.
        follower : bool
            Whether the load is a pressure p [N/m], positive if it pushes to the left, seen from the
            start of the beam: a number, a function ``p(t)`` of time, a `Parameter` or an `Input`.

        Returns
        -------
        Load or VirtualWork
            The load, or the virtual work of a pressure, for `change` and `remove`.

        Raises
        ------
        SceneError
            For a function that does not take the arguments named in `of`, or for a part beyond the
            ends of the beam.

        Examples
        --------
        A load on a third of a beam, which its supports carry as 5/6 and 1/6.

        >>> import fx_beam as fb
        >>> scene = fb.Scene()
        >>> beam = scene.add_beam([(0, 0), (3, 0)], fb.Section(EA=1e7, GA=1e7, EI=1e5), elements=4)
        >>> scene.pin(beam.start)
        >>> scene.fix(beam.end, "y")
        >>> load = scene.add_line_load(beam, (0, -60), between=(0, 1))
        >>> print(fb.static(scene, linear=True).reaction(beam.end)[-1].round(6))
        [ 0. 10.  0.]

        A load of 100 N over a length of 0.1 m that moves along a beam at 3 m/s. Statics takes its
        position at the time `t`, here at three quarters of the length.

        >>> import numpy as np, fx_beam as fb
        >>> scene = fb.Scene()
        >>> beam = scene.add_beam([(0, 0), (2, 0)], fb.Section(EA=1e7, GA=1e7, EI=1e5), elements=20)
        >>> scene.pin(beam.start)
        >>> scene.fix(beam.end, "y")
        >>> def moving(s, t):
        ...     return 0.0, -1000 * np.clip(1 - abs(s - 3 * t) / 0.1, 0, None)
        >>> load = scene.add_line_load(beam, moving, of="arc length and time")
        >>> print(fb.static(scene, t=0.5).reaction(beam.end)[-1].round(1))
        [ 0. 75.  0.]

        A pressure on a half ring: its supports carry p times its width, whatever its shape.

        >>> scene = fb.Scene()
        >>> section = fb.Section(EA=1e5, GA=1e5, EI=50.0)
        >>> arch = scene.add_beam(fb.arc((-1, 0), (0, 1), (1, 0)), section, elements=8, degree=2)
        >>> scene.clamp(arch.start)
        >>> scene.clamp(arch.end)
        >>> inside = scene.add_line_load(arch, 30.0, follower=True)  # outwards: to the left
        >>> held = fb.static(scene)
        >>> feet = held.reaction(arch.start) + held.reaction(arch.end)
        >>> print(round(float(feet[-1, 1]), 9))
        -60.0
        """
        loads.check_beam(self, beam, "line load")
        require(is_flag(follower), "line load: follower", follower, "True or False")
        if not follower:
            return _added(self.loads, loads.line_load(beam, load, of, between))
        number = 1
        while f"pressure {number}" in self.parameters:
            number += 1
        pressure, value = loads.pressure_on(beam, load, of, between, number)
        self.parameters.add([("pressure", value)], f"pressure on {loads.label(beam)}")
        return _added(self.virtual_works, pressure)

    def shake(self, x=None, y=None) -> Shaking:
        r"""Shake the base on which the whole scene stands.

        Displacements and velocities are relative to the base, supports are at rest, and each mass
        has the force :math:`-m a(t)`, also in statics. Supports, fixed points, obstacles, springs
        to the ground, and the air of a drag move with the base. The work of these forces, relative
        to the base, is part of `Energy.work`. Several shakings add up.

        Parameters
        ----------
        x, y : callable, Input, float or (times, accelerations), optional
            Acceleration a of the base along each direction: ``a(t)`` [m/s^2]; or a record, two
            lists of the same length: times [s] in order, and accelerations [m/s^2], linear between
            them. The same time twice is a jump. The record is zero before and after; the base then
            keeps its last velocity.

        Returns
        -------
        Shaking
            With `x` and `y`, for `change` and `remove`.

        Raises
        ------
        SceneError
            Without any acceleration, or for an invalid record.

        Examples
        --------
        A mass on a spring, on a base that starts at 2 m/s^2: it swings up to 2 a / omega^2 behind.

        >>> import numpy as np, fx_beam as fb
        >>> scene = fb.Scene()
        >>> mass = scene.add_body((0, 0), mass=3.0).centre
        >>> scene.fix(mass, "y", "rotation")
        >>> springs = scene.add_spring(mass, x=fb.Spring(3.0 * (2 * np.pi) ** 2))
        >>> shaking = scene.shake(x=([0, 10], [2.0, 2.0]))
        >>> relative = fb.simulate(scene, dt=1e-3, t_end=0.5).displacement(mass)[-1, 0]
        >>> print(round(float(relative * (2 * np.pi) ** 2), 3))
        -4.0
        """
        base = {}
        for name, value in (("x", x), ("y", y)):
            if value is not None:
                kind = f"shaking along {name}"
                base[name] = loads.Load(kind, None, acceleration(value, kind))
        require(bool(base), "shake: x, y", None, "an acceleration [m/s^2] for one of them at least")
        self.loads += base.values()
        return Shaking(**base)

    def add_natural_strain(
        self, beam: Beam, *, axial=None, shear=None, curvature=None
    ) -> NaturalStrain:
        """Give a beam strains at which it has no stress: heat, lack of fit, prestress, muscles.

        The stored energy is that of the strains less the natural strains. Several natural strains
        of a beam add up. Over a step they change in proportion to the time; the work of this
        change, -N dE*, is exact, and part of `Energy.work`. `static` multiplies natural strains by
        the load factor.

        Parameters
        ----------
        beam : Beam
            A beam of this scene.
        axial, shear : float, callable or Input, optional
            Natural axial and shear strain.
        curvature : float, callable or Input, optional
            Natural curvature [1/m], in addition to the curvature of the beam as drawn.

            Each is a number or a function, whose arguments are named f for the fraction of the arc
            length, from 0 to 1, t for the time, or (f, t) for both. A function of (f, t) is called
            with all fractions at once if it takes arrays.

        Returns
        -------
        NaturalStrain
            The natural strain, for `change` and `remove`.

        Raises
        ------
        SceneError
            For values that are no finite numbers, functions of other arguments, or no strain.

        Examples
        --------
        A strip with the natural curvature 1/R is an arc of this radius, without stress.

        >>> import math, fx_beam as fb
        >>> scene = fb.Scene()
        >>> beam = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e4, GA=1e4, EI=1.0), elements=8)
        >>> scene.clamp(beam.start)
        >>> strain = scene.add_natural_strain(beam, curvature=math.pi / 2)
        >>> arc = fb.static(scene)
        >>> print(round(float(arc.rotation(beam.end)[-1] / math.pi), 6))
        0.5

        Let the curvature oscillate, as in a swimming tail.

        >>> strain = scene.change(strain, curvature=lambda f, t: 2.0 * f * math.sin(5.0 * t))
        """
        loads.check_beam(self, beam, "natural strain")
        components = {"axial": axial, "shear": shear, "curvature": curvature}
        return _added(self.natural_strains, natural_strain(beam, components))

    def add_drag(self, on: Beam | Node, linear=0.0, quadratic=0.0, rotation=0.0) -> loads.Drag:
        """Add a drag, a force against the velocity, as in a fluid at rest.

        The force is v (linear + quadratic norm(v)). Its loss is in `Energy.dissipated`. In statics
        it is zero. Several drags on one beam or node add up.

        Parameters
        ----------
        on : Beam or Node
            A beam, for a force per reference length, or a node.
        linear : float or (along, across)
            Force per speed [N s/m], of a beam per length [N s/m^2]. A pair, for beams, has the
            coefficients along the director of the section and across it.
        quadratic : float or (along, across)
            Force per square of the speed [N s^2/m^2], of a beam per length [N s^2/m^3]. With a pair
            each component of the force depends on that of the velocity (cross-flow principle).
        rotation : float
            Moment per spin [N m s/rad], of a beam per length [N s/rad].

        Returns
        -------
        Drag
            The drag, which `remove` takes away again.

        Raises
        ------
        SceneError
            For negative or non-finite coefficients, if all are zero, or for a pair for a node.

        Examples
        --------
        Drag in proportion to the mass halves every velocity in ln(2) / alpha.

        >>> import math, fx_beam as fb
        >>> scene, alpha = fb.Scene(), 2.0
        >>> section = fb.Section(EA=1e4, GA=1e4, EI=1e2, rhoA=0.5, rhoI=0.01)
        >>> beam = scene.add_beam([(0, 0), (1, 0)], section)
        >>> drag = scene.add_drag(beam, linear=alpha * section.rhoA, rotation=alpha * section.rhoI)
        >>> scene.set_velocity(beam, (0.0, 3.0))
        >>> solution = fb.simulate(scene, dt=0.01, t_end=math.log(2) / alpha)
        >>> print(f"{solution.velocity(beam.end)[-1, 1]:.3f} m/s")
        1.500 m/s
        """
        loads.check_target(self, on, "drag")
        return _added(self.drags, loads.Drag(on, linear, quadratic, rotation))

    def add_damping(self, mass: float = 0.0, stiffness: float = 0.0) -> loads.Damping:
        r"""Damp all beams and masses by Rayleigh's two numbers, :math:`C = \alpha M + \tau K`.

        A small vibration of angular frequency omega about the reference has the damping ratio
        :math:`\alpha / (2 \omega) + \tau \omega / 2`; `rayleigh` chooses both numbers. In large
        motion the part of the mass is a force :math:`-\alpha m v` against the velocity of each
        mass, relative to the base: it also damps rigid motions. The part of the stiffness is a
        `retardation` beside that of the sections: it acts on strain rates, and damps no rigid
        motion. Springs are not damped: give them a `Damper`. The loss is in `Energy.dissipated`,
        exactly in schemes that conserve energy. Several dampings add up.

        Parameters
        ----------
        mass : float
            Mass factor alpha [1/s], of beams and lumped masses, also for rotations.
        stiffness : float
            Retardation time tau [s].

        Returns
        -------
        Damping
            The damping, which `remove` takes away again.

        Raises
        ------
        SceneError
            For negative or non-finite numbers, or if both are zero.

        Examples
        --------
        Two per cent at 1 Hz and at 20 Hz. Between them the ratio is smaller.

        >>> import fx_beam as fb
        >>> scene = fb.Scene()
        >>> section = fb.Section(EA=1e6, GA=1e6, EI=12.0, rhoA=1.0)
        >>> beam = scene.add_beam([(0, 0), (2, 0)], section, elements=8, degree=2)
        >>> scene.clamp(beam.start)
        >>> damping = scene.add_damping(*fb.rayleigh((1.0, 20.0), (0.02, 0.02)))
        >>> lowest = fb.modes(scene, n=3)
        >>> lowest.frequencies.round(2), lowest.damping_ratios.round(4)
        (array([0.48, 3.04, 8.52]), array([0.0398, 0.0092, 0.0103]))
        """
        alpha = loads.not_negative(mass, "damping: mass")
        tau = loads.not_negative(stiffness, "damping: stiffness")
        require(alpha > 0 or tau > 0, "damping: mass, stiffness", 0.0, "positive, one at least")
        return _added(self.dampings, loads.Damping(alpha, tau))

    def add_virtual_work(
        self, term: Callable[..., Expr], beam: Beam | None = None
    ) -> loads.VirtualWork:
        """Add a force of your own by its virtual work, in UFL.

        Parameters
        ----------
        term : callable
            ``term(step)`` gives the virtual work of the force per reference length, a scalar UFL
            expression linear in ``step.virtual_u`` and ``step.virtual_psi``. `step` is an
            `fx_beam.Step`. The element's reduced Gauss rule integrates it, so that a jump along a
            beam must be at a node. Numbers that change are a `Parameter`; functions and constants
            of UFL or dolfinx are refused, as they would be read only once.
        beam : Beam, optional
            The beam on which the force acts; by default all beams.

        Returns
        -------
        VirtualWork
            The virtual work, which `remove` takes away again.

        Raises
        ------
        SceneError
            If `term` is not a function, or gives no UFL expression.

        Examples
        --------
        A viscous force against the velocity, of 0.5 N s/m per metre.

        >>> import ufl, fx_beam as fb
        >>> scene = fb.Scene()
        >>> work = scene.add_virtual_work(lambda step: -0.5 * ufl.dot(step.v, step.virtual_u))
        """
        if beam is not None:
            loads.check_beam(self, beam, "virtual work")
        work = loads.VirtualWork(term, beam)
        from .ufl_symbols import STEP

        name = f"virtual work {len(self.virtual_works) + 1}"
        self.parameters.add([(name, work.of(STEP, name))], name)
        return _added(self.virtual_works, work)

    def change(self, load: _Load, value=None, *, axial=None, shear=None, curvature=None) -> _Load:
        """Change the value of a load, or components of a natural strain.

        Parameters
        ----------
        load : Load, VirtualWork of a pressure, or NaturalStrain
            What `add_force`, `add_moment`, `add_line_load` or `add_natural_strain` returned, or the
            x or y of what `shake` returned.
        value : float, (x, y), callable or Input
            New value of a load, as the method that added it takes it.
        axial, shear, curvature : float, callable or Input, optional
            New components of a natural strain; other components stay.

        Returns
        -------
        Load, VirtualWork or NaturalStrain
            The part with the new value, which takes the place of `load`.

        Raises
        ------
        SceneError
            For a load of another scene, or a value that does not fit.
        """
        strains = {"axial": axial, "shear": shear, "curvature": curvature}
        if isinstance(load, NaturalStrain):
            require(value is None, f"change: value of a {load}", value, "axial=, shear=, ...")
        else:
            names = ", ".join(name for name, strain in strains.items() if strain is not None)
            require(not names, f"change: {names} of a load", None, "those of natural strains")
        if isinstance(load, loads.VirtualWork):
            place_in(self, "virtual_works", load, "change", "a pressure")
            require(bool(load.own), "change", load, "a pressure; others change by a Parameter")
            self.parameters[load.own[0]] = value
            return load
        name = "natural_strains" if isinstance(load, NaturalStrain) else "loads"
        index, place = place_in(self, name, load, "change", "a load or a natural strain")
        new: Any
        if isinstance(load, NaturalStrain):
            new = changed_strain(load, strains)
        elif load.kind.startswith("shaking"):
            new = replace(load, value=acceleration(value, load.kind))
        else:
            new = loads.changed(load, value)
        index.replace(place, new)
        self.changes += 1
        return new

    def remove(self, *parts) -> None:
        """Take away joints, members, contacts, loads, masses, drag, forces, natural strains.

        With a beam or a body its loads, masses, joints, supports and contacts are removed, and
        those of nodes that belong to no other part. Motions that start from a solution before the
        change recognise the parts that stay (`simulate`). The name of a removed part cannot be used
        again.

        Parameters
        ----------
        *parts : Joint, Beam, Body, Contact, Load, Mass, Drag, VirtualWork, ForceBetween, ...
            Parts that the methods `add_...` returned. For supports there is `free`.

        Raises
        ------
        SceneError
            For a part that this scene does not have, or that cannot be removed.

        Examples
        --------
        A prop that is taken away: the end of the beam sinks by q L^4 / (8 EI).

        >>> import fx_beam as fb
        >>> scene = fb.Scene()
        >>> section = fb.Section(EA=1e6, GA=1e8, EI=1e3)
        >>> beam = scene.add_beam([(0, 0), (2, 0)], section, elements=8, degree=2)
        >>> load = scene.add_line_load(beam, (0.0, -1.0))
        >>> scene.clamp(beam.start)
        >>> scene.fix(beam.end, "y")
        >>> propped = fb.static(scene)
        >>> scene.free(beam.end, "y")
        >>> free = fb.static(scene, start=propped)
        >>> print(free.displacement(beam.end)[[0, -1], 1].round(5))
        [ 0.    -0.002]
        >>> scene.remove(load)
        >>> unloaded = fb.static(scene, start=free)
        >>> bool(abs(unloaded.displacement(beam.end)[-1]).max() < 1e-9)
        True
        """
        remove_parts(self, parts)
        self.changes += 2 * len(parts)  # also if something else is added

    def free(self, node: Node, *components: str) -> None:
        """Take supports and prescribed motions away from a node.

        Parameters
        ----------
        node : Node
            A node of this scene.
        *components : {"x", "y", "rotation"}
            Components to free; by default all that are supported.

        Raises
        ------
        SceneError
            For a component that is not supported.
        """
        loads.check_node(self, node, "support")
        supports = self.fixed, self.prescribed
        numbered = {name: (node.number, i) for i, name in enumerate(COMPONENTS)}
        names = [name for name, key in numbered.items() if any(key in part for part in supports)]
        for name in components or names or ["a component"]:
            require(is_one_of(name, names), f"free {node}", name, f"one that is supported: {names}")
            self.fixed.discard(numbered[name])
            self.prescribed.pop(numbered[name], None)
            self.changes += 2

    def lock(self, joint: Joint, coordinate: str | None = None) -> Joint:
        """Lock a joint: from the next run on it keeps its slide or its angle.

        A motion that starts from a solution keeps the value at the end of that solution. Velocities
        are projected by the mass, as in a plastic impact (`simulate`, `Energy.impact`). The force
        of the lock is `JointMotion.motor_force` of the joint that is returned.

        Parameters
        ----------
        joint : Joint
            A joint of this scene with a slide or a relative rotation that no motor drives.
        coordinate : {"slide", "rotation"}, optional
            The coordinate to lock, for joints that have both.

        Returns
        -------
        Joint
            The locked joint, which takes the place of `joint`. Both name it in solutions.

        Raises
        ------
        SceneError
            For a joint that this scene does not have, or a coordinate that it does not have.

        Examples
        --------
        A latch: two masses that move apart on a guide, until they are 1.5 m from each other. The
        energy m1 m2 / (m1 + m2) v^2 / 2 is lost.

        >>> import fx_beam as fb
        >>> scene = fb.Scene()
        >>> one, other = (scene.add_body((x, 0), mass=2.0, inertia=0.1).centre for x in (0, 1))
        >>> guide = scene.add_joint(fb.Prismatic(one, other, axis=(1, 0)))
        >>> scene.set_velocity(other, (0.6, 0.0))
        >>> y = {"distance": fb.Output("slide", guide)}
        >>> apart = fb.simulate(
        ...     scene, dt=0.1, t_end=2.0, outputs=y, until=lambda t, y: y["distance"] - 1.5
        ... )
        >>> scene.lock(guide)
        <joint 0, Prismatic of node 0 at (0, 0) and node 1 at (1, 0)>
        >>> latched = fb.simulate(scene, dt=0.1, t_end=2.0, start=apart)
        >>> float(latched.energy.impact[0].round(9)), latched.velocity(one)[-1].round(9)
        (0.18, array([0.3, 0. ]))
        """
        return self._replaced(joint, "lock", lambda old: locked(old, coordinate))

    def unlock(self, joint: Joint) -> Joint:
        """Unlock a joint that `lock` has locked.

        Parameters
        ----------
        joint : Joint
            A joint of this scene that is locked.

        Returns
        -------
        Joint
            The free joint, which takes the place of `joint`.

        Raises
        ------
        SceneError
            For a joint that this scene does not have, or that is not locked.
        """
        return self._replaced(joint, "unlock", unlocked)

    def _replaced(self, joint: Joint, name: str, change: Callable[[Joint], Joint]) -> Joint:
        """A changed joint in the place of the one before."""
        old = joint_of(self, joint, name)
        new = change(old)
        index, place = place_in(self, "joints", old, name, "a joint")
        index.replace(place, new)
        self._couplings[coupling_of(old)] = new
        self.changes += 1
        return new

    def set_velocity(self, target: Beam | Body | Node, velocity=(0.0, 0.0), spin=0.0) -> None:
        """Set the velocity and spin at t = 0.

        Parameters
        ----------
        target : Beam, Body or Node
            A node, a beam for all its nodes, or a body: the velocity is that of its centre.
        velocity : (vx, vy) or callable
            Velocity, or ``velocity(x, y)`` at a reference position [m/s].
        spin : float or callable
            Rate of the section rotation, or ``spin(x, y)`` [rad/s].
        """
        if isinstance(target, Body):
            check_body(self, target, "velocity")
            self.velocities += velocities_of(target, velocity, spin)
            return
        loads.check_target(self, target, "velocity")
        carriers = target.carriers if isinstance(target, Beam) else ()
        moving = (target, *carriers)
        self.velocities += [loads.initial_velocity(part, velocity, spin) for part in moving]

    def set_rate(self, joint: Joint, rate: float) -> None:
        """Set the rate of a joint at t = 0.

        All other velocities are then compatible with joints and supports, and closest to those of
        `set_velocity` (by default zero) in the norm of the mass matrix.

        Parameters
        ----------
        joint : Joint
            A joint of this scene without a motor; not a sleeve on a beam.
        rate : float
            Rate of the slide [m/s] if the joint has one, else of the angle [rad/s] of b relative to
            a, as `JointMotion.rate`. Derivatives with such a start use differences.

        Raises
        ------
        SceneError
            For a joint that this scene does not have, or that has no such rate; `simulate`, if no
            mass moves with it, or if rates of several joints exclude each other.

        Examples
        --------
        Two rods in a row: the hinge between them opens, and nothing else gives momentum.

        >>> import fx_beam as fb
        >>> scene, section = fb.Scene(), fb.Section(EA=1e4, GA=1e4, EI=1e2, rhoA=1.0, rhoI=1e-3)
        >>> rods = [scene.add_beam([(0, 0), (x, 0)], section, elements=4) for x in (-1, 1)]
        >>> hinge = scene.add_joint(fb.Revolute(rods[0].start, rods[1].start))
        >>> scene.set_rate(hinge, 2.0)
        >>> motion = fb.simulate(scene, dt=1e-3, t_end=1e-3)
        >>> float(motion.joint(hinge).spin[0].round(9)), motion.linear_momentum[0].round(9) + 0.0
        (2.0, array([0., 0.]))
        """
        own = joint_of(self, joint, "set_rate")
        name = "rotation" if own.axis is None else "slide"
        ok = not own.on_beam and own.coordinates.get(name) is not None and name not in own.driven
        require(ok, "set_rate: joint", joint, "a Revolute, Prismatic or PinInSlot without motor")
        self.rates[own.number] = finite(rate, f"set_rate: rate of {own}")
        self.make_velocities_compatible()
        self.changes += 1

    def _nodes_at(self, ends: list, name: str) -> tuple[Node, ...]:
        """Nodes at the ends of elements; an end that is a node belongs to another beam, too."""
        for node in [end for end in ends if isinstance(end, Node)]:
            loads.check_node(self, node, name)
        nodes = []
        for end in ends:
            if not isinstance(end, Node):
                x, y = end
                end = self.nodes.add(x, y, self)
            nodes.append(end)
        return tuple(nodes)


def _is_held(scene: Scene, node: Node) -> bool:
    """Whether a node is the ground, or a component of it is supported or driven."""
    if node is GROUND:
        return True
    keys = [(node.number, component) for component in range(3)]
    return any(key in scene.fixed or key in scene.prescribed for key in keys)


def _free_component(scene: Scene, node: Node, component: str) -> tuple[int, int]:
    """Numbers of a node and of a component that is not supported; SceneError otherwise."""
    expected = f"one of {COMPONENTS}"
    require(is_one_of(component, COMPONENTS), f"support of {node}", component, expected)
    key = node.number, COMPONENTS.index(component)
    if key in scene.fixed or key in scene.prescribed:
        raise SceneError(f"{component} of {node} is supported twice; scene.free removes one")
    return key


def _added(parts: list, part: _Part) -> _Part:
    """The part, added to a list of the scene."""
    parts.append(part)
    return part


def _varies(section: Section) -> bool:
    """Whether a stiffness or an inertia varies along a beam."""
    return any(section.varies(name) for name in ("EA", "GA", "EI", "rhoA", "rhoI"))


def _look_at_elements(beam: Beam) -> None:
    """Warn of elements that are too coarse for a section or an offset."""
    if beam.carriers or _varies(beam.section):
        warn_of_coarse_elements(beam)


def _where_now(node: Node, at, start, forwards, left) -> tuple[float, float, float]:
    """Displacements along two directions and rotation of a node from which springs count."""
    require(at is None or is_one_of(at, ("now",)), "spring: at", at, "'now', or left out")
    together = (at is None) == (start is None)
    require(together, "spring: start", start, "a solution with at='now', or left out without")
    if start is None:
        return 0.0, 0.0, 0.0
    has_rows = hasattr(start, "displacement") and hasattr(start, "rotation")
    require(has_rows, "spring: start", start, "an fx_beam.Solution")
    moved, turned = start.displacement(node)[-1], start.rotation(node)[-1]
    return float(forwards @ moved), float(left @ moved), float(turned)
