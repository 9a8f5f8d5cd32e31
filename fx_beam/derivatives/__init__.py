"""Motions and equilibria as functions of numbers: values without set-up, and derivatives."""
