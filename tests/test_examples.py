"""Every public object shows an example, and the examples run."""

import doctest
import inspect

import pytest

import fx_beam as fb

OBJECTS = {
    name: thing for name, thing in ((n, getattr(fb, n)) for n in fb.__all__) if callable(thing)
}
FINDER, RUNNER = doctest.DocTestFinder(exclude_empty=True), doctest.DocTestRunner(verbose=False)


@pytest.fixture(scope="module")
def examples():
    """All examples of the public objects and of their methods, by object."""
    return {
        name: [test for test in FINDER.find(thing, name, globs={}) if test.examples]
        for name, thing in OBJECTS.items()
    }


def test_every_public_object_has_an_example(examples):
    names = [name for name, thing in OBJECTS.items() if inspect.getdoc(thing)]
    assert set(names) == set(OBJECTS) and len(names) > 40
    own = {name: [test for test in examples[name] if test.name == name] for name in names}
    assert [name for name in names if not own[name]] == []


def test_the_examples_of_all_public_objects_give_what_they_show(examples, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # some write files
    report = []
    for test in (test for tests in examples.values() for test in tests):
        RUNNER.run(test, out=report.append, clear_globs=True)
    assert RUNNER.failures == 0, "".join(report)
    assert RUNNER.tries > 100
