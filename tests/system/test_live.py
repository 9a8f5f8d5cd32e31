"""The page on which a motion runs: what it answers, and what a browser makes of it."""

import contextlib
import http.client
import json
import os
import signal
import subprocess
import sys
import time
import urllib.parse

import browser
import numpy as np
import pytest
from scenes import assert_refused

import fx_beam as fb
from fx_beam.plot import live_page
from fx_beam.plot.look import MEMBERS

pytestmark = pytest.mark.plot
STRIP = fb.Section(EA=1e4, GA=1e4, EI=20.0, rhoA=0.5, rhoI=1e-4, retardation=1e-2)


def arm(gravity=None, **options):
    """A motion of an arm with a hub, by a torque; its tip is node 4."""
    scene = fb.Scene(gravity=gravity)
    beam = scene.add_beam([(0, 0), (1, 0)], STRIP, elements=4)
    hub = scene.add_joint(fb.Revolute(fb.GROUND, beam.start))
    scene.add_mass(beam.start, 0.0, inertia=0.05)
    scene.add_moment(beam.start, fb.Input("torque"))
    outputs = {"angle": fb.Output("angle", hub), "force": fb.Output("force", hub)}
    return fb.Motion(scene, dt=2e-3, outputs=outputs, **options)


@contextlib.contextmanager
def shown(motion, **options):
    view = fb.plot.live(motion, **options)
    try:
        yield view
    finally:
        view.close()


def send(view, text, path="picture", method="POST", **headers):
    """Status and text of an answer."""
    address = urllib.parse.urlsplit(view.url)
    connection = http.client.HTTPConnection(address.netloc, timeout=60)
    with contextlib.closing(connection):
        connection.request(method, address.path + path, text, headers)
        answer = connection.getresponse()
        return answer.status, answer.read().decode()


REQUEST = {"inputs": {}, "pull": None, "speed": 1.0, "reset": False, "end": False}


def ask(view, **request):
    status, text = send(view, json.dumps(REQUEST | request))
    assert status == 200, text
    return json.loads(text)


def run_to(view, t, **request):
    """Pictures until a time [s]; the last one."""
    until = time.monotonic() + 60
    while (picture := ask(view, **request))["t"] < t:
        assert time.monotonic() < until and not picture["error"]
    return picture


# -- What it answers -------------------------------------------------------------------------------


def test_a_motion_follows_sliders_without_jumps_and_goes_back():
    motion = arm(record=fb.Record())
    with shown(motion, limits={"torque": (-3, 3)}) as view:
        at_rest = ask(view)["outputs"]["angle"][0]
        moved = run_to(view, 1.2, inputs={"torque": [2.0]})
        assert moved["targets"] == {"torque": [2.0]} and moved["outputs"]["angle"][0] > at_rest
        assert motion.inputs["torque"] == pytest.approx(2.0, rel=1e-3)
        torques = np.diff(motion.solution().energy.work)
        # The first steps have almost none of the torque.
        assert 0 <= abs(torques[:5]).max() < 1e-3 * torques.max()
        before = motion.t
        back = ask(view, reset=True, speed=0.0)
        assert before >= 1.0 and back["t"] == 0.0 and back["targets"] == {"torque": [0.0]}
        assert ask(view, speed=0.0)["t"] == 0.0


def test_the_mouse_is_a_spring_whose_length_fades():
    motion = arm()
    with shown(motion) as view:
        to = [0.0, 1.0]
        first = ask(view)
        pulled = run_to(view, 8.0, pull={"node": 4, "to": to, "times": 10.0}, speed=20.0)
        apart = [np.hypot(*np.subtract(picture["nodes"][4], to)) for picture in (first, pulled)]
        assert apart[1] < 0.3 * apart[0] and pulled["outputs"]["pull of the mouse"][0] > 0
        assert run_to(view, pulled["t"] + 0.1)["outputs"]["pull of the mouse"] == [0.0]


def test_a_picture_has_members_supports_and_energies_of_the_state():
    motion = arm(gravity=(0.0, -9.81))
    with shown(motion) as view:
        run_to(view, 0.2)
        picture = ask(view, speed=0.0)
        assert picture["nodes"] == (motion.state.X + motion.q[:, :2]).tolist()
        assert picture["energies"]["total"] == motion.state.energy.total[0]
        (member,) = (shape for shape in picture["shapes"] if shape["edge"] == MEMBERS[0])
        assert member["points"][:5] == picture["nodes"] and len(picture["shapes"]) > 2


