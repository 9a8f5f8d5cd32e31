"""One function for many cases, or for finer steps: `sweep` and `converge`."""
