"""Tests that share what is slow to make run in one process."""

from types import SimpleNamespace

import pytest
from conftest import pytest_xdist_make_scheduler

TESTS = {
    "tests/test_demo_ring.py::test_ring": "ring",
    "tests/test_demo_ring.py::test_ring[1]": "ring",
    "tests/test_demos.py::test_pictures[ring]": "ring",
    "tests/test_paper.py::test_numbers[ring]": "ring",
    "tests/test_demos.py::test_pictures[pendulum]": "pendulum",
    "tests/test_demo_pendulum.py::test_period[0.01-1.5]": "pendulum",
    "tests/test_paper.py::test_rows": "paper",
    "tests/test_paper.py::test_figure[3]": "paper",
    "tests/test_joints.py::test_joint[ring]": "joints",
    "tests/test_joints.py::test_joint[a::b]": "joints",
}


class Process:
    """What pytest-xdist knows of a process, and the tests that it is sent."""

    def __init__(self, name):
        self.gateway = SimpleNamespace(id=name)
        self.shutting_down, self.sent = False, []

    def send_runtest_some(self, indices):
        self.sent.append({[*TESTS.values()][i] for i in indices})

    def shutdown(self):
        self.shutting_down = True


def test_each_group_is_sent_to_one_process_as_a_whole():
    pytest.importorskip("xdist")
    option = SimpleNamespace(loadscopereorder=True)
    config = SimpleNamespace(option=option, getvalue=lambda name: ["popen"] * 2)
    scheduler = pytest_xdist_make_scheduler(config, SimpleNamespace(loadscopesched=print))
    processes = [Process("a"), Process("b")]
    for process in processes:
        scheduler.add_node(process)
        scheduler.add_node_collection(process, [*TESTS])
    scheduler.schedule()
    while scheduler.has_pending:
        for process in processes:
            for index, name in enumerate(TESTS):
                if any(name in unit for unit in scheduler.assigned_work[process].values()):
                    scheduler.mark_test_complete(process, index)
    sent = [unit for process in processes for unit in process.sent]
    assert all(len(unit) == 1 for unit in sent)
    assert sorted(next(iter(unit)) for unit in sent) == sorted(set(TESTS.values()))
    assert all(process.sent for process in processes)
