"""A motion in a browser while it runs: sliders for its inputs, and the mouse as a spring."""

from __future__ import annotations

import json
import logging
import math
import secrets
import sys
import webbrowser
from collections.abc import Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Event, Lock, Thread
from time import perf_counter
from typing import Any

import numpy as np
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from fx_beam.errors import StepError, finite, is_whole, positive, require, vector
from fx_beam.results.export import of_numpy

from .drawing import Drawing
from .look import Colour, Pen, theme_of
from .symbols import draw_held, draw_members, draw_moving

_log = logging.getLogger("fx_beam")
_TEMPLATE = Path(__file__).with_suffix(".html")
_ENERGIES = "kinetic", "strain", "potential", "springs", "total"
# By the clock: time for the steps of a picture, and the longest pause that they make up for [s].
_STEPPING, _LONGEST = 0.03, 0.1
# Time in which an input follows its slider, by the clock [s]; most bytes of a request.
_FOLLOWING, _LONGEST_TEXT = 0.1, 65_536
# Points of a line in pixels: 96 pixels are 72 points.
_PIXELS = 96 / 72


class LiveView:
    """A page that shows a motion while it runs, made by `live`; notebooks show it.

    Attributes
    ----------
    url : str
        Address of the page on this computer, with the token that each request needs.
    """

    def __init__(self, motion: Any, limits: Mapping[str, Any] | None, speed: float):
        self._ended = Event()
        run = _PageRun(motion, limits, speed)
        page = _TEMPLATE.read_text("utf-8").replace("/* DATA */", _text(run.description()))
        path = f"/{secrets.token_urlsafe(16)}/"
        parts = {"run": run, "page": page, "path_of_page": path, "ended": self._ended}
        handler = type("Handler", (_Handler,), parts)
        self._server = _Server(("127.0.0.1", 0), handler)
        self._server.timeout = 0.1
        self.url = f"http://127.0.0.1:{self._server.server_port}{path}"
        self._thread = Thread(target=self._serve, daemon=True, name="fx_beam live view")
        self._thread.start()

    def _serve(self) -> None:
        with self._server:
            while not self._ended.is_set():
                self._server.handle_request()

    def wait(self) -> None:
        """Open the page in a browser; return when it is ended in the browser or by Ctrl-C."""
        if not webbrowser.open(self.url):
            _log.warning("no browser could be opened; the page is %s", self.url)
        try:
            self._ended.wait()
        except KeyboardInterrupt:
            pass
        self.close()

    def close(self) -> None:
        """End the page; the motion keeps its state."""
        self._ended.set()
        self._thread.join()

    def __repr__(self):
        return f"<LiveView: {'ended' if self._ended.is_set() else self.url}>"

    def _repr_html_(self):
        return f'<iframe src="{self.url}" style="width:100%;height:42rem;border:0"></iframe>'


def live(
    motion: Any, limits: Mapping[str, tuple[float, float]] | None = None, speed: float = 1.0
) -> LiveView:
    """Page that shows a running motion, with a slider for each input and the mouse as a spring.

    The page has buttons for pause, slower, faster, reset and end, and curves of energies and
    outputs. Press the mouse on a node and pull: a spring acts between the node and the mouse, by
    ``forces`` of `Motion.step`. Inputs follow their sliders within some tenths of a second, without
    jumps of their rates. While the page runs, nothing else may use the motion.

    This process serves the page, at an address on this computer with a secret token; requests
    without the token are refused. A notebook shows the page. In a script `LiveView.wait` opens it
    in a browser.

    Parameters
    ----------
    motion : Motion
        The motion, which continues from its present state.
    limits : dict, optional
        Least and largest values of inputs by name, for their sliders. By default they are the
        present value of the input minus and plus 1, or minus and plus twice this value if that is
        more.
    speed : float
        Seconds of the motion in a second, if the computer steps that fast.

    Returns
    -------
    LiveView
        The page, with its address `url`.

    Raises
    ------
    SceneError
        For limits of an unknown input, limits that are not two rising numbers, or a speed that is
        not positive.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene(gravity=(0, -9.81))
    >>> strip = fb.Section(EA=1e4, GA=1e4, EI=0.5, rhoA=0.5, rhoI=1e-4)
    >>> arm = scene.add_beam([(0, 0), (1, 0)], strip)
    >>> scene.pin(arm.start)
    >>> load = scene.add_moment(arm.start, fb.Input("torque"))
    >>> view = fb.plot.live(fb.Motion(scene, dt=2e-3), limits={"torque": (-5, 5)})
    >>> view.url.startswith("http://127.0.0.1:")
    True
    >>> view.close()  # a script calls view.wait()
    """
    require(hasattr(motion, "snapshot"), "live: motion", motion, "an fx_beam.Motion")
    return LiveView(motion, limits, positive(speed, "live: speed"))


