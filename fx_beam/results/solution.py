"""Result of a simulation: motion, resultants, energies and momenta over time."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from fx_beam.errors import SceneError, answering_keywords, is_one_of, no_attribute, shown
from fx_beam.scene import outputs as quantities
from fx_beam.scene.beam import Beam, BeamPlace, Node, no_node
from fx_beam.scene.body import Body
from fx_beam.scene.contacts import Contact
from fx_beam.scene.forces_between import ForceBetween
from fx_beam.scene.joints import GROUND, Joint, key_of
from fx_beam.scene.loads import NAMES
from fx_beam.scene.notebook import html_table, sketch
from fx_beam.scene.outputs import OF_NODES, Output, component_of, is_gear, quantity_of
from fx_beam.scene.parts import Parts
from fx_beam.scene.scene import Scene

from . import export, joined, joint_and_contact_motion as over_time, member_fields
from .joint_and_contact_motion import ContactMotion, GearMotion, JointMotion, PullMotion
from .records import BeamResultants, BeamStress, Energy, Stats, facts, known_resultants, read_only
from .state import HISTORIES, State

if TYPE_CHECKING:
    from fx_beam.scene.gears import Gear


# What is set when it is first read.
_LATER = {*HISTORIES, "energy", "end"}


@answering_keywords
class Solution:
    """Motion of a scene over time, or its equilibria over the load factor.

    All arrays are read-only. With the mid-point schemes rates are projected, in the norm of the
    mass, to rates that joints and driven motions allow, and the mean forces of a step belong to
    these rates. At nodes without mass that move freely, velocities of the mid-point schemes are
    means over the step that ends at t[k], or over the last part of a halved step, and so are spins
    at nodes without rotary inertia.

    Parameters
    ----------
    histories : dict
        The histories below, by name.
    X : (n_node, 2) float
        Reference positions [m].
    energy : Energy or None
        Energies and work; None for the "energy" of `histories`.
    stats : Stats
        Statistics of the simulation.
    beams : dict
        The beams by name.
    nodes_of_beam : dict
        All nodes of each beam in order, those inside elements included.
    resultants_of_beam : callable
        ``resultants_of_beam(name)`` gives the `BeamResultants`; None where they are not known.
    variables_of_beam : dict
        Internal variables, (n, points) each, by name for each beam that has some.
    variables_of_joint : dict
        Internal variables of springs, (n,) each, by name for each number of a joint that has some.
    contacts : list of Contact
        The contacts of the scene.
    bodies : dict, optional
        The bodies by name.
    end : State or callable, optional
        The last state, its vectors by nodes, for `simulate(start=...)`, or a function that gives
        it; None after a failed run.
    names_of_parameters : sequence of str
        Names of the columns of `parameters`.
    variables_of_contact : dict, optional
        Stretch and slip (n, points, 2) [m] by the number of each contact with friction.
    turns_of_line : dict, optional
        Half turns (n, spans) of the spans of a rope over pulleys [rad], by its number.
    stability : dict, optional
        `unstable_modes` and `critical_points` of a path by their names, or functions that find them
        when they are first read.

    Attributes
    ----------
    branches : list of Solution
        The branches of a path by ``static(..., branches=...)``, each with branches of its own.
    origin : Branch or None
        Where a branch starts; None for other solutions.
    t : (n,) float
        Times [s]; in a static solution load factors.
    t_level : (n,) float
        Times at which the rows of `resultants`, `reaction`, `JointMotion.force` and
        `ContactMotion.force` hold [s]: the scheme's level in the step that ends at t[k]. With
        mid-point schemes the rows are means over the whole step, also if it was halved: the mean
        times the length of the step is the impulse. With other schemes they are values, in a halved
        step those of its last part, and in a scheme with sub-steps those of the last sub-step. Row
        0 is the start: reactions and joint forces are zero or, after `simulate(start=...)`, those
        of the last step before.
    q : (n, nodes, 3) float
        Displacements and rotation [m, rad].
    v : (n, nodes, 3) float
        Velocities and spins [m/s, rad/s]; zero in a static solution.
    a : (n, nodes, 3) float
        Accelerations [m/s^2, rad/s^2]; zero in a static solution.
    reactions : (n, nodes, 3) float
        Forces and moments of the supports on the nodes [N, N m].
    motor_forces : (n, joints) float
        Forces and moments of the joints' motors [N, N m].
    linear_momentum : (n, 2) float
        Linear momentum [kg m/s].
    angular_momentum : (n,) float
        Angular momentum about the origin [kg m^2/s].
    slides : (n, joints) float
        Slides of the joints [m]; NaN for removed joints.
    joint_forces : (n, joints, 3) float
        Forces and moments of the joints on their nodes b [N, N m].
    contact_forces : (n, contacts, 2) float
        Forces of obstacles on nodes, one obstacle after the other [N].
    line_forces : (n, lines) float
        Pulls of forces between points and ropes, by their numbers [N].
    parameters : (n, parameters) float
        Parameters in functions of your own, in the order of `Scene.parameters`.

    Examples
    --------
    A bar that rotates about a pin.

    >>> import fx_beam as fb
    >>> scene = fb.Scene(gravity=(0, -9.81))
    >>> section = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.1)
    >>> bar = scene.add_beam([(0, 0), (1, 0)], section, elements=2)
    >>> scene.pin(bar.start)
    >>> solution = fb.simulate(scene, dt=0.05, t_end=0.5)
    >>> solution.position(bar.end).shape, solution.resultants(bar).M.shape
    ((11, 2), (11, 2))
    """

    energy: Energy
    end: State | None

    def __init__(
        self,
        histories: Mapping[str, np.ndarray],
        X: np.ndarray,
        energy: Energy | None,
        stats: Stats,
        beams: dict[str, Beam],
        nodes_of_beam: dict[str, np.ndarray],
        resultants_of_beam: Callable[[str], Any],
        variables_of_beam: dict[str, dict[str, np.ndarray]],
        variables_of_joint: dict[int, dict[str, np.ndarray]],
        contacts: list[Contact],
        bodies: dict[str, Body] | None = None,
        end: State | Callable[[], State] | None = None,
        names_of_parameters: Sequence[str] = (),
        variables_of_contact: dict[int, np.ndarray] | None = None,
        turns_of_line: dict[int, np.ndarray] | None = None,
        stability: Mapping[str, Any] | None = None,
    ):
        # Histories, energies and the last state are set when they are first read.
        self._histories, self._end = histories, end
        self.X, self.contacts = read_only(X), contacts
        if energy is not None:
            self.energy = energy
        self.stats = stats
        self.beams, self.bodies = beams, bodies or {}
        self.nodes_of_beam = {name: read_only(nodes) for name, nodes in nodes_of_beam.items()}
        self.resultants_of_beam = resultants_of_beam
        self.variables_of_beam, self.variables_of_joint = variables_of_beam, variables_of_joint
        self.variables_of_contact = variables_of_contact or {}
        self.turns_of_line = turns_of_line or {}
        self.names_of_parameters = list(names_of_parameters)
        self._stability = dict(stability or {})
        self.branches: list[Solution] = []
        self.origin: Any = None
        #: The path of these equilibria, for derivatives; copies have none.
        self.load_path: Any = None
        #: Whether members store other energies than their sections do, by a user.
        self.has_own_energy = False
        #: Loads on nodes at these equilibria, and fading forces (2,) by node, for pictures.
        self.loads_on_nodes: Any = None
        #: Parts of the scene in the runs of a motion, each with its first row, for pictures.
        self.parts: tuple[tuple[int, Parts], ...] = ((0, Parts(contacts=tuple(contacts))),)

    def __getattr__(self, name: str) -> Any:
        """Attribute that is set when it is first read."""
        if name not in _LATER or "_histories" not in self.__dict__:
            raise no_attribute(self, name, dir(type(self)))
        value: Any = self._end if name == "end" else self._histories[name]
        if name in HISTORIES:
            value = read_only(value)
        self.__dict__[name] = value() if callable(value) else value
        return self.__dict__[name]

    def __dir__(self):
        return [*super().__dir__(), *_LATER]

    def __getstate__(self):
        # The function for the resultants holds the compiled model: copies get computed values.
        known = known_resultants(self)
        unread = "_histories", "_end"
        state = {name: value for name, value in self.__dict__.items() if name not in unread}
        state |= {name: getattr(self, name) for name in _LATER}
        with suppress(ValueError):  # numbers of unstable modes are found for copies
            _ = self.unstable_modes
        state["_stability"] = {n: x for n, x in self._stability.items() if not callable(x)}
        return {**state, "resultants_of_beam": known.get, "load_path": None}

    def __repr__(self):
        rows, steps = len(self.t), self.stats.steps
        count = f"{steps} steps" if rows == steps + 1 else f"{rows} rows"  # not all were recorded
        return (
            f"<Solution: {self.stats.scheme}, {count} to "
            f"{'load factor' if self.stats.static else 't ='} {self.t[-1]:g}"
            f"{f' by {self.stats.until!r}' if self.stats.until else ''}, "
            f"energy error {abs(self.energy.balance_error).max():.2g} J>"
        )

    def _repr_html_(self):
        rows = np.unique(np.linspace(0, len(self.q) - 1, 5).astype(int)) if self.has_motion else []
        lines = [
            self.X[nodes] + self.q[k, nodes, :2]
            for k in rows
            for nodes in self.nodes_of_beam.values()
        ]
        shades = [f"hsl(205 100% {85 - 50 * (k + 1) / len(self.q):.0f}%)" for k in rows]
        shades = [shade for shade in shades for _ in self.nodes_of_beam]
        return html_table("Solution", facts(self)) + sketch(lines, shades)

    @property
    def load_factor(self) -> np.ndarray:
        """Load factors (n,) of a static solution: the fraction of the loads and driven motions."""
        if not self.stats.static:
            raise ValueError("the solution is one over time, without load factors; use t")
        return self.t

    @property
    def unstable_modes(self) -> np.ndarray:
        """Numbers (n,) of modes that grow in the equilibria of a static solution.

        Without forces that follow the motion it is the number of negative eigenvalues of the
        tangent; with such forces the number of growing modes among the lowest twelve, without
        damping, where a flutter vibration counts once. In a frame that turns, Coriolis forces do
        not count.
        """
        return read_only(self._of_path("unstable_modes"))

    @property
    def stable(self) -> np.ndarray:
        """Whether the equilibria of a static solution are stable, (n,): no mode grows."""
        return self.unstable_modes == 0

    @property
    def critical_points(self) -> list[Any]:
        """The critical points between the rows of a static solution, in the order of the path.

        A list of `CriticalPoint`, found when it is first read, of the scene as it was computed. A
        point that could not be located between two rows is "not located", with a warning; where
        `unstable_modes` is refused, the list is empty, with a warning.
        """
        return list(self._of_path("critical_points"))

    def _of_path(self, name: str) -> Any:
        _ = self.load_factor  # refuses a motion
        if name not in self._stability:
            raise ValueError(
                f"{name}: a solution from a file has none, nor has a copy of one in which they "
                "were not read before. Compute the path again by static"
            )
        if callable(find := self._stability[name]):
            self._stability[name] = find()
        return self._stability[name]

    @property
    def has_motion(self) -> bool:
        """Whether displacements and rotations were recorded."""
        return len(self.q) == len(self.t)

    @property
    def has_rates(self) -> bool:
        """Whether velocities and accelerations were recorded."""
        return len(self.v) == len(self.t)

    def _of_node(self, name: str, number: int) -> np.ndarray:
        """A history (n, 3) of a node; of a record alone, if the history has not been read."""
        if name not in self.__dict__ and hasattr(self._histories, "of_node"):
            if (rows := self._histories.of_node(name, number)) is not None:
                return read_only(rows)
        return self.recorded(name)[:, number]

    def _at_node(self, name: str, node: Node) -> np.ndarray:
        """A quantity of a node: columns of a history, by the table of outputs."""
        number, quantity = _node_number(self, node), OF_NODES[name]
        rows = self._of_node(quantity.of, number)[:, quantity.columns]
        return rows + self.X[number] if quantity.is_place else rows

    # -- Motion of a node -----------------------------------------------------------------------

    def position(self, node: Node) -> np.ndarray:
        """Position of a node over time.

        Parameters
        ----------
        node : Node
            A node of the scene.

        Returns
        -------
        (n, 2) float
            Position [m].
        """
        return self._at_node("position", node)

    def displacement(self, node: Node) -> np.ndarray:
        """Displacement of a node over time.

        Parameters
        ----------
        node : Node
            A node of the scene.

        Returns
        -------
        (n, 2) float
            Displacement from the reference position [m].
        """
        return self._at_node("displacement", node)

    def rotation(self, node: Node) -> np.ndarray:
        """Rotation of a node over time.

        Parameters
        ----------
        node : Node
            A node of the scene.

        Returns
        -------
        (n,) float
            Section rotation from the reference configuration, not wrapped [rad].
        """
        return self._at_node("rotation", node)

    def velocity(self, node: Node) -> np.ndarray:
        """Velocity of a node over time.

        Parameters
        ----------
        node : Node
            A node of the scene.

        Returns
        -------
        (n, 2) float
            Velocity at t[k] [m/s].
        """
        return self._at_node("velocity", node)

    def spin(self, node: Node) -> np.ndarray:
        """Spin of a node over time.

        Parameters
        ----------
        node : Node
            A node of the scene.

        Returns
        -------
        (n,) float
            Rate of the section rotation at t[k] [rad/s].
        """
        return self._at_node("spin", node)

    def acceleration(self, node: Node) -> np.ndarray:
        """Acceleration of a node over time.

        Parameters
        ----------
        node : Node
            A node of the scene.

        Returns
        -------
        (n, 2) float
            Acceleration [m/s^2]: for the mid-point schemes the mean over the step, which holds at
            `t_level[k]`; for `Newmark` the value at t[k], for `HHT` and `GeneralizedAlpha` that at
            t[k] + (alpha_m - alpha_f) dt, after their start. Row 0 is the start.
        """
        return self._at_node("acceleration", node)

    def reaction(self, node: Node) -> np.ndarray:
        """Force and moment of the supports on a node over time.

        Parameters
        ----------
        node : Node
            A node of the scene.

        Returns
        -------
        (n, 3) float
            Force [N] and moment [N m] at `t_level[k]`; zero for components without support.
        """
        return self._at_node("reaction", node)

    # -- Joints ---------------------------------------------------------------------------------

    @overload
    def joint(self, joint: Joint) -> JointMotion: ...

    @overload
    def joint(self, joint: ForceBetween) -> PullMotion: ...

    @overload
    def joint(self, joint: Gear) -> GearMotion: ...

    def joint(self, joint: Joint | ForceBetween | Gear) -> JointMotion | PullMotion | GearMotion:
        """Angle, slide, their rates, force and motor of a joint over time; the pull of a rope.

        Parameters
        ----------
        joint : Joint, Gear or ForceBetween
            The joint, gear or rack that `Scene.add_joint` returned; or what `Scene.add_rope` or
            `Scene.add_force_between` returned.

        Returns
        -------
        JointMotion, PullMotion or GearMotion
            With `angle`, `slide`, `spin`, `rate`, `force`, `motor_force`, `motor_power`, `gap`; of
            a rope with `force` and `length`, of a gear with `force` and `difference`.
        """
        if isinstance(joint, ForceBetween):
            return self._line(joint)
        if is_gear(joint):
            gear: Any = joint
            return self._gear(gear)
        if not isinstance(joint, Joint) or not 0 <= joint.number < self.slides.shape[1]:
            raise ValueError(
                f"{shown(joint)} is not a joint of this solution; take the one that add_joint "
                "returned"
            )
        for node in (joint.a, joint.b):
            if node is not GROUND:
                _node_number(self, node)  # a joint of another scene has other nodes
        # Or the same nodes, where its number is that of another joint. Ours may be removed by now.
        known, sought = None if self.end is None else self.end.constraints, key_of(joint)
        keys = known.joints[joint.number :: -1] if known else ()
        recorded = next((key for key in keys if key.number == sought.number), sought)
        if (recorded.kind, recorded.a, recorded.b) != (sought.kind, sought.a, sought.b):
            raise ValueError(
                f"{joint} belongs to another scene; the joint of this number is here a "
                f"{recorded.kind} of the nodes {recorded.a} and {recorded.b}"
            )
        return JointMotion(self, joint)

    def _gear(self, gear: Gear) -> GearMotion:
        self.joint(gear.joint_a), self.joint(gear.joint_b)  # are they of this solution?
        if not 0 <= gear.number < self.slides.shape[1]:
            raise ValueError(f"{gear} is not in this solution; take what add_joint returned")
        return GearMotion(self, gear)

    def _line(self, line: ForceBetween) -> PullMotion:
        if not 0 <= line.number < self.line_forces.shape[1]:
            raise ValueError(
                f"{line} is not in this solution; take what add_rope or add_force_between of its "
                "scene returned"
            )
        for point in line.points:
            if isinstance(point, Node):
                _node_number(self, point)
        return PullMotion(self, line)

    # -- Parameters -----------------------------------------------------------------------------

    def parameter(self, name: str) -> np.ndarray:
        """Values of a parameter over time.

        Parameters
        ----------
        name : str
            Name of the `Parameter`.

        Returns
        -------
        (n,) float
            Its value at each row.
        """
        if name not in self.names_of_parameters:
            raise ValueError(
                f"the solution has no parameter {name!r}; it has {self.names_of_parameters}"
            )
        return self.parameters[:, self.names_of_parameters.index(name)]

    # -- Contacts -------------------------------------------------------------------------------

    def contact(self, contact: Contact) -> ContactMotion:
        """Gaps, forces and slip of a contact over time.

        Parameters
        ----------
        contact : Contact
            What `Scene.add_contact` returned, or one of `contacts`.

        Returns
        -------
        ContactMotion
            With `gap`, `force` and its parts, `slip`, and `nodes`.
        """
        known = {recorded.number: recorded for recorded in self.contacts}
        if not isinstance(contact, Contact) or contact.number not in known:
            raise ValueError(
                f"{shown(contact)} is not a contact of this solution; take the one that "
                "add_contact returned"
            )
        recorded = known[contact.number]  # also for that of its scene or of a copy
        other = recorded.shape != contact.shape and not isinstance(recorded.shape, Beam)
        if str(recorded) != str(contact) or other:
            raise ValueError(f"{contact} belongs to another scene; this solution has {recorded}")
        return ContactMotion(self, recorded)

    # -- Beams ----------------------------------------------------------------------------------

    def shape(self, beam: Beam | str) -> np.ndarray:
        """Deformed axis of a beam over time.

        Parameters
        ----------
        beam : Beam or str
            A beam or its name.

        Returns
        -------
        (n, elements * degree + 1, 2) float
            Positions of the nodes of the beam, those inside elements included [m].
        """
        nodes = self.nodes_of_beam[_beam_name(self, beam)]
        return self.X[nodes] + self.recorded("q")[:, nodes, :2]

    def resultants(self, beam: Beam | str) -> BeamResultants:
        """Stress resultants along a beam over time.

        Parameters
        ----------
        beam : Beam or str
            A beam or its name.

        Returns
        -------
        BeamResultants
            Axial force N, shear force Q and bending moment M at the arc lengths s and the times
            `t_level`. Row 0 is the start configuration. Forces of `Scene.add_virtual_work` that act
            inside a beam are not included.

        Raises
        ------
        ValueError
            If the motion was not recorded, or the rates that the scheme's resultants need.
        """
        self.recorded("q")  # they are computed from the motion
        resultants = self.resultants_of_beam(_beam_name(self, beam))
        if resultants is None:  # of a copy or a file without the rates that they need
            self.recorded("v")
        elif callable(resultants.balance):  # which reads what this solution has in use
            later = functools.partial(_balance, self, resultants.balance)
            return replace(resultants, balance=later)
        return resultants

    def stress(self, beam: Beam | str) -> BeamStress:
        """Normal and shear stresses along a beam over time, at the edges of its sections.

        Parameters
        ----------
        beam : Beam or str
            A beam or its name.

        Returns
        -------
        BeamStress
            Stresses at the arc lengths s of `resultants`, and at any places.

        Raises
        ------
        SceneError
            If the section of the beam has no sizes, or a `strain_energy`.
        ValueError
            As of `resultants`.

        Examples
        --------
        >>> import fx_beam as fb
        >>> scene, bar = fb.Scene(), fb.Section.rectangle(0.2, 0.1, **fb.materials.steel)
        >>> beam = scene.add_beam([(0, 0), (2, 0)], bar)
        >>> scene.clamp(beam.start)
        >>> load = scene.add_force(beam.end, (0.0, -1e3))
        >>> stress = fb.static(scene, linear=True).stress(beam).at(0.0)
        >>> stress.upper[-1].round(), stress.shear[-1].round()
        (array([3000000.]), array([-60000.]))
        """
        return BeamStress(self.beams[_beam_name(self, beam)], self.resultants(beam))

    def internal(self, beam: Beam | str, variable: str | None = None) -> np.ndarray:
        """An internal variable along a beam over time.

        Parameters
        ----------
        beam : Beam or str
            A beam or its name.
        variable : str, optional
            Name of one of the `InternalVariables` of its section; not needed if there is only one.

        Returns
        -------
        (n, elements * degree) float
            Values of the variable at the times t and at the arc lengths s of `resultants`.

        Raises
        ------
        ValueError
            If the motion was not recorded, or the beam has no such variable.
        """
        name = _beam_name(self, beam)
        known = self.variables_of_beam.get(name, {})
        internal_names = [name for name in known if name not in NAMES.values()]
        if variable is None and len(internal_names) == 1:
            (variable,) = internal_names
        return over_time.internal_variable(self, known, variable, f"beam {name!r}")

    def value(self, output: Output) -> np.ndarray:
        """An output over time, as `Motion` gives it at each step.

        Parameters
        ----------
        output : Output
            Any output of a part of this solution but "critical_load" and "period".

        Returns
        -------
        (n, ...) float
            Values at the times `t`, of forces at `t_level`: (n,) for a single number, (n,
            components) for several, and (n, points) for "N", "Q" and "M" of a beam. `Output.unit`
            is the unit.

        Raises
        ------
        SceneError
            For anything but an output, for "critical_load" and "period", and for parts of other
            scenes.
        ValueError
            If a needed quantity was not recorded.

        Examples
        --------
        >>> import fx_beam as fb
        >>> scene = fb.Scene(gravity=(0, -9.81))
        >>> ball = scene.add_body((0, 1), mass=1.0, inertia=0.1).centre
        >>> fall = fb.simulate(scene, dt=0.1, t_end=0.2)
        >>> fall.value(fb.Output("velocity", ball, "y")).round(3)
        array([ 0.   , -0.981, -1.962])
        """
        quantities.check_has_rows(output)
        place: Any = output.of
        name = output.quantity
        if isinstance(place, Scene):
            for node in place.nodes[:1]:
                _node_number(self, node)  # of another scene
            return getattr(self.energy, quantity_of(output).of)
        if isinstance(place, Beam):
            return getattr(self.resultants(place), name)
        if quantities.is_section_force(output):
            forces = self.resultants(place.beam).at(place.s)
            return quantities.section_value(output, forces.N[:, 0], forces.Q[:, 0], forces.M[:, 0])
        if isinstance(place, Node | BeamPlace):
            if isinstance(place, Node):
                _node_number(self, place)
            else:
                _beam_name(self, place.beam)
            return over_time.values_in(self, over_time.measured_in(self, output))
        if isinstance(place, Contact):
            contact = self.contact(place)
            rows = contact.gap.min(axis=1) if name == "gap" else contact.force.sum(axis=1)
        else:
            rows = getattr(self.joint(place), name)
        return rows if output.component is None else rows[:, component_of(output)]

    # -- Files and tables -----------------------------------------------------------------------

    save, to_csv = export.save, export.to_csv
    to_pandas, to_xarray = export.to_pandas, export.to_xarray
    then, to_paraview = joined.then, member_fields.to_paraview

    def recorded(self, name: str) -> np.ndarray:
        """A history that the `Record` may have omitted.

        Parameters
        ----------
        name : str
            Name of one of the solution's histories, such as "q".

        Returns
        -------
        (n, ...) float
            The history.
        """
        if not is_one_of(name, HISTORIES):
            raise ValueError(f"name = {shown(name)} must be one of {list(HISTORIES)}")
        rows, kind = getattr(self, name), HISTORIES[name].record
        if len(rows) != len(self.t):
            if self.stats.file and kind in ("motion", "rates"):
                raise ValueError(
                    f"{kind} not in memory: the rows are in the file {self.stats.file}, for "
                    "ParaView or pyvista; simulate without `file` in Record to have them here"
                )
            raise ValueError(f"{kind} not recorded; simulate with record=Record({kind}=True)")
        return rows


def _balance(solution: Solution, balance: Callable[[], Any]) -> Any:
    """The balance of a beam, with the solution as long as it is not known."""
    return balance()


def _node_number(solution, node: Node) -> int:
    """Number of a node of a solution."""
    if not isinstance(node, Node):
        raise no_node(node)
    X, scene = solution.X, scene_of(solution)
    other: Any = node.scene
    ok = node.number < len(X) and X[node.number].tolist() == [node.x, node.y]
    if ok and scene and other and other is not scene:  # a copy, or one that was built again
        pairs = zip(scene.nodes, other.nodes, strict=False)
        ok = all((a.x, a.y) == (b.x, b.y) for a, b in pairs)
    if not ok:
        raise SceneError(f"{node} is not a node of this solution; take a node of its scene")
    return node.number


def scene_of(solution) -> Any:
    """The scene of a solution; None for one that was read from a file."""
    first = next(itertools.chain(solution.beams.values(), solution.bodies.values()), None)
    node = first.start if isinstance(first, Beam) else getattr(first, "centre", None)
    return getattr(node, "scene", None)


def parts_in(solution, k: int) -> Parts:
    """Parts of the scene in row k of a solution; of copies and of files there are contacts only."""
    return next(parts for first, parts in solution.parts[::-1] if first <= k)


def forces_on_nodes(solution: Solution, k: int, magnify: float = 1.0) -> dict[int, np.ndarray]:
    """Forces (2,) on nodes in row k, by their numbers [N]; followers turn as in a picture."""
    loads, fading = solution.loads_on_nodes or (parts_in(solution, k).loads, {})
    t, static = solution.t[k], solution.stats.static
    forces = {node: (1 - t) * force for node, force in fading.items()}
    for load in loads:
        if load.kind != "force" or not isinstance(load.target, Node):
            continue
        node, z = load.target.number, (t if static else 1.0) * complex(*load.value(t))
        z *= np.exp(1j * magnify * solution.recorded("q")[k, node, 2]) if load.follower else 1.0
        forces[node] = forces.get(node, 0.0) + np.array([z.real, z.imag])
    return forces


def _beam_name(solution, beam: Beam | str) -> str:
    """Name of a beam of a solution."""
    if isinstance(beam, Joint):
        raise ValueError(
            f"{beam} is no beam. What belongs to it is in solution.joint(joint): angle, slide, "
            "force, and internal(variable) of its spring"
        )
    name, beams = beam.name if isinstance(beam, Beam) else beam, solution.beams
    if isinstance(beam, Beam) and name in beams and beam.nodes != beams[name].nodes:
        raise ValueError(
            f"{shown(name)} is not a beam of this solution, whose beam of this name has other "
            "nodes; take the beam of its scene, or give the name"
        )
    if not is_one_of(name, beams):
        raise ValueError(f"{shown(name)} is not a beam of this solution; it has {list(beams)}")
    return name
