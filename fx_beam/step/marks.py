"""Marks: copies of the state in C to which a loop can return."""

from __future__ import annotations

from .tables import Problem

# What of C changes in steps, beside the memory of the state.
_STRUCTS = "state", "predictor", "control"


class Mark:
    """The state in C at some time, with its past and its local errors."""

    def __init__(self, problem: Problem):
        self._problem, self._memory = problem, problem.memory.copy()
        self._numbers = [bytes(struct) for struct in _structs(problem)]

    def restore(self) -> None:
        """Have this state in C again."""
        self._problem.memory[:] = self._memory
        for struct, numbers in zip(_structs(self._problem), self._numbers, strict=True):
            struct[:] = numbers


def _structs(problem: Problem) -> list:
    """Numbers that go with the memory of the state, as bytes."""
    ffi, p = problem.ffi, problem.c
    return [ffi.buffer(ffi.addressof(p, name)) for name in _STRUCTS]
