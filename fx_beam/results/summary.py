"""What a solution is and took, in a few lines, as notebooks show it."""

from __future__ import annotations

from typing import Any


def facts(solution: Any) -> dict[str, str]:
    """Range, steps, effort and energy of a solution, by their names."""
    stats, energy = solution.stats, solution.energy
    time = "load factor" if stats.static else "t"
    entries = {
        "scheme": stats.scheme,
        time: f"{solution.t[0]:g} to {solution.t[-1]:g}, {len(solution.t)} rows",
        "steps": f"{stats.steps}, {stats.halvings} halvings",
        "Newton iterations": str(stats.newton_iterations),
        "solver": f"{stats.solver}, {stats.unknowns} unknowns",
        "seconds": f"{stats.seconds:.3g}, and {stats.setup_seconds:.3g} to set up",
        "total energy": f"{energy.total[0]:.6g} to {energy.total[-1]:.6g}",
        "largest energy error": f"{abs(energy.balance_error).max():.2g}",
    }
    return entries | ({"ended early": str(stats.failure)} if stats.failure else {})
