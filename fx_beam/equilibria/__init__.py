"""Equilibria: `static`, paths through limit points, their stability and branches."""
