"""A scene: beams, supports, masses and loads as plain data, checked as they are given."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.validation import TimeFunction, time_function, vector

from .beam import COMPONENTS, Beam, Node, polyline
from .curve import Curve, lay_along
from .joints import GROUND, Joint
from .loads import Load, Velocity, VirtualWork, initial_velocity, label, line_load
from .section import Section
from .summary import facts, html_table


class Scene:
    """Beams, supports, masses, loads and initial rates of a planar system.

    Lengths in metres, masses in kilograms, times in seconds and angles in radians, or any other
    consistent units. Angles and moments count anticlockwise.

    A copy of a scene, or one that was pickled, has nodes, beams and joints of its own: take them
    from its `beams` and `joints`.

    Parameters
    ----------
    gravity : (gx, gy), optional
        Acceleration [m/s^2] of every mass, lumped ones as well; none by default.
    """

    def __init__(self, gravity: Sequence[float] | None = None):
        self.gravity = None if gravity is None else vector(gravity, 2, "gravity")
        self.beams: list[Beam] = []
        self.nodes: list[Node] = []
        #: Smallest and largest coordinates of the nodes.
        self._corners = np.full(2, np.nan), np.full(2, np.nan)
        #: Fixed components: (node number, component number).
        self.fixed: set[tuple[int, int]] = set()
        #: Displacements or rotations given as functions of time.
        self.prescribed: dict[tuple[int, int], TimeFunction] = {}
        #: Lumped masses: node number, mass [kg], inertia [kg m^2].
        self.masses: list[tuple[int, float, float]] = []
        self.loads: list[Load] = []
        self.velocities: list[Velocity] = []
        self.virtual_works: list[VirtualWork] = []
        self.joints: list[Joint] = []
        #: Whether initial velocities that violate a joint are projected instead of refused.
        self.projects_velocities = False

    def __copy__(self):
        return copy.deepcopy(self)

    def __setstate__(self, state):
        self.__dict__.update(state)
        for node in self.nodes:
            object.__setattr__(node, "scene", self)

    def _repr_html_(self):
        return html_table("Scene", facts(self))

    # -- Geometry -----------------------------------------------------------------------------

    def add_beam(
        self,
        points: Sequence | Curve | Callable,
        section: Section,
        elements: int | Sequence[int] = 1,
        degree: int = 1,
        name: str | None = None,
    ) -> Beam:
        """Add a beam along a polyline or a curve; it is free of stress in that shape.

        Parameters
        ----------
        points : sequence of (x, y) or Node, Curve, or callable
            Corners [m]; or a curve: an `arc`, a `spline`, or ``points(fraction)`` that gives
            (x, y) for a fraction in [0, 1]. A node of another beam is shared rigidly:
            displacement and rotation are the same. Points at the same place are not joined.
            Elements end at equal distances of arc length on a curve, along which those of
            degree 2 and 3 are curved themselves; those of degree 1 are its chords.
        section : Section
            Cross-section.
        elements : int or sequence of int
            Number of elements in all, or of each straight piece.
        degree : int
            Polynomial degree 1, 2 or 3, the same for all beams of a scene.
        name : str, optional
            Name in messages and pictures.

        Returns
        -------
        Beam
            The beam, whose `start`, `end` and `node(fraction)` are its nodes.

        Raises
        ------
        SceneError
            For points, elements, degree, section or name that make no beam.
        """
        taken = {beam.name for beam in self.beams}
        if name is None:
            numbers = itertools.count(len(taken) + 1)
            name = next(free for n in numbers if (free := f"beam {n}") not in taken)
        if name in taken:
            raise SceneError(f"two beams are called {name!r}; give them different names")
        if not isinstance(section, Section):
            raise SceneError(f"beam {name!r}: section must be an fx_beam.Section, not {section!r}")
        if degree not in (1, 2, 3) or not isinstance(degree, int | np.integer):
            raise SceneError(f"beam {name!r}: degree = {degree!r} must be 1, 2 or 3")
        if self.beams and degree != self.beams[0].degree:
            raise SceneError(
                f"beam {name!r}: degree {degree} differs from degree {self.beams[0].degree} of "
                f"{self.beams[0].name!r}; all beams of a scene share one degree"
            )
        if callable(points):
            points = Curve(points)
        if isinstance(points, Curve):
            layout = lay_along(points, elements, degree, name)
        else:
            layout = polyline(points, elements, name)
        nodes = self._nodes_at(layout.ends, name)
        beam = Beam(name, nodes, degree, layout.s, section, layout.inner)
        self.beams.append(beam)
        return beam

    def _nodes_at(self, ends: list, name: str) -> tuple[Node, ...]:
        """Nodes at the ends of elements; those that are given as such belong to other beams."""
        for end in ends:
            if isinstance(end, Node):
                self._check_node(end, f"beam {name!r}")
        nodes = []
        for end in ends:
            if not isinstance(end, Node):
                end = Node(len(self.nodes), float(end[0]), float(end[1]), self)
                self.nodes.append(end)
                place = np.array([end.x, end.y])
                self._corners = np.fmin(self._corners[0], place), np.fmax(self._corners[1], place)
            nodes.append(end)
        return tuple(nodes)

    # -- Supports -----------------------------------------------------------------------------

    def fix(self, node: Node, *components: str) -> None:
        """Hold components of a node at their start value.

        Parameters
        ----------
        node : Node
            A node of this scene.
        *components : {"x", "y", "rotation"}
            What is held.

        Raises
        ------
        SceneError
            For an unknown component or one that is already supported.
        """
        self._check_node(node, "support")
        if not components:
            raise SceneError(f"support of {node}: name what is fixed, of {COMPONENTS}")
        for component in components:
            self.fixed.add(self._free_component(node, component))

    def pin(self, node: Node) -> None:
        """Hold the displacement of a node; it may turn.

        Parameters
        ----------
        node : Node
            A node of this scene.
        """
        self.fix(node, "x", "y")

    def clamp(self, node: Node) -> None:
        """Hold displacement and rotation of a node.

        Parameters
        ----------
        node : Node
            A node of this scene.
        """
        self.fix(node, *COMPONENTS)

    def prescribe(self, node: Node, x=None, y=None, rotation=None) -> None:
        """Move components of a node as functions of time.

        Parameters
        ----------
        node : Node
            A node of this scene.
        x, y : callable, optional
            Displacement from the reference position at time t [m]; zero at t = 0.
        rotation : callable, optional
            Rotation from the reference configuration at time t [rad]; zero at t = 0.

        Raises
        ------
        SceneError
            For a component that is already supported, or a function without a number.
        """
        self._check_node(node, "prescribed motion")
        motions = zip(COMPONENTS, (x, y, rotation), strict=True)
        given = {name: value for name, value in motions if value is not None}
        if not given:
            raise SceneError(f"prescribed motion of {node}: give x, y or rotation")
        for name, value in given.items():
            function = time_function(value, 1, f"prescribed {name} of {node}")
            self.prescribed[self._free_component(node, name)] = function

    # -- Joints -------------------------------------------------------------------------------

    def add_joint(self, joint: Joint) -> Joint:
        """Add a joint.

        Parameters
        ----------
        joint : Joint
            Made by `Rigid`, `Revolute`, `Prismatic` or `PinInSlot`.

        Returns
        -------
        Joint
            The joint as the scene has it, for `Solution.slide` and `Solution.joint_force`.

        Raises
        ------
        SceneError
            For nodes of another scene, nodes that are not where the joint has them, or a motor that
            does not start from zero.
        """
        if not isinstance(joint, Joint):
            raise SceneError(
                f"add_joint needs a joint such as fx_beam.Revolute(a, b), not {joint!r}"
            )
        for node in (joint.a, joint.b):
            if node is not GROUND:
                self._check_node(node, joint.kind)
        joint.check_start(np.subtract(*self._corners[::-1]).max())
        joint = replace(joint, number=len(self.joints))
        self.joints.append(joint)
        return joint

    def make_velocities_compatible(self) -> None:
        """Let initial velocities that violate a joint or a support be projected.

        The nearest velocities in the norm of the mass matrix are taken, instead of an error.
        """
        self.projects_velocities = True

    # -- Masses and loads -----------------------------------------------------------------------

    def add_mass(self, node: Node, mass: float, inertia: float = 0.0) -> None:
        """Add a lumped mass.

        Parameters
        ----------
        node : Node
            A node of this scene.
        mass : float
            Mass [kg].
        inertia : float
            Moment of inertia [kg m^2].

        Raises
        ------
        SceneError
            For a negative or non-finite value.
        """
        self._check_node(node, "mass")
        for name, value in (("mass", mass), ("inertia", inertia)):
            if not (vector(value, 1, f"{name} of {node}")[0] >= 0):
                raise SceneError(f"{name} = {value!r} of {node} must not be negative")
        self.masses.append((node.number, float(mass), float(inertia)))

    def add_force(self, node: Node, force, follower: bool = False) -> None:
        """Add a force.

        Parameters
        ----------
        node : Node
            A node of this scene.
        force : (fx, fy) or callable
            Force, or ``force(t)`` [N].
        follower : bool
            Whether the force turns with the section of its node: then (fx, fy) is what it is in the
            reference configuration. A dead force keeps its direction.
        """
        self._check_node(node, "force")
        function = time_function(force, 2, f"force on {node}")
        self.loads.append(Load("force", node, function, bool(follower)))

    def add_moment(self, node: Node, moment) -> None:
        """Add a moment.

        In the plane its axis does not turn: a dead moment and one that follows are the same.

        Parameters
        ----------
        node : Node
            A node of this scene.
        moment : float or callable
            Moment, or ``moment(t)`` [N m].
        """
        self._check_node(node, "moment")
        self.loads.append(Load("moment", node, time_function(moment, 1, f"moment on {node}")))

    def add_line_load(self, beam: Beam, load, of: str = "time") -> None:
        """Add a dead load along a beam.

        Parameters
        ----------
        beam : Beam
            A beam of this scene.
        load : (qx, qy) or callable
            Force per reference length [N/m]: the same everywhere and always, or a function of the
            time ``load(t)``, or of the arc length ``load(s)`` from the beam's start [m].
        of : {"time", "arc length"}
            What a function is one of.

        Raises
        ------
        SceneError
            For a function that does not take what `of` says.
        """
        self._check_beam(beam, "line load")
        self.loads.append(line_load(beam, load, of))

    def add_virtual_work(self, term: Callable[[Any], Any], beam: Beam | None = None) -> None:
        """Add the virtual work of a force of your own, in UFL.

        Parameters
        ----------
        term : callable
            ``term(step)`` gives the virtual work per reference length that the force does, a
            scalar UFL expression linear in ``step.virtual_u`` and ``step.virtual_psi``; for a
            viscous force ``lambda step: -c * ufl.dot(step.v, step.virtual_u)``. `step` is an
            `fx_beam.Step`. It is integrated with the element's reduced Gauss rule. Functions and
            constants of dolfinx are refused, as they would be read once.
        beam : Beam, optional
            Where it acts; on all beams by default.

        Raises
        ------
        SceneError
            If `term` cannot be called.
        """
        if not callable(term):
            raise SceneError(f"add_virtual_work needs a function of the step, not {term!r}")
        if beam is not None:
            self._check_beam(beam, "virtual work")
        self.virtual_works.append(VirtualWork(term, beam))

    def set_velocity(self, target: Beam | Node, velocity=(0.0, 0.0), spin=0.0) -> None:
        """Set the velocity and spin at t = 0.

        Parameters
        ----------
        target : Beam or Node
            A node, or a beam for all its nodes.
        velocity : (vx, vy) or callable
            Velocity, or ``velocity(x, y)`` at a reference position [m/s].
        spin : float or callable
            Rate of the section rotation, or ``spin(x, y)`` [rad/s].
        """
        check = self._check_beam if isinstance(target, Beam) else self._check_node
        check(target, "velocity")
        self.velocities.append(initial_velocity(target, velocity, spin))

    # -- Checks -------------------------------------------------------------------------------

    def _check_node(self, node, what: str) -> None:
        if not isinstance(node, Node):
            raise SceneError(
                f"{what}: {node!r} is no node; take one from a beam: beam.start, beam.end or "
                "beam.node(fraction)"
            )
        if node.scene is not self:
            raise SceneError(f"{what}: {node} belongs to another scene")

    def _check_beam(self, beam, what: str) -> None:
        if not isinstance(beam, Beam):
            raise SceneError(f"{what}: {beam!r} is no beam; take what add_beam returned")
        if beam.start.scene is not self or beam not in self.beams:
            raise SceneError(f"{what}: {label(beam)} belongs to another scene")

    def _free_component(self, node: Node, component: str) -> tuple[int, int]:
        if component not in COMPONENTS:
            raise SceneError(f"support of {node}: {component!r} is none of {COMPONENTS}")
        key = (node.number, COMPONENTS.index(component))
        if key in self.fixed or key in self.prescribed:
            raise SceneError(f"{component} of {node} is supported twice")
        return key