@pytest.mark.parametrize(
    ("limits", "words"),
    [({"force": (0, 1)}, "among"), ({"torque": (1, 0)}, "in order"), ({"torque": 3}, "2 numbers")],
)
def test_limits_of_sliders_are_two_numbers_of_an_input(limits, words):
    assert_refused(words, fb.plot.live, arm(), limits=limits)


def test_a_scene_is_no_motion():
    assert_refused("an fx_beam.Motion", fb.plot.live, fb.Scene())


def test_a_step_that_fails_is_told_and_the_motion_can_go_back():
    with shown(arm(max_halvings=0)) as view:
        failed = ask(view)
        pull = {"node": 4, "to": [0.0, 1e9], "times": 1e3}
        for _ in range(200):
            failed = failed if failed["error"] else ask(view, pull=pull)
        assert "failed" in failed["error"]
        assert ask(view, reset=True)["error"] == ""


def test_only_nodes_that_are_there_are_pulled_and_inputs_may_have_two_numbers():
    scene = fb.Scene()
    gone = scene.add_beam([(0, 0), (1, 0)], STRIP, elements=1)
    bar = scene.add_beam([(0, 1), (1, 1)], STRIP, elements=2)
    scene.remove(gone)
    scene.add_force(bar.end, fb.Input("push"))
    motion = fb.Motion(scene, dt=0.01)
    with shown(motion) as view:
        picture = ask(view)
        assert [place[1] for place in picture["nodes"]] == [1.0, 1.0, 1.0]
        pull = {"node": 2, "to": [1.0, 3.0], "times": 1.0}
        moved = run_to(view, 0.5, pull=pull, inputs={"push": [0.0, 0.1]})
        assert moved["nodes"][2][1] > 1.0 and len(moved["targets"]["push"]) == 2


def test_a_motion_that_is_used_elsewhere_is_told():
    motion = arm()
    with shown(motion) as view, motion._alone:
        status, text = send(view, json.dumps(REQUEST))
        assert status == 400 and "another thread" in text


# -- What it does not answer -----------------------------------------------------------------------


def test_nothing_is_answered_without_the_token_or_for_another_host():
    with shown(arm()) as view:
        assert send(view, "", path="", method="GET")[0] == 200
        assert send(view, "", path="", method="GET", Host="example.org")[0] == 404
        assert send(view, "", path="../", method="GET")[0] == 404
        assert send(view, "", path="x", method="GET")[0] == 404
        assert send(view, "", path="", method="PUT")[0] == 501
        other = fb.plot.live(arm())
        assert other.url.rsplit("/", 2)[1] != view.url.rsplit("/", 2)[1]
        other.close()
    assert view.url.startswith("http://127.0.0.1:") and len(view.url.rsplit("/", 2)[1]) > 20


@pytest.mark.parametrize(
    "text",
    [
        *("", "[]", "{}", "no json", '{"end": false}'),
        json.dumps(REQUEST | {"inputs": {"other": [1.0]}}),
        json.dumps(REQUEST | {"inputs": {"torque": [None]}}),
        json.dumps(REQUEST | {"pull": {"node": 99, "to": [0, 0], "times": 1}}),
        json.dumps(REQUEST | {"pull": {"node": 4, "to": [0, "x"], "times": 1}}),
        json.dumps(REQUEST | {"speed": -1}),
    ],
)
def test_what_the_page_does_not_send_changes_nothing(text):
    motion = arm()
    with shown(motion) as view:
        assert send(view, text)[0] == 400
        assert motion.t == 0.0 and motion.inputs == {"torque": 0.0}
        assert ask(view)["error"] == ""


# -- The end ---------------------------------------------------------------------------------------

SCRIPT = """
import sys
sys.path.insert(0, "tests/system")
import fx_beam as fb
from test_live import arm
view = fb.plot.live(arm())
print(view.url, flush=True)
view.wait()
print(view)
"""