class _PageRun:
    """The motion of a page: what the page asks for, and what it draws."""

    def __init__(self, motion: Any, limits: Mapping[str, Any] | None, speed: float):
        self._motion, self._speed, self._lock = motion, speed, Lock()
        self._begin = motion.snapshot()
        self._take_inputs()
        for name in limits or {}:
            require(name in self._targets, "live: limits", name, f"among {[*self._targets]}")
        self._limits = {name: self._limits_of(name, limits or {}) for name in self._targets}
        drawing = Drawing(motion.state, [0])
        self._window = drawing.window
        scene = motion.scene
        #: Nodes that the mouse may pull.
        self._nodes = [node for node in scene.nodes if node.number not in scene.gone]
        self._numbers = [node.number for node in self._nodes]
        self._axes = Figure((8, 8)).add_axes((0, 0, 1, 1))
        low, high = np.array(self._window)
        (x, y), half = (low + high) / 2, max(high - low) / 2
        self._axes.set(xlim=(x - half, x + half), ylim=(y - half, y + half))
        masses = [mass for _, mass, _ in scene.masses]
        for beam in drawing.solution.beams.values():
            masses.append(beam.length * float(beam.section.values("rhoA", np.array([0.5]))[0]))
        #: All mass [kg], and the stiffness by which it swings once in a second of the clock [N/m].
        self._mass = sum(masses) or 1.0
        self._stiffness = (2 * math.pi / speed) ** 2 * self._mass
        #: Motion that is due [s], time of the clock [s], and size of the last pull [N].
        self._due, self._clock, self._pull = 0.0, perf_counter(), 0.0

    def _take_inputs(self) -> None:
        """Take the inputs of the motion as targets, which they follow from rest."""
        inputs = self._motion.inputs.items()
        self._targets = {name: np.array(x, float, ndmin=1) for name, x in inputs}
        self._inputs = {name: (x, np.zeros(len(x))) for name, x in self._targets.items()}

    def _limits_of(self, name: str, limits: Mapping[str, Any]) -> list[float]:
        if name in limits:
            low, high = vector(limits[name], 2, f"live: limits of {name!r}").tolist()
            require(low < high, f"live: limits of {name!r}", limits[name], "two numbers in order")
            return [low, high]
        values = self._targets[name]
        reach = float(np.maximum(1.0, 2 * abs(values)).max())
        return [float(values.min()) - reach, float(values.max()) + reach]

    def description(self) -> dict[str, Any]:
        """Parts of the page that stay."""
        return {"limits": self._limits, "speed": self._speed, "window": self._window}

    def answer(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Take the steps that are due, and give a picture; an error for what is no request."""
        with self._lock:
            speed, pull = finite(request["speed"], "speed", "not negative"), request["pull"]
            for name, values in request["inputs"].items():
                self._targets[name] = vector(values, len(self._targets[name]), name)
            if pull is not None:
                ok = is_whole(pull["node"], 0, len(self._nodes) - 1)
                require(ok, "node", pull["node"], "the number of a node")
                pull = pull["node"], vector(pull["to"], 2, "to"), positive(pull["times"], "times")
            if request["reset"]:
                self._motion.restore(self._begin)
                self._take_inputs()
                self._due = 0.0
            now, t, error = perf_counter(), self._motion.t, ""
            passed, self._clock = min(now - self._clock, _LONGEST), now
            self._due = self._due + speed * passed if speed else 0.0
            try:
                self._steps(speed, pull, now + _STEPPING)
            except StepError as failed:
                error, self._due = str(failed), 0.0
            ran = (self._motion.t - t) / passed
            return self._picture() | {"error": error, "ran": ran}

    def _steps(self, speed: float, pull: tuple | None, end: float) -> None:
        """Take the steps that are due, until the end of their time on the clock [s]."""
        motion, self._pull = self._motion, 0.0
        while self._due >= motion.dt:
            if perf_counter() > end:
                self._due = 0.0
                return
            part = motion.dt / (speed * _FOLLOWING)
            for name, target in self._targets.items():
                self._inputs[name] = _followed(*self._inputs[name], target, part)
            forces = {} if pull is None else self._forces(*pull)
            motion.step({name: x for name, (x, _) in self._inputs.items()}, forces)
            self._due -= motion.dt

    def _forces(self, i: int, to: np.ndarray, times: float) -> dict[Any, np.ndarray]:
        """The pull of the mouse on a node, some times as stiff as usual, with a little damping."""
        motion, node, number = self._motion, self._nodes[i], self._numbers[i]
        stiffness = times * self._stiffness
        damping = 0.2 * math.sqrt(stiffness * self._mass)
        stretch = to - (node.x, node.y) - motion.q[number, :2]
        force = stiffness * stretch - damping * motion.v[number, :2]
        self._pull = float(np.hypot(*force))
        return {node: force}

    def _picture(self) -> dict[str, Any]:
        """Lines and markers of the present state, and values for curves."""
        state = self._motion.state
        drawing = Drawing(state, [0])
        drawing.include(self._window)
        pen = Pen(self._axes, theme_of("light"), drawing.thinness)
        draw_members(pen, drawing, 0)
        draw_moving(pen, drawing, 0)
        draw_held(pen, drawing, drawing.parts(0), 0)
        energies = {name: float(getattr(state.energy, name)[0]) for name in _ENERGIES}
        outputs = {name: np.ravel(value) for name, value in self._motion.outputs.items()}
        return {
            "t": state.t[0],
            "shapes": _shapes(pen),
            "nodes": drawing.positions(self._numbers, 0),
            "targets": self._targets,
            "energies": {name: x for name, x in energies.items() if x or name == "total"},
            "outputs": {**outputs, "pull of the mouse": [self._pull]},
        }


def _followed(x: np.ndarray, rate: np.ndarray, target: np.ndarray, part: float) -> tuple:
    """A value and its rate after a part of the time in which it follows a target, as if damped."""
    away = x - target
    slope = rate + away
    decay = math.exp(-part)
    return target + (away + slope * part) * decay, (rate - slope * part) * decay


def _shapes(pen: Pen) -> list[dict[str, Any]]:
    """Areas, lines and discs of a pen, the lowest first, with gaps as null; sizes in pixels."""
    look: dict[str, Any]
    shapes = list[tuple[float, np.ndarray, dict[str, Any]]]()
    for (face, edge, width, z), areas in pen.areas.items():
        look = {"face": _written(face), "edge": _written(edge) if width else None}
        closed = (np.concatenate([area, area[:1]]) for area in areas)
        shapes += [(z, area, look | {"width": _PIXELS * width}) for area in closed]
    for (colour, width, z, dash), lines in pen.lines.items():
        look = {"edge": _written(colour), "width": _PIXELS * width}
        look |= {"dash": [_PIXELS * width * part for part in dash]}
        shapes += [(z, line, look) for line in lines]
    for (radius, face, edge, width, z), centres in pen.rings.items():
        look = {"face": _written(face), "edge": _written(edge) if width else None}
        look |= {"width": _PIXELS * width, "disc": 2 * _PIXELS * radius * pen.scale}
        shapes += [(z, places, look) for places in centres]
    return [
        look | {"points": [None if math.isnan(x) else (x, y) for x, y in points.tolist()]}
        for _, points, look in sorted(shapes, key=lambda shape: shape[0])
    ]


def _written(colour: Colour) -> str | None:
    """A colour as the page has it."""
    return None if colour == "none" else to_hex(colour)


def _text(data: dict[str, Any]) -> str:
    """Data as JSON, in which no text can end an element of a page."""
    return json.dumps(data, allow_nan=False, default=of_numpy).replace("<", "\\u003c")


class _Server(ThreadingHTTPServer):
    """Says nothing of a page that was closed."""

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Report an error, but not of a connection."""
        if not isinstance(sys.exc_info()[1], ConnectionError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    """Answers the page and its requests at the address with the token, and nothing else."""

    protocol_version = "HTTP/1.1"  # one connection for all pictures
    run: _PageRun
    page: str
    path_of_page: str
    ended: Event

    def do_GET(self) -> None:
        """The page."""
        if self._is_known(""):
            self._send(200, "text/html; charset=utf-8", self.page)

    def do_POST(self) -> None:
        """A picture, after the steps that are due; or the end."""
        if not self._is_known("picture"):
            return
        try:
            size = min(int(self.headers["Content-Length"]), _LONGEST_TEXT)
            request = json.loads(self.rfile.read(size))
            answer = _text({} if request["end"] else self.run.answer(request))
        except (ValueError, KeyError, TypeError, AttributeError, RuntimeError) as error:
            return self._send(400, "text/plain; charset=utf-8", f"not possible: {error}")
        self._send(200, "application/json", answer)
        if request["end"]:
            self.ended.set()

    def _is_known(self, name: str) -> bool:
        """Whether a request has the address of the page before its end; others find nothing."""
        path = secrets.compare_digest(self.path.encode(), (self.path_of_page + name).encode())
        host = self.headers["Host"] == f"127.0.0.1:{self.connection.getsockname()[1]}"
        known = path and host and not self.ended.is_set()
        if not known:
            self._send(404, "text/plain", "not found")
        return known

    def _send(self, status: int, kind: str, text: str) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content := text.encode())))
        self.send_header("Cache-Control", "no-store")
        self.send_header("Referrer-Policy", "no-referrer")
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *arguments: Any) -> None:
        """Say nothing."""
