"""Functions of several elements with few optimisations, which are compiled in half of the time."""

import functools
from contextlib import contextmanager
from unittest import mock

from fx_beam.compiled import build, form_tables

# Those of derivatives are large, and run for short: they have none. The others are small, and long
# motions call them often.
_DERIVATIVES = "work by start", "slopes of forces"
_whole = form_tables.load_batches


@functools.wraps(_whole)
def _load_batches(name, *given):
    flags = [*build.BATCH_FLAGS, "-O0" if name in _DERIVATIVES else "-O1"]
    with mock.patch.object(build, "BATCH_FLAGS", flags):
        return _whole(name, *given)


def use():
    """Compile all such functions quickly from now on."""
    form_tables.load_batches = _load_batches


@contextmanager
def not_used():
    """In this block they are compiled as in other processes."""
    with mock.patch.object(form_tables, "load_batches", _whole):
        yield
