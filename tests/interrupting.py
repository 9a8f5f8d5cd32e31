"""Interrupts at every place of a call: exceptions as signal handlers raise them."""

import sys


class Stop(BaseException):
    """An error that a handler of signals may raise."""


def stop():
    """Raise it."""
    raise Stop


def call_stopped_at(place, call, opcodes=False, how=stop):
    """Call a function, and `how` before one of its lines of Python, or of their instructions.

    `place` counts them from 0 on, also in all that is called. Returns whether there is that place.
    """
    left = place

    def trace(frame, event, _):
        nonlocal left
        frame.f_trace_opcodes = opcodes
        if event == ("opcode" if opcodes else "line"):
            left -= 1
            if left == -1:
                sys.settrace(None)
                how()
        return trace

    sys.settrace(trace)
    try:
        call()
    except Stop:
        pass
    finally:
        sys.settrace(None)
    return left < 0


def lines_of(call):
    """Number of lines of Python in a call, up to its progress bar and in all."""
    before = count = 0

    def trace(frame, event, _):
        nonlocal before, count
        count += event == "line"
        if frame.f_code.co_name == "progress_bar":
            before = count
        return trace

    sys.settrace(trace)
    try:
        call()
    finally:
        sys.settrace(None)
    return before, count
