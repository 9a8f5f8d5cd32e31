"""The same for many cases or finer steps: `sweep` and `converge`."""
