"""Every public object shows an example, and the examples run."""

import doctest

import pytest

import fx_beam as fb

OBJECTS = {name: getattr(fb, name) for name in fb.__all__ if callable(getattr(fb, name))}


@pytest.fixture(scope="module")
def examples():
    """Examples of the public objects and of their methods, by object, each run once."""
    finder, runner = doctest.DocTestFinder(), doctest.DocTestRunner(verbose=False)
    values = {}
    for name, thing in OBJECTS.items():
        report = []
        own = [test for test in finder.find(thing, name, globs={}) if test.examples]
        failed = sum(runner.run(test, out=report.append).failed for test in own)
        values[name] = [test.name for test in own], failed, "".join(report)
    return values


@pytest.mark.parametrize("name", OBJECTS)
def test_a_public_object_has_an_example_that_gives_what_it_shows(name, examples):
    own, failed, report = examples[name]
    assert name in own, f"fx_beam.{name} has no section Examples"
    assert failed == 0, report


@pytest.mark.parametrize("method", ["add_beam", "add_virtual_work"])
def test_methods_of_a_scene_have_examples(method, examples):
    assert f"Scene.{method}" in examples["Scene"][0]