@pytest.mark.parametrize("end", ["the page", "Ctrl-C"])
def test_a_script_waits_until_the_page_is_ended_or_ctrl_c(end):
    command = [sys.executable, "-c", SCRIPT]
    environment = os.environ | {"BROWSER": "true", "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as process:
        url = process.stdout.readline().strip()
        view = type("View", (), {"url": url})
        ask(view)
        if end == "the page":
            assert ask(view, end=True) == {}
        else:
            process.send_signal(signal.SIGINT)
        rest, _ = process.communicate(timeout=60)
    assert process.returncode == 0 and "ended" in rest
    with pytest.raises(OSError):
        ask(view)


# -- A browser -------------------------------------------------------------------------------------

IN_BROWSER = """
const seen = {}, frame = () => new Promise(requestAnimationFrame);
const wait = async ready => {
  for (let k = 0; !ready(); k++) {
    if (k > 3000) throw new Error("waited for " + ready);
    await frame();
  }
};
const tell = seen => fetch("picture", { method: "POST", body: JSON.stringify({ ...sent, seen }) });
const after = t => wait(() => picture.t > t);
const tip = () => picture.nodes[4];
const point = (type, place) => {
  const box = canvas.getBoundingClientRect(), [x, y] = toPixels(place);
  canvas.dispatchEvent(new PointerEvent(type, { clientX: box.left + x, clientY: box.top + y }));
};
async function use() {
  await wait(() => picture && sliders.length);
  const slider = sliders[0][2];
  seen.limits = [slider.min, slider.max, slider.value];
  slider.value = 1.5;
  slider.dispatchEvent(new Event("input"));
  await after(0.5);
  seen.torque = picture.targets.torque;
  seen.angle = picture.outputs.angle[0];
  find("reset").click();
  await wait(() => picture.t < 0.4);
  seen.back = slider.value;
  point("pointerdown", tip());
  point("pointermove", [0, 1]);
  seen.node = sent.pull.node;
  await after(0.7);
  seen.pulled = tip();
  seen.pull = picture.outputs["pull of the mouse"][0];
  point("pointerup", [0, 1]);
  await wait(() => picture.outputs["pull of the mouse"][0] === 0);
  find("pause").click();
  for (let k = 0; k < 5; k++) await frame();
  const t = picture.t;
  for (let k = 0; k < 5; k++) await frame();
  seen.paused = picture.t - t;
  find("pause").click();
  find("slower").click();
  await after(t);
  seen.speed = sent.speed;
  seen.charts = [...charts.keys()];
  const box = canvas.getBoundingClientRect();
  seen.ratio = canvas.width / box.width / (canvas.height / box.height);
  const pixels = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  seen.drawn = pixels.filter((x, i) => i % 4 === 3 && x).length;
  await tell(seen);
  find("end").click();
}
use().catch(error => tell({ error: String(error) }));
"""


@pytest.mark.slow
@browser.needed
def test_a_browser_drives_pulls_pauses_and_ends_a_motion(tmp_path, monkeypatch):
    file, told, answer = tmp_path / "live.html", [], live_page._PageRun.answer
    page = live_page._TEMPLATE.read_text("utf-8").replace(
        "</body>", f"<script>{IN_BROWSER}</script></body>"
    )
    file.write_text(page, "utf-8")
    monkeypatch.setattr(live_page, "_TEMPLATE", file)

    def listening(run, request):
        told.extend([request["seen"]] if "seen" in request else [])
        return answer(run, request)

    monkeypatch.setattr(live_page._PageRun, "answer", listening)
    with shown(arm(), limits={"torque": (-2, 2)}) as view, browser.window(view.url, tmp_path):
        assert view._ended.wait(100), told
    (seen,) = told
    assert seen["limits"] == ["-2", "2", "0"] and seen["torque"] == [1.5] and seen["back"] == "0"
    assert seen["angle"] > 0.1
    assert seen["node"] == 4 and seen["pull"] > 0 and seen["pulled"][1] > 0.1
    assert seen["paused"] == 0 and seen["speed"] == 0.5
    assert seen["charts"] == ["energies", "angle", "force", "pull of the mouse"]
    assert seen["drawn"] > 200 and seen["ratio"] == pytest.approx(1.0, abs=0.02)
