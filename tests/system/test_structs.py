"""What Python hands over to C: by the declarations, and as a whole."""

import cffi
import numpy as np
import pytest

from fx_beam import c_library
from fx_beam.c_library import Structs

DECLARED = """
typedef double Law(double);
typedef struct {
  int ends[2];
  double *length;
} Bar;
typedef struct {
  int nodes, *dofs;
  double *mass; /* of *all */
  Law *law;
  Bar ground;
} Frame;
"""


@pytest.fixture
def frame():
    ffi = cffi.FFI()
    ffi.cdef(DECLARED)
    return Structs(ffi), ffi.new("Frame *")


def test_arrays_have_the_type_of_the_declaration(frame):
    structs, c = frame
    structs.set(c, nodes=2, dofs=np.arange(2), mass=[1, 2], law=None)
    structs.check(c)
    assert (c.dofs[1], c.mass[1]) == (1, 2.0)
    with pytest.raises(TypeError, match="float64 for C's int"):
        structs.set(c, dofs=np.array([0.5]))


def test_a_pointer_that_is_not_set_is_named(frame):
    structs, c = frame
    structs.set(c, dofs=[0], law=None)
    with pytest.raises(ValueError, match="Frame: not set: mass"):
        structs.check(c)
    structs.set(c, mass=[1], ground={"ends": [0, 1]})
    structs.check(c)


def test_threads_that_ask_at_once_get_the_same_declarations(monkeypatch):
    """Whose types alone fit each other: here another thread has them first."""
    monkeypatch.setattr(c_library, "_things", {})
    first = []

    def make():
        first.append(c_library.compiled("key", object))
        return object()

    assert c_library.compiled("key", make) is first[0]
